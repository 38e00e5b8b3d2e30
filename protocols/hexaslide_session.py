"""A session of postures of a Hexa Slide: its procedure file, its events, and their state.

The record is the journal's: append-only, a digest a line, cut anywhere it opens up to its last
whole line. Lengths are millimetres, angles degrees, as the machine file has them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, cast, get_args

import numpy as np
from pydantic import Field, TypeAdapter, model_validator

from calib.arrays import FloatArray
from calib.errors import CalibrationError, RecordError, UsageError
from calib.hexaslide.geometry import CHAINS, HexaSlide
from calib.hexaslide.procedures import ANGLES, Procedure, ProcedureKind
from calib.hexaslide.residuals import Readings
from calib.hexaslide.simulation import SimulatedHexaSlide, on_link
from protocols.data_table import NUMBER
from protocols.documents import Celsius, Count, Document, Name, Seed, Words, read_toml
from protocols.hexaslide import (
    MOST_POSTURES,
    SCHEMA,
    Angle,
    Coordinate,
    FileUnits,
    HexaSlideMachine,
    HexaSlideMeasurements,
    MeasuredPosture,
    MeasuringNoise,
    NoiseFigure,
    load_postures,
    machine_like,
    unit_question,
)
from protocols.machine_files import beginning_of
from protocols.record import Meaning, Record, RecordForm, read_record
from protocols.session import Beginning, Closed, Continuation, Line, Noted, Skipped, Superseded

SessionSchema = Literal[
    "glidecal.hexaslide-session/1",
    "glidecal.hexaslide-session/2",
    "glidecal.hexaslide-session/3",
    "glidecal.hexaslide-session/4",
]
"""Of 1 every chain has a rail; from 3 on the day of an imported table can be stated, from 4 on the
machine's serial number and place."""

SCHEMA_ID: SessionSchema = get_args(SessionSchema)[-1]
PROCEDURES = Path(__file__).with_name("hexaslide_procedures")

SixMm = tuple[Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate]
PostureMmDeg = tuple[Coordinate, Coordinate, Coordinate, Angle, Angle, Angle]
"""x, y, z in millimetres, theta, psi, phi in degrees."""

Values = tuple[Coordinate, ...]
"""In the order of what is measured: millimetres, angles degrees."""


class PostureProcedure(Document):
    """What is measured in which postures, and with which noise, 0 where that is not known.

    ``measured`` empty is what the kind measures: the posture or its place, with a constraint link
    nothing but that it was reached. ``attach`` tells the operator what to attach.
    """

    schema_id: Literal["glidecal.hexaslide-procedure/1"] = Field(
        alias="schema", default="glidecal.hexaslide-procedure/1"
    )
    name: Name
    kind: ProcedureKind = Field(strict=False)
    measured: tuple[Name, ...] = ()
    attach: Words = ""
    noise_mm: NoiseFigure = 0.0
    noise_deg: NoiseFigure = 0.0
    postures: Annotated[tuple[PostureMmDeg, ...], Field(max_length=MOST_POSTURES)] = ()

    @model_validator(mode="after")
    def _measurable(self) -> PostureProcedure:
        try:
            self.whole()
        except CalibrationError as problem:
            raise ValueError(str(problem)) from problem
        if (self.noise_mm == 0.0) != (self.noise_deg == 0.0):
            raise ValueError("noise_mm and noise_deg: both 0 (not known), or both larger")
        return self

    def whole(self) -> Procedure:
        """The procedure for the mathematics. Raises CalibrationError."""
        return Procedure.of(self.kind.value, self.measured)

    def in_metres(self) -> FloatArray:
        """Postures of the procedure ``(p, 6)``, metres and radians."""
        rows = np.array(self.postures).reshape(-1, 6)
        return np.hstack([rows[:, :3] / 1000.0, np.radians(rows[:, 3:])])

    def with_postures(self, postures: FloatArray) -> PostureProcedure:
        """The procedure in postures ``(p, 6)``, metres and radians."""
        rows = np.hstack([1000.0 * postures[:, :3], np.degrees(postures[:, 3:])])
        return self.model_copy(update={"postures": tuple(map(tuple, rows.round(6).tolist()))})

    def with_noise(self, noise_mm: float | None, noise_deg: float | None) -> PostureProcedure:
        """The procedure with another noise, None: as it is. Raises UsageError for one 0 alone."""
        length_mm = self.noise_mm if noise_mm is None else noise_mm
        angle_deg = self.noise_deg if noise_deg is None else noise_deg
        if (length_mm == 0.0) != (angle_deg == 0.0):
            noise_words = f"{length_mm:g} mm and {angle_deg:g}°"
            raise UsageError(
                "--noise-mm and --noise-deg", noise_words, "both 0 (not known), or neither"
            )
        return self.model_copy(update={"noise_mm": length_mm, "noise_deg": angle_deg})


