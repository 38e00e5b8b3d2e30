"""The machine file: what is known of one machine of the family before measuring."""

from __future__ import annotations

import math
from collections.abc import Iterable
from operator import ge
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from calib.arrays import FloatArray
from calib.errors import CalibrationError, RecordError, UsageError
from calib.tripod.effects.drives import geometry_tolerances
from calib.tripod.effects.effect import Placed
from calib.tripod.effects.gauges import contact_tolerances
from calib.tripod.geometry import USABLE_BAR, Geometry
from protocols.documents import (
    LARGEST_MM,
    ZERO,
    Day,
    Document,
    FigureMm,
    LengthMm,
    Name,
    Tolerance,
    Triple,
    Words,
    read_text,
    read_toml,
    refuse_empty,
    toml_text,
    triple,
    with_serial_number,
)
from protocols.machine_files import SCHEMA, USUAL_MACHINE, machine_files, machine_names, schema_of

Length = Annotated[float, Field(ge=0.001, le=LARGEST_MM)]


Frame = Literal["touched-off", "aligned", "machine"]
"""What is free when the tool is judged: a shift, as the workpiece is touched off; a shift and a
turn, as it is aligned too; nothing, as coordinates are the machine's own."""


def _somewhere(vector: Triple) -> Triple:
    # a shorter vector tells no direction
    if math.hypot(*vector) < 1e-6:
        raise ValueError("a direction, such as [0.0, 0.0, -1.0], not of length 0")
    return vector


Direction = Annotated[Triple, AfterValidator(_somewhere)]
"""Of any length but 0."""


Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Part = tuple[Fraction, Fraction]
"""Of a bar: two fractions of it from the tool end."""

Step = Annotated[float, Field(ge=1e-3, le=1e6)]
Steps = tuple[Step, Step, Step]
"""Of drives x, y, z, as firmware holds how far a motor moves a carriage."""

LineTolerance = Annotated[float, Field(ge=0.0, le=100.0)]
"""Of a parameter of a drive's line; 0: as the file states it, and what departs has a name."""

Joint = Annotated[str, Field(pattern="^-?[xyz]$")]


def _each_once(joints: tuple[str, str, str]) -> tuple[str, str, str]:
    if sorted(name[-1] for name in joints) != ["x", "y", "z"]:
        raise ValueError('each drive once, such as ["z", "-x", "y"]')
    return joints


class Instrument(Document):
    """One indicator: profile and port, what it measures, and the maker's figures in mm.

    ``axes`` are the directions it may measure along, preferred ones first. ``channel`` belongs to
    interfaces with several inputs, ``pattern`` and ``request`` to the profile ``ascii-line``;
    ``travel_mm`` is how far the spindle goes, None where nobody said it. ``pushed_in`` tells what a
    reading becomes when its spindle is pushed in, None where nobody said or tried it.
    ``serial_number``, ``certificate`` and its date say which one it is and who calibrated it.
    """

    profile: Name
    port: Name = ""
    axes: Annotated[str, Field(pattern="^[xyz]{1,3}$")] = "xyz"
    unit: Literal["mm", "inch", "µm"] = "mm"
    channel: Annotated[int, Field(ge=1, le=99)] = 1
    resolution_mm: FigureMm | None = None
    travel_mm: FigureMm | None = None
    pushed_in: Literal["larger", "smaller"] | None = None
    repeatability_mm: FigureMm | None = None
    pattern: str | None = None
    request: str | None = None
    serial_number: Words | None = None
    certificate: Words | None = None
    certificate_date: Day | None = None


class Drive(Document):
    """One linear drive with its bar: x, y and z in this order.

    The line of the carriage's joint starts at ``origin_mm``, where its coordinate is 0, and runs
    along ``direction``, of any length; the carriage is ahead of the platform. ``platform_mm`` is
    where the bar is held, from the tool; ``leg_length_mm`` and ``usable_bar`` are this bar's own.
    """

    origin_mm: Triple
    direction: Direction
    platform_mm: Triple = ZERO
    leg_length_mm: Length | None = None
    usable_bar: Part | None = None


