"""A procedure is data: one object gives the step list, the time estimate and the limit check."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, compress, pairwise, permutations, product
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator

from calib.arrays import LEG_NAMES, TOOL
from calib.errors import RecordError, UsageError
from calib.tripod.geometry import Geometry
from protocols.documents import (
    ZERO,
    Document,
    LengthMm,
    Name,
    Seed,
    Tolerance,
    Triple,
    line_of,
    read_text,
    read_toml,
    triple,
)
from protocols.machine import Instrument, Machine

Leg = Literal["x", "y", "z"]
Touched = Literal["x", "y", "z", "tool"]
"""A leg, or the tool itself, as against a plate."""
Level = Literal["zero", "max", "min"] | LengthMm
Key = tuple[str | int, ...]
"""Where in a procedure file something stands."""

SUBJECT = "procedure file"
PROCEDURES = Path(__file__).with_name("procedures")
MOST_STEPS = 20_000
"""Four days of measuring at 20 s a step."""

ALL_AXES: tuple[Leg, ...] = ("x", "y", "z")
BOTH = ("xyz", "xyz")
"""Two indicators that may measure along any axis."""


USUAL_PRINTABLE_MM = 100.0
"""The printable radius that rings of the program's own plate procedures are for: 80 mm of it."""

SLIDING = -1.0
"""Station of a mounting that has several, on a reference plane."""


class Plane(Document):
    """Readings of legs over a reference plane on which the stand slides (papers/000, fig. 4a).

    In each posture of ``levels`` every leg across an axis of ``axes`` is read along that axis at
    all ``stations``, which are fractions of the bar in that posture.
    """

    axes: Annotated[tuple[Leg, ...], Field(min_length=1)] = ("z",)
    stations: Annotated[
        tuple[Annotated[float, Field(gt=0.0, lt=1.0)], ...], Field(min_length=2)
    ] = (0.1, 0.9)
    levels: Annotated[tuple[Level, ...], Field(min_length=1)] = ("zero", "max", "min")

    @model_validator(mode="after")
    def _differ(self) -> Plane:
        if len({0.0 if level == "zero" else level for level in self.levels}) < 2:
            raise ValueError(
                "levels: one posture only; two at least: in one the plane's tilt looks like a leg's"
            )
        if len(set(self.stations)) < len(self.stations) or len(set(self.axes)) < len(self.axes):
            raise ValueError("axes and stations: one of them twice; each may be named once")
        return self


class Plate(Document):
    """Readings of the tool along one coordinate, as against a plate, instead of readings of legs.

    Positions from Zero are the corners of a regular figure of ``points`` on each circle of
    ``radii_mm`` (0: its middle) at each of ``heights_mm`` along ``axis``, then ``positions_mm``.
    Before each reading the tool lifts off by ``lift_mm`` along ``axis``; 0: it slides there.
    """

    axis: Leg = "z"
    radii_mm: tuple[Annotated[float, Field(ge=0.0, le=10_000.0)], ...] = ()
    points: Annotated[int, Field(ge=2, le=1000)] = 6
    heights_mm: Annotated[
        tuple[Annotated[float, Field(ge=-10_000.0, le=10_000.0)], ...], Field(min_length=1)
    ] = (0.0,)
    positions_mm: tuple[Triple, ...] = ()
    lift_mm: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0

    @model_validator(mode="after")
    def _differ(self) -> Plate:
        corners = sum(self.points if radius else 1 for radius in self.radii_mm)
        count = len(self.heights_mm) * corners + len(self.positions_mm)
        if count > MOST_STEPS:
            raise ValueError(f"{count} positions; up to {MOST_STEPS} can be measured")
        if len(set(self.places_mm())) < 2:
            raise ValueError("one position only; at least two different ones are needed")
        return self

    def within(self, printable_mm: float) -> Plate:
        """The plate with rings of the same part of a printable circle of this radius."""
        factor = printable_mm / USUAL_PRINTABLE_MM
        radii = tuple(round(factor * radius, 3) for radius in self.radii_mm)
        return self.model_copy(update={"radii_mm": radii})

    def places_mm(self) -> list[Triple]:
        """Every position in the order given, mm."""
        return [
            *(
                self._place(radius, number, height)
                for height in self.heights_mm
                for radius in self.radii_mm
                for number in range(self.points if radius else 1)
            ),
            *self.positions_mm,
        ]

    def _place(self, radius: float, number: int, height: float) -> Triple:
        """The first corner lies along the second of the other coordinates; on a micrometre."""
        angle = math.tau * (0.25 + number / self.points)
        # + 0.0: a rounded -0.0 would be shown with its sign
        across = iter((round(radius * math.cos(angle), 3), round(radius * math.sin(angle), 3)))
        return triple(height if name == self.axis else next(across) + 0.0 for name in ALL_AXES)


