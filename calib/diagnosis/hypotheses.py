"""What may be missing: the catalogue at every place, powers of travel, other bars.

What each costs before any reading, and which a procedure cannot tell apart. The lead of a screw
that the machine file does not name is searched in the readings.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.arrays import BLIND, LEG_NAMES, FloatArray, Observations, stacks, without
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import Case, Problem
from calib.diagnosis.results import AliasMap, Imitation
from calib.diagnosis.selection import contained
from calib.noise.reading import IndicatorFigures
from calib.tripod.effects.candidates import (
    Candidate,
    candidates,
    candidates_together,
    invisible,
    stacked_columns,
)
from calib.tripod.effects.drives import ISO_LEADS_MM, ActuatorCyclic, ActuatorScale
from calib.tripod.effects.effect import (
    PER_THOUSAND,
    Effect,
    EffectInstance,
    EffectParameter,
    Kind,
)
from calib.tripod.effects.empirical import BASES, Empirical
from calib.tripod.pipeline import Model, Stage, command

SURE = 2.0
"""Standard uncertainties by which a size must be beyond its limit."""

MOST_LOSS = 200.0
"""What a candidate's own size may cost; a model's sizes together cost without limit."""

ALL = "all"
LENGTHS = "leg_length"
LENGTH = EffectParameter("length", "mm", 0.1)

ALIAS_NOISE_MM = 0.002
"""Noise beside which effects are compared."""

TOLERANCE_MM = (2.0, 2.0, 2.0, 0.1, 0.1, 0.1)
"""Of joint offsets and bar lengths."""

STEP = 0.25
"""Of the grid of frequencies, in turns over the whole travel: neighbours are nearly alike."""

LEAST_LEVELS = 4
"""Postures away from Zero that a carriage's own leg needs: sine, cosine and lead fit any three."""

FINE = 10
"""Parts of a step, around the best."""


def hypotheses_of(problem: Problem, effects: Sequence[Effect]) -> list[Candidate]:
    """Every candidate that the sessions can show, stacked over them; other bars in one of them.

    Powers of one carriage's travel run beside them: what they do as well is not claimed by name.
    """
    sessions = [(one.model, one.observed) for one in problem.fitted_sessions]
    powers = [Empirical((name,)) for name in BASES if BASES[name].stage == Stage.ACTUATOR]
    every = candidates_together(sessions, [*with_searched_leads(problem, effects), *powers])
    known = [one for one in every if one.kind != Kind.EMPIRICAL or one.arrangement == "one"]
    return [*known, *_other_bars(problem)]


def is_known(candidate: Candidate) -> bool:
    """Whether it is an effect with a name; no mistake, no power of travel."""
    return candidate.kind not in (Kind.GROSS_ERROR, Kind.EMPIRICAL)


def _other_bars(problem: Problem) -> list[Candidate]:
    """Each session but the first measured with bars of other lengths."""
    sessions = problem.fitted_sessions
    of_row = np.repeat(np.arange(len(sessions)), [len(one.observed) for one in sessions])
    title = "the bars are not those of the first session: diagnose the sessions one at a time"
    found = []
    for k, one in enumerate(sessions[1:], start=1):
        columns = np.zeros((len(of_row), 3))
        columns[of_row == k] = one.base[:, 3:] / one.case.tolerance_mm[3:]
        what = "other_bars", title, Kind.GROSS_ERROR, f"session {k + 1}", "one"
        found.append(Candidate(*what, (LENGTH,) * 3, columns))
    return found


def causes_of(candidate: Candidate) -> int:
    """How many things are wrong at once: axes, bars, indicators with values of their own.

    Lengths beyond their tolerance are one: who made one bar so made the others.
    """
    together = candidate.kind == Kind.ENVIRONMENT or candidate.id == LENGTHS
    if candidate.arrangement != "each" or together:
        return 1
    if candidate.kind == Kind.INDICATOR:
        return len(candidate.shares)
    return 1 + candidate.where.count(",")


def unremarkable(candidate: Candidate) -> FloatArray:
    """Sizes of its parameters ``(r,)`` that nobody would remark on."""
    return np.array([parameter.tolerance for parameter in candidate.parameters])


def log_priors(problem: Problem, candidates: Sequence[Candidate]) -> FloatArray:
    """What each candidate costs in log weight ``(J,)``: to be chosen, and for its size."""
    lost = np.minimum(losses(problem, [[one] for one in candidates]), MOST_LOSS)
    return np.asarray(log_choices(candidates) + lost)


