"""Files of a Hexa Slide: the machine, where to measure, what was measured there, and the truth.

Where to measure is a table, or what ``glidecal postures --json`` wrote; measured postures are one
JSON file, the truth behind simulated ones another.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import re
from collections.abc import Iterable
from contextlib import suppress
from io import StringIO
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from calib.arrays import FloatArray
from calib.errors import CalibrationError, RecordError
from calib.hexaslide.arms import Numbers
from calib.hexaslide.geometry import (
    CHAINS,
    END_NAMES,
    LENGTH_NAME,
    LEVEL,
    NOT_UNIT,
    Box,
    ConstraintLink,
    Geometry,
    HexaSlide,
    inverse,
)
from calib.hexaslide.procedures import Procedure, ProcedureKind
from calib.hexaslide.residuals import Readings
from protocols.documents import (
    Document,
    Name,
    Words,
    describe,
    read_json,
    read_text,
    read_toml,
    toml_text,
    triple,
    with_serial_number,
)

Metres = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Vector = tuple[float, float, float]
SHORTEST_MM = 1e-3
Length = Annotated[float, Field(ge=SHORTEST_MM, le=1e6)]
Angle = Annotated[float, Field(ge=-360.0, le=360.0)]
Tolerance = Annotated[float, Field(gt=0.0, le=100.0)]
Lead = Annotated[float, Field(ge=0.1, le=1000.0)]

IN_METRES = 1
"""Number of the schema of machine files whose lengths were metres; they are read as millimetres."""


def _ordered(bounds: tuple[float, float]) -> tuple[float, float]:
    if not bounds[0] < bounds[1]:
        raise ValueError("the lower bound first, then a larger one")
    return bounds


Range = Annotated[tuple[Coordinate, Coordinate], AfterValidator(_ordered)]


def _unit_vector(rail: Vector) -> Vector:
    square = sum(part * part for part in rail)
    if abs(square - 1.0) > NOT_UNIT:
        raise ValueError(f"a unit vector; this one has the length {square**0.5:.10g}")
    if abs(rail[2]) < LEVEL:
        raise ValueError(f"a rail that is not level, |z| ≥ {LEVEL:g}")
    return rail


class Chain(Document):
    """One chain; ``rail`` is a unit vector, ``joint_mm`` on the platform.

    Without a rail the leg is telescopic, from a joint at ``start_mm`` that stands still, and has
    the length ``link_mm`` where its drive reads 0.

    ``travel_mm`` is from where to where the slider may go; ``zeros_deg`` what encoders in the joint
    on the carriage read too much: of the turn about the rail, and of the angle to it.
    """

    start_mm: Point
    rail: Annotated[Vector, AfterValidator(_unit_vector)] | None = None
    joint_mm: Point
    link_mm: Coordinate
    travel_mm: Range | None = None
    zeros_deg: tuple[Angle, Angle] = (0.0, 0.0)

    @field_validator("link_mm")
    @classmethod
    def _long_enough(cls, link_mm: float, info: ValidationInfo) -> float:
        """A telescopic leg may read its whole length, then this is none, and may be corrected."""
        if info.data.get("rail") is not None and link_mm < SHORTEST_MM:
            raise ValueError(f"{SHORTEST_MM:g} mm at least")
        return link_mm


class PostureBox(Document):
    """Bounds of the postures, lower before upper."""

    x_mm: Range
    y_mm: Range
    z_mm: Range
    theta_deg: Range
    psi_deg: Range
    phi_deg: Range

    def bounds(self) -> Box:
        """The box in metres and radians."""
        places = np.array([self.x_mm, self.y_mm, self.z_mm]) / 1000.0
        angles = np.radians([self.theta_deg, self.psi_deg, self.phi_deg])
        lower, upper = np.vstack([places, angles]).T
        return Box(lower, upper)


class LinkEnds(Document):
    """Ends of the constraint link in the frames of platform and base, and its length."""

    platform_end_mm: Point
    base_end_mm: Point
    length_mm: Length


class Tolerances(Document):
    """By how much a machine as it was built may differ from its file, standard deviations.

    ``rail_mm_per_m`` is how far a rail leads across in a metre along. They say what a reading is
    expected to be, and decide nothing in a calibration.
    """

    start_mm: Tolerance = 1.0
    rail_mm_per_m: Tolerance = 1.0
    joint_mm: Tolerance = 1.0
    link_mm: Tolerance = 1.0
    constraint_link_mm: Tolerance = 1.0

    @property
    def slider_mm(self) -> float:
        """Standard deviation of where a slider is for a posture, about."""
        return math.hypot(self.start_mm, self.joint_mm, self.link_mm)

    def of(self, names: Iterable[str]) -> FloatArray:
        """Standard deviations ``(k,)`` of parameters; what encoders read too much is not known."""
        sizes = {
            **dict.fromkeys(("Ax", "Ay", "Az"), self.start_mm),
            **dict.fromkeys(("ax", "ay"), self.rail_mm_per_m),
            **dict.fromkeys(("Bx", "By", "Bz"), self.joint_mm),
            **dict.fromkeys((*END_NAMES, LENGTH_NAME), self.constraint_link_mm),
            "l": self.link_mm,
        }
        sizes_m = [sizes.get(name, sizes.get(name.rstrip("123456"), np.inf)) for name in names]
        return np.array(sizes_m) / 1000.0


CALIBRATED = ", calibrated"
"""What the name of a calibrated machine ends with, once."""

NO_RAIL: Vector = (0.0, 0.0, 0.0)

KIND, SCHEMA_OF_MACHINE = "glidecal.hexaslide", "glidecal.hexaslide/2"


def _plain(part: Any, unit: float, key: str = "") -> Any:  # noqa: ANN401 (JSON)
    """Lists as tuples; numbers under a key that ends with ``_m`` times ``unit``."""
    if isinstance(part, list | tuple):
        return tuple(_plain(entry, unit, key) for entry in part)
    if isinstance(part, dict):
        keys = {name: f"{name}m" if _in_metres(name, unit) else name for name in part}
        return {keys[name]: _plain(value, unit, name) for name, value in part.items()}
    is_number = isinstance(part, int | float) and not isinstance(part, bool)
    return unit * part if is_number and _in_metres(key, unit) else part


def _in_metres(key: str, unit: float) -> bool:
    """Whether a key of a file whose lengths are so many millimetres is a length in metres."""
    return unit != 1.0 and key.endswith("_m")


class HexaSlideMachine(Document):
    """One Hexa Slide; checked to reach all of its box.

    ``serial_number`` tells it from others of its ``name``, and ``place`` where it is.
    ``platform_tolerance_mm`` is by how much, r.m.s. over the box, the platform may be off;
    ``lead_mm`` is that of the drives' screws, of which a wave of a rail has its period.
    """

    schema_id: Literal["glidecal.hexaslide/2"] = Field(
        alias="schema", default="glidecal.hexaslide/2"
    )
    name: Name
    serial_number: Words | None = None
    place: Words | None = None
    platform_tolerance_mm: Tolerance | None = None
    lead_mm: Lead | None = None
    chain: tuple[Chain, ...]
    box: PostureBox
    constraint_link: LinkEnds | None = None
    tolerances: Tolerances = Tolerances()

    @model_validator(mode="before")
    @classmethod
    def _of_old_file(cls, content: object) -> object:
        """A file in metres as one in millimetres.

        What a validator hands on is strict as Python is, so lists of JSON become tuples here.
        """
        if not isinstance(content, dict):
            return content
        if content.get("schema") == f"{KIND}/{IN_METRES}":
            return {**_plain(content, 1000.0), "schema": SCHEMA_OF_MACHINE}
        return _plain(content, 1.0)

    @property
    def before_calibration(self) -> str:
        """The name that the machine had before any calibration; a calibrated one has more."""
        return self.name.removesuffix(CALIBRATED)

    @property
    def title(self) -> str:
        """The name under which sessions of a machine are put together, calibrated or not."""
        return with_serial_number(self.before_calibration, self.serial_number)

    @property
    def full_name(self) -> str:
        """The name, with its serial number where one is stated."""
        return with_serial_number(self.name, self.serial_number)

    @field_validator("chain")
    @classmethod
    def _framed(cls, chain: tuple[Chain, ...]) -> tuple[Chain, ...]:
        if len(chain) != CHAINS:
            raise ValueError(f"six chains, each with its own [[chain]]; here are {len(chain)}")
        with_rail = sum(link.rail is not None for link in chain)
        if with_rail not in (0, CHAINS):
            raise ValueError(f"{with_rail} of six chains have a rail; all of them, or none")
        try:
            _geometry(chain)
        except CalibrationError as problem:
            raise ValueError(f"{problem.thing}: {problem.allowed}") from problem
        return chain

    @field_validator("box")
    @classmethod
    def _reached(cls, box: PostureBox, info: ValidationInfo) -> PostureBox:
        if "chain" in info.data:
            try:
                inverse(_geometry(info.data["chain"]), box.bounds().grid())
            except CalibrationError as problem:
                raise ValueError(f"{problem.thing}: {problem.found}") from problem
        return box

    def whole(self) -> HexaSlide:
        """The machine for the mathematics."""
        ends, link = self.constraint_link, None
        if ends is not None:
            platform_end, base_end = np.array([ends.platform_end_mm, ends.base_end_mm]) / 1000.0
            link = ConstraintLink(platform_end, base_end, ends.length_mm / 1000.0)
        travel = [chain.travel_mm or (-np.inf, np.inf) for chain in self.chain]
        zeros = np.radians([chain.zeros_deg for chain in self.chain]).ravel()
        return HexaSlide(
            _geometry(self.chain), self.box.bounds(), link, zeros, np.array(travel).T / 1000.0
        )


def machine_text(machine: HexaSlideMachine, comments: Iterable[str]) -> str:
    """The machine file below ``comments``, a line each."""
    return toml_text(machine.model_dump(mode="json", exclude_none=True), comments)


def _geometry(chain: tuple[Chain, ...]) -> Geometry:
    """Raises CalibrationError."""
    return Geometry(
        np.array([link.start_mm for link in chain]) / 1000.0,
        np.array([link.rail or NO_RAIL for link in chain]),
        np.array([link.joint_mm for link in chain]) / 1000.0,
        np.array([link.link_mm for link in chain]) / 1000.0,
    )


def load_hexaslide(path: Path | None = None) -> HexaSlideMachine:
    """The machine of a TOML file; without one the example H60. Raises RecordError."""
    shipped = Path(__file__).with_name("machines") / "hexaslide-h60.toml"
    return read_toml(path or shipped, HexaSlideMachine, "machine file")


MOST_POSTURES = 10_000


class Posture(Document):
    """One posture."""

    x_m: Metres
    y_m: Metres
    z_m: Metres
    theta_deg: Angle
    psi_deg: Angle
    phi_deg: Angle


class PostureList(BaseModel):
    """The part of a ``glidecal.postures/1`` document that counts here."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)

    postures: Annotated[tuple[Posture, ...], Field(min_length=1, max_length=MOST_POSTURES)]


