"""What an effect is, and the sorts of laws: what is moved at which stage of the simulation."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import permutations
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, TOOL, Conditions, FloatArray
from calib.quantity import known_to
from calib.tripod.pipeline import Flow, Stage, measuring_directions


class Kind(StrEnum):
    """Where the cause of an effect lies."""

    MACHINE = "machine"
    INDICATOR = "indicator"
    ENVIRONMENT = "environment"
    GROSS_ERROR = "blunder"  # a mistake in the data; the word of the documents
    EMPIRICAL = "empirical"  # an unnamed effect


@dataclass(frozen=True)
class EffectParameter:
    """One parameter: name, unit, a size in that unit that nobody would remark on.

    ``limit`` is a size that nobody can overlook, ``least`` the smallest value that has a meaning.
    ``power`` is that of travel / `AT_MM` in a law without a name; its value is the size there.
    """

    name: str
    unit: str
    tolerance: float
    limit: float = math.inf
    least: float = -math.inf
    power: int = 0

    def unit_over(self, travel_mm: float) -> float:
        """Tolerance of the parameter on a machine of this longest travel from Zero.

        At the end of a travel beyond `AT_MM` the law does as much as there on a shorter one: a long
        rail is made as straight as a short one.
        """
        return self.tolerance * min(1.0, AT_MM / travel_mm) ** self.power


AT_MM = 100.0
"""Travel, or displacement, at which laws of a power have the size of their value."""


class Effect(Protocol):
    """What an effect does; a small frozen dataclass.

    Laws of one ``id`` are variants of it and differ in the names of their parameters.
    """

    @property
    def id(self) -> str:
        """Name in the catalogue, such as ``backlash``."""

    @property
    def title(self) -> str:
        """The effect in the words of a workshop."""

    @property
    def kind(self) -> Kind:
        """Where its cause lies."""

    @property
    def stage(self) -> Stage:
        """The one stage of the pipeline that it changes."""

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """Parameters of one place."""

    @property
    def controller(self) -> str:
        """What to do against it, in words; empty if nothing.

        ``{place}`` stands for the places, ``{axis}`` and ``{along}`` for their letters, ``{third}``
        for the axis that a pair does not name, the name of a parameter for its value and unit.
        """

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """Where it may act: legs, pairs, directions of legs or mounts (``"xy"``)."""

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """What the stage hands on instead of ``stage_input``.

        ``values`` in the units of `parameters`. Leading axes of ``stage_input`` and ``flow`` hold
        several machines; values may be complex.
        """


AnyEffect = TypeVar("AnyEffect", bound=Effect)


@dataclass(frozen=True)
class EffectInstance:
    """A law at one place with values in its units: an effect for the pipeline.

    ``deviations`` are the standard uncertainties of its values, empty where nobody states them.
    """

    effect: Effect
    place: str
    values: tuple[float | complex, ...]
    deviations: tuple[float, ...] = field(default=(), compare=False)

    def size_words(self, number: int) -> str:
        """One value with its unit, with no more digits than its uncertainty leaves."""
        value, unit = self.values[number].real, self.effect.parameters[number].unit
        if number < len(self.deviations) and self.deviations[number] > 0.0:
            return f"{known_to(value, 2.0 * self.deviations[number])} {unit}"
        return f"{value:+.4g} {unit}"

    @property
    def id(self) -> str:
        """Name in the catalogue."""
        return self.effect.id

    @property
    def stage(self) -> Stage:
        """The stage of the law."""
        return self.effect.stage

    def with_value(self, number: int, value: float | complex) -> Self:
        """The effect with one other value."""
        values = (*self.values[:number], value, *self.values[number + 1 :])
        return replace(self, values=values)

    def change(self, stage_input: NDArray[Any], flow: Flow) -> NDArray[Any]:
        """The law with these values, at this place."""
        return self.effect.change(stage_input, flow, self.place, self.values)


def remedies(placed_laws: Sequence[EffectInstance]) -> tuple[str, ...]:
    """What to do against an effect that acts at these places, once for those of equal values."""
    alike: dict[tuple[float | complex, ...], list[EffectInstance]] = {}
    for placed_effect in placed_laws:
        if placed_effect.effect.controller:
            alike.setdefault(placed_effect.values, []).append(placed_effect)
    return tuple(dict.fromkeys(map(_remedy, alike.values())))


def _remedy(alike: Sequence[EffectInstance]) -> str:
    effect, places = alike[0].effect, [placed_effect.place for placed_effect in alike]
    third = ("".join(name for name in LEG_NAMES if name not in place) for place in places)
    labels = {
        "place": ", ".join(places),
        "axis": ", ".join(dict.fromkeys(place[0] for place in places)),
        "along": ", ".join(dict.fromkeys(place[-1] for place in places)),
        "third": ", ".join(dict.fromkeys(third)),
    }
    for number, parameter in enumerate(effect.parameters):
        size = alike[0].size_words(number)
        if alike[0].values[number].real < parameter.least:
            return f"nothing to enter: no machine has {size} of this"
        labels[parameter.name] = size
    return re.sub(r"\{(\w+)\}", lambda match: labels.get(match[1], match[0]), effect.controller)


PAIRS = ("xy", "yz", "xz")
AROUND = ("xy", "yz", "zx")
"""Pairs of axes, each from one to the next."""

DIRECTIONS = tuple(first + second for first, second in permutations(LEG_NAMES, 2))
AT_TOOL = ("tx", "ty", "tz")

PER_THOUSAND = 1e-3
"""mm in a µm, rad in a mrad, mm per mm in a mm/m."""


def mounts(conditions: Conditions) -> tuple[str, ...]:
    """Leg and measuring axis of every kind of mounting of an indicator; a contact has none."""
    rows = ~conditions.contact
    touched = set(zip(conditions.leg[rows].tolist(), conditions.axis[rows].tolist(), strict=True))
    return tuple(place for place in DIRECTIONS + AT_TOOL if numbers(place) in touched)


def on_legs(conditions: Conditions) -> tuple[str, ...]:
    """The `mounts` that touch a leg."""
    return tuple(place for place in mounts(conditions) if place not in AT_TOOL)


def numbers(place: str) -> tuple[int, int]:
    """0, 1, 2 for both letters of a place; `TOOL` for the tool."""
    leg = TOOL if place in AT_TOOL else LEG_NAMES.index(place[0])
    return leg, LEG_NAMES.index(place[1])


def travel_mm(flow: Flow, leg: int) -> FloatArray:
    """Commanded travel of a carriage from Zero ``(n,)``."""
    return np.asarray(flow.command_mm[:, leg] - flow.geometry.zero_mm[leg])


def from_meeting_mm(flow: Flow, leg: int) -> NDArray[Any]:
    """How far a carriage is along its drive from where the drives meet ``(..., n)``."""
    return np.asarray(flow.carriage_mm[..., leg] - flow.geometry.meeting_mm[leg])


def at_mount(flow: Flow, place: str) -> FloatArray:
    """1 for the readings of this leg and measuring axis, 0 for others and contacts ``(n,)``."""
    (leg, axis), conditions = numbers(place), flow.taken
    rows = (conditions.leg == leg) & (conditions.axis == axis) & ~conditions.contact
    return np.asarray(rows, dtype=np.float64)


def kelvins(conditions: Conditions) -> FloatArray:
    """Temperature of each reading above 20 °C ``(n,)``; NaN where not known."""
    return np.asarray(conditions.temperature_c - 20.0)  # the reference of ISO 1


def machine_kelvins(conditions: Conditions) -> FloatArray:
    """Kelvins of parts of the machine: 0 where not all readings have a temperature.

    At Zero, where an indicator is mounted, it is 0.
    """
    mounted = conditions.mount >= 0
    temperatures_known = np.isfinite(conditions.temperature_c[mounted]).all()
    return np.where(mounted & temperatures_known, np.nan_to_num(kelvins(conditions)), 0.0)


@dataclass(frozen=True, eq=False)
class Acting:
    """What an effect is handed at one place, see `Effect.change`."""

    stage_input: NDArray[Any]
    flow: Flow
    place: str
    values: Sequence[complex]

    @property
    def leg(self) -> int:
        """The leg that the place names first."""
        return LEG_NAMES.index(self.place[0])


class Law:
    """What the laws here share. Sorts of them, below, say at which stage and how something moves;
    a law says by how much.
    """

    kind = Kind.MACHINE
    where: tuple[str, ...] = ()

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """All of ``where``, whatever was measured."""
        return self.where if len(conditions) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """What passes, moved by `off`."""
        at = Acting(stage_input, flow, place, values)
        return np.asarray(stage_input + self.moved(at, self.off(at)))

    def off(self, at: Acting) -> NDArray[Any]:
        """By how much ``(..., n)``, mm; one number where it is the same for all readings.

        Unless a law says otherwise that is its value.
        """
        return np.asarray(at.values[0])

    def moved(self, _at: Acting, off_mm: NDArray[Any]) -> NDArray[Any]:
        """The change of what passes; of a law of no sort `off` is all of it."""
        return off_mm


def wave_mm(at: Acting, period_mm: float, sine: complex, cosine: complex) -> NDArray[Any]:
    """Sine · sin t + cosine · (cos t - 1), µm, t one turn a period of travel: 0 at Zero, in mm."""
    turn = 2 * np.pi * travel_mm(at.flow, at.leg) / period_mm
    return np.asarray(PER_THOUSAND * (sine * np.sin(turn) + cosine * (np.cos(turn) - 1.0)))


class OfCarriage(Law):
    """One carriage is further along its drive by `off`."""

    stage = Stage.ACTUATOR
    where: tuple[str, ...] = LEG_NAMES

    def moved(self, at: Acting, off_mm: NDArray[Any]) -> NDArray[Any]:
        """Carriages or bars ``(..., n, 3)``."""
        return np.asarray(off_mm[..., None] * np.eye(3)[at.leg])


class OfBar(OfCarriage):
    """One bar is longer by `off`."""

    stage = Stage.TOOL


@dataclass(frozen=True)
class OfFoot(Law):
    """One foot is sideways by `off`; ``"xy"``: that of axis x towards +y.

    ``where`` are the directions across the machine's drives, of `Geometry.across`.
    """

    where: tuple[str, ...] = DIRECTIONS
    stage = Stage.FOOT

    def moved(self, at: Acting, off_mm: NDArray[Any]) -> NDArray[Any]:
        """Feet ``(..., n, 3, 3)``."""
        return moved_foot(at.leg, at.flow.geometry.across[at.place], off_mm)


class OfTouch(Law):
    """The touched point of a leg is off along the measuring axis."""

    stage = Stage.TOUCH

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured."""
        return on_legs(conditions)

    def moved(self, at: Acting, off_mm: NDArray[Any]) -> NDArray[Any]:
        """Touched points ``(..., n, 3)``."""
        along = measuring_directions(at.flow.geometry, at.flow.taken)
        return np.asarray((off_mm * at_mount(at.flow, at.place))[..., None] * along)