def log_choices(candidates: Sequence[Candidate]) -> FloatArray:
    """What it costs to choose each ``(J,)``, every cause of it anew, before any reading.

    All effects are equally likely; then whether one part errs or identical parts err alike; then
    which, and in which arrangement. Variants, such as screws of other leads, count as one. Bars
    need not be chosen: that they are off is known, only not how far.
    """
    causes = [causes_of(one) for one in candidates]
    simple = {
        (one.id, one.where, one.arrangement)
        for one, count in zip(candidates, causes, strict=True)
        if count == 1
    }
    ways = Counter((name, where == ALL) for name, where, _ in simple)
    kinds = Counter(name for name, _ in ways)
    effects = len({one.id for one in candidates})
    choices = [
        (1 if one.id == LENGTHS else effects)
        * max(kinds[one.id], 1)
        * max(ways[one.id, one.where == ALL], 1)
        for one in candidates
    ]
    return np.asarray(np.array(causes) * np.log(np.array(choices, dtype=np.float64)))


def losses(problem: Problem, together: Sequence[Sequence[Candidate]]) -> FloatArray:
    """What sets of candidates lose ``(k,)`` for the sizes that they would need, in log weight.

    A normal prior on each parameter, thirty times the unremarkable size wide and cut off at its
    limit: a fit that needs more pays, and directions that hardly show are not inflated.
    """
    sizes = [POLICY.far * np.concatenate([unremarkable(one) for one in some]) for some in together]
    limits = [np.array([p.limit for one in some for p in one.parameters]) for some in together]
    columns = [np.hstack([one.columns for one in some]) for some in together]
    found = np.zeros(len(together))
    y = problem.y[:, None]
    for alike, stacked in stacks([c * s for c, s in zip(columns, sizes, strict=True)]):
        white = problem.free(stacked)
        left, singular, right = np.linalg.svd(white, full_matrices=False)
        seen = singular > BLIND * singular.max(axis=1, keepdims=True, initial=0.0)
        along = left.transpose(0, 2, 1) @ y
        free = y - left @ (seen[:, :, None] * along)
        held = 1.0 / (singular**2 + 1.0)
        value = ((singular * held * along[:, :, 0])[:, None] @ right)[:, 0]
        unsure = (held[:, None] @ right**2)[:, 0]
        most = np.array([limits[k] / sizes[k] for k in alike]) + SURE * np.sqrt(unsure)
        value = np.clip(value, -most, most)
        residual = y - white @ value[:, :, None]
        loss = (residual**2).sum(axis=(1, 2)) - (free**2).sum(axis=(1, 2)) + (value**2).sum(axis=1)
        found[alike] = np.maximum(0.5 * loss, 0.0)
    return found


def alias_map(model: Model, taken: Observations, effects: Sequence[Effect]) -> AliasMap:
    """Compare every effect in its smallest places with every other; base parameters are free.

    ``taken`` holds the readings of a procedure; their values do not matter.
    """
    figures = IndicatorFigures(repeatability_mm=ALIAS_NOISE_MM)
    session = Case(model, taken, figures, np.array(TOLERANCE_MM)).fitted()
    problem = Problem.of([session])
    compared = [c for c in candidates(model, session.observed, effects) if c.arrangement != "each"]
    blocks = problem.blocks([c.columns for c in compared])
    found = []
    for i, first in enumerate(compared):
        for j, second in enumerate(compared):
            if first.id == second.id or not blocks[i].shape[1]:
                continue
            share = contained(blocks[i], blocks[j])
            if share > POLICY.alike:
                column = problem.free(first.columns @ unremarkable(first))
                rest = float((without(blocks[j], column) ** 2).sum())
                pair = (first.id, first.where), (second.id, second.where)
                found.append(Imitation(*pair, share, rest))
    return AliasMap(
        tuple(dict.fromkeys((c.id, c.where) for c in compared)),
        tuple(found),
        invisible(model, session.observed, effects),
    )