def procedure_names() -> tuple[str, ...]:
    """Names of the procedures that come with the program."""
    return tuple(sorted(path.stem for path in PROCEDURES.glob("*.toml")))


def load_posture_procedure(source: str, posture_file: Path | None = None) -> PostureProcedure:
    """A procedure by name or file, in the postures of a table where one is given.

    Raises UsageError for a name, RecordError for a file.
    """
    path = Path(source)
    if source in procedure_names():
        path = PROCEDURES / f"{source}.toml"
    elif not path.suffix:
        raise UsageError("procedure", repr(source), f"{', '.join(procedure_names())}, or a file")
    procedure = read_toml(path, PostureProcedure, "procedure file")
    return (
        procedure if posture_file is None else procedure.with_postures(load_postures(posture_file))
    )


def commands(machine: HexaSlideMachine, procedure: PostureProcedure) -> PostureCommands:
    """Where the sliders are sent for the postures of a procedure.

    With a constraint link the platform is up or down so far that its ends are as far apart as it is
    long: a rigid one holds it there, and an indicator in it has little travel. Raises RecordError
    naming the posture that cannot be.
    """
    hexaslide, postures = machine.whole(), procedure.in_metres()
    try:
        linked = procedure.kind is ProcedureKind.CONSTRAINT_LINK
        if linked and hexaslide.link is None:
            raise RecordError("machine file", "no [constraint_link]", "one for this procedure")
        postures = hexaslide.inside(postures)
        if linked and len(postures):
            postures = on_link(hexaslide, postures)
        sliders = hexaslide.sliders_at(postures)
    except CalibrationError as problem:
        raise RecordError(
            f"procedure {procedure.name}, {problem.thing}",
            problem.found,
            problem.allowed,
            unit_question(postures, hexaslide.box)
            or "Give postures of this machine with --posture-file: glidecal postures finds them.",
        ) from problem
    return PostureCommands(procedure.with_postures(postures), 1000.0 * sliders)


@dataclass(frozen=True, eq=False)
class PostureCommands:
    """A procedure with the postures that are reached, and the sliders ``(p, 6)`` for them, mm."""

    procedure: PostureProcedure
    sliders_mm: FloatArray

    def of(self, posture: int) -> SixMm:
        """Commands of a posture, counted from 1."""
        return cast("SixMm", tuple(self.sliders_mm[posture - 1].round(4).tolist()))


def typed_values(text: str, procedure: Procedure) -> tuple[SixMm | None, Values]:
    """What an operator typed: the sliders, where a rigid link holds them, then the values.

    Raises UsageError for anything but so many numbers.
    """
    sliders = CHAINS if procedure.has_rigid_link else 0
    names = [*(f"slider {k}" for k in range(1, sliders + 1)), *procedure.measured]
    fields = text.split()
    units = "mm, angles in degrees" if set(procedure.measured) & set(ANGLES) else "mm"
    requirement = f"{len(names)} numbers: {', '.join(names)}, in {units}"
    faults = [word for word in fields if not NUMBER.fullmatch(word) or abs(float(word)) > LARGEST]
    if faults:
        hint = "Write decimals with a point, spaces between." if "," in faults[0] else ""
        raise UsageError("the input", repr(faults[0]), requirement, hint)
    if len(fields) != len(names):
        raise UsageError("the input", f"{len(fields)} numbers", requirement)
    numbers = tuple(float(word) for word in fields)
    return (cast("SixMm", numbers[:CHAINS]) if sliders else None), numbers[sliders:]