COLUMNS = tuple(Posture.model_fields)
POSTURES_WITH_COLUMNS = f"1 to {MOST_POSTURES} postures with the columns {', '.join(COLUMNS)}"


def load_postures(path: Path) -> FloatArray:
    """Postures ``(p, 6)`` in metres and radians, from ``.csv`` with a header line or ``.json``.

    Raises RecordError naming the line.
    """
    if path.suffix == ".json":
        postures = read_json(path, PostureList, "posture file", POSTURES_WITH_COLUMNS).postures
    else:
        postures = _from_table(path)
    rows = np.array([[getattr(posture, name) for name in COLUMNS] for posture in postures])
    rows[:, 3:] = np.radians(rows[:, 3:])
    return rows


def _from_table(path: Path) -> tuple[Posture, ...]:
    reader = csv.DictReader(StringIO(read_text(path, "posture file")))
    if set(reader.fieldnames or ()) != set(COLUMNS):
        raise _refused(path, f"line 1: columns {', '.join(reader.fieldnames or ()) or 'none'}")
    postures = []
    for row in reader:
        try:
            numbers = {name: float(value) for name, value in row.items()}
            # JSON, so that NaN and infinity are refused in one place
            postures.append(Posture.model_validate_json(json.dumps(numbers)))
        except (TypeError, ValueError) as problem:
            reason = describe(problem) if isinstance(problem, ValidationError) else "no six numbers"
            raise _refused(path, reason=f"line {reader.line_num}: {reason}") from problem
    if not 1 <= len(postures) <= MOST_POSTURES:
        raise _refused(path, f"{len(postures)} postures")
    return tuple(postures)