class MotionLimits(Document):
    """How a controller may move the machine by itself, in the coordinates that it takes, mm.

    No move is longer than ``longest_mm``, none leaves the box from ``low_mm`` to ``high_mm`` (None:
    from the joint limits). A set-up begins with a move of ``preroll_mm`` from below. Read back, the
    machine is within ``reached_mm`` of where it was sent.
    """

    feed_mm_min: Annotated[float, Field(ge=1.0, le=1e6)] = 1500.0
    longest_mm: Length = 250.0
    preroll_mm: Annotated[float, Field(ge=0.01, le=1000.0)] = 10.0
    reached_mm: Annotated[float, Field(ge=1e-4, le=1.0)] = 0.01
    low_mm: Triple | None = None
    high_mm: Triple | None = None

    @model_validator(mode="after")
    def _box(self) -> MotionLimits:
        if (self.low_mm is None) != (self.high_mm is None):
            raise ValueError("low_mm and high_mm: one of them only; a box has both")
        if self.low_mm and self.high_mm and any(map(ge, self.low_mm, self.high_mm)):
            raise ValueError("low_mm and high_mm: the lowest corner first, then the highest")
        return self


SQUARE_DRIVES = (
    Drive(origin_mm=ZERO, direction=(1.0, 0.0, 0.0)),
    Drive(origin_mm=ZERO, direction=(0.0, 1.0, 0.0)),
    Drive(origin_mm=ZERO, direction=(0.0, 0.0, 1.0)),
)


