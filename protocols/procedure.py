"""A procedure is data: one object gives the step list, the time estimate and the limit check."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, model_validator

from calib.observations import LEG_NAMES
from calib.orthoglide.geometry import Geometry
from protocols.documents import (
    Document,
    LengthMm,
    Name,
    Seconds,
    Seed,
    Tolerance,
    read_text,
    read_toml,
)
from protocols.errors import RecordError, UsageError
from protocols.toml_lines import line_of

Leg = Literal["x", "y", "z"]
Level = Literal["zero", "max", "min"] | LengthMm


MOST_STEPS = 20_000
"""Four days of measuring at 20 s a step."""

ALL_AXES: tuple[Leg, ...] = ("x", "y", "z")
BOTH = ("xyz", "xyz")
"""Two indicators that may measure along any axis."""


class Procedure(Document):
    """What is measured, in which order. Levels and stations are visited in the order given.

    With ``order = "free"`` the levels after Zero may be shuffled in each cycle; ``random_seed``
    does it. Readings are stable when they stay within ``tolerance_mm`` for ``window_s``; a reading
    further than ``repeat_limit_mm`` from earlier repeats of its posture is questioned.
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
    levels: Annotated[tuple[Level, ...], Field(min_length=2)]
    return_to_zero: bool = True
    seconds_per_step: Annotated[Seconds, Field(gt=0.0)] = 20.0
    order: Literal["fixed", "free"] = "fixed"
    random_seed: Seed | None = None
    window_s: Annotated[float, Field(ge=1e-3, le=60.0)] = 1.0
    tolerance_mm: Annotated[Tolerance, Field(le=1.0)] = 0.004
    repeat_limit_mm: Tolerance = 0.05

    @model_validator(mode="after")
    def _sensible(self) -> Procedure:
        levels = [0.0 if level == "zero" else level for level in self.levels]
        if len(set(levels)) < 2:
            raise ValueError("levels: one posture only; at least two different ones are needed")
        steps = len(self.legs) * len(self.stations) * self.cycles * len(self.levels)
        if steps > MOST_STEPS:
            raise ValueError(f"{steps} steps; up to {MOST_STEPS} can be measured")
        if len(set(self.legs)) < len(self.legs) or len(set(self.stations)) < len(self.stations):
            raise ValueError("legs and stations: one of them twice; each may be named once")
        if self.order == "free" and len(set(levels)) < len(levels):
            raise ValueError('order = "free": a level is there twice; only "fixed" keeps its sense')
        if self.random_seed is not None and self.order == "fixed":
            raise ValueError('random_seed: the order of this procedure is its purpose ("fixed")')
        return self

    def steps(self, geometry: Geometry, axes: Sequence[str] = BOTH) -> tuple[Step, ...]:
        """Every step in order, for one or two indicators.

        ``axes`` names for each indicator the directions it may measure along; the axes of a step
        stand in the order of the indicators. With one the leg is measured twice, once for each
        axis. Raises RecordError where a joint limit does not allow a level, UsageError where the
        indicators do not fit a leg.
        """
        visits = self._visits(geometry, axes)
        return tuple(Step(number, *visit) for number, visit in enumerate(visits, start=1))

    def _visits(self, geometry: Geometry, axes: Sequence[str]) -> Iterator[Visit]:
        outside = self.first_outside(geometry)
        if outside is not None:
            raise _outside_limits(f"procedure {self.name}, level", self.levels[outside], geometry)
        for station in self.stations:
            for leg in self.legs:
                for together in axes_on_leg(leg, axes):
                    for cycle in range(1, self.cycles + 1):
                        for displacement in self._cycle(geometry, leg, station, cycle):
                            yield leg, displacement, cycle, station, together
                    if self.return_to_zero:
                        yield leg, 0.0, self.cycles, station, together

    def _cycle(self, geometry: Geometry, leg: Leg, station: float, cycle: int) -> list[float]:
        """Displacements of one cycle: Zero first where it is checked, shuffled where asked for."""
        levels = [_displacement(level, geometry) for level in self.levels]
        if self.random_seed is not None:
            zeros = [level for level in levels if level == 0.0]
            others = [level for level in levels if level != 0.0]
            random.Random(f"{self.random_seed}/{leg}/{station}/{cycle}").shuffle(others)
            levels = zeros + others
        if self.return_to_zero and levels[0] != 0.0:
            levels.insert(0, 0.0)
        return levels

    def first_outside(self, geometry: Geometry) -> int | None:
        """Index of the first level that the joint limits do not allow."""
        low, high = geometry.travel_min_mm, geometry.travel_max_mm
        return next(
            (
                k
                for k, level in enumerate(self.levels)
                if not low <= _displacement(level, geometry) <= high
            ),
            None,
        )

    def read_in_place(self, geometry: Geometry) -> int:
        """How many steps repeat a posture without leaving it; they show the indicator only."""
        steps = self.steps(geometry)
        return sum(
            before.place == after.place and before.displacement_mm == after.displacement_mm
            for before, after in pairwise(steps)
        )

    def duration_s(self, geometry: Geometry, axes: Sequence[str] = BOTH) -> float:
        """Estimated time for the whole procedure."""
        return len(self.steps(geometry, axes)) * self.seconds_per_step