def _refused(path: Path, value: str = "", *, reason: str = "") -> RecordError:
    return RecordError(f"posture file {path}", value, POSTURES_WITH_COLUMNS, reason=reason)


def unit_question(postures: FloatArray, box: Box) -> str:
    """What to ask of postures ``(p, 6)`` outside a box that would be inside in another unit.

    Metres and radians; empty where no unit explains it.
    """
    for factor, size_words in ((1000.0, "1000 times as large"), (1e-3, "a thousandth as large")):
        with suppress(CalibrationError):
            box.inside(postures * np.repeat([factor, 1.0], 3))
            return (
                f"All would be inside with lengths {size_words}: are they in the unit of the file? "
                "A procedure file has millimetres, a posture file metres (x_m)."
            )
    return ""


MeasurementsSchema = Literal["glidecal.hexaslide-measurements/1"]
TruthSchema = Literal["glidecal.hexaslide-truth/1"]
SCHEMA: MeasurementsSchema = "glidecal.hexaslide-measurements/1"
TRUTH_SCHEMA: TruthSchema = "glidecal.hexaslide-truth/1"
WHOLE_FILE = "a whole file as glidecal simulate --machine hexaslide writes it"
NUMBER_OF_POSTURE = re.compile(r"postures\.(\d+)")