class Procedure(Document):
    """What is measured, in which order. Levels and stations are visited in the order given.

    With ``order = "free"`` the levels after Zero may be shuffled in each cycle; ``random_seed``
    does it. Readings are stable when they stay within ``tolerance_mm`` for ``window_s``; a reading
    nearer than ``repeat_limit_mm`` to what is expected of it is never questioned. With
    ``plate`` the tool itself is read at positions; then there are no legs, stations and levels.
    """

    schema_id: Literal["glidecal.procedure/1"] = Field(alias="schema")
    name: Name
    title: Name
    description: Name = ""
    legs: Annotated[tuple[Leg, ...], Field(min_length=1)] = ("x", "y", "z")
    stations: Annotated[
        tuple[Annotated[float, Field(gt=0.0, lt=1.0)], ...], Field(min_length=1)
    ] = (0.5,)
    cycles: Annotated[int, Field(ge=1, le=100)]
    levels: tuple[Level, ...] = ()
    plate: Plate | None = None
    plane: Plane | None = None
    return_to_zero: bool = True
    seconds_per_step: Annotated[float, Field(gt=0.0, le=3600.0)] = 20.0
    order: Literal["fixed", "free"] = "fixed"
    random_seed: Seed | None = None
    window_s: Annotated[float, Field(ge=1e-3, le=60.0)] = 1.0
    tolerance_mm: Annotated[Tolerance, Field(le=1.0)] = 0.004
    repeat_limit_mm: Tolerance = 0.05

    @model_validator(mode="after")
    def _sensible(self) -> Procedure:
        levels = [0.0 if level == "zero" else level for level in self.levels]
        if self.plate is not None and levels:
            raise ValueError("levels and plate: legs are read at levels, the tool at a plate; one")
        if self.plate is not None and self.plane is not None:
            raise ValueError("plane and plate: the tool is read at a plate, legs over a plane; one")
        from_zero = bool(levels) or self.plane is None
        if self.plate is None and from_zero and len(set(levels)) < 2:
            raise ValueError("levels: one posture only; at least two different ones are needed")
        steps = len(self.legs) * len(self.stations) * self.cycles * len(self.levels)
        if self.plate is not None:
            steps = self.cycles * len(self.plate.places_mm())
        if self.plane is not None:
            over = self.plane
            plane_steps = len(self.legs) * len(over.axes) * len(over.stations) * len(over.levels)
            steps += self.cycles * plane_steps
        if steps > MOST_STEPS:
            raise ValueError(f"{steps} steps; up to {MOST_STEPS} can be measured")
        if len(set(self.legs)) < len(self.legs) or len(set(self.stations)) < len(self.stations):
            raise ValueError("legs and stations: one of them twice; each may be named once")
        if self.order == "free" and len(set(levels)) < len(levels):
            raise ValueError('order = "free": a level is there twice; only "fixed" keeps its order')
        if self.random_seed is not None and self.order == "fixed":
            raise ValueError('random_seed: the order of this procedure is its purpose ("fixed")')
        return self

    def steps(self, geometry: Geometry, axes: Sequence[str] = BOTH) -> tuple[Step, ...]:
        """Every step in order, for one or two indicators.

        ``axes`` names for each indicator the directions it may measure along; the axes of a step
        stand in the order of the indicators. With one the leg is measured twice, once for each
        axis. Raises as `check_limits`, and UsageError where the indicators do not fit a leg.
        """
        self.check_limits(geometry)
        steps = self._of_tool(self.plate) if self.plate else self._of_legs(geometry, axes)
        if self.plane is not None:
            from_zero = steps if self.levels else ()
            steps = chain(from_zero, self._over_plane(self.plane, geometry, axes))
        return tuple(replace(step, number=number) for number, step in enumerate(steps, start=1))

    def indicators_used(self, instruments: Sequence[Instrument]) -> tuple[Instrument, ...]:
        """The indicators that read: the tool, or over planes alone, the first along each axis.

        Raises UsageError where none may.
        """
        if self.levels:
            return tuple(instruments)
        along = self.plane.axes if self.plane else (self.plate.axis,) if self.plate else ()
        axes = [instrument.axes for instrument in instruments]
        numbers = {self._reading_along(axis, axes) for axis in along}
        return tuple(
            instrument for number, instrument in enumerate(instruments) if number in numbers
        )

    def _reading_along(self, axis: str, axes: Sequence[str]) -> int:
        """Number of the first indicator that may measure along an axis."""
        for number, directions in enumerate(axes):
            if axis in directions:
                return number
        choices = " and ".join(f"@{directions}" for directions in axes) or "none"
        at = "at the tool" if self.plate else "over the plane"
        raise UsageError(f"indicator of {self.name}", choices, f"one along {axis}, {at}")

    def _of_tool(self, plate: Plate) -> Iterator[Step]:
        for cycle in range(1, self.cycles + 1):
            places = plate.places_mm()
            if self.random_seed is not None:
                random.Random(f"{self.random_seed}/tool/{cycle}").shuffle(places)
            if self.return_to_zero and places[0] != ZERO:
                places.insert(0, ZERO)
            for place in places:
                yield Step(0, "tool", 0.0, cycle, 0.0, (plate.axis,), place)
        if self.return_to_zero:
            yield Step(0, "tool", 0.0, self.cycles, 0.0, (plate.axis,), ZERO)

    def _of_legs(self, geometry: Geometry, axes: Sequence[str]) -> Iterator[Step]:
        for station, leg in product(self.stations, self.legs):
            for step_axes in axes_on_leg(leg, axes):
                for cycle, at in self._visits(geometry, self.levels, f"{leg}/{station}"):
                    yield Step(0, leg, at, cycle, station, step_axes)

    def _over_plane(self, plane: Plane, geometry: Geometry, axes: Sequence[str]) -> Iterator[Step]:
        for axis, leg in product(plane.axes, self.legs):
            if leg == axis:
                continue
            first = self._reading_along(axis, axes)
            for cycle, at in self._visits(geometry, plane.levels, f"{leg}/over {axis}"):
                for station in plane.stations:
                    yield Step(0, leg, at, cycle, station, (axis,), None, True, first)

    def _visits(
        self, geometry: Geometry, visited_levels: Sequence[Level], seed: str
    ) -> Iterator[tuple[int, float]]:
        """Cycle and displacement of each posture of a set-up, in their order.

        Zero first in a cycle where it is checked, shuffled where asked for, Zero at the end.
        """
        for cycle in range(1, self.cycles + 1):
            levels = [_displacement(level, geometry) for level in visited_levels]
            if self.random_seed is not None:
                nonzero = [level for level in levels if level != 0.0]
                # seeded by text: the same order in every version of Python, for both axes of a leg
                random.Random(f"{self.random_seed}/{seed}/{cycle}").shuffle(nonzero)
                levels = [level for level in levels if level == 0.0] + nonzero
            if self.return_to_zero and levels[0] != 0.0:
                levels.insert(0, 0.0)
            yield from ((cycle, level) for level in levels)
        if self.return_to_zero:
            yield self.cycles, 0.0

    def check_limits(self, geometry: Geometry, path: Path | None = None) -> None:
        """Raises RecordError for the first level, or position, outside the joint limits.

        UsageError for readings of legs whose bars do not reach to lie along their drives. With the
        ``path`` of its file the error names the line.
        """
        if self.plate is None and not geometry.reads_legs:
            raise UsageError(
                f"procedure {self.name}",
                "readings of legs, on a machine whose bars are nowhere along their drives",
                "a procedure with [plate], readings of the tool",
                "plate-rings is one.",
            )
        limits = f"the joint limits {geometry.travel_min_mm:g} … {geometry.travel_max_mm:g} mm"
        coordinate, requirement = "level", limits
        if self.plate is not None:
            coordinate, requirement = "position", f"a position that the bars reach within {limits}"
        elif not geometry.common_zero:
            requirement = f"places that the bars of every leg reach within {limits}"
        for key, value in self._beyond_limits(geometry):
            next_step = f"Change the {coordinate}, or the limits in the machine file."
            raise RecordError(
                f"{self._where(path, key)}, {coordinate}", value, requirement, next_step
            )

    def _beyond_limits(self, geometry: Geometry) -> Iterator[tuple[Key, str]]:
        """Positions, or levels, that the machine does not allow, with their place in the file."""
        if self.plate is not None:
            places = self.plate.places_mm()
            for place in compress(places, ~geometry.stands(np.array(places))):
                yield ("plate",), position_words(place)
        levels: list[tuple[Key, Level]] = [(("levels", k), v) for k, v in enumerate(self.levels)]
        if self.plane is not None:
            levels += [(("plane", "levels", k), v) for k, v in enumerate(self.plane.levels)]
        for (key, level), leg in product(levels, self.legs):
            mm = _displacement(level, geometry)
            if not leg_within(leg, mm, geometry):
                yield key, f"{mm:g} mm" if geometry.common_zero else f"{mm:g} mm of leg {leg}"

    def check_bars(self, geometry: Geometry, path: Path | None = None) -> None:
        """Raises RecordError for the first touched point off the usable part of its bar.

        Records are not asked: what was measured stays readable. With the ``path`` of its file the
        error names the line.
        """
        if self.plate is not None or not geometry.reads_legs:  # nor are legs read there
            return
        touched: list[tuple[Key, tuple[str, float, float]]] = []
        if self.levels:
            levels = [0.0, *(_displacement(level, geometry) for level in self.levels)]
            for (k, at), leg, mm in product(enumerate(self.stations), self.legs, levels):
                touched.append((("stations", k), (leg, at, mm)))
        if self.plane is not None:  # set anew in each posture, so as at Zero
            self._check_plane(self.plane, geometry, path)
            for (k, at), leg in product(enumerate(self.plane.stations), self.legs):
                touched.append((("plane", "stations", k), (leg, at, 0.0)))
        for number, fault in off_bar([visit for _, visit in touched], geometry):
            raise RecordError(
                f"{self._where(path, touched[number][0])}, stations",
                fault,
                "points on the usable part of the bar at every level, and at Zero",
                "Change the station or the levels, or usable_bar in the machine file.",
            )

    def _check_plane(self, plane: Plane, geometry: Geometry, path: Path | None) -> None:
        """Raises RecordError for the first touched point beyond the end of the plane."""
        low, high = geometry.plane_mm or (-math.inf, math.inf)
        levels = dict.fromkeys([0.0, *(_displacement(level, geometry) for level in plane.levels)])
        for level, (number, station) in product(levels, enumerate(plane.stations)):
            for leg in (leg for leg in self.legs if set(plane.axes) - {leg}):
                at_mm = level + station * geometry.covered_mm[leg_number(leg)]
                if low <= at_mm <= high:
                    continue
                raise RecordError(
                    f"{self._where(path, ('plane', 'stations', number))}, stations over the plane",
                    f"station {station:g} of leg {leg} in posture "
                    f"{posture_name(level, geometry)} at {at_mm:.1f} mm along the leg",
                    f"plane_mm of the machine file, {low:g} … {high:g} mm",
                    "Change the station or the levels, or use a longer plane.",
                )

    def _where(self, path: Path | None, key: Key) -> str:
        """The procedure by name, or the file that it is read from with the line of a key."""
        if path is None:
            return f"procedure {self.name}"
        line = line_of(read_text(path, SUBJECT), key)
        return f"procedure file {path}" + (f", line {line}" if line else "")

    def repeats_in_place(self, geometry: Geometry) -> int:
        """How many steps repeat a posture without leaving it; they show the indicator only."""
        steps = self.steps(geometry)
        return sum(
            (earlier.place, earlier.station, earlier.posture_mm)
            == (later.place, later.station, later.posture_mm)
            for earlier, later in pairwise(steps)
        )

    def duration_s(self, geometry: Geometry, axes: Sequence[str] = BOTH) -> float:
        """Estimated time for the whole procedure."""
        return len(self.steps(geometry, axes)) * self.seconds_per_step


