"""What to measure next: what lowers the bound at the tool most for its minutes.

Also which measurement separates the names that stay open, and, where no reading of legs lowers the
bound, which measurement outside shows what they cannot see.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, starmap

import numpy as np

from calib.arrays import TIE, FloatArray, descending
from calib.posterior.correction import Correction, parts_of
from calib.posterior.forecast import HEAVIEST, Forecast
from calib.posterior.library import ELSE
from calib.posterior.measurements import FurtherMeasurement, MeasurementPreparation
from calib.posterior.mixture import ExpectedReadings
from calib.posterior.models import Posterior
from calib.tripod.effects.drives import StraightnessOfFourthOrder
from calib.tripod.effects.empirical import EMPIRICAL

WORTH = 0.9
"""A measurement is worth its time where it lowers the bound to less than this part."""

MOST_FURTHER = 6
GOAL = 60.0
"""Noise variances between two names that are aimed at: values are known by estimate only."""
NEARLY = 0.97
"""A shorter measurement is preferred when it separates so much of the best."""
APART = 1.0
"""Names that no measurement separates by so many noise variances are one thing in other words."""
DECISIVE = 25.0
"""Noise variances from which a measurement decides between names; below it helps."""
DECIDED = 0.95
"""Probability from which a name is not open."""
OPEN = 0.01
"""Weight, beside the likeliest, that a rival has at least."""
MOST_COMPARED = 6
NEAR = 0.1
"""Weight, beside the likeliest of a name, from which another model of it counts."""
MOST_OF_NAME = 3


@dataclass(frozen=True, eq=False)
class Proposal:
    """A measurement, the expected bound at the tool after it, and what a minute of it gains."""

    candidate: FurtherMeasurement
    bound_mm: float
    gain_mm_per_minute: float


Name = tuple[tuple[str, str], ...]
"""Ids and places of what is true together; none where nothing has a name."""


@dataclass(frozen=True, eq=False)
class Separation:
    """The measurement that tells names apart: the two nearest by ``apart`` noise variances."""

    candidate: FurtherMeasurement
    names: tuple[Name, ...]
    apart: float

    @property
    def words(self) -> str:
        """The measurement and what it decides between."""
        verb = "decides" if self.apart >= DECISIVE else "helps to decide"
        names = [" with ".join(starmap(_place_words, name)) for name in self.names]
        names = [name or "no effect" for name in names]
        return f"{self.candidate.words}; it {verb} between {', '.join(names[:-1])} and {names[-1]}"


def _place_words(name: str, where: str) -> str:
    """An effect and its place; what is everywhere and has no name has no place to state."""
    if name == ELSE:
        return "an effect without a name"
    unnamed = name in (EMPIRICAL, StraightnessOfFourthOrder.id)
    return f"{'an unnamed effect' if unnamed else name} ({where})"


@dataclass(frozen=True)
class OutsideMeasurement:
    """A measurement with another instrument, and the bound where it shows no error.

    ``share`` is the part of the square of the bound that no reading of legs shows.
    """

    instrument: str
    words: str
    share: float
    bound_mm: float


@dataclass(frozen=True)
class FurtherSetUp:
    """Set-ups read over the whole way, there and back, and the bound at the tool afterwards.

    ``legs`` each get one at this station. ``minutes`` count from the first of them.
    """

    legs: tuple[str, ...]
    station: float
    displacements_mm: tuple[float, ...]
    minutes: float
    bound_mm: float


@dataclass(frozen=True)
class Reach:
    """The bound at the tool now, and after further set-ups in turn.

    They go on as long as one lowers the bound to `WORTH` of what it was.
    """

    bound_mm: float
    further: tuple[FurtherSetUp, ...]

    @property
    def is_last(self) -> bool:
        """Whether more set-ups would not help."""
        return len(self.further) < MOST_FURTHER

    def towards(self, wanted_mm: float, before_mm: float = math.inf) -> FurtherSetUp | None:
        """The next set-up; None where the bound is as wanted, or more would not help.

        More does not help where none is worth it, nor where the last one was not: ``before_mm`` is
        the bound before that.
        """
        helped = self.bound_mm <= WORTH * before_mm
        return self.further[0] if self.further and helped and self.bound_mm > wanted_mm else None


@dataclass(frozen=True, eq=False)
class Planner:
    """A posterior, what is entered from it, and what may be measured.

    A reading has the noise of the last session, or ``stated_mm``.
    """

    posterior: Posterior
    correction: Correction
    candidates: tuple[FurtherMeasurement, ...]
    stated_mm: float | None = None

    @cached_property
    def forecast(self) -> Forecast:
        """The posterior with what is entered now: it is entered anew after the measurement."""
        left_out = {entry.part for entry in self.correction.left_out}
        index = [
            k
            for group, parts in parts_of(self.posterior, self.correction.holds).items()
            for name, columns in parts
            for k in columns
            if group not in left_out and name not in left_out
        ]
        frame = self.correction.frame
        return Forecast(self.posterior, frame, index, self.stated_mm)

    @property
    def bound_mm(self) -> float:
        """Bound with the correction as it is, in its frame."""
        return self.correction.off.bound_mm[self.correction.frame]

    @cached_property
    def readings(self) -> list[ExpectedReadings]:
        """What each candidate is expected to show."""
        expectations: dict[tuple[MeasurementPreparation, int], ExpectedReadings] = {}
        for preparation in dict.fromkeys(candidate.preparation for candidate in self.candidates):
            alike = (c.taken for c in self.candidates if c.preparation == preparation)
            set_ups = {(preparation, id(set_up)): set_up for taken in alike for set_up in taken}
            expected = self.forecast.readings([*set_ups.values()], preparation.model)
            expectations |= dict(zip(set_ups, expected, strict=True))
        return [
            ExpectedReadings.together(
                [expectations[candidate.preparation, id(s)] for s in candidate.taken]
            )
            for candidate in self.candidates
        ]

    @cached_property
    def _scale(self) -> float:
        """The bound over that of the models of the forecast, which are not all."""
        return self.bound_mm / self.forecast.now_mm

    @cached_property
    def proposals(self) -> list[Proposal]:
        """The best a minute first."""
        proposals = []
        for candidate, readings in zip(self.candidates, self.readings, strict=True):
            bound_mm = self._scale * self.forecast.after_mm(readings)
            gain = (self.bound_mm - bound_mm) / candidate.minutes
            proposals.append(Proposal(candidate, bound_mm, gain))
        return descending(proposals, lambda proposal: proposal.gain_mm_per_minute)

    @property
    def more_helps(self) -> bool:
        """Whether any proposal lowers the bound to less than `WORTH`."""
        return any(proposal.bound_mm < WORTH * self.bound_mm for proposal in self.proposals)

    @cached_property
    def reach(self) -> Reach:
        """Set-ups over the whole way, one after the other, each the best for its time.

        What an option gained when it was last tried is more than it gains now, so most need not be
        tried again.
        """
        gains = {k: math.inf for k, candidate in enumerate(self.candidates) if candidate.is_way}
        plan: list[ExpectedReadings] = []
        further: list[FurtherSetUp] = []
        bound_mm, minutes = self.bound_mm, 0.0
        while len(further) < MOST_FURTHER:
            best: tuple[int, float] | None = None
            for k in descending(gains, gains.__getitem__):
                if best and gains[k] <= (1.0 + TIE) * gains[best[0]]:
                    break
                together = ExpectedReadings.together([*plan, self.readings[k]])
                after_mm = self._scale * self.forecast.after_mm(together)
                gains[k] = math.log(bound_mm / after_mm) / self.candidates[k].minutes
                better = best is None or gains[k] > (1.0 + TIE) * gains[best[0]]
                if better and after_mm < WORTH * bound_mm:
                    best = k, after_mm
            if best is None:
                break
            candidate, bound_mm = self.candidates[best[0]], best[1]
            plan.append(self.readings[best[0]])
            minutes += candidate.minutes
            where = candidate.legs, candidate.station, candidate.levels_mm
            further.append(FurtherSetUp(*where, minutes, bound_mm))
        return Reach(self.bound_mm, tuple(further))

    @cached_property
    def _open(self) -> list[tuple[Name, float, list[int]]]:
        """Names that stay open, their probability and their likeliest models; or none.

        A name has several models where these fit about as well, such as screws of other leads.
        """
        shares: dict[Name, float] = {}
        names = [self._name(model.members) for model in self.posterior.models]
        for model, name in zip(self.posterior.models, names, strict=True):
            shares[name] = shares.get(name, 0.0) + model.weight
        models: dict[Name, list[int]] = {}
        for k, number in enumerate(self.forecast.numbers[:HEAVIEST].tolist()):
            models.setdefault(names[number], []).append(k)
        likeliest = descending(shares, shares.__getitem__)[:MOST_COMPARED]
        if shares[likeliest[0]] >= DECIDED:
            return []
        names_open = []
        for name in likeliest:
            of_name, weight = models.get(name, []), self.forecast.weight
            heaviest = [k for k in of_name if weight[k] >= NEAR * weight[of_name[0]]]
            if heaviest and shares[name] >= OPEN * shares[likeliest[0]]:
                names_open.append((name, shares[name], heaviest[:MOST_OF_NAME]))
        return names_open

    def _name(self, members: Sequence[int]) -> Name:
        components = [self.posterior.components[k] for k in members]
        return tuple(sorted((component.id, component.where) for component in components))

    def _apart(self) -> list[FloatArray]:
        """How far each candidate separates open names, in noise variances of nearest models."""
        models = [k for _, _, numbers in self._open for k in numbers]
        starts = np.cumsum([0, *(len(numbers) for _, _, numbers in self._open[:-1])])
        matrices = []
        for apart in self.forecast.apart(self.readings, models):
            rows = np.minimum.reduceat(np.minimum(apart, apart.T), starts, axis=0)
            matrices.append(np.asarray(np.minimum.reduceat(rows, starts, axis=1)))
        return matrices

    @cached_property
    def separation(self) -> Separation | None:
        """The shortest measurement that separates open names nearly best; None where none does.

        What needs no change of the machine comes first.
        """
        if len(self._open) < 2 or not self.candidates:
            return None
        weight = np.array([share for _, share, _ in self._open])
        apart = self._apart()
        score = np.array([weight @ np.minimum(distances, GOAL) @ weight for distances in apart])
        best = min(
            np.flatnonzero(score >= NEARLY * score.max()).tolist(),
            key=lambda k: (bool(self.candidates[k].preparation.words), self.candidates[k].minutes),
        )
        largest = float(apart[best][0, 1:].max())
        least = DECISIVE if largest >= DECISIVE else APART
        subset = [0]
        for k in range(1, len(self._open)):
            if all(apart[best][k, earlier] >= least for earlier in subset):
                subset.append(k)
        if len(subset) < 2:
            return None
        nearest = min(float(apart[best][a, b]) for a, b in combinations(subset, 2))
        return Separation(self.candidates[best], tuple(self._open[k][0] for k in subset), nearest)

    @cached_property
    def outside(self) -> OutsideMeasurement | None:
        """What shows the part of the error that legs do not see, where it is the larger one."""
        errors = self.posterior.for_bounds.tool_errors[self.correction.frame]

        def bound(columns: Sequence[int]) -> float:
            return errors.without(columns).bound_mm(self.correction.off.values)

        bound_mm = errors.bound_mm(self.correction.off.values)
        seen_mm = errors.seen.bound_mm(self.correction.off.values)
        share = 1.0 - (seen_mm / bound_mm) ** 2
        if share <= 0.5:
            return None
        bounds = {instrument: bound(columns) for instrument, (columns, _) in OUTSIDE.items()}
        best = min(bounds, key=lambda instrument: bounds[instrument])
        return OutsideMeasurement(best, OUTSIDE[best][1], share, bounds[best])


OUTSIDE: dict[str, tuple[tuple[int, ...], str]] = {
    "square": (
        (-1,),
        "read the tool along a square that is aligned with the table: it shows how far the machine "
        "is turned about Z",
    ),
    "plate": (
        (-3, -2),
        "read the tool against a plate that lies on the table: it shows how far the machine is "
        "turned about X and Y",
    ),
    "ball": (
        (-6, -5, -4),
        "touch a ball at a known place of the table: it shows how far the machine is shifted",
    ),
}
"""Instruments, the shifts and turns of the machine that each shows, and how."""