LARGEST_VALUE = 100.0
Value = Annotated[float, Field(ge=-LARGEST_VALUE, le=LARGEST_VALUE)]
NoiseFigure = Annotated[float, Field(ge=0.0, le=100.0)]


class MeasuringNoise(Document):
    """Standard deviation of one measured value, both 0 where it is not known."""

    length_mm: NoiseFigure
    angle_mrad: NoiseFigure

    @model_validator(mode="after")
    def _together(self) -> MeasuringNoise:
        if (self.length_mm == 0.0) != (self.angle_mrad == 0.0):
            raise ValueError("length_mm and angle_mrad: both 0 (not known), or both larger")
        return self


class FileUnits(Document):
    """Units of the numbers under ``postures``; no others are read."""

    length: Literal["m"] = "m"
    angle: Literal["rad"] = "rad"


class MeasuredPosture(Document):
    """Six slider positions, and the values named by ``measured``."""

    sliders: tuple[Value, Value, Value, Value, Value, Value]
    values: tuple[Value, ...] = ()


class HexaSlideMeasurements(Document):
    """Everything that a calibration needs; nothing of what it is to find."""

    schema_id: MeasurementsSchema = Field(alias="schema")
    program: Name = ""
    origin: Literal["measured", "simulated"]
    seed: int | None = None
    procedure: ProcedureKind = Field(strict=False)
    measured: tuple[Name, ...]
    units: FileUnits
    noise: MeasuringNoise
    machine_file: Name
    machine: HexaSlideMachine
    postures: Annotated[tuple[MeasuredPosture, ...], Field(min_length=1, max_length=MOST_POSTURES)]

    @model_validator(mode="after")
    def _fits(self) -> HexaSlideMeasurements:
        try:
            components = self.as_procedure().measured
        except CalibrationError as problem:
            raise ValueError(str(problem)) from problem
        if components != self.measured:
            raise ValueError(
                f"measured with {self.procedure.value}: {', '.join(components) or 'nothing, []'}"
            )
        if self.procedure is ProcedureKind.CONSTRAINT_LINK and self.machine.constraint_link is None:
            raise ValueError("constraint-link needs a machine with a constraint_link")
        for number, posture in enumerate(self.postures, start=1):
            if len(posture.values) != len(components):
                count = len(posture.values)
                raise ValueError(
                    f"posture {number} has {count} values, {len(components)} are measured"
                )
        return self

    def as_procedure(self) -> Procedure:
        """The procedure with what it measures. Raises CalibrationError."""
        fixed = self.procedure is ProcedureKind.POSE_INVERSE
        procedure = Procedure.of(self.procedure.value, () if fixed else self.measured)
        return procedure.on(self.machine.whole())

    def readings(self) -> Readings:
        """The measurements as arrays, metres and radians."""
        return Readings(
            self.as_procedure(),
            np.array([posture.sliders for posture in self.postures]),
            np.array([posture.values for posture in self.postures]).reshape(len(self.postures), -1),
            self.noise.length_mm / 1000.0,
            self.noise.angle_mrad / 1000.0,
        )

    def digest(self) -> str:
        """SHA-256 of the numbers, whatever the file looks like."""
        plain = json.dumps([posture.model_dump() for posture in self.postures])
        return hashlib.sha256(plain.encode()).hexdigest()

    def text(self) -> str:
        """The file: a header, then one posture a line."""
        header = self.model_dump(mode="json", exclude={"postures"})
        rows = ",\n  ".join(posture.model_dump_json() for posture in self.postures)
        return f'{_lines(header)},\n "postures": [\n  {rows}\n ]\n}}\n'