@dataclass(frozen=True)
class Step:
    """One posture in which one or two indicators are read on one leg, or one at the tool.

    The ``number`` counts from 1; it is 0 until `Procedure.steps` has all of them.
    With ``over_plane`` the stand slides on a reference plane to the station, in this posture.
    ``first`` is the number, from 0, of the indicator that reads the first of the axes.
    """

    number: int
    leg: Touched
    displacement_mm: float
    cycle: int
    station: float
    axes: tuple[Leg, ...]
    position_mm: Triple | None = None
    over_plane: bool = False
    first: int = 0

    @property
    def indicators(self) -> range:
        """Numbers of the indicators that read, from 0, in the order of the axes."""
        return range(self.first, self.first + len(self.axes))

    @property
    def posture_mm(self) -> tuple[float, Triple | None]:
        """What the controller is told."""
        return self.displacement_mm, self.position_mm

    @property
    def touched(self) -> str:
        """``leg X``, or ``tool``."""
        return self.leg if self.leg == "tool" else f"leg {self.leg.upper()}"

    @property
    def at_zero(self) -> bool:
        """Whether this is the Zero posture."""
        return self.displacement_mm == 0.0 and self.position_mm in (None, ZERO)

    @property
    def place(self) -> tuple[Touched, float, tuple[Leg, ...]]:
        """Where the stand must be; a new place is a new mounting. On a plane it slides."""
        return self.leg, SLIDING if self.over_plane else self.station, self.axes

    def posture(self, geometry: Geometry) -> str:
        """ZERO, MAX, MIN or the displacement in mm; of the tool its position."""
        return posture_words(self.posture_mm, geometry)


