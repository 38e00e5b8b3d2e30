"""Sizes of effects: fitted together, then through the nonlinear simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.diagnosis.cleaning import Case
from calib.diagnosis.hypotheses import FAR, Hypothesis, held
from calib.diagnosis.model_selection import ModelSelection
from calib.diagnosis.problem import Problem
from calib.diagnosis.results import Value
from calib.errors import NotIdentifiable
from calib.linalg import onto
from calib.observations import FloatArray
from calib.tripod.effects.effect import EffectInstance

CORRECTIONS = 2

Sizes = dict[int, tuple[tuple[Value, ...], tuple[EffectInstance, ...]]]
"""Parameters of each entry, and the effects that they make."""


@dataclass(frozen=True, eq=False)
class Fitting:
    """Entries of one race, fitted to its sessions."""

    problem: Problem
    entries: Sequence[Hypothesis]
    race: ModelSelection
    cases: Sequence[Case]
    _found: dict[tuple[int, ...], tuple[Sizes, FloatArray]] = field(default_factory=dict)

    def refined(self, members: tuple[int, ...]) -> Sizes:
        """`values` through the nonlinear simulation: effects in, base fitted anew, corrected."""
        return self._through_the_simulation(members)[0]

    def as_if_linear(self, members: tuple[int, ...]) -> Problem:
        """The problem less what these effects do beyond their derivatives."""
        return self.problem.as_if_linear(self._through_the_simulation(members)[1])

    def _through_the_simulation(self, members: tuple[int, ...]) -> tuple[Sizes, FloatArray]:
        if members not in self._found:
            self._found[members] = self._corrected(members)
        return self._found[members]

    def _corrected(self, members: tuple[int, ...]) -> tuple[Sizes, FloatArray]:
        """Sizes, and the readings ``(n,)`` as a linear machine would give them."""
        found, y = self.values(members, self.problem.y), self.problem.y
        basis = self.race.basis(members)
        for _ in range(CORRECTIONS):
            placed = tuple(effect for _, effects in found.values() for effect in effects)
            try:
                y = self.left_with(placed) + self._linear_share(found, members)
            except NotIdentifiable:
                return found, self.problem.y
            beyond = y - self.problem.y
            found = self.values(members, self.problem.y + onto(basis, beyond))
        return found, y

    def left_with(self, placed: tuple[EffectInstance, ...]) -> FloatArray:
        """Whitened residual ``(n,)`` with these effects in the model, nuisance projected out.

        Raises NotIdentifiable where the legs cannot meet.
        """
        adopted = []
        for case, one in zip(self.cases, self.problem.fitted_sessions, strict=True):
            model = case.model.with_effects((*case.model.effects, *placed))
            adopted.append(one.again(model, case.tolerance_mm))
        return Problem.of(adopted).y

    def _linear_share(
        self,
        found: Sizes,
        members: tuple[int, ...],
    ) -> FloatArray:
        """What the columns of the members with these values explain ``(n,)``, whitened."""
        total_mm = np.zeros_like(self.problem.y)
        for k in members:
            value = np.array([v.value for v in found[k][0]])
            if found[k][1]:
                total_mm += self.entries[k].columns @ value
        return self.problem.free(total_mm)

    def values(self, members: tuple[int, ...], y: FloatArray | None = None) -> Sizes:
        """Parameters of these entries fitted together, base parameters and zeros free."""
        y = self.problem.y if y is None else y
        columns = np.hstack([self.entries[k].columns for k in members])
        size = FAR * np.concatenate([self.entries[k].tolerance for k in members])
        free = self.problem.free(columns * size)
        best, _ = held(free, y)
        value = best * size
        spread = np.sqrt(np.linalg.inv(free.T @ free + np.eye(len(size))).diagonal()) * size
        found: Sizes = {}
        start = 0
        for k in members:
            entry = self.entries[k]
            rows = slice(start, start + len(entry.names))
            start += len(entry.names)
            parameters = tuple(
                Value(name, float(v), float(u), unit)
                for (name, unit), v, u in zip(entry.names, value[rows], spread[rows], strict=True)
            )
            placed = entry.candidate.effects(value[rows]) if entry.candidate else ()
            found[k] = parameters, placed
        return found
