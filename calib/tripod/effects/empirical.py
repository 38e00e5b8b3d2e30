"""A law without a name: how readings depend on displacement, approach, time, temperature.

It stands in models for what nobody could name. Powers of travel run beside the catalogue,
but nothing is ever called by it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, Conditions, FloatArray
from calib.tripod.effects.effect import (
    AT_MM,
    DIRECTIONS,
    PER_THOUSAND,
    Acting,
    EffectParameter,
    Kind,
    Law,
    OfCarriage,
    OfReading,
    kelvins,
    law_named,
    travel_mm,
    wave_mm,
)
from calib.tripod.pipeline import Stage

EMPIRICAL = "empirical"
MICROMETRES = "µm"


@dataclass(frozen=True)
class Basis:
    """One thing that readings or carriages may depend on: its parameter, and words for it."""

    parameter: EffectParameter
    words: str
    stage: Stage = Stage.READING


def _bases() -> Iterator[Basis]:
    powers = (
        ("line", 1, "in proportion to"),
        ("square", 2, "with the square of"),
        ("cube", 3, "with the cube of"),
        ("fourth", 4, "with the fourth power of"),
    )
    for name, power, text in powers:
        size = EffectParameter(f"{name}_at_100mm", MICROMETRES, 10.0, power=power)
        yield Basis(size, f"{text} displacement")
    yield Basis(
        EffectParameter("up_less_down", MICROMETRES, 10.0), "with the direction of approach"
    )
    yield Basis(EffectParameter("per_hour", "µm/h", 10.0), "with time")
    yield Basis(EffectParameter("per_kelvin", "µm/K", 5.0), "with temperature")
    for name, power, text in powers[1:]:  # in proportion it has a name: actuator_scale
        size = EffectParameter(f"travel_{name}_at_100mm", MICROMETRES, 10.0, power=power)
        yield Basis(size, f"{text} travel", Stage.ACTUATOR)


BASES: dict[str, Basis] = {basis.parameter.name: basis for basis in _bases()}
"""By the name of the parameter."""


@dataclass(frozen=True)
class Empirical(Law):
    """A sum of bases: added to the readings of a mounting, or to the place of a carriage."""

    bases: tuple[str, ...]
    id = EMPIRICAL
    kind = Kind.EMPIRICAL
    controller = "nothing to enter before it has a name"

    @property
    def stage(self) -> Stage:
        """Readings or carriages; all bases have the same."""
        return BASES[self.bases[0]].stage

    @property
    def title(self) -> str:
        """What depends on what."""
        of_reading = self.stage == Stage.READING
        grows = "readings grow" if of_reading else "a carriage is off along its way"
        return f"{grows} {' and '.join(BASES[name].words for name in self.bases)}"

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """One for each basis."""
        return tuple(BASES[name].parameter for name in self.bases)

    @property
    def _sort(self) -> Law:
        return OfReading() if self.stage == Stage.READING else OfCarriage()

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured, or every carriage."""
        return self._sort.places(conditions)

    def off(self, at: Acting) -> NDArray[Any]:
        """Each value times its basis."""
        columns = [_column(name, at) for name in self.bases]
        terms = [value * column for value, column in zip(at.values, columns, strict=True)]
        return np.asarray(PER_THOUSAND * np.sum(terms, axis=0))

    def moved(self, at: Acting, off_mm: NDArray[Any]) -> NDArray[Any]:
        """Readings or carriages."""
        return self._sort.moved(at, off_mm)


def _column(name: str, at: Acting) -> FloatArray:
    """What a value is multiplied with ``(n,)``; 0 where it is not known.

    Half the sign of the approach; hours; kelvins above 20 °C; powers of displacement or travel.
    """
    conditions, basis = at.flow.taken, BASES[name]
    match name:
        case "up_less_down":
            return np.asarray(conditions.approach / 2.0)
        case "per_hour":
            return np.nan_to_num(conditions.time_s / 3600.0)
        case "per_kelvin":
            return np.nan_to_num(kelvins(conditions))
    of_reading = basis.stage == Stage.READING
    way_mm = conditions.displacement_mm if of_reading else travel_mm(at.flow, at.leg)
    return np.asarray((way_mm / AT_MM) ** basis.parameter.power)


@dataclass(frozen=True)
class Coupling(OfCarriage):
    """A carriage off by the product of its travel and another's: a frame that bends, say.

    The place is the carriage, then the other one. Readings of legs, where the others stand nearly
    still, hardly show it.
    """

    id = EMPIRICAL
    kind = Kind.EMPIRICAL
    title = "a carriage is off by the product of two travels, for an unknown reason"
    where = DIRECTIONS
    parameters = (EffectParameter("travel_product_at_100mm", MICROMETRES, 10.0, power=2),)
    controller = "nothing to enter before it has a name"

    def off(self, at: Acting) -> NDArray[Any]:
        """The value times both travels / 100 mm."""
        leg, neighbour = map(LEG_NAMES.index, at.place)
        part = travel_mm(at.flow, leg) * travel_mm(at.flow, neighbour) / AT_MM**2
        return PER_THOUSAND * (at.values[0] * part)


HARMONICS = 3
"""Of an error that repeats: a sawtooth has these with 1, 1/2 and 1/3 of the size."""

REPEATING = re.compile(r"(?:sine|cosine)_[1-9]_of_([0-9]{1,4}(?:\.[0-9]{1,4})?)mm")
"""Parameters of `Repeating`: the harmonic, then the period."""


@dataclass(frozen=True)
class Repeating(OfCarriage):
    """A carriage off by something that repeats along its way and need not be a sine."""

    period_mm: float
    id = EMPIRICAL
    kind = Kind.EMPIRICAL
    controller = "nothing to enter before it has a name"

    @property
    def title(self) -> str:
        """What repeats, and how often."""
        return (
            f"a carriage is off by what repeats every {self.period_mm:g} mm, for an unknown reason"
        )

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """Two of each harmonic; their names tell the period."""
        return tuple(
            EffectParameter(f"{wave}_{k}_of_{self.period_mm:g}mm", MICROMETRES, 5.0)
            for k in range(1, HARMONICS + 1)
            for wave in ("sine", "cosine")
        )

    def off(self, at: Acting) -> NDArray[Any]:
        """Sum of a sin k t + b (cos k t - 1) over harmonics k, t one turn for each period."""
        harmonics = [
            wave_mm(at, self.period_mm / (k + 1), *at.values[2 * k : 2 * k + 2])
            for k in range(HARMONICS)
        ]
        return np.asarray(np.sum(harmonics, axis=0))


def empirical_effect(names: Iterable[str]) -> Empirical | Coupling | Repeating | None:
    """The law of these parameters in their usual order.

    None where one of them is not known, or where some belong to readings and some to carriages.
    """
    ids = set(names)
    if ids == {parameter.name for parameter in Coupling.parameters}:
        return Coupling()
    if repeating := law_named(Repeating, REPEATING, ids):
        return repeating
    if not ids or not ids <= set(BASES) or len({BASES[n].stage for n in ids}) > 1:
        return None
    return Empirical(tuple(name for name in BASES if name in ids))
