"""First takes that stand apart within the play of a carriage; without a play that is a mistake.

Nobody saw how the first reading of a mounting was reached. Where a carriage has play it stands
somewhere within it, so the first take lies anywhere between what both sides would read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.arrays import FloatArray, IntArray, numbered
from calib.posterior.apart import (
    LEAST,
    LOG_RANGE,
    Mistake,
    first_takes,
    standing_apart,
)
from calib.posterior.cells import FINEST_MM, Cells
from calib.posterior.library import Component
from calib.posterior.models import WeightedModel
from calib.posterior.screening import even_mm
from calib.posterior.selection import SCALES
from calib.tripod.effects.candidates import placed_columns
from calib.tripod.effects.drives import Backlash
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.movements import departures_mm

APART = 3.0
"""Standard deviations of a difference from which on a first take may stand within a play: with less
it looks like its repeats."""

WITHIN = 0.5
"""Probability that first takes stand within a play, not at one end of it."""

REACHES = 2.0
"""Standard deviations above its mean up to which a play may reach a first take; what is further off
is a mistake, or in the tail of noise."""


def first_takes_apart(cells: Cells, session: int) -> Mistake | None:
    """The first takes of a session that depart from their repeats, with zeros of their own.

    Its log prior is that within a play, but for what `WithinPlay.log_more` adds for its size.
    """
    visits, off_mm = cells.visits, departures_mm(cells.visits, APART)
    if not off_mm:
        return None
    rows = sorted(off_mm)
    far_mm = np.maximum(np.abs([off_mm[row] for row in rows]), FINEST_MM)
    log_prior = math.log(WITHIN) - float(np.log(2.0 * LOG_RANGE * far_mm).sum())
    mistake = standing_apart(visits, *first_takes(visits, rows), log_prior)
    return replace(mistake, session=session)


@dataclass(frozen=True, eq=False)
class WithinPlay:
    """First takes that stand apart, and what play of a carriage does to each.

    ``off_mm`` ``(n,)`` is how far they are from the nearest repeat, ``derivatives`` ``(n,)`` by
    place those of readings by the play there, ``adopted_mm`` ``(n,)`` what adopted plays do.
    ``beyond`` ``(n,)`` marks those that no tail of the noise reaches.
    """

    off_mm: FloatArray
    beyond: NDArray[np.bool_]
    derivatives: dict[str, FloatArray]
    adopted_mm: FloatArray

    @classmethod
    def of(cls, cells: Cells) -> WithinPlay | None:
        """The first takes of one session as it was put right; None where none stands apart."""
        apart = dict(_apart(cells))
        if not apart:
            return None
        conditions = cells.means.take([*apart])
        down, up = (
            placed_columns(
                cells.model,
                replace(conditions, movement=np.full((len(conditions), 3), way)),
                [Backlash()],
            )
            for way in (-1.0, 1.0)
        )
        derivatives = {law[1]: (down[law] - up[law])[:, 0] for law in down}
        plays = [
            effect.values[0].real * derivatives[effect.place]
            for effect in cells.case.model.effects
            if isinstance(effect, EffectInstance) and effect.id == Backlash.id
        ]
        off_mm = np.maximum(np.abs([*apart.values()]), FINEST_MM)
        beyond = off_mm > LEAST["first_take"] * np.median(even_mm(cells))
        adopted = np.sqrt(np.sum(np.square(plays), axis=0) + 0.0 * off_mm)
        return cls(off_mm, beyond, derivatives, adopted)

    def log_more(self, components: Sequence[Component]) -> tuple[float, FloatArray]:
        """Log prior that an adopted play adds, and what each component adds ``(scales, k)``.

        Within a play of scale g a reading is off by N(0, (g u J)²), J its derivative by the play;
        by a mistake it is off by any size.
        """
        adopted = self._log_usual(self.adopted_mm**2)
        gain = np.zeros((len(SCALES), len(components)))
        for k, component in enumerate(components):
            changes = [
                component.unit[share.values[0]] * self.derivatives[share.place]
                for share in component.shares
                if share.effect.id == Backlash.id
            ]
            if changes:
                square = np.square(changes).sum(axis=0)
                of_scale = [self.adopted_mm**2 + scale**2 * square for scale in SCALES]
                gain[:, k] = [self._log_usual(play_mm2) - adopted for play_mm2 in of_scale]
        return adopted, gain

    def reached_by(self, play_mm: Mapping[str, float]) -> bool:
        """Whether adopted plays and these, by their places, reach one of them and all far ones."""
        reaches_mm = (abs(size * self.derivatives[place]) for place, size in play_mm.items())
        reached = sum(reaches_mm, self.adopted_mm) >= self.off_mm
        return bool(reached.any() and reached[self.beyond].all())

    def _log_usual(self, square_mm2: FloatArray) -> float:
        """Log density within plays of these mean squares ``(n,)``, over that of a mistake."""
        square_mm2 = np.maximum(square_mm2, FINEST_MM**2)
        within = -0.5 * (self.off_mm**2 / square_mm2 + np.log(2.0 * math.pi * square_mm2))
        log_density = within + np.log(2.0 * LOG_RANGE * self.off_mm)
        return float(np.maximum(log_density, 0.0).sum())


def _apart(cells: Cells) -> Iterator[tuple[int, float]]:
    """First takes with a zero of their own, and how far each is from its nearest repeat, mm."""
    means = cells.means
    place = numbered(means.leg, means.axis, means.station, means.over_plane)
    posture = numbered(place, means.level, *means.position_mm.T)
    alone = np.bincount(means.mount)[means.mount] == 1
    for row in np.flatnonzero(alone & ~means.approach_known).tolist():
        repeats: IntArray = np.flatnonzero((posture == posture[row]) & ~alone)
        if len(repeats):
            off_mm = means.value_mm[row] - means.value_mm[repeats]
            yield row, float(off_mm[np.abs(off_mm).argmin()])


def log_priors(
    within: Sequence[WithinPlay], components: Sequence[Component]
) -> tuple[float, FloatArray]:
    """Log prior of first takes within adopted plays, and of components ``(scales, k)``."""
    log_usual = 0.0
    log_prior = np.tile([component.log_prior for component in components], (len(SCALES), 1))
    for takes in within:
        priors, gain = takes.log_more(components)
        log_usual, log_prior = log_usual + priors, log_prior + gain
    return log_usual, log_prior


def reached(
    models: Sequence[WeightedModel], within: Sequence[WithinPlay], components: Sequence[Component]
) -> tuple[list[WeightedModel], float]:
    """Models with a play that reaches first takes, and the log share that they have of all.

    All of them and -inf where none does.
    """
    reaching = []
    for model in models:
        play_mm = _plays_mm(model, components)
        if any(takes.reached_by(play_mm) for takes in within):
            reaching.append(model)
    share = math.fsum(model.weight for model in reaching)
    if not share:
        return [*models], -math.inf
    return [replace(m, weight=m.weight / share) for m in reaching], math.log(share)


def _plays_mm(model: WeightedModel, components: Sequence[Component]) -> dict[str, float]:
    """How large a model's play of each carriage may be, `REACHES` above its mean."""
    play_mm = dict[str, float]()
    for k, places in model.places(components).items():
        for share in components[k].shares:
            if share.effect.id == Backlash.id:
                first = places.start + share.values[0]
                variance = float(model.variance_at(slice(first, first + 1))[0])
                size = abs(float(model.mean[first])) + REACHES * math.sqrt(variance)
                play_mm[share.place] = play_mm.get(share.place, 0.0) + size
    return play_mm