def posture_words(posture_mm: tuple[float, Triple | None], geometry: Geometry) -> str:
    """ZERO, MAX, MIN or the displacement in mm; of the tool its position."""
    displacement_mm, position_mm = posture_mm
    if position_mm is not None:
        return "ZERO" if position_mm == ZERO else position_words(position_mm)
    return posture_name(displacement_mm, geometry)


def axes_on_leg(leg: Leg, axes: Sequence[str]) -> list[tuple[Leg, ...]]:
    """What is read together on a leg: one group for two indicators, one for each axis with one.

    Of the two ways to share the axes between two indicators the one that they prefer is taken.
    Raises UsageError where neither fits.
    """
    across: list[Leg] = [axis for axis in ALL_AXES if axis != leg]
    fitting = [
        way
        for way in permutations(across, len(axes))
        if all(axis in directions for axis, directions in zip(way, axes, strict=True))
    ]
    if not fitting:
        raise UsageError(
            f"indicators on leg {leg}",
            " and ".join(f"@{directions}" for directions in axes),
            f"axes {across[0]} and {across[1]}, one for each indicator",
        )
    if len(axes) == 1:
        return fitting
    return [min(fitting, key=lambda way: sum(map(str.index, axes, way)))]


def posture_name(displacement_mm: float, geometry: Geometry) -> str:
    """ZERO, MAX, MIN of this machine, or the displacement in mm."""
    names = {0.0: "ZERO", geometry.travel_max_mm: "MAX", geometry.travel_min_mm: "MIN"}
    return names.get(displacement_mm, f"{displacement_mm:+g} mm")


