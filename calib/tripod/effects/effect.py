"""What sort of cause an effect has, and what its parameters are."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import permutations
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, TOOL, Conditions, FloatArray
from calib.tripod.pipeline import Flow, Stage, measuring_directions


class Kind(StrEnum):
    """Where the cause of an effect lies."""

    MACHINE = "machine"
    INDICATOR = "indicator"
    ENVIRONMENT = "environment"
    BLUNDER = "blunder"  # a mistake in the data
    EMPIRICAL = "empirical"  # an unnamed effect


@dataclass(frozen=True)
class EffectParameter:
    """One parameter: name, unit, a size in that unit that nobody would remark on.

    ``limit`` is a size that nobody can overlook, ``least`` the smallest value that has a meaning.
    """

    name: str
    unit: str
    tolerance: float
    limit: float = math.inf
    least: float = -math.inf


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
    def invariances(self) -> tuple[str, ...]:
        """What it does not depend on, in words."""

    @property
    def controller(self) -> str:
        """What to do against it, in words; empty if nothing.

        ``{place}`` stands for the places, ``{axis}`` and ``{along}`` for their letters, ``{third}``
        for the axis that a pair does not name, the name of a parameter for its value and unit.
        """

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Where it may act: legs, pairs, directions of legs or mounts (``"xy"``)."""

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """What the stage hands on instead of ``stage_input``.

        ``values`` in the units of `parameters`. Leading axes of ``stage_input`` and ``flow`` hold
        several machines; values may be complex.
        """


@dataclass(frozen=True)
class EffectInstance:
    """A law at one place with values in its units: an effect for the pipeline."""

    effect: Effect
    place: str
    values: tuple[float | complex, ...]

    @property
    def id(self) -> str:
        """Name in the catalogue."""
        return self.effect.id

    @property
    def stage(self) -> Stage:
        """The stage of the law."""
        return self.effect.stage

    def with_value(self, number: int, value: float | complex) -> Self:
        """The same with one other value."""
        values = (*self.values[:number], value, *self.values[number + 1 :])
        return replace(self, values=values)

    def change(self, stage_input: NDArray[Any], flow: Flow) -> NDArray[Any]:
        """The law with these values, at this place."""
        return self.effect.change(stage_input, flow, self.place, self.values)


def remedies(placed: Sequence[EffectInstance]) -> tuple[str, ...]:
    """What to do against an effect that acts at these places, once for those of equal values."""
    alike: dict[tuple[float | complex, ...], list[EffectInstance]] = {}
    for one in placed:
        alike.setdefault(one.values, []).append(one)
    return tuple(
        dict.fromkeys(_remedy(some) for some in alike.values() if some[0].effect.controller)
    )


def _remedy(alike: Sequence[EffectInstance]) -> str:
    effect, places = alike[0].effect, [one.place for one in alike]
    words = {
        "place": ", ".join(places),
        "axis": ", ".join(dict.fromkeys(place[0] for place in places)),
        "along": ", ".join(dict.fromkeys(place[-1] for place in places)),
        "third": ", ".join(dict.fromkeys(_third(place) for place in places)),
    }
    for parameter, value in zip(effect.parameters, alike[0].values, strict=True):
        if value.real < parameter.least:
            return f"nothing to enter: no machine has {value.real:+.4g} {parameter.unit} of this"
        words[parameter.name] = f"{value.real:+.4g} {parameter.unit}"
    return re.sub(r"\{(\w+)\}", lambda found: words.get(found[1], found[0]), effect.controller)


def _third(place: str) -> str:
    """The axis that a pair does not name."""
    return "".join(name for name in LEG_NAMES if name not in place)


PAIRS = ("xy", "yz", "xz")
AROUND = ("xy", "yz", "zx")
"""Pairs of axes, each from one to the next."""

DIRECTIONS = tuple(first + second for first, second in permutations(LEG_NAMES, 2))
AT_TOOL = ("tx", "ty", "tz")

BOTH_WAYS = "same for both directions of approach"
REPEATABLE = (BOTH_WAYS, "constant in time")

PER_THOUSAND = 1e-3
"""mm in a µm, rad in a mrad, mm per mm in a mm/m."""


def mounts(taken: Conditions) -> tuple[str, ...]:
    """Leg and measuring axis of every kind of mounting there is."""
    found = set(zip(taken.leg.tolist(), taken.axis.tolist(), strict=True))
    return tuple(place for place in DIRECTIONS + AT_TOOL if numbers(place) in found)


def on_legs(taken: Conditions) -> tuple[str, ...]:
    """Those of `mounts` that touch a leg."""
    return tuple(place for place in mounts(taken) if place not in AT_TOOL)


def numbers(place: str) -> tuple[int, int]:
    """0, 1, 2 for both letters of a place; `TOOL` for the tool."""
    leg = TOOL if place in AT_TOOL else LEG_NAMES.index(place[0])
    return leg, LEG_NAMES.index(place[1])


def unit(axis: int) -> FloatArray:
    """Unit vector ``(3,)``."""
    return np.asarray(np.eye(3)[axis])


def travel(flow: Flow, leg: int) -> FloatArray:
    """Commanded travel of a carriage from Zero ``(n,)``, mm."""
    return np.asarray(flow.command_mm[:, leg] - flow.geometry.zero_mm[leg])


def at_mount(flow: Flow, place: str) -> FloatArray:
    """1 for the readings of this leg and measuring axis, 0 for others ``(n,)``."""
    leg, axis = numbers(place)
    return np.asarray((flow.taken.leg == leg) & (flow.taken.axis == axis), dtype=np.float64)


def moved_carriage(stage_input: NDArray[Any], leg: int, along_mm: NDArray[Any]) -> NDArray[Any]:
    """Carriages ``(..., n, 3)`` with one moved along its axis by ``(..., n)``."""
    return np.asarray(stage_input + along_mm[..., None] * unit(leg))


def moved_foot(
    stage_input: NDArray[Any], leg: int, towards: FloatArray, sideways_mm: NDArray[Any]
) -> NDArray[Any]:
    """Feet ``(..., n, 3, 3)`` with one moved by ``(..., n)`` along a unit vector ``(3,)``."""
    where = np.outer(unit(leg), towards)
    return np.asarray(stage_input + sideways_mm[..., None, None] * where)


@dataclass(frozen=True, eq=False)
class Acting:
    """What an effect is handed at one place, see `Effect.change`."""

    stage_input: NDArray[Any]
    flow: Flow
    place: str
    values: Sequence[Any]

    @property
    def leg(self) -> int:
        """The leg that the place names first."""
        return LEG_NAMES.index(self.place[0])


class OfCarriageOrBar:
    """Places and change of what makes one carriage further, or one bar longer, than it should be.

    Positions of carriages and lengths of bars are alike ``(..., n, 3)``.
    """

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every leg."""
        return LEG_NAMES if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The carriage is further, or the bar longer, by `off_mm`."""
        at = Acting(stage_input, flow, place, values)
        return moved_carriage(stage_input, at.leg, self.off_mm(at))

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """By how much ``(..., n)``."""
        raise NotImplementedError


class OfTouch:
    """Places and change of what puts the touched point off along the measuring axis."""

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured."""
        return on_legs(taken)

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The touched point is off by `off_mm` where the place is measured."""
        off_mm = self.off_mm(Acting(stage_input, flow, place, values)) * at_mount(flow, place)
        along = measuring_directions(flow.geometry, flow.taken)
        return np.asarray(stage_input + off_mm[..., None] * along)

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """By how much ``(..., n)``."""
        raise NotImplementedError
