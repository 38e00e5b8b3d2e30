"""The race of the candidates: one step after the other, each judged against pure noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.diagnosis.problem import Problem
from calib.diagnosis.scan import Null, Reference, gap_p_value, null_scores, scores
from calib.diagnosis.selection import Search, Weighed, credible_set, foremost, union
from calib.observations import FloatArray

LEVEL = 0.01
"""Chance of a gap or an agreement called wrongly."""

NAMING_LEVEL = 0.005
"""Chance of a name on data with nothing missing; half of the level, for noise is never quite
normal."""
MOST_EFFECTS = 3


@dataclass(frozen=True, eq=False)
class Outcome:
    """Which models explain the gap. ``kept`` is the best one, empty where nothing may be named.

    ``models`` is the 95 % set around it; ``step_p`` the global p-value of each effect kept;
    ``adequate`` tells whether what is left agrees with the noise.
    """

    kept: Weighed | None
    models: tuple[Weighed, ...]
    singles: tuple[Weighed, ...]
    step_p: tuple[float, ...]
    local_log_p: FloatArray
    adequate: bool
    gap_before: tuple[float, int, float]
    gap_after: tuple[float, int, float]


@dataclass(eq=False)
class Race:
    """Candidates as blocks ``(n, r)`` over one problem; ``prices``, ``causes`` as in `Search`."""

    problem: Problem
    blocks: tuple[FloatArray, ...]
    prices: FloatArray
    causes: tuple[int, ...]
    seed: int
    _nulls: dict[tuple[tuple[int, ...], bool], Null] = field(default_factory=dict)

    def run(self) -> Outcome:
        """Name what can be named."""
        search = Search(
            self.problem.y, self.blocks, self.problem.spread(), self.prices, self.causes
        )
        singles = search.singles()
        before = self.gap(())
        by_cells = self.problem.noise_df <= 0.0
        first_p, local = self.step((), by_cells=by_cells)
        if first_p > NAMING_LEVEL:
            return self._nothing(singles, (first_p,), local, before)
        chosen, models, steps = self._grow(search, singles, first_p, by_cells)
        after = self.gap(chosen.members)
        adequate = after[2] > LEVEL
        if not adequate and not by_cells:
            kept, held, p = self._only_what_stands_out(search, singles, chosen)
            after = self.gap(kept.members) if kept else before
            return Outcome(kept, tuple(held), tuple(singles), p, local, False, before, after)
        return Outcome(chosen, tuple(models), tuple(singles), steps, local, adequate, before, after)

    def _grow(
        self, search: Search, singles: Sequence[Weighed], first_p: float, by_cells: bool
    ) -> tuple[Weighed, list[Weighed], tuple[float, ...]]:
        """The smallest number of causes whose best model leaves nothing that stands out."""
        sizes = search.by_causes(singles, MOST_EFFECTS)
        everything = next(sizes)
        best = foremost(everything or singles)
        steps = [first_p]
        for larger in sizes:
            p, _ = self.step(best.members, by_cells=by_cells)
            enough = p > NAMING_LEVEL and (by_cells or self.gap(best.members)[2] > LEVEL)
            if enough or not larger:
                break
            everything = [*everything, *larger]
            best = foremost(larger)
            steps.append(p)
        return best, credible_set(everything), tuple(steps)

    def _only_what_stands_out(
        self, search: Search, singles: Sequence[Weighed], best: Weighed
    ) -> tuple[Weighed | None, list[Weighed], tuple[float, ...]]:
        """Where a gap remains the noise of repeats proves nothing: judge by what the cells leave.

        Errors that stay with a posture would otherwise be named after whatever resembles them.
        """
        kept: tuple[int, ...] = ()
        steps: list[float] = []
        model = best
        for _ in range(len(best.members)):
            p, _ = self.step(kept, by_cells=True)
            if p > NAMING_LEVEL:
                break
            model = max(search.beside(kept), key=lambda m: m.log_weight)
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
        squares = np.array([((b.T @ y) ** 2).sum() for b in blocks])[:, None]
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
        if key not in self._nulls:
            deviation = self.problem.unevenness()
            shown = [blocks[k] for k in present]
            self._nulls[key] = null_scores(shown, reference, self.seed, deviation)
        return self._nulls[key].p_value(float(local.min())), local

    def beside(self, kept: tuple[int, ...]) -> tuple[list[FloatArray], FloatArray]:
        """The blocks and the vector with the kept candidates projected out."""
        if not kept:
            return list(self.blocks), self.problem.y
        basis = union([self.blocks[k] for k in kept])
        y = self.problem.y - basis @ (basis.T @ self.problem.y)
        blocks = []
        for k, block in enumerate(self.blocks):
            rest = block - basis @ (basis.T @ block)
            left, singular, _ = np.linalg.svd(rest, full_matrices=False)
            blocks.append(left[:, singular > 1e-3] if k not in kept else left[:, :0])
        return blocks, y

    def gap(self, kept: tuple[int, ...]) -> tuple[float, int, float]:
        """What a model leaves beyond the scatter of repeats: square sum, freedom, p-value."""
        y = self._beside_y(kept)
        gap, df = self.problem.gap(y), self._structure_df(kept)
        return gap, df, gap_p_value(gap, df, self.problem.noise_df)

    def _beside_y(self, kept: tuple[int, ...]) -> FloatArray:
        if not kept:
            return self.problem.y
        basis = union([self.blocks[k] for k in kept])
        return np.asarray(self.problem.y - basis @ (basis.T @ self.problem.y))

    def _structure_df(self, kept: tuple[int, ...]) -> int:
        if not kept:
            return self.problem.structure_df
        basis = union([self.blocks[k] for k in kept])
        inside = np.linalg.svd(self.problem.structure.T @ basis, compute_uv=False)
        return max(self.problem.structure_df - int((inside > 1e-3).sum()), 0)

    def _noise_df(self) -> float:
        return self.problem.noise_df if self.problem.noise_df > 0.0 else float("inf")

    def _nothing(
        self,
        singles: Sequence[Weighed],
        steps: tuple[float, ...],
        local: FloatArray,
        before: tuple[float, int, float],
    ) -> Outcome:
        adequate = before[2] > LEVEL
        return Outcome(None, (), tuple(singles), steps, local, adequate, before, before)
