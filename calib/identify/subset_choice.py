"""The sets of parameters that the papers identify, side by side: views, none of them chosen."""

from __future__ import annotations

from dataclasses import dataclass, field

from calib.arrays import FloatArray
from calib.errors import NotIdentifiable
from calib.identify.identify import IdentificationCase, identify
from calib.identify.solution import SUBSETS, Method, Solution, Subset, Weights

USUAL: tuple[Subset, ...] = ("joint-offsets", "with-tolerances", "both", "leg-lengths")
"""The set that is shown where none is asked for: the first that the readings determine."""


@dataclass(frozen=True, eq=False)
class SubsetChoice:
    """The solutions of all sets; each is identified when it is first asked for.

    Joint offsets and lengths are off by ``tolerance_mm`` ``(6,)``, standard deviations;
    ``identified`` holds each set that was asked for, or why it is not determined.
    """

    case: IdentificationCase
    tolerance_mm: FloatArray
    method: Method = "exact"
    weights: Weights = "equal"
    identified: dict[Subset, Solution | NotIdentifiable] = field(default_factory=dict)

    def solution(self, subset: Subset) -> Solution:
        """The solution of a set. Raises NotIdentifiable where the readings do not determine it."""
        solution = self._solution_or_reason(subset)
        if isinstance(solution, NotIdentifiable):
            raise solution
        return solution

    def _by_subset(self) -> dict[Subset, Solution | NotIdentifiable]:
        return {subset: self._solution_or_reason(subset) for subset in SUBSETS}

    def _solution_or_reason(self, subset: Subset) -> Solution | NotIdentifiable:
        if subset not in self.identified:
            try:
                solution: Solution | NotIdentifiable = identify(
                    self.case, subset, self.method, self.weights, tolerance_mm=self.tolerance_mm
                )
            except NotIdentifiable as problem:
                solution = problem.with_traceback(None)  # its frames hold all arrays
            self.identified[subset] = solution
        return self.identified[subset]

    @property
    def solutions(self) -> dict[Subset, Solution]:
        """Solutions of all sets that the readings determine."""
        return {
            subset: solution
            for subset, solution in self._by_subset().items()
            if not isinstance(solution, NotIdentifiable)
        }

    @property
    def refused(self) -> dict[Subset, NotIdentifiable]:
        """The reason for every set that they do not determine."""
        return {
            subset: reason
            for subset, reason in self._by_subset().items()
            if isinstance(reason, NotIdentifiable)
        }

    @property
    def usual(self) -> Subset:
        """The set that is shown where none is asked for.

        Raises NotIdentifiable where not even one is determined.
        """
        for subset in USUAL:
            if isinstance(self._solution_or_reason(subset), Solution):
                return subset
        raise self.refused["joint-offsets"]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why sets are missing."""
        return tuple(
            f"{subset} left out: {problem.found}" for subset, problem in self.refused.items()
        )
