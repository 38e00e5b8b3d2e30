"""A procedure is data: one object gives the step list, the time estimate and the limit check."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from calib.observations import LEG_NAMES
from calib.orthoglide.geometry import Geometry
from protocols.documents import Document, read_toml
from protocols.errors import RecordError, UsageError

Leg = Literal["x", "y", "z"]
Level = Literal["zero", "max", "min"] | float


class Procedure(Document):
    """What is measured, in which order. Levels and stations are visited in the order given."""

    schema_id: Literal["glidecal.procedure/1"] = Field(alias="schema")
    name: str
    title: str
    description: str = ""
    legs: Annotated[tuple[Leg, ...], Field(min_length=1)] = ("x", "y", "z")
    stations: Annotated[
        tuple[Annotated[float, Field(gt=0.0, lt=1.0)], ...], Field(min_length=1)
    ] = (0.5,)
    cycles: Annotated[int, Field(ge=1, le=100)]
    levels: Annotated[tuple[Level, ...], Field(min_length=2)]
    return_to_zero: bool = True
    seconds_per_step: Annotated[float, Field(gt=0.0)] = 20.0

    def steps(self, geometry: Geometry, indicators: int = 2) -> tuple[Step, ...]:
        """Every step in order. Raises RecordError where a joint limit does not allow a level.

        Two indicators read both axes of a leg at once; with one the leg is measured twice.
        """
        visits = self._visits(geometry, indicators)
        return tuple(Step(number, *visit) for number, visit in enumerate(visits, start=1))

    def _visits(self, geometry: Geometry, indicators: int) -> Iterator[Visit]:
        levels = [_displacement(level, geometry, self.name) for level in self.levels]
        for station in self.stations:
            for leg in self.legs:
                across: tuple[Leg, ...] = tuple(a for a in ("x", "y", "z") if a != leg)
                for axes in [across] if indicators >= 2 else [(axis,) for axis in across]:
                    for cycle in range(1, self.cycles + 1):
                        for displacement in levels:
                            yield leg, displacement, cycle, station, axes
                    if self.return_to_zero:
                        yield leg, 0.0, self.cycles, station, axes

    def duration_s(self, geometry: Geometry, indicators: int = 2) -> float:
        """Estimated time for the whole procedure."""
        return len(self.steps(geometry, indicators)) * self.seconds_per_step


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


def load_procedure(name: str) -> Procedure:
    """A procedure by name, or from a TOML file by path.

    Raises UsageError for an unknown name and RecordError for a file that cannot be used.
    """
    if _is_toml(name):
        return read_toml(Path(name), Procedure, "procedure file")
    if name not in procedure_names():
        raise UsageError(
            "procedure",
            repr(name),
            ", ".join(procedure_names()) + ", or the path of a .toml file",
        )
    with resources.as_file(resources.files("protocols") / "procedures" / f"{name}.toml") as path:
        return read_toml(path, Procedure, "procedure file")


def _is_toml(name: str) -> bool:
    return name.endswith(".toml")


def _displacement(level: Level, geometry: Geometry, name: str) -> float:
    if isinstance(level, str):
        levels = {"zero": 0.0, "max": geometry.travel_max_mm, "min": geometry.travel_min_mm}
        return levels[level]
    if not geometry.travel_min_mm <= level <= geometry.travel_max_mm:
        raise RecordError(
            f"procedure {name}, level",
            f"{level:g} mm",
            f"the joint limits {geometry.travel_min_mm:g} … {geometry.travel_max_mm:g} mm",
            "Change the level, or the limits in the machine file.",
        )
    return float(level)