class Machine(Document):
    """One machine: geometry in mm, and what its controller holds.

    ``serial_number`` tells it from others of its ``name``, and ``place`` where it is.
    Without ``drive`` the drives are the axes of the coordinates. ``workspace_mm`` is the box that
    errors of the tool are judged over, lowest and highest corner from Zero; with ``set_at_zero``
    they count from the tool's place at Zero. ``usable_bar`` are the fractions of every bar, from
    the tool end, between which joints and stand leave room for an indicator. ``procedure`` is taken
    where none is named; ``tool_tolerance_mm`` is what the tool may be off by, r.m.s., for
    ``glidecal verify``. ``frame`` is how workpieces are set on this machine: the correction is the
    best one in this frame.

    ``home_offset_mm`` are the controller's present HOME_OFFSET values, of the joints that move x, y
    and z, needed to write new ones; ``position_endstop_mm``, in its place, heights of the tool over
    Zero at which their switches trip, as firmware of printers has them; ``rotation_distance_mm``
    (Klipper) and ``steps_per_mm`` (others) what it holds for the travel of drives x, y, z;
    ``joints`` names the drive that joint 0, 1, 2 moves, ``-x`` where the joint counts against it;
    ``entered_offsets_mm`` are joint offsets already entered when the session is measured;
    ``offset_tolerance_mm`` and ``length_tolerance_mm`` are standard deviations of how far joint
    offsets and leg lengths of such machines are off, before anything is measured;
    ``length_correlation`` is that of what the legs are off by: 0.7 where all bars were cut with one
    jig, so that they are long or short together;
    ``across_tolerance_mm``, ``lean_tolerance_mrad`` and ``scale_tolerance_mm_m`` the same of where
    the line of a drive lies in each direction across it, of its direction, and of its travel;
    ``radius_tolerance_mm`` the same of the radius of all towers, where it may be a guess that
    nobody has measured; 0.4 times that of where each tower stands round the plate;
    ``plate_bow_tolerance_mm`` the same of how far a plate that the tool meets is from flat, 100 mm
    from its middle; ``platform_tilt_tolerance_mrad`` of how unequal the two bars of a leg are, in
    parts of their distance: the platform tilts by about so much as it goes out. It acts on a probe
    that is ``probe_offset_mm`` beside the tool, in x and y;
    ``printable_radius_mm`` is the circle about Zero that firmware of a printer lets the tool go
    in: rings of the program's own plate procedures follow it;
    ``adjusted`` is any name, such as a date, of the state since parts of the machine were last
    moved: sessions with other names are of another machine; ``rail_mm`` are the two places along
    every rail, from where the axes meet, at which it rests on shims or screws.
    ``plane_tilt_mrad`` is the most that a reference plane leans along a leg, and ``plane_mm`` from
    where to where along every leg, from the tool at Zero, a stand can slide on it; None: anywhere.
    ``gravity`` is the direction in which weight pulls, of any length;
    ``load`` is the weight that the tool has now, in units of its usual one: another in a session
    with a mass hung on it; ``screw_lead_mm`` is the travel of a carriage for one turn of its
    screw, if it is known; ``mdi`` tells whether its controller is given tool or joint coordinates
    by hand; ``fastest_feed_mm_min`` is how fast it moves at most: a reading taken sooner than a
    step's way needs at that is questioned, and no feed of ``motion`` is above it; ``indicator``
    are the indicators that are used with it.
    """

    schema_id: Literal["glidecal.machine/1"] = Field(alias="schema", default="glidecal.machine/1")
    name: Name = USUAL_MACHINE
    serial_number: Words | None = None
    place: Words | None = None
    leg_length_mm: Length = 310.25
    travel_max_mm: LengthMm = 60.0
    travel_min_mm: LengthMm = -100.0
    parallelogram_width_mm: Length = 80.0
    tool_radius_mm: Length = 31.0
    usable_bar: Part = USABLE_BAR
    home_offset_mm: Triple | None = None
    position_endstop_mm: Triple | None = None
    rotation_distance_mm: Steps | None = None
    steps_per_mm: Steps | None = None
    joints: Annotated[tuple[Joint, Joint, Joint], AfterValidator(_each_once)] | None = None
    entered_offsets_mm: Triple = ZERO
    offset_tolerance_mm: Tolerance = 2.0
    length_tolerance_mm: Tolerance = 0.1
    length_correlation: Annotated[float, Field(ge=0.0, le=0.95)] = 0.0
    across_tolerance_mm: LineTolerance = 0.0
    radius_tolerance_mm: LineTolerance = 0.0
    lean_tolerance_mrad: LineTolerance = 0.0
    scale_tolerance_mm_m: LineTolerance = 0.0
    plate_bow_tolerance_mm: LineTolerance = 0.0
    platform_tilt_tolerance_mrad: LineTolerance = 0.0
    probe_offset_mm: tuple[LengthMm, LengthMm] | None = None
    printable_radius_mm: Length | None = None
    adjusted: Name | None = None
    rail_mm: tuple[Length, Length] | None = None
    plane_tilt_mrad: Annotated[float, Field(ge=0.01, le=100.0)] = 5.0
    plane_mm: tuple[LengthMm, LengthMm] | None = None
    gravity: Direction = (0.0, 0.0, -1.0)
    load: Annotated[float, Field(ge=0.001, le=1000.0)] = 1.0
    screw_lead_mm: Annotated[float, Field(ge=0.001, le=1000.0)] | None = None
    mdi: Literal["tool", "joint"] = "tool"
    fastest_feed_mm_min: Annotated[float, Field(ge=1.0, le=1e6)] = 6000.0
    motion: MotionLimits | None = None
    indicator: tuple[Instrument, ...] = ()
    drive: tuple[Drive, Drive, Drive] | None = None
    workspace_mm: tuple[Triple, Triple] | None = None
    set_at_zero: bool | None = None
    procedure: str | None = None
    tool_tolerance_mm: Tolerance | None = None
    frame: Frame = "touched-off"

    @model_validator(mode="after")
    def _possible(self) -> Machine:
        try:
            geometry = self.geometry()
        except CalibrationError as problem:
            raise ValueError(str(problem)) from problem
        if self.rail_mm and self.rail_mm[0] >= self.rail_mm[1]:
            raise ValueError("rail_mm: the nearer end first, then the other")
        if self.home_offset_mm and self.position_endstop_mm:
            raise ValueError("home_offset_mm and position_endstop_mm: the same switches; state one")
        if self.radius_tolerance_mm and (not self.across_tolerance_mm or geometry.common_zero):
            raise ValueError(
                "radius_tolerance_mm: of towers around the middle, beside across_tolerance_mm"
            )
        if self.motion and self.motion.feed_mm_min > self.fastest_feed_mm_min:
            raise ValueError("motion, feed_mm_min: more than fastest_feed_mm_min")
        return self

    @property
    def title(self) -> str:
        """The name, with its serial number where one is stated."""
        return with_serial_number(self.name, self.serial_number)

    def home_at_mm(self) -> Triple | None:
        """Joint coordinates of the home switches of drives x, y, z as the file states them."""
        return self.home_offset_mm or self.tripped_at_mm(self.position_endstop_mm)

    def tripped_at_mm(self, endstop_mm: Triple | None) -> Triple | None:
        """Joint coordinates where the tool over the middle is at these heights, mm."""
        if endstop_mm is None:
            return None
        return triple((np.array(endstop_mm) + self.geometry().zero_mm).tolist())

    def holding_steps(self, steps: Triple | None) -> Machine:
        """The machine where firmware holds these ``steps``: mm for a turn, or steps per mm.

        None: as the file states. Raises UsageError for a step that is no positive number.
        """
        if steps is None:
            return self
        if not min(steps) > 0.0:
            step_words = ", ".join(f"{step:g}" for step in steps)
            raise UsageError("steps of towers x, y, z", step_words, "three numbers above 0")
        return self.model_copy(update={"rotation_distance_mm": steps, "steps_per_mm": steps})

    def tolerances_mm(self) -> FloatArray:
        """Tolerance of each base parameter ``(6,)``, in their order."""
        return np.repeat([self.offset_tolerance_mm, self.length_tolerance_mm], 3)

    def geometry_tolerances(self) -> dict[Placed, float]:
        """Laws of drives' lines, plate and platform at their places, with tolerances."""
        tolerances = self.across_tolerance_mm, self.lean_tolerance_mrad, self.scale_tolerance_mm_m
        contacts = self.plate_bow_tolerance_mm, self.platform_tilt_tolerance_mrad
        return {
            **geometry_tolerances(self.geometry(), *tolerances),
            **contact_tolerances(*contacts),
        }

    def rails_rest_mm(self) -> tuple[float, float]:
        """Where rails rest; without ``rail_mm`` the ends of the carriages' travel."""
        geometry = self.geometry()
        zero_mm = float((geometry.zero_mm - geometry.meeting_mm).mean())
        return self.rail_mm or (zero_mm + self.travel_min_mm, zero_mm + self.travel_max_mm)

    def with_drives_of(self, geometry: Geometry) -> Machine:
        """The machine with the drives' lines of a geometry, to 0.1 µm and 0.1 µrad."""
        former = self.drive or SQUARE_DRIVES
        drives = triple(
            drive.model_copy(update={"origin_mm": _rounded(at, 4), "direction": _rounded(way, 7)})
            for drive, at, way in zip(former, geometry.origin_mm, geometry.direction, strict=True)
        )
        return self.model_copy(update={"drive": drives})

    @property
    def beside_mm(self) -> Triple:
        """Where a probe meets a plate, from the tool."""
        x, y = self.probe_offset_mm or (0.0, 0.0)
        return x, y, 0.0

    @property
    def usual_procedure(self) -> str:
        """The procedure that is taken where none is named."""
        return self.procedure or "zero-max-min"

    def geometry(self) -> Geometry:
        """The nominal geometry for the mathematics."""
        drives = self.drive or SQUARE_DRIVES
        return Geometry(
            leg_length_mm=triple(drive.leg_length_mm or self.leg_length_mm for drive in drives),
            travel_max_mm=self.travel_max_mm,
            travel_min_mm=self.travel_min_mm,
            parallelogram_width_mm=self.parallelogram_width_mm,
            tool_radius_mm=self.tool_radius_mm,
            gravity=_unit_vector(self.gravity),
            screw_lead_mm=self.screw_lead_mm,
            load=self.load,
            origin_mm=triple(drive.origin_mm for drive in drives),
            direction=triple(_unit_vector(drive.direction) for drive in drives),
            platform_mm=triple(drive.platform_mm for drive in drives),
            workspace_mm=self.workspace_mm,
            set_at_zero=self.set_at_zero or False,
            usable_bar=triple(drive.usable_bar or self.usable_bar for drive in drives),
            plane_mm=self.plane_mm,
        )