FIRST_APPROACH = "Come to the first posture with all sliders going up: play goes by it."
"""Which way they came to the others follows from the posture before."""

LARGEST = 1e5
"""Of a value that is typed, mm or degrees."""


def simulated_truth(session: PostureSession) -> HexaSlideMachine:
    """The machine behind a simulated session. Raises UsageError for one that was measured."""
    opened = session.opened
    if opened.truth is not None:
        return opened.truth
    if opened.seed is None:
        raise UsageError(f"session {session.name}", opened.origin, "a simulated one")
    planned = commands(opened.machine, opened.procedure)
    true = SimulatedPostures(opened.machine, planned, opened.seed).truth
    nominal = opened.machine
    return machine_like(nominal, nominal.name, replace(true, box=nominal.whole().box))


class SimulatedPostures:
    """What an operator would read and type on a simulated machine."""

    def __init__(
        self,
        machine: HexaSlideMachine,
        planned: PostureCommands,
        seed: int,
        truth: HexaSlideMachine | None = None,
    ) -> None:
        procedure = planned.procedure.whole().on(machine.whole())
        tolerances = machine.tolerances.of(procedure.parameters)
        true = None if truth is None else truth.whole()
        self._machine = SimulatedHexaSlide(procedure, machine.whole(), tolerances, seed, true)
        self._planned = planned
        noise_mm, noise_deg = planned.procedure.noise_mm, planned.procedure.noise_deg
        self._noise = np.array([noise_mm / 1000.0, np.radians(noise_deg)])

    @property
    def truth(self) -> HexaSlide:
        """The machine behind what is read."""
        return self._machine.truth

    def typed(self, posture: int, attempt: int) -> str:
        """What is typed in a posture, counted from 1, the first time or later. Raises as
        `SimulatedHexaSlide.read`.
        """
        planned, procedure = self._planned, self._planned.procedure.whole()
        posture_m = planned.procedure.in_metres()[posture - 1]
        target_m = np.array(planned.of(posture)) / 1000.0
        sliders, values = self._machine.read(posture_m, target_m, posture, attempt, self._noise)
        angular = np.array([name in ANGLES for name in procedure.measured], dtype=bool)
        display_values = np.where(angular, np.degrees(values), 1000.0 * values)
        numbers = [*(1000.0 * sliders if procedure.has_rigid_link else []), *display_values]
        return " ".join(f"{number:.5f}" for number in numbers)


class PosturesOpened(Beginning):
    """First line: the schema, and everything known before measuring.

    ``truth`` is the simulated machine where it is that of an earlier session; else it comes from
    ``seed``. ``indicator`` is ``PROFILE:PORT``.
    """

    schema_id: SessionSchema = Field(alias="schema", default=SCHEMA_ID)
    machine: HexaSlideMachine
    machine_file: Name
    procedure: PostureProcedure
    operator: Name = ""
    temperature_c: Celsius | None = None
    seed: Seed | None = None
    truth: HexaSlideMachine | None = None
    indicator: Name = ""
    remarks: tuple[Name, ...] = ()


class PostureReading(Line):
    """One posture: where the sliders were, and what was measured there.

    ``text`` is what was typed or stood in the table.
    """

    event: Literal["reading"] = "reading"
    reading: Count
    posture: Count
    sliders_mm: SixMm
    values: Values = ()
    text: str


class PosturesContinued(Continuation):
    """The session goes on after an interruption; bytes of a torn last line were set aside."""

    schema_id: SessionSchema = Field(alias="schema", default=SCHEMA_ID)


PostureEvent = Annotated[
    PosturesOpened | PostureReading | Superseded | Skipped | Noted | PosturesContinued | Closed,
    Field(discriminator="event"),
]
POSTURE_EVENT: TypeAdapter[PostureEvent] = TypeAdapter(PostureEvent)


