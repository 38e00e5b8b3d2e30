"""A law without a name: how readings depend on displacement, approach, time, temperature.

It stands in models for what nobody could name. Powers of travel run beside the catalogue,
but nothing is ever called by it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, Conditions, FloatArray
from calib.tripod.effects.effect import (
    DIRECTIONS,
    PER_THOUSAND,
    EffectParameter,
    Kind,
    at_mount,
    mounts,
    moved_carriage,
    travel,
)
from calib.tripod.effects.environment import REFERENCE_C, SECONDS_PER_HOUR
from calib.tripod.pipeline import Flow, Stage

EMPIRICAL = "empirical"
AT_MM = 100.0
MICROMETRES = "µm"


@dataclass(frozen=True)
class Basis:
    """One thing that readings or carriages may depend on: its parameter, and words for it.

    ``power`` is that of displacement or travel / 100 mm, 0 for what is no power.
    """

    parameter: EffectParameter
    power: int
    words: str
    stage: Stage = Stage.READING


def _bases() -> Iterator[Basis]:
    powers = (
        ("line", 1, "in proportion to"),
        ("square", 2, "with the square of"),
        ("cube", 3, "with the cube of"),
        ("fourth", 4, "with the fourth power of"),
    )
    for name, power, words in powers:
        size = EffectParameter(f"{name}_at_100mm", MICROMETRES, 10.0)
        yield Basis(size, power, f"{words} displacement")
    yield Basis(
        EffectParameter("up_less_down", MICROMETRES, 10.0), 0, "with the direction of approach"
    )
    yield Basis(EffectParameter("per_hour", "µm/h", 10.0), 0, "with time")
    yield Basis(EffectParameter("per_kelvin", "µm/K", 5.0), 0, "with temperature")
    for name, power, words in powers[1:]:  # in proportion it has a name: actuator_scale
        size = EffectParameter(f"travel_{name}_at_100mm", MICROMETRES, 10.0)
        yield Basis(size, power, f"{words} travel", Stage.ACTUATOR)


BASES: dict[str, Basis] = {one.parameter.name: one for one in _bases()}
"""By the name of the parameter."""


@dataclass(frozen=True)
class Empirical:
    """A sum of bases: added to the readings of a mounting, or to the place of a carriage."""

    bases: tuple[str, ...]
    id: str = EMPIRICAL
    kind: Kind = Kind.EMPIRICAL
    invariances: tuple[str, ...] = ()
    controller: str = "nothing to enter before it has a name"

    @property
    def stage(self) -> Stage:
        """Readings or carriages; all bases have the same."""
        return BASES[self.bases[0]].stage

    @property
    def title(self) -> str:
        """What depends on what."""
        grows = (
            "readings grow" if self.stage == Stage.READING else "a carriage is off along its way"
        )
        return f"an unnamed effect: {grows} {empirical_words(self.bases)}"

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """One for each basis."""
        return tuple(BASES[name].parameter for name in self.bases)

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured, or every carriage."""
        if self.stage == Stage.READING:
            return mounts(taken)
        return LEG_NAMES if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """What passes grows by each value times its basis."""
        if self.stage == Stage.READING:
            columns = [_of_reading(name, flow.taken) for name in self.bases]
            return np.asarray(stage_input + _grown_mm(values, columns) * at_mount(flow, place))
        leg = LEG_NAMES.index(place)
        part = travel(flow, leg) / AT_MM
        columns = [part ** BASES[name].power for name in self.bases]
        return moved_carriage(stage_input, leg, _grown_mm(values, columns))


@dataclass(frozen=True)
class Coupling:
    """A carriage off by the product of its travel and another's: a frame that bends, say.

    No session looks for it: readings of legs, where the others stand nearly still, hardly show it.
    The bound at the tool counts with it.
    """

    id: str = EMPIRICAL
    kind: Kind = Kind.EMPIRICAL
    stage: Stage = Stage.ACTUATOR
    title: str = "a carriage is off by its travel times another's, for no known reason"
    parameters: tuple[EffectParameter, ...] = (
        EffectParameter("travel_product_at_100mm", MICROMETRES, 10.0),
    )
    invariances: tuple[str, ...] = ()
    controller: str = "nothing to enter before it has a name"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """The carriage, then the other one."""
        return DIRECTIONS if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The carriage goes so much further."""
        leg, other = map(LEG_NAMES.index, place)
        part = travel(flow, leg) * travel(flow, other) / AT_MM**2
        return moved_carriage(stage_input, leg, _grown_mm(values, [part]))


def _grown_mm(values: Sequence[Any], columns: Sequence[FloatArray]) -> NDArray[Any]:
    terms = [value * column for value, column in zip(values, columns, strict=True)]
    return np.asarray(PER_THOUSAND * np.sum(terms, axis=0))


def _of_reading(name: str, taken: Conditions) -> FloatArray:
    """What a value is multiplied with ``(n,)``; 0 where it is not known.

    Powers of displacement / 100 mm; half the sign of the approach; hours; kelvins above 20 °C.
    """
    match name:
        case "up_less_down":
            return np.asarray(taken.approach / 2.0)
        case "per_hour":
            return np.nan_to_num(taken.time_s / SECONDS_PER_HOUR)
        case "per_kelvin":
            return np.nan_to_num(taken.temperature_c - REFERENCE_C)
    return np.asarray((taken.displacement_mm / AT_MM) ** BASES[name].power)


def empirical_words(bases: Iterable[str]) -> str:
    """``with the cube of displacement and with time``."""
    return " and ".join(BASES[name].words for name in bases)


def empirical_effect(names: Iterable[str]) -> Empirical | None:
    """The law of these parameters in their usual order.

    None where one of them is not known, or where some belong to readings and some to carriages.
    """
    wanted = set(names)
    if not wanted or not wanted <= set(BASES) or len({BASES[n].stage for n in wanted}) > 1:
        return None
    return Empirical(tuple(name for name in BASES if name in wanted))