def machine_text(machine: Machine, comments: Iterable[str]) -> str:
    """The machine file below ``comments``, a line each; defaults are left out."""
    content = machine.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    return toml_text({"schema": machine.schema_id, "name": machine.name, **content}, comments)


def _rounded(vector: Triple, digits: int) -> Triple:
    return triple(round(part, digits) + 0.0 for part in vector)


def _unit_vector(vector: Triple) -> Triple:
    return triple(part / math.hypot(*vector) for part in vector)


def _import_of(path: Path) -> str:
    """What makes a machine file of a file that may be a firmware's; empty for ``.toml``."""
    if path.suffix.lower() == ".toml":
        return ""
    options = "-o first.jsonl --machine-file-out printer.toml"
    return f"If it is a printer's: glidecal import {path} {options}"


def load_machine(name_or_path: Path | str | None) -> Machine:
    """A machine by name, or from a TOML file; None: the prototype of the papers.

    Raises UsageError for an unknown name and RecordError for a file that cannot be used.
    """
    name = USUAL_MACHINE if name_or_path is None else str(name_or_path)
    path = machine_files()[name] if name in machine_names() else Path(name)
    if path.name == name and not path.suffix and not path.exists():
        choices = f"{', '.join(machine_names())}, or the path of a machine file"
        raise UsageError("machine", repr(name), choices)
    try:
        machine = read_toml(path, Machine, "machine file", _import_of(path))
    except RecordError as problem:
        schema = schema_of(read_text(path, "machine file"))
        if not schema.startswith("glidecal.") or schema == SCHEMA:
            raise
        raise RecordError(
            f"machine file {path}", f"schema {schema}, another kind of machine", SCHEMA
        ) from problem
    refuse_empty(
        machine,
        f"machine file {path}",
        "at least the name of the machine, and what differs from the machine of the papers",
        f"glidecal machine writes a whole one; or name {USUAL_MACHINE} in place of the file.",
    )
    return machine