def default_mount(leg: str, axis: str, station: float) -> str:
    """Name of a mounting: leg and axis, and the station where it is not the middle."""
    if station == SLIDING:
        return f"{leg}{axis}-plane"
    if leg == "tool":
        return f"tool-{axis}"
    return f"{leg}{axis}" if station == 0.5 else f"{leg}{axis}@{station:g}"


def leg_number(name: str) -> int:
    """0, 1, 2 for x, y, z, and `TOOL`."""
    return TOOL if name == "tool" else LEG_NAMES.index(name)


def leg_within(leg: str, displacement_mm: float, geometry: Geometry) -> bool:
    """Whether the joint limits allow a displacement from the Zero of a leg."""
    if not geometry.common_zero:
        return geometry.goes(leg_number(leg), displacement_mm)
    return geometry.travel_min_mm <= displacement_mm <= geometry.travel_max_mm


def off_bar(
    visits: Sequence[tuple[str, float, float]], geometry: Geometry
) -> list[tuple[int, str]]:
    """Number and words of each visit that touches its leg off the usable part of the bar.

    A visit is a leg, the station at Zero and the displacement in mm.
    """
    if not visits:
        return []
    names, station, displacement = (np.array(column) for column in zip(*visits, strict=True))
    leg = np.array([leg_number(name) for name in names], dtype=np.intp)
    touched = geometry.touched(leg, station, displacement)
    faults = []
    for k in np.flatnonzero(~geometry.on_bar(leg, station, displacement)):
        low, high = geometry.usable_bar[leg[k]]
        posture = posture_name(float(displacement[k]), geometry)
        place = f"station {station[k]:g} of leg {names[k]} touched at {touched[k]:.3f} of the bar"
        faults.append((int(k), f"{place} in posture {posture}; usable is {low:g} … {high:g}"))
    return faults


