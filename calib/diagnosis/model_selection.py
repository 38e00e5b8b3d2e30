"""The race of the candidates: one step after the other, each judged against pure noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.diagnosis.problem import Problem
from calib.diagnosis.scan import Null, Reference, gap_p_value, null_scores, scores
from calib.diagnosis.selection import Search, WeighedModel, credible_set, foremost, heaviest_first
from calib.linalg import NEW_DIRECTION, new_directions, rank_of, squares_in, union, without
from calib.observations import FloatArray

LEVEL = 0.01
"""Chance of a gap or an agreement called wrongly."""

NAMING_LEVEL = 0.005
"""Chance of a name on data with nothing missing; half of the level, for noise is never quite
normal."""
MOST_EFFECTS = 3
MOST_LOOKED_AT = 100
"""Models of one size whose sizes are judged together, at most."""

OUT_OF_THE_RACE = 10.0
"""Log weight behind the best from where a model counts for nothing."""

SECOND_LOOK = 3


@dataclass(frozen=True, eq=False)
class Outcome:
    """Which models explain the gap. ``kept`` is the best one, empty where nothing may be named.

    ``models`` is the 95 % set around it; ``step_p`` the global p-value of each effect kept;
    ``adequate`` tells whether what is left agrees with the noise.
    """

    kept: WeighedModel | None
    models: tuple[WeighedModel, ...]
    singles: tuple[WeighedModel, ...]
    step_p: tuple[float, ...]
    local_log_p: FloatArray
    adequate: bool
    gap_before: tuple[float, int, float]
    gap_after: tuple[float, int, float]


@dataclass(eq=False)
class ModelSelection:
    """Candidates as blocks ``(n, r)`` over one problem; ``log_priors``, ``causes`` as in `Search`.

    ``loss`` tells what members together lose for the sizes they need (`entries.implausible`).
    """

    problem: Problem
    blocks: tuple[FloatArray, ...]
    log_priors: FloatArray
    causes: tuple[int, ...]
    seed: int
    loss: Callable[[tuple[int, ...]], float] = lambda _: 0.0
    nulls: dict[tuple[tuple[int, ...], bool], Null] = field(default_factory=dict)

    def run(self) -> Outcome:
        """Name what can be named."""
        search = Search(
            self.problem.y, self.blocks, self.problem.spread, self.log_priors, self.causes
        )
        singles = search.singles()
        before = self.gap(())
        by_cells = self.problem.noise_df <= 0.0
        first_p, local = self.step((), by_cells=by_cells)
        if first_p > NAMING_LEVEL:
            return self._nothing(singles, (first_p,), local, before)
        chosen, weighed, steps = self._grow(search, singles, first_p, by_cells)
        after = self.gap(chosen.members)
        adequate = after[2] > LEVEL
        if not adequate and not by_cells:
            kept, held, p = self._only_what_stands_out(search, singles, chosen, weighed)
            after = self.gap(kept.members) if kept else before
            adequate = after[2] > LEVEL
            return Outcome(kept, tuple(held), tuple(singles), p, local, adequate, before, after)
        models = tuple(credible_set(weighed))
        return Outcome(chosen, models, tuple(singles), steps, local, adequate, before, after)

    def _grow(
        self, search: Search, singles: Sequence[WeighedModel], first_p: float, by_cells: bool
    ) -> tuple[WeighedModel, list[WeighedModel], tuple[float, ...]]:
        """The smallest number of causes whose best model leaves nothing that stands out."""
        sizes = search.by_causes(singles, MOST_EFFECTS)
        everything = self._paid(next(sizes))
        best = foremost(everything or singles)
        steps = [first_p]
        for larger in sizes:
            p, _ = self.step(best.members, by_cells=by_cells)
            enough = p > NAMING_LEVEL and (by_cells or self.gap(best.members)[2] > LEVEL)
            if enough or not larger:
                break
            larger = self._paid(larger)
            everything = [*everything, *larger]
            best = foremost(larger)
            steps.append(p)
        return best, everything, tuple(steps)

    def _paid(self, models: Sequence[WeighedModel]) -> list[WeighedModel]:
        """Less what they lose for their sizes together; without those far behind."""
        found: list[WeighedModel] = []
        for model in heaviest_first(models)[:MOST_LOOKED_AT]:
            best = max((m.log_weight for m in found), default=-np.inf)
            if model.log_weight < best - OUT_OF_THE_RACE:
                break
            weight = model.log_weight - self.far_together(model.members)
            found.append(replace(model, log_weight=weight))
        return found

    def far_together(self, members: tuple[int, ...]) -> float:
        """Log weight lost for sizes that only the sizes of the others call for."""
        if len(members) < 2:
            return 0.0
        return max(self.loss(members) - sum(self.loss((k,)) for k in members), 0.0)

    def _only_what_stands_out(
        self,
        search: Search,
        singles: Sequence[WeighedModel],
        best: WeighedModel,
        weighed: Sequence[WeighedModel],
    ) -> tuple[WeighedModel | None, list[WeighedModel], tuple[float, ...]]:
        """Where a gap remains the noise of repeats proves nothing: judge by what the cells leave.

        Errors that stay with a posture would otherwise be named after whatever resembles them.
        One is added after the other; a heavier model of the whole search goes before, if all of
        it stands out.
        """
        kept, held, steps = self._one_after_the_other(search, singles, best)
        for model in heaviest_first(weighed)[:SECOND_LOOK]:
            if kept and heaviest_first([kept, model])[0] is kept:
                break
            others = [tuple(k for k in model.members if k != m) for m in model.members]
            apart = tuple(self.step(each, by_cells=True)[0] for each in others)
            if max(apart) <= NAMING_LEVEL:
                return model, credible_set([model]), tuple(sorted(apart))
        return kept, held, steps

    def _one_after_the_other(
        self, search: Search, singles: Sequence[WeighedModel], best: WeighedModel
    ) -> tuple[WeighedModel | None, list[WeighedModel], tuple[float, ...]]:
        kept: tuple[int, ...] = ()
        steps: list[float] = []
        model = best
        for _ in range(len(best.members)):
            p, _ = self.step(kept, by_cells=True)
            if p > NAMING_LEVEL:
                break
            model = heaviest_first(self._paid(search.beside(kept)))[0]
            kept = model.members
            steps.append(p)
        if not kept:
            return None, [], tuple(steps)
        rivals = [m for m in singles if len(kept) == 1] or [model]
        return model, credible_set(rivals), tuple(steps)

    def step(self, kept: tuple[int, ...], *, by_cells: bool) -> tuple[float, FloatArray]:
        """Global p-value of the best further candidate, and the local log p of each ``(J,)``."""
        blocks, y = self.beside(kept)
        reference = Reference(self._noise_df(), self._structure_df(kept), by_cells=by_cells)
        width = [block.shape[1] for block in blocks]
        squares = np.array([squares_in(b, y) for b in blocks])[:, None]
        total = np.array([self.problem.gap(y)])
        if by_cells:
            squares = np.minimum(squares, total)
        present = [k for k, w in enumerate(width) if w]
        local = np.zeros(len(blocks))
        local[present] = scores(squares[present], [width[k] for k in present], reference, total)[
            :, 0
        ]
        if not present:
            return 1.0, local
        key = kept, by_cells
        if key not in self.nulls:
            deviation = self.problem.unevenness()
            shown = [blocks[k] for k in present]
            self.nulls[key] = null_scores(shown, reference, self.seed, deviation)
        return self.nulls[key].p_value(float(local.min())), local

    def beside(self, kept: tuple[int, ...]) -> tuple[list[FloatArray], FloatArray]:
        """The blocks and the vector with the kept candidates projected out."""
        if not kept:
            return list(self.blocks), self.problem.y
        basis = self.basis(kept)
        blocks = [
            new_directions(basis, block) if k not in kept else block[:, :0]
            for k, block in enumerate(self.blocks)
        ]
        return blocks, without(basis, self.problem.y)

    def basis(self, members: tuple[int, ...]) -> FloatArray:
        """Orthonormal basis ``(n, r)`` of candidates together."""
        nothing = np.zeros((len(self.problem.y), 0))
        return union([self.blocks[k] for k in members]) if members else nothing

    def gap(self, kept: tuple[int, ...]) -> tuple[float, int, float]:
        """What a model leaves beyond the scatter of repeats: square sum, freedom, p-value."""
        y = self.left(kept)
        gap, df = self.problem.gap(y), self._structure_df(kept)
        return gap, df, gap_p_value(gap, df, self.problem.noise_df)

    def left(self, kept: tuple[int, ...]) -> FloatArray:
        """What a model leaves ``(n,)``."""
        return without(self.basis(kept), self.problem.y)

    def _structure_df(self, kept: tuple[int, ...]) -> int:
        inside = self.problem.structure.T @ self.basis(kept)
        return max(self.problem.structure_df - rank_of(inside, NEW_DIRECTION, 1.0), 0)

    def _noise_df(self) -> float:
        return self.problem.noise_df if self.problem.noise_df > 0.0 else float("inf")

    def _nothing(
        self,
        singles: Sequence[WeighedModel],
        steps: tuple[float, ...],
        local: FloatArray,
        before: tuple[float, int, float],
    ) -> Outcome:
        adequate = before[2] > LEVEL
        return Outcome(None, (), tuple(singles), steps, local, adequate, before, before)
