"""Which candidates are named: one step after the other, each judged against pure noise.

What is kept is then fitted through the nonlinear simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.diagnosis.hypotheses import (
    FAR,
    causes_of,
    implausible,
    is_known,
    log_priors,
    prior_constrained,
    unremarkable,
)
from calib.diagnosis.problem import Problem
from calib.diagnosis.results import Gap, Value
from calib.diagnosis.selection import (
    ALIKE,
    Search,
    WeighedModel,
    contained,
    credible_set,
    foremost,
    global_p_value,
    heaviest_first,
    null_scores,
    scores,
)
from calib.errors import NotIdentifiable
from calib.linalg import NEW_DIRECTION, new_directions, onto, rank_of, squares_in, without
from calib.observations import FloatArray
from calib.tripod.effects.candidates import Candidate
from calib.tripod.effects.effect import EffectInstance, Kind

LEVEL = 0.01
"""Chance of a gap or an agreement called wrongly."""

NAMING_LEVEL = 0.005
"""Chance of a name on data with nothing missing; half of the level, for noise is never quite
normal."""
MOST_EFFECTS = 3
MOST_LOOKED_AT = 100
"""Models of one size whose sizes are judged together, at most."""

OUT_OF_REACH = 10.0
"""Log weight behind the best from where a model counts for nothing."""

SECOND_LOOK = 3
CORRECTIONS = 2

Sizes = dict[int, tuple[tuple[Value, ...], tuple[EffectInstance, ...]]]
"""Parameters of each candidate, and the effects that they make."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Which models explain the gap. ``kept`` is the best one, None where nothing may be named.

    ``models`` is the 95 % set around it; ``step_p`` the global p-value of each effect kept;
    ``local_log_p`` ``(J,)`` the log p-value of each candidate alone; ``adequate`` tells whether the
    residual agrees with the noise.
    """

    kept: WeighedModel | None
    models: tuple[WeighedModel, ...]
    singles: tuple[WeighedModel, ...]
    step_p: tuple[float, ...]
    local_log_p: FloatArray
    adequate: bool

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
        self._nulls: dict[tuple[tuple[int, ...], bool], FloatArray] = {}
        self._refined: dict[tuple[int, ...], tuple[Sizes, FloatArray]] = {}

    @classmethod
    def of(cls, problem: Problem, candidates: Sequence[Candidate]) -> ModelSelection:
        """Of candidates that show at all; a power that a named effect imitates is left out."""
        blocks = [problem.block(one.columns) for one in candidates]
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
                and any(contained(block, other) > ALIKE for other in known)
            )
        ]
        some = [candidates[k] for k in shown]
        return cls(problem, some, [blocks[k] for k in shown], log_priors(problem, some))

    @cached_property
    def search(self) -> Search:
        """Sets of candidates, weighed."""
        return Search(self.problem.y, self.blocks, self.problem.spread, self.log_priors)

    def run(self) -> Outcome:
        """Name what can be named."""
        singles = self.search.singles()
        by_cells = self.problem.noise_df <= 0.0
        first_p, local = self.step((), by_cells=by_cells)
        chosen: WeighedModel | None = None
        models: list[WeighedModel] = []
        steps = [first_p]
        if first_p <= NAMING_LEVEL:
            chosen, weighed = self._grow(singles, steps, by_cells=by_cells)
            models = credible_set(weighed)
            if not by_cells and not self.leaves_no_gap(chosen.members):
                chosen, models, steps = self._only_what_stands_out(singles, chosen, weighed)
        adequate = self.leaves_no_gap(chosen.members if chosen else ())
        return Outcome(chosen, tuple(models), tuple(singles), tuple(steps), local, adequate)

    def _grow(
        self, singles: Sequence[WeighedModel], steps: list[float], *, by_cells: bool
    ) -> tuple[WeighedModel, list[WeighedModel]]:
        """The smallest number of causes whose best model leaves nothing that stands out."""
        causes = [causes_of(one) for one in self.candidates]
        sizes = self.search.by_causes(singles, causes, MOST_EFFECTS)
        everything = self._paid(next(sizes))
        best = foremost(everything or singles)
        for larger in sizes:
            p, _ = self.step(best.members, by_cells=by_cells)
            enough = p > NAMING_LEVEL and (by_cells or self.leaves_no_gap(best.members))
            if enough or not larger:
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
            if model.log_weight < best - OUT_OF_REACH:
                break
            weight = model.log_weight - self.far_together(model.members)
            found.append(replace(model, log_weight=weight))
        return found

    def far_together(self, members: tuple[int, ...]) -> float:
        """Log weight lost for sizes that only the sizes of the others call for."""
        if len(members) < 2:
            return 0.0
        candidates = [self.candidates[k] for k in members]
        alone = sum(implausible(self.problem, [one]) for one in candidates)
        return max(implausible(self.problem, candidates) - alone, 0.0)

    def _only_what_stands_out(
        self,
        singles: Sequence[WeighedModel],
        best: WeighedModel,
        weighed: Sequence[WeighedModel],
    ) -> tuple[WeighedModel | None, list[WeighedModel], list[float]]:
        """Where a gap remains the noise of repeats proves nothing: judge by what the cells leave.

        Errors that stay with a posture would otherwise be named after whatever resembles them.
        One is added after the other; a heavier model of the whole search goes before, if all of
        it stands out.
        """
        kept: WeighedModel | None = None
        steps: list[float] = []
        for _ in best.members:
            members = kept.members if kept else ()
            p, _ = self.step(members, by_cells=True)
            if p > NAMING_LEVEL:
                break
            kept = heaviest_first(self._paid(self.search.larger(members)))[0]
            steps.append(p)
        for model in heaviest_first(weighed)[:SECOND_LOOK]:
            if kept and heaviest_first([kept, model])[0] is kept:
                break
            others = [tuple(k for k in model.members if k != m) for m in model.members]
            apart = sorted(self.step(each, by_cells=True)[0] for each in others)
            if apart[-1] <= NAMING_LEVEL:
                return model, [model], apart
        if kept is None:
            return None, [], steps
        rivals = singles if len(kept.members) == 1 else [kept]
        return kept, credible_set(rivals), steps

    def step(self, kept: tuple[int, ...], *, by_cells: bool) -> tuple[float, FloatArray]:
        """Global p-value of the best further candidate, and the local log p of each ``(J,)``."""
        blocks, y = self.given(kept)
        noise_df = None if by_cells else self.problem.noise_df
        df = self._structure_df(kept)
        present = [k for k, block in enumerate(blocks) if block.shape[1]]
        shown = [blocks[k] for k in present]
        local = np.zeros(len(blocks))
        if not present:
            return 1.0, local
        squares = np.array([squares_in(b, y) for b in shown])[:, None]
        total = np.array([self.problem.gap(y)])
        if by_cells:
            squares = np.minimum(squares, total)
        ranks = [block.shape[1] for block in shown]
        local[present] = scores(squares, ranks, noise_df, df, total)[:, 0]
        key = kept, by_cells
        if key not in self._nulls:  # a step is asked for several times, its draws take longest
            deviation = self.problem.unevenness()
            self._nulls[key] = null_scores(shown, noise_df, df, deviation)
        return global_p_value(float(local.min()), self._nulls[key]), local

    def given(self, kept: tuple[int, ...]) -> tuple[list[FloatArray], FloatArray]:
        """The blocks and the vector with the kept candidates projected out."""
        if not kept:
            return list(self.blocks), self.problem.y
        basis = self.search.basis(kept)
        blocks = [
            new_directions(basis, block) if k not in kept else block[:, :0]
            for k, block in enumerate(self.blocks)
        ]
        return blocks, without(basis, self.problem.y)

    def gap(self, kept: tuple[int, ...]) -> Gap:
        """What a model leaves beyond the scatter of repeats."""
        residual, df = self.residual(kept), self._structure_df(kept)
        gap = self.problem.gap(residual)
        rms_mm = self.problem.gap_rms_mm(residual)
        return Gap(rms_mm, gap, df, self.problem.gap_p_value(gap, df))

    def leaves_no_gap(self, kept: tuple[int, ...]) -> bool:
        """Whether the residual agrees with the noise."""
        return self.gap(kept).p_value > LEVEL

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
        size = FAR * np.concatenate([unremarkable(one) for one in candidates])
        free = self.problem.free(np.hstack([one.columns for one in candidates]) * size)
        value = prior_constrained(free, self.problem.y if y is None else y) * size
        spread = np.sqrt(np.linalg.inv(free.T @ free + np.eye(len(size))).diagonal()) * size
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