def with_searched_leads(problem: Problem, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The laws, and the cyclic error whose lead explains most at each carriage.

    None where the machine file names the lead or cyclic errors are not among the laws.
    """
    geometry = problem.fitted_sessions[0].model.geometry
    known = {one.lead_mm for one in effects if isinstance(one, ActuatorCyclic)}
    if geometry.screw_lead_mm is not None or not known:
        return tuple(effects)
    leads = [best for screw in screws_of(problem) if (best := screw.best_lead_mm())]
    return (*effects, *(ActuatorCyclic(lead) for lead in dict.fromkeys(leads) if lead not in known))


def other_leads_mm(
    problem: Problem, basis: FloatArray, placed: Sequence[EffectInstance]
) -> list[float]:
    """Other leads that cannot be told from that of a screw which was named.

    ``basis`` ``(n, r)`` is what else was named; none where several screws were named together.
    """
    screws = [one for one in screws_of(problem) if [p.place for p in placed] == [one.place]]
    effect = placed[0].effect if placed else None
    if not screws or not isinstance(effect, ActuatorCyclic):
        return []
    return screws[0].other_leads_mm(basis, effect.lead_mm)


@dataclass(frozen=True, eq=False)
class Screw:
    """A carriage: its travel ``(n,)``, mm, and what the readings change for each mm of it."""

    problem: Problem
    place: str
    travel_mm: FloatArray
    per_mm: FloatArray

    @cached_property
    def _step(self) -> float:
        return STEP / max(float(np.ptp(self.travel_mm)), STEP * ISO_LEADS_MM[-1])

    @cached_property
    def _grid(self) -> FloatArray:
        """Turns for each mm of travel."""
        return np.arange(1.0 / ISO_LEADS_MM[-1], 1.0 / ISO_LEADS_MM[0] + self._step / 2, self._step)

    def other_leads_mm(self, basis: FloatArray, lead_mm: float) -> list[float]:
        """Peaks that cannot be told from this lead.

        One within half a turn over the whole travel is the same lead, not so well known.
        """
        grid = self._grid
        squares = self.explained(1.0 / grid, basis)
        inner = np.concatenate([[-np.inf], squares, [-np.inf]])
        peak = (squares >= inner[:-2]) & (squares >= inner[2:])
        own = float(self.explained(np.array([lead_mm]), basis)[0])
        apart = np.abs(grid - 1.0 / lead_mm) > 2.0 * self._step
        return [
            float(f"{1.0 / turns:.2g}")
            for turns in grid[peak & apart & (squares > own - POLICY.told_apart)]
        ]

    def best_lead_mm(self) -> float | None:
        """The lead that explains most; a standard one if it does as well.

        None where the best explains less than `POLICY.decisive`: pure noise reaches that at some
        lead and carriage in less than one of 1000 sessions.
        """
        grid = self._grid
        near = float(grid[np.argmax(self.explained(1.0 / grid))])
        around = near + self._step * np.linspace(-1.0, 1.0, 2 * FINE + 1)
        fine = 1.0 / np.clip(around, *grid[[0, -1]])
        squares = self.explained(fine)
        best = float(squares.max())
        if best < POLICY.decisive:
            return None
        standard = self.explained(np.array(ISO_LEADS_MM))
        if standard.max() >= best - POLICY.told_apart:
            return ISO_LEADS_MM[int(np.argmax(standard))]
        return float(f"{fine[np.argmax(squares)]:.3g}")

    def explained(self, leads_mm: FloatArray, basis: FloatArray | None = None) -> FloatArray:
        """Squares ``(k,)`` that sine and cosine of each lead explain, in noise variances.

        Beside a basis ``(n, r)`` of what else was named.
        """
        turn = 2.0 * np.pi * self.travel_mm[:, None] / leads_mm
        waves = np.sin(turn), np.cos(turn) - 1.0
        sine, cosine = (self.problem.free(self.per_mm[:, None] * wave) for wave in waves)
        y = self.problem.y
        if basis is not None:
            y, sine, cosine = (without(basis, one) for one in (y, sine, cosine))
        square = (sine * sine).sum(axis=0)
        rest = cosine - sine * ((sine * cosine).sum(axis=0) / square)
        return np.asarray((y @ sine) ** 2 / square + (y @ rest) ** 2 / (rest * rest).sum(axis=0))


def screws_of(problem: Problem) -> list[Screw]:
    """The carriages that were read in enough postures."""
    sessions = [(one.model, one.observed) for one in problem.fitted_sessions]
    (columns,) = stacked_columns(sessions, [ActuatorScale()])
    commands = np.vstack([command(model.geometry, taken) for model, taken in sessions])
    travel = commands - sessions[0][0].geometry.zero_mm
    touched = problem.conditions("leg")
    found = []
    for place, column in columns.items():
        own = travel[:, LEG_NAMES.index(place)]
        moved = own != 0.0
        levels = np.unique(own[moved & (touched == LEG_NAMES.index(place))].round(3))
        if len(levels) < LEAST_LEVELS:
            continue
        per_mm = np.where(moved, column[:, 0] / np.where(moved, PER_THOUSAND * own, 1.0), 0.0)
        found.append(Screw(problem, place, own, per_mm))
    return found