def position_words(position_mm: Triple) -> str:
    """``(0, 35, -5) mm``."""
    return f"({', '.join(f'{part:g}' for part in position_mm)}) mm"


def procedure_names() -> tuple[str, ...]:
    """Names of the procedures that come with the program."""
    return tuple(sorted(path.stem for path in PROCEDURES.glob("*.toml")))


def guided_procedure_names(
    geometry: Geometry, printable_mm: float | None = None
) -> tuple[str, ...]:
    """Procedures that a guided session can measure on this machine: legs, or a plate."""
    names = []
    for name in procedure_names():
        try:
            load_procedure(name, geometry, printable_mm).steps(geometry)
        except (RecordError, UsageError):  # beyond its limits, or legs that cannot be read
            continue
        names.append(name)
    return tuple(names)


def load_procedure(name: str, geometry: Geometry, printable_mm: float | None = None) -> Procedure:
    """A procedure by name, or from a TOML file by path, checked against the machine.

    Where firmware lets the tool go within ``printable_mm`` of Zero, rings of one by name follow it.
    Raises UsageError for an unknown name and for legs that are not read on these drives,
    RecordError for a file that cannot be used.
    """
    path = Path(name)
    if not name.endswith(".toml"):
        path = PROCEDURES / f"{name}.toml"
        if name not in procedure_names():
            choices = ", ".join(procedure_names()) + ", or the path of a .toml file"
            raise UsageError("procedure", repr(name), choices)
    procedure = read_toml(path, Procedure, SUBJECT)
    if path.parent == PROCEDURES and procedure.plate and printable_mm is not None:
        plate = procedure.plate.within(printable_mm)
        procedure = procedure.model_copy(update={"plate": plate})
    procedure.check_limits(geometry, path)
    procedure.check_bars(geometry, path)
    return procedure


def procedure_on(machine: Machine, name: str | None = None) -> Procedure:
    """The procedure of that name on a machine, None: its usual one; as `load_procedure`."""
    procedure_name = name or machine.usual_procedure
    return load_procedure(procedure_name, machine.geometry(), machine.printable_radius_mm)


def shuffled(procedure: Procedure, seed: int) -> Procedure:
    """The procedure with its levels shuffled in each cycle, always alike for one seed.

    Raises UsageError where its order is fixed.
    """
    try:
        return Procedure.model_validate(procedure.model_dump() | {"random_seed": seed})
    except ValidationError as problem:
        raise UsageError(
            f"random order of procedure {procedure.name}",
            problem.errors()[0]["msg"].removeprefix("Value error, "),
            'a seed from 0 for a procedure with order = "free"',
            "Leave the seed out to measure in the order written.",
        ) from problem


def _displacement(level: Level, geometry: Geometry) -> float:
    if isinstance(level, str):
        levels = {"zero": 0.0, "max": geometry.travel_max_mm, "min": geometry.travel_min_mm}
        return levels[level]
    return float(level)
