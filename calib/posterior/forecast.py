"""What the posterior will be after further readings, before these are taken.

In each model everything is linear about its own solution, so its covariance after the readings is
known beforehand, and where its mean goes if another model is true. Weights change by the expected
log Bayes factors. What is entered is projected again from the mean of the mixture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from functools import cached_property

import numpy as np

from calib.arrays import (
    DEPENDENT,
    Conditions,
    FloatArray,
    basis_of,
    incidence,
    joined,
    lengths,
    tilts,
)
from calib.errors import UnreachablePosture
from calib.identify.fit import design_of
from calib.posterior.cells import BASE, HOMING_MM
from calib.posterior.correction import projector_of
from calib.posterior.library import ELSE, something_else
from calib.posterior.mixture import ExpectedReadings, Group, UpdatedGroup
from calib.posterior.models import Posterior
from calib.posterior.readings import LENGTHS
from calib.posterior.tool import Frame
from calib.posterior.tool_errors import KEPT
from calib.stats import root_quantile
from calib.tripod.effects.candidates import placed_columns
from calib.tripod.effects.effect import EffectInstance, Placed
from calib.tripod.pipeline import Model

HEAVIEST = 48
"""Models that are followed one by one; of the lighter ones as many stand for all."""

FOLLOWED = 8
"""Of these so many have derivatives at their own solution; the others those of the session."""

TRUTHS = 6
"""Models that are taken to be true in turn: they stand for equal shares of the weight."""

LIGHT = 1e-4
"""A model that readings leave less weight does not change the bound."""

SHOWN = 1e-7
"""Of the largest mean square at the tool: a direction that moves it less is left out."""


class Forecast:
    """The posterior as the planner sees it: ``models`` of it, in a frame, with what is entered.

    Of these, ``numbers`` in the posterior, the heaviest, and of the others every so many, which
    stand for those between; ``weight`` is that of all that they stand for, ``fields`` are they in
    the tool's field. Those ``followed`` have derivatives at their own solution. ``truths`` are
    taken to be true in turn, each for a share of the weight. ``shown`` ``(q, f)`` is a root of the
    frame's metric, ``entered`` ``(q, f)`` the same of what is entered for an expected field.
    ``noise_mm2`` is the variance of a reading that repeats reduce, and what repeats share.
    """

    def __init__(
        self,
        posterior: Posterior,
        frame: Frame,
        index: Sequence[int],
        stated_mm: float | None = None,
    ) -> None:
        """``index`` are the columns of the field that are entered.

        A reading has the noise that the last session has, or ``stated_mm``.
        """
        weight = np.array([model.weight for model in posterior.models])
        order = np.argsort(-weight, kind="stable")
        first, light = order[:HEAVIEST], order[HEAVIEST:]
        step = max(1, -(-len(light) // HEAVIEST))
        groups = [light[k : k + step] for k in range(0, len(light), step)]
        numbers = [*first.tolist(), *(int(group[len(group) // 2]) for group in groups)]
        weights = [*weight[first], *(float(weight[group].sum()) for group in groups)]
        self.posterior, self.numbers = posterior, np.array(numbers)
        self.weight = np.array(weights) / sum(weights)
        self.models = [posterior.models[k] for k in numbers]
        self.fields = [posterior.models_in_field[k] for k in numbers]
        self.followed = [k for k, model in enumerate(self.models) if model.members][:FOLLOWED]
        along = np.searchsorted(np.cumsum(self.weight), (np.arange(TRUTHS) + 0.5) / TRUTHS)
        number, times = np.unique(along, return_counts=True)
        self.truths = list(zip(number.tolist(), (times / TRUTHS).tolist(), strict=True))
        square, axes = np.linalg.eigh(posterior.field.metrics[frame])
        visible = square > SHOWN**2 * square[-1]
        self.shown = np.sqrt(square[visible])[:, None] * axes[:, visible].T
        into = projector_of(posterior.field, index, frame)
        self.entered = np.asarray(self.shown[:, list(index)] @ into)
        self.cells = cells = posterior.sessions[-1]  # with the offsets of the machine as it is
        self.noise_mm2 = (stated_mm or 0.0) ** 2, 0.0
        if stated_mm is None:
            scatter = float(np.median(cells.scatter_mm2 * cells.visits.averaged))
            shared = cells.noise.quantisation_mm2(cells.means) if cells.noise else np.zeros(1)
            self.noise_mm2 = scatter, float(np.mean(shared))

    @property
    def noise_mm(self) -> float:
        """Standard deviation of a reading."""
        return math.sqrt(sum(self.noise_mm2))

    @cached_property
    def groups(self) -> list[Group]:
        """All models as `groups_of` has them."""
        return self.groups_of(range(len(self.numbers)))

    def groups_of(self, models: Sequence[int]) -> list[Group]:
        """Models by the base that they share, and by how large something else is in them."""
        of_key: dict[tuple[int, float], list[int]] = {}
        for k in models:
            size_mm = 0.0
            for member, scale in self.models[k].key:
                if self.posterior.components[member].id == ELSE:
                    size_mm = scale * float(self.posterior.components[member].unit[0])
            of_key.setdefault((id(self.fields[k].base_root), size_mm), []).append(k)
        rows_of_field = np.vstack([self.shown, self.entered])
        return [
            Group(rows, [self.fields[k] for k in rows], size_mm, self._about, rows_of_field)
            for (_, size_mm), rows in of_key.items()
        ]

    @cached_property
    def _about(self) -> FloatArray:
        """Where readings of the last session are linear about, in the tool's field ``(f,)``."""
        about = self.posterior.start.copy()
        about[:BASE] += self.cells.model.parameters_mm
        return about

    @cached_property
    def machines(self) -> list[tuple[Model, FloatArray]]:
        """Each of the models `followed`, and what its machine has not ``(f,)``: a little of all."""
        nominal, first = self.cells.case.model, self.posterior.parameter_count - 3
        machines = []
        for k in self.followed:
            model, remainder = self.models[k], self.fields[k].mean - self.posterior.start
            remainder[:BASE] = 0.0
            effects: list[EffectInstance] = []
            for member, places in model.places(self.posterior.components).items():
                remainder -= self.posterior.into_field[member] @ model.mean[places]
                effects += self.posterior.components[member].effects(model.mean[places])
            parameters = np.concatenate([model.mean[first : first + 3], model.mean[:LENGTHS]])
            machine = nominal.with_effects((*nominal.effects, *effects)).with_parameters(parameters)
            machines.append((machine, remainder))
        return machines

    def readings(
        self,
        set_ups: Sequence[Conditions],
        change: Callable[[Model], Model] = lambda model: model,
    ) -> list[ExpectedReadings]:
        """What each set-up is expected to show of a machine after a ``change``.

        Beside that its joint offsets differ from those of the last session by homing.
        """
        means, counts = zip(*(_cells(set_up) for set_up in set_ups), strict=True)
        conditions = joined(means)
        model = change(self.cells.model)
        start, columns = model.readings(conditions), self._columns(model, conditions)
        expectations = []
        for k, (machine, remainder) in zip(self.followed, self.machines, strict=True):
            acting = {
                (share.effect, share.place)
                for member in self.models[k].members
                for share in self.posterior.components[member].shares
            }
            machine = change(machine)
            try:
                derivatives = self._columns(machine, conditions, acting, columns)
                expectations.append(
                    (machine.readings(conditions) + derivatives @ remainder, derivatives)
                )
            except UnreachablePosture:  # as the others: by derivatives of the session
                expectations.append(
                    (start + columns @ (self.fields[k].mean - self._about), columns)
                )
        spread_mm = np.minimum(self.cells.case.tolerance_mm[:3], HOMING_MM)
        expected_readings, row = [], 0
        for set_up, count in zip(means, counts, strict=True):
            rows = slice(row, row + len(set_up))
            row += len(set_up)
            whiten = self._whitening(set_up, count)
            errors = something_else(set_up) if any(g.size_mm for g in self.groups) else None
            visible = whiten @ columns[rows]
            expected_readings.append(
                ExpectedReadings(
                    whiten @ start[rows],
                    visible,
                    np.zeros((len(whiten), 0)) if errors is None else whiten @ errors,
                    visible[:, :3] * spread_mm,
                    tuple((whiten @ e[rows], whiten @ c[rows]) for e, c in expectations),
                )
            )
        return expected_readings

    def _columns(
        self,
        model: Model,
        conditions: Conditions,
        laws: Collection[Placed] | None = None,
        start: FloatArray | None = None,
    ) -> FloatArray:
        """Derivatives ``(n, f)`` by the field at a model; of other than these laws as ``start``."""
        if start is None:
            columns = np.zeros((len(conditions), self.shown.shape[1]))
            columns[:, :BASE] = design_of(model, conditions, range(BASE), ())
        else:
            columns = start.copy()
        laws_of_field = self.posterior.field.columns if laws is None else laws
        effects = list(dict.fromkeys(effect for effect, _ in laws_of_field))
        for law, derivatives in placed_columns(model, conditions, effects, laws_of_field).items():
            columns[:, self.posterior.field.columns[law]] = derivatives
        return columns

    def _whitening(self, conditions: Conditions, count: FloatArray) -> FloatArray:
        """Makes means of cells independent, of unit variance, and free of zeros ``(m, n)``."""
        scatter, shared = self.noise_mm2
        root = np.sqrt(np.maximum(scatter / count + shared, 1e-10))
        zeros = np.hstack([incidence(conditions.mount), tilts(conditions)]) / root[:, None]
        basis = basis_of(zeros / lengths(zeros), DEPENDENT)
        complete = np.linalg.qr(basis, mode="complete")[0]
        return np.asarray(complete[:, basis.shape[1] :].T / root)

    @cached_property
    def now_mm(self) -> float:
        """The bound without more readings."""
        empty, field = np.zeros((0, 0)), np.zeros((0, self.shown.shape[1]))
        unchanged = tuple((np.zeros(0), field) for _ in self.followed)
        return self.after_mm(ExpectedReadings(np.zeros(0), field, empty, empty, unchanged))

    def after_mm(self, readings: ExpectedReadings) -> float:
        """The bound after these readings, the mean over the models that may be true."""
        updated = [UpdatedGroup(group, readings, self.followed) for group in self.groups]
        place = {
            k: (update, j) for update in updated for j, k in enumerate(update.group.rows.tolist())
        }
        total = 0.0
        for truth, share in self.truths:
            true, j = place[truth]
            weight = self.weight_if(updated, true, j)
            total += share * self._bound_mm(updated, weight, true.expected[:, j])
        return total

    def weight_if(self, updated: Sequence[UpdatedGroup], true: UpdatedGroup, j: int) -> FloatArray:
        """Weights of the models ``(M,)`` expected after readings of model j, which is ``true``."""
        log = np.log(self.weight)
        for update in updated:
            log[update.group.rows] -= update.log_factor(true, j)
        weight = np.exp(log - log.max())
        return np.asarray(weight / weight.sum())

    def apart(
        self, measurements: Sequence[ExpectedReadings], models: Sequence[int]
    ) -> list[FloatArray]:
        """What model j leaves of each if model i is true ``(h, h)``, noise variances."""
        groups = self.groups_of(models)
        order = [k for group in groups for k in group.rows.tolist()]
        place = [order.index(k) for k in models]
        matrices = []
        for readings in measurements:
            updated = [UpdatedGroup(group, readings, self.followed) for group in groups]
            expected = np.hstack([update.expected for update in updated])[:, place]
            squares = np.hstack([update.squares(expected) for update in updated])
            matrices.append(np.asarray(squares[:, place]))
        return matrices

    def _bound_mm(
        self, updated: Sequence[UpdatedGroup], weight: FloatArray, readings: FloatArray
    ) -> float:
        """The bound of a mixture where these are the readings ``(n,)``."""
        count, q = len(self.weight), len(self.shown)
        mean = np.zeros((2 * q, count))
        for up in updated:
            mean[:, up.group.rows] = up.means(readings)
        off = mean[:q] - (mean[q:] @ weight)[:, None]
        distances = np.zeros((count, 3))
        distances[:, 0] = weight
        for up in updated:
            distances[up.group.rows, 1:] = up.squares_at_tool.moments(off[:, up.group.rows])
        heavy = weight > LIGHT
        share, square, variance = distances[heavy].T
        return root_quantile(share, square, variance, KEPT)


def _cells(conditions: Conditions) -> tuple[Conditions, FloatArray]:
    """One reading of each cell, and how many it has ``(n,)``."""
    first = np.unique(conditions.cell, return_index=True)[1]
    return conditions.take(first), np.bincount(conditions.cell).astype(np.float64)