class OfReading(Law):
    """What an indicator shows is off."""

    kind = Kind.INDICATOR
    stage = Stage.READING

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured, and those of the tool."""
        return mounts(conditions)

    def moved(self, at: Acting, off_mm: NDArray[Any]) -> NDArray[Any]:
        """Readings ``(..., n)``."""
        return np.asarray(off_mm * at_mount(at.flow, at.place))


def law_named(
    law_of: Callable[[float], AnyEffect], pattern: re.Pattern[str], names: Iterable[str]
) -> AnyEffect | None:
    """The law of a figure, such as a lead, whose parameters have these names; None without one."""
    ids = set(names)
    figures = {float(match[1]) for match in map(pattern.fullmatch, ids) if match}
    laws = (law_of(figure) for figure in figures if figure > 0.0)
    return next((law for law in laws if ids == {p.name for p in law.parameters}), None)


def moved_foot(leg: int, towards: FloatArray, sideways_mm: NDArray[Any]) -> NDArray[Any]:
    """The change of feet ``(..., n, 3, 3)``, one moved by ``(..., n)`` along a unit vector."""
    return np.asarray(sideways_mm[..., None, None] * np.outer(np.eye(3)[leg], towards))


AdoptedSize = tuple[int, str]
"""The number of an adopted effect, and the keys of its values: equal ones are one size."""

Placed = tuple[Effect, str]
"""A law and its place."""

AdoptedLaws = Mapping[Placed, AdoptedSize]
"""Laws of adopted effects at their places."""