class PostureMeaning(Meaning):
    """Readings have the values that are measured, too, and name postures that there are."""

    opened = PosturesOpened

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._opened: PosturesOpened | None = None

    def check(self, number: int, event: PostureEvent) -> None:
        """Raises RecordError with the line number."""
        if isinstance(event, PosturesOpened):
            self._opened = event
        elif isinstance(event, PostureReading):
            self.count(number, event.reading)
            self._check_reading(number, event)
        else:
            super().check(number, event)

    def _check_reading(self, number: int, event: PostureReading) -> None:
        assert self._opened is not None, "line 1 opens"
        procedure = self._opened.procedure
        count = len(procedure.whole().measured)
        if len(event.values) != count:
            raise self.error(number, f"{len(event.values)} values", f"{count} are measured")
        if procedure.postures and event.posture > len(procedure.postures):
            requirement = f"1 … {len(procedure.postures)}, as in the procedure"
            raise self.error(number, f"posture {event.posture}", requirement)


POSTURE_FORM = RecordForm(SCHEMA_ID, POSTURE_EVENT, PosturesContinued, PostureMeaning)
"""Of sessions of postures."""


@dataclass(frozen=True)
class PostureSession:
    """State of a session after its events: ``readings`` that count, in the order taken, all that
    were taken, the reason why others do not count, and by posture why one was left out.
    """

    opened: PosturesOpened
    readings: tuple[PostureReading, ...]
    all_readings: tuple[PostureReading, ...]
    superseded: dict[int, str]
    skipped: dict[int, str]
    notes: tuple[str, ...]
    name: str = ""

    @property
    def next_posture(self) -> int | None:
        """The first posture that is neither measured nor left out, from 1; None: all are done."""
        settled = {reading.posture for reading in self.readings} | self.skipped.keys()
        numbers = range(1, len(self.opened.procedure.postures) + 1)
        return next((number for number in numbers if number not in settled), None)

    def only(self, reading: PostureReading) -> Readings:
        """One reading for the mathematics."""
        return replace(self, readings=(reading,)).measurements().readings()

    def measurements(self) -> HexaSlideMeasurements:
        """What counts, for the mathematics. Raises RecordError for a session without readings."""
        opened, procedure = self.opened, self.opened.procedure
        if not self.readings:
            raise RecordError(f"session {self.name}", "no reading in use", "one at least")
        names = procedure.whole().measured
        units = [np.radians(1.0) if name in ANGLES else 1e-3 for name in names]
        return HexaSlideMeasurements(
            schema=SCHEMA,
            program=opened.program,
            origin="simulated" if opened.origin == "simulated" else "measured",
            seed=opened.seed,
            procedure=procedure.kind,
            measured=names,
            units=FileUnits(),
            noise=MeasuringNoise(
                length_mm=procedure.noise_mm,
                angle_mrad=1000.0 * float(np.radians(procedure.noise_deg)),
            ),
            machine_file=opened.machine_file,
            machine=opened.machine,
            postures=tuple(
                MeasuredPosture(
                    sliders=cast("SixMm", tuple(mm / 1000.0 for mm in reading.sliders_mm)),
                    values=tuple(
                        unit * value for unit, value in zip(units, reading.values, strict=True)
                    ),
                )
                for reading in self.readings
            ),
        )


def fold_postures(events: Iterable[object]) -> PostureSession:
    """The state after these events; the first one must be `PosturesOpened`."""
    recorded = cast("Sequence[PostureEvent]", tuple(events))
    opened = recorded[0]
    assert isinstance(opened, PosturesOpened)
    readings = tuple(event for event in recorded if isinstance(event, PostureReading))
    superseded: dict[int, str] = {}
    skipped: dict[int, str] = {}
    for event in recorded:
        match event:
            case Superseded():
                superseded |= dict.fromkeys(event.readings, event.reason)
            case Skipped():
                skipped |= dict.fromkeys(event.steps, event.reason)
            case PostureReading():
                skipped.pop(event.posture, None)
    return PostureSession(
        opened,
        tuple(reading for reading in readings if reading.reading not in superseded),
        readings,
        superseded,
        skipped,
        tuple(event.text for event in recorded if isinstance(event, Noted)),
    )


def read_postures(path: Path) -> tuple[PostureSession, Record]:
    """A session and its record. Raises RecordError as `read_record`, and for measurements alone."""
    if SCHEMA.encode() in beginning_of(path):
        raise RecordError(f"session {path}", "a file of measurements", "a session")
    record = read_record(path, POSTURE_FORM)
    return replace(fold_postures(record.events), name=path.name), record
