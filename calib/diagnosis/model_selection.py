"""Which candidates are named: one step after the other, each judged against pure noise.

What is kept is then fitted through the nonlinear simulation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import (
    NEW_DIRECTION,
    FloatArray,
    incidence,
    new_directions,
    numbered,
    onto,
    rank_of,
    squares_in_each,
    without,
)
from calib.diagnosis.hypotheses import (
    causes_of,
    is_known,
    log_priors,
    losses,
    unremarkable,
)
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import Problem
from calib.diagnosis.results import Gap, Value
from calib.diagnosis.selection import (
    CandidateSearch,
    Spread,
    WeighedModel,
    credible_set,
    evidence,
    foremost,
    global_p_value,
    heaviest_first,
    null_scores,
    scores,
)
from calib.errors import NotIdentifiable
from calib.noise.reading import LEAST_NOISE_MM
from calib.tripod.effects.candidates import Candidate
from calib.tripod.effects.effect import EffectInstance, Kind

MOST_LOOKED_AT = 100
"""Models of one size whose sizes are judged together, at most."""

CORRECTIONS = 2
"""How often sizes go through the simulation, which bends where derivatives do not."""

Sizes = dict[int, tuple[tuple[Value, ...], tuple[EffectInstance, ...]]]
"""Parameters of each candidate, and the effects that they make."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Which models explain the gap. ``kept`` is the best one, None where nothing may be named.

    ``models`` is the 95 % set around it; ``step_p`` the global p-value of each effect kept;
    ``local_log_p`` ``(J,)`` the log p-value of each candidate alone; ``adequate`` tells whether the
    residual agrees with the noise. Where ``doubted``, repeats that are none explain as much.
    """

    kept: WeighedModel | None
    models: tuple[WeighedModel, ...]
    singles: tuple[WeighedModel, ...]
    step_p: tuple[float, ...]
    local_log_p: FloatArray
    adequate: bool
    doubted: bool

    @property
    def members(self) -> tuple[int, ...]:
        """Candidates of the model that was kept."""
        return self.kept.members if self.kept else ()


@dataclass(eq=False)
class ModelSelection:
    """Candidates as blocks ``(n, r)`` over one problem, and their log priors ``(J,)``.

    Which of them explain the readings, and of which sizes they are then.
    """

    problem: Problem
    candidates: Sequence[Candidate]
    blocks: Sequence[FloatArray]
    log_priors: FloatArray

    def __post_init__(self) -> None:
        self._refined: dict[tuple[int, ...], tuple[Sizes, FloatArray]] = {}

    @classmethod
    def of(cls, problem: Problem, candidates: Sequence[Candidate]) -> ModelSelection:
        """Of candidates that show at all; a power that a named effect imitates is left out."""
        blocks = problem.blocks([one.columns for one in candidates])
        known = [
            block
            for one, block in zip(candidates, blocks, strict=True)
            if is_known(one) and causes_of(one) == 1
        ]
        shown = [
            k
            for k, block in enumerate(blocks)
            if block.shape[1]
            and not (
                candidates[k].kind == Kind.EMPIRICAL
                and known
                and squares_in_each(known, block).max() > POLICY.alike * block.shape[1]
            )
        ]
        some = [candidates[k] for k in shown]
        return cls(problem, some, [blocks[k] for k in shown], log_priors(problem, some))

    @cached_property
    def search(self) -> CandidateSearch:
        """Sets of candidates, weighed."""
        return CandidateSearch(self.problem.y, self.blocks, self.problem.spread, self.log_priors)

    def run(self) -> Outcome:
        """Name what can be named."""
        first_p, local = self.step(())
        chosen: WeighedModel | None = None
        models: list[WeighedModel] = []
        steps, doubted = [first_p], False
        if first_p <= POLICY.naming_level:
            chosen, weighed = self._grow(steps)
            models = credible_set(weighed)
            own = self.own_errors("cell") if self.problem.has_repeats() else -np.inf
            doubted = chosen.log_weight < own
            if doubted or not self.leaves_no_gap(chosen.members):
                chosen, models = self._beside_own_errors()
        adequate = self.leaves_no_gap(chosen.members if chosen else ())
        found = tuple(models), tuple(self.search.singles), tuple(steps)
        return Outcome(chosen, *found, local, adequate, doubted and not chosen)

    def _grow(self, steps: list[float]) -> tuple[WeighedModel, list[WeighedModel]]:
        """The smallest number of causes whose best model leaves nothing that stands out."""
        causes = [causes_of(one) for one in self.candidates]
        sizes = self.search.by_causes(causes, POLICY.most_causes)
        everything = self._paid(next(sizes))
        best = foremost(everything or self.search.singles)
        for _ in range(1, POLICY.most_causes):
            closed = self.leaves_no_gap(best.members)
            p, _ = self.step(best.members, drawn=not closed)
            if (closed and p > POLICY.naming_level) or not (larger := next(sizes)):
                break
            larger = self._paid(larger)
            everything = [*everything, *larger]
            best = foremost(larger)
            steps.append(p)
        return best, everything

    def _paid(self, models: Sequence[WeighedModel]) -> list[WeighedModel]:
        """Less what they lose for their sizes together; without those far behind."""
        found: list[WeighedModel] = []
        for model in heaviest_first(models)[:MOST_LOOKED_AT]:
            best = max((m.log_weight for m in found), default=-np.inf)
            if model.log_weight < best - POLICY.beyond:
                break
            weight = model.log_weight - self.far_together(model.members)
            found.append(replace(model, log_weight=weight))
        return found

    def far_together(self, members: tuple[int, ...]) -> float:
        """Log weight lost for sizes that only the sizes of the others call for."""
        if len(members) < 2:
            return 0.0
        candidates = [self.candidates[k] for k in members]
        together, *alone = losses(self.problem, [candidates, *([one] for one in candidates)])
        return max(float(together - sum(alone)), 0.0)

    def own_errors(self, of: str) -> float:
        """Log weight of an error of its own at each posture (``level``) or ``cell``, and no name.

        It explains any shape: what does not do much better has no claim to a name.
        """
        if self.problem.noise_df <= 0.0:
            return -np.inf
        own = incidence(numbered(self.problem.mount, self.problem.conditions(of)))
        return evidence(*self.problem.explained_by(own), self.problem.spread)

    def _beside_own_errors(self) -> tuple[WeighedModel | None, list[WeighedModel]]:
        """What stands out where postures err by themselves, by an amount that only the gap tells.

        Errors that stay with a posture would otherwise be named after whatever resembles them.
        """
        problem = self.problem
        spread = Spread(problem.gap(problem.y), float(problem.structure_df))
        search = replace(self.search, y=onto(problem.structure, problem.y), spread=spread)
        causes = [causes_of(one) for one in self.candidates]
        sizes = search.by_causes(causes, POLICY.most_causes)
        models = {model.members: model for some in (search.singles, *sizes) for model in some}
        weighed = self._paid([*models.values()])
        if not weighed or foremost(weighed).log_weight < 0.5 * POLICY.decisive:
            return None, []
        return self.search.weighed(foremost(weighed).members), credible_set(weighed)

    def step(self, kept: tuple[int, ...], *, drawn: bool = False) -> tuple[float, FloatArray]:
        """Global p-value of the best further candidate, and the local log p of each ``(J,)``.

        Without any noise known they are judged by what each of them leaves. The best of many is no
        less likely than itself alone: where that is enough not to name it, and the p-value need not
        be ``drawn``, it is this limit.
        """
        others = [k for k in range(len(self.blocks)) if k not in kept]
        blocks, y = self.beside(kept, others)
        noise_df = self.problem.noise_df or None
        df = self._structure_df(kept)
        shown = [block for block in blocks if block.shape[1]]
        local = np.zeros(len(self.blocks))
        only_rounding = noise_df is None and self.problem.gap_rms_mm(y) < LEAST_NOISE_MM
        if not shown or only_rounding:
            return 1.0, local
        present = [k for k, block in zip(others, blocks, strict=True) if block.shape[1]]
        squares = squares_in_each(shown, y)[:, None]
        total = np.array([self.problem.gap(y)])
        if noise_df is None:
            squares = np.minimum(squares, total)
        ranks = [block.shape[1] for block in shown]
        local[present] = scores(squares, ranks, noise_df, df, total)[:, 0]
        best, deviation = float(local.min()), self.problem.unevenness()
        least = math.exp(best)
        if least > POLICY.naming_level and not drawn and (deviation == 1.0).all():
            return least, local
        null = null_scores(shown, noise_df, df, deviation)
        return global_p_value(best, null), local

    def beside(
        self, kept: tuple[int, ...], some: Sequence[int]
    ) -> tuple[list[FloatArray], FloatArray]:
        """Blocks of some candidates and the vector, with those that are kept projected out."""
        blocks = [self.blocks[k] for k in some]
        if not kept:
            return blocks, self.problem.y
        basis = self.search.basis(kept)
        return new_directions(basis, blocks), without(basis, self.problem.y)

    def gap(self, kept: tuple[int, ...]) -> Gap:
        """What a model leaves beyond the scatter of repeats."""
        residual, df = self.residual(kept), self._structure_df(kept)
        gap = self.problem.gap(residual)
        rms_mm = self.problem.gap_rms_mm(residual)
        return Gap(rms_mm, gap, df, self.problem.gap_p_value(gap, df))

    def leaves_no_gap(self, kept: tuple[int, ...]) -> bool:
        """Whether the residual agrees with the noise."""
        return self.gap(kept).p_value > POLICY.agreement_level

    def residual(self, kept: tuple[int, ...]) -> FloatArray:
        """What a model leaves ``(n,)``, whitened."""
        return without(self.search.basis(kept), self.problem.y)

    def _structure_df(self, kept: tuple[int, ...]) -> int:
        inside = self.problem.structure.T @ self.search.basis(kept)
        return max(self.problem.structure_df - rank_of(inside, NEW_DIRECTION, 1.0), 0)

    def refined(self, members: tuple[int, ...]) -> tuple[Sizes, FloatArray]:
        """`values` through the nonlinear simulation: effects in, base fitted anew, corrected.

        With them ``y`` ``(n,)`` as a machine would leave it that follows its derivatives so far.
        """
        if members in self._refined:
            return self._refined[members]
        problem = self.problem
        found, y = self.values(members), problem.y
        for _ in range(CORRECTIONS):
            linear_mm = np.zeros_like(problem.y)
            for k, (parameters, effects) in found.items():
                if effects:
                    values = np.array([v.value for v in parameters])
                    linear_mm += self.candidates[k].columns @ values
            adopted = tuple(effect for _, each in found.values() for effect in each)
            try:
                y = problem.adopting(adopted).y + problem.free(linear_mm)
            except NotIdentifiable:
                y = problem.y
                break
            beyond = onto(self.search.basis(members), y - problem.y)
            found = self.values(members, problem.y + beyond)
        self._refined[members] = found, y
        return found, y

    def values(self, members: tuple[int, ...], y: FloatArray | None = None) -> Sizes:
        """Parameters of these candidates fitted together, base parameters and zeros free."""
        candidates = [self.candidates[k] for k in members]
        size = POLICY.far * np.concatenate([unremarkable(one) for one in candidates])
        free = self.problem.free(np.hstack([one.columns for one in candidates]) * size)
        y = self.problem.y if y is None else y
        information = free.T @ free + np.eye(len(size))  # each size has a unit normal prior
        value = np.linalg.solve(information, free.T) @ y * size
        spread = np.sqrt(np.linalg.inv(information).diagonal()) * size
        found: Sizes = {}
        start = 0
        for k, one in zip(members, candidates, strict=True):
            rows = slice(start, start + len(one.parameters))
            start = rows.stop
            parameters = tuple(
                Value(parameter.name, float(v), float(u), parameter.unit)
                for parameter, v, u in zip(one.parameters, value[rows], spread[rows], strict=True)
            )
            found[k] = parameters, one.effects(value[rows])
        return found