class HexaSlideTruth(Document):
    """The machine behind simulated measurements, and their digest."""

    schema_id: TruthSchema = Field(alias="schema")
    measurements_sha256: str
    machine: HexaSlideMachine

    def text(self) -> str:
        """The file."""
        return _lines(self.model_dump(mode="json")) + "\n}\n"


def _lines(header: dict[str, object]) -> str:
    """One key a line, without the last bracket."""
    rows = (f' "{key}": {json.dumps(value, ensure_ascii=False)}' for key, value in header.items())
    return "{\n" + ",\n".join(rows)


def read_measurements(path: Path) -> HexaSlideMeasurements:
    """Raises RecordError naming the file, the place, the value and what is allowed."""
    text = read_text(path, "measurements")
    try:
        return HexaSlideMeasurements.model_validate_json(text)
    except ValidationError as problem:
        fault = NUMBER_OF_POSTURE.sub(lambda at: f"posture {int(at[1]) + 1}", describe(problem))
        raise RecordError(f"measurements {path}", reason=fault, allowed=WHOLE_FILE) from problem


def read_truth(path: Path, measured: HexaSlideMeasurements) -> HexaSlideMachine:
    """The true machine. Raises RecordError, also for the truth of other measurements."""
    truth = read_json(path, HexaSlideTruth, "truth file", WHOLE_FILE)
    if truth.measurements_sha256 != measured.digest():
        raise RecordError(
            f"truth file {path}",
            "the truth of other measurements",
            "the file that simulate --truth wrote together with the measurements",
        )
    return truth.machine


def machine_like(nominal: HexaSlideMachine, name: str, machine: HexaSlide) -> HexaSlideMachine:
    """The machine file with the numbers of another machine, box and all else as they are."""
    geometry, link = machine.geometry, machine.link
    zeros = np.degrees(machine.zeros_rad).reshape(-1, 2).tolist()
    chains = tuple(
        chain.model_copy(
            update={
                "start_mm": _point(geometry.base[k]),
                "rail": None if geometry.telescopic else tuple(geometry.rails[k].tolist()),
                "joint_mm": _point(geometry.platform[k]),
                "link_mm": 1000.0 * float(geometry.links[k]),
                "zeros_deg": tuple(zeros[k]),
            }
        )
        for k, chain in enumerate(nominal.chain)
    )
    ends = None
    if link is not None:
        ends = LinkEnds(
            platform_end_mm=_point(link.platform_end),
            base_end_mm=_point(link.base_end),
            length_mm=1000.0 * link.length_m,
        )
    return nominal.model_copy(update={"name": name, "chain": chains, "constraint_link": ends})


def _point(values_m: Numbers) -> Point:
    """A point in millimetres."""
    return triple(1000.0 * float(value) for value in values_m)