Visit = tuple[Leg, float, int, float, tuple[Leg, ...]]


@dataclass(frozen=True)
class Step:
    """One posture in which one or two indicators are read on one leg."""

    number: int
    leg: Leg
    displacement_mm: float
    cycle: int
    station: float
    axes: tuple[Leg, ...]

    @property
    def place(self) -> tuple[Leg, float, tuple[Leg, ...]]:
        """Where the stand must be; a new place is a new mounting."""
        return self.leg, self.station, self.axes

    def posture(self, geometry: Geometry) -> str:
        """ZERO, MAX, MIN or the displacement in mm."""
        return posture_name(self.displacement_mm, geometry)


def axes_on_leg(leg: Leg, axes: Sequence[str]) -> list[tuple[Leg, ...]]:
    """What is read together on a leg: one group for two indicators, one for each axis with one.

    Of the two ways to share the axes between two indicators the one that they prefer is taken.
    Raises UsageError where neither fits.
    """
    across: list[Leg] = [axis for axis in ALL_AXES if axis != leg]
    if len(axes) == 1:
        groups: list[tuple[Leg, ...]] = [(axis,) for axis in across if axis in axes[0]]
    else:
        ways: list[tuple[Leg, ...]] = [(across[0], across[1]), (across[1], across[0])]
        first, second = axes[0], axes[1]
        fitting = [way for way in ways if way[0] in first and way[1] in second]
        groups = sorted(fitting, key=lambda w: first.index(w[0]) + second.index(w[1]))[:1]
    if not groups:
        raise UsageError(
            f"indicators on leg {leg}",
            " and ".join(f"@{allowed}" for allowed in axes),
            f"axes {across[0]} and {across[1]}, one for each indicator",
        )
    return groups


def posture_name(displacement_mm: float, geometry: Geometry) -> str:
    """ZERO, MAX, MIN of this machine, or the displacement in mm."""
    named = {0.0: "ZERO", geometry.travel_max_mm: "MAX", geometry.travel_min_mm: "MIN"}
    return named.get(displacement_mm, f"{displacement_mm:+g} mm")


def default_mount(leg: str, axis: str, station: float) -> str:
    """Name of a mounting: leg and axis, and the station where it is not the middle."""
    return f"{leg}{axis}" if station == 0.5 else f"{leg}{axis}@{station:g}"


def leg_number(name: str) -> int:
    """0, 1, 2 for x, y, z."""
    return LEG_NAMES.index(name)


def procedure_names() -> tuple[str, ...]:
    """Names of the procedures that come with the program."""
    folder = resources.files("protocols") / "procedures"
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if _is_toml(f.name)))


def load_procedure(name: str, geometry: Geometry) -> Procedure:
    """A procedure by name, or from a TOML file by path, checked against the joint limits.

    Raises UsageError for an unknown name and RecordError for a file that cannot be used.
    """
    if _is_toml(name):
        return _read_procedure(Path(name), geometry)
    if name not in procedure_names():
        raise UsageError(
            "procedure",
            repr(name),
            ", ".join(procedure_names()) + ", or the path of a .toml file",
        )
    with resources.as_file(resources.files("protocols") / "procedures" / f"{name}.toml") as path:
        return _read_procedure(path, geometry)


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


def _read_procedure(path: Path, geometry: Geometry) -> Procedure:
    procedure = read_toml(path, Procedure, "procedure file")
    outside = procedure.first_outside(geometry)
    if outside is not None:
        line = line_of(read_text(path, "procedure file"), ("levels", outside))
        where = f"procedure file {path}, line {line}, level"
        raise _outside_limits(where, procedure.levels[outside], geometry)
    return procedure


def _is_toml(name: str) -> bool:
    return name.endswith(".toml")


def _displacement(level: Level, geometry: Geometry) -> float:
    if isinstance(level, str):
        levels = {"zero": 0.0, "max": geometry.travel_max_mm, "min": geometry.travel_min_mm}
        return levels[level]
    return float(level)


def _outside_limits(where: str, level: Level, geometry: Geometry) -> RecordError:
    return RecordError(
        where,
        f"{_displacement(level, geometry):g} mm",
        f"the joint limits {geometry.travel_min_mm:g} … {geometry.travel_max_mm:g} mm",
        "Change the level, or the limits in the machine file.",
    )
