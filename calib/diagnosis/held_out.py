"""How large the gap is on readings that the choice of a name did not see."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import block_diag  # scipy.linalg would take 0.04 s more to import

from calib.arrays import LEG_NAMES, TOOL, FloatArray, IntArray
from calib.diagnosis.claims import NAMES
from calib.diagnosis.gap import LOOSE, Leftover, expected_base, spread_of
from calib.diagnosis.results import HeldOutGap
from calib.errors import CalibrationError
from calib.posterior.cells import Cells
from calib.posterior.gaussian import About
from calib.posterior.library import Component
from calib.posterior.models import Posterior
from calib.posterior.readings import LENGTHS, LinearSessions, free_columns, linear_about
from calib.posterior.selection import SCALES, Key, ModelSelection, Products
from calib.tripod.effects.effect import Effect, EffectInstance

MOST_SETS = 40
"""Sets of components that are tried again; lighter ones are not chosen without a few readings."""


def on_other_sessions(
    leftover: Leftover,
    held_out_sessions: Sequence[Cells],
    effects: tuple[EffectInstance, ...],
    timed: Sequence[Effect],
) -> HeldOutGap | None:
    """The gap on sessions that were not used at all: effects and lengths as they were found.

    Every session has its own offsets and zeros. None where the effects put the machine out of its
    own reach.
    """
    try:
        fitted = Leftover.of(leftover.sessions, effects, timed)
        plain = Leftover.of(held_out_sessions, leftover.resized(), timed, leftover.bars())
        adopted = Leftover.of(
            held_out_sessions, (*effects, *fitted.resized()), timed, fitted.bars()
        )
    except CalibrationError:
        return None
    how = "sessions that were not used"
    return HeldOutGap(how, plain.rms_mm(plain.left), adopted.rms_mm(adopted.left), plain.noise_mm)


def left_out_postures(
    posterior: Posterior,
    plain: Leftover,
    fitted: Leftover,
    adopted: Sequence[EffectInstance],
    kinds: Collection[str] = NAMES,
) -> HeldOutGap | None:
    """Leave out one side of one leg at a time, of the tool the places on one side of Zero; choose
    anew, fit, predict what was left out.

    Chosen among single components of these ``kinds``, names unless laws are allowed, too, and the
    sets of them that all readings leave possible. All is about the machine ``fitted`` with the
    effects ``adopted``: a large one is far from its derivatives without.
    Zeros come from the rest of each mounting. None where nothing can be left out.
    """
    return _LeftOut(posterior, plain, _linear_with(posterior, fitted, adopted), kinds).gap()


def _linear_with(
    posterior: Posterior, leftover: Leftover, adopted: Sequence[EffectInstance]
) -> LinearSessions:
    """The sessions about the machine with these effects, as if it had none of them."""
    lengths, offsets = np.split(leftover.rows.value, [LENGTHS])
    models = []
    for cells, offsets_mm in zip(posterior.sessions, offsets.reshape(-1, 3), strict=True):
        nominal = cells.case.model
        acting = nominal.with_effects((*nominal.effects, *adopted))
        models.append(acting.with_parameters(np.concatenate([offsets_mm, lengths])))
    components = posterior.components[: len(posterior.linear.index)]
    linear, _ = linear_about(posterior.sessions, models, components)
    rows, residual = linear.rows, linear.rows.residual.copy()
    if not {(instance.effect, instance.place) for instance in adopted} <= rows.places.keys():
        return posterior.linear
    for instance in adopted:
        columns = rows.columns[:, rows.places[instance.effect, instance.place]]
        residual += columns @ np.real(instance.values)
    return replace(linear, rows=replace(rows, residual=residual))


@dataclass(frozen=True, eq=False)
class _LeftOut:
    posterior: Posterior
    leftover: Leftover
    linear: LinearSessions
    kinds: Collection[str]

    def gap(self) -> HeldOutGap | None:
        root = np.sqrt(np.concatenate([c.variance_mm2 for c in self.posterior.sessions]))
        squares, noise, count = np.zeros(2), 0.0, 0
        for rows in self._groups():
            squares_of_rows = [(error * root[rows]) ** 2 for error in self._missed(rows)]
            squares += [float(square.sum()) for square in squares_of_rows]
            noise += float((root[rows] ** 2).sum())
            count += len(rows)
        if not count:
            return None
        rms_before, rms_after = np.sqrt(squares / count).tolist()
        of_tool = self.leftover.conditions("leg") == TOOL
        parts = [] if of_tool.all() else ["one side of one leg"]
        parts += ["all places on one side of Zero"] if of_tool.any() else []
        how = f"{' or '.join(parts)} left out at a time, the choice made again each time"
        return HeldOutGap(how, rms_before, rms_after, math.sqrt(noise / count))

    def _groups(self) -> Iterator[IntArray]:
        """Cells of one leg on one side of Zero, in all sessions; of the tool along a coordinate."""
        leg = self.leftover.conditions("leg")
        displacement = self.leftover.conditions("displacement_mm")
        places = [(k, displacement) for k in range(len(LEG_NAMES))]
        places += [(TOOL, along) for along in self.leftover.conditions("position_mm").T]
        for k, coordinate in places:
            for side in (1.0, -1.0):
                rows = np.flatnonzero((leg == k) & (np.sign(coordinate) == side))
                if len(rows) and len(rows) < (leg == k).sum():
                    yield rows

    @cached_property
    def _base(self) -> FloatArray:
        """Columns ``(n, z + k + b)`` of zeros, adopted sizes and base, per what is expected."""
        rows = self.linear.rows
        all_zeros: FloatArray = block_diag(
            [cells.zeros for cells in self.posterior.sessions]
        ).toarray()
        zeros = np.zeros((len(rows.residual), all_zeros.shape[1]))
        zeros[: rows.cells] = LOOSE * all_zeros
        case, linear = self.posterior.sessions[-1].case, self.linear
        sizes = free_columns(self._components, linear.columns, linear.index, case)
        return np.hstack([zeros, sizes, rows.base * spread_of(rows)])

    @property
    def _components(self) -> tuple[Component, ...]:
        """Components of the linear problem, those of the likeliest labels."""
        return self.posterior.components[: len(self.linear.index)]

    @cached_property
    def _sets(self) -> list[Key]:
        """Sets of two and three of these kinds that all readings leave likeliest, with scales."""
        numbers = {
            k for k, component in enumerate(self._components) if component.kind in self.kinds
        }
        return [
            model.key
            for model in self.posterior.models
            if len(model.members) > 1 and numbers >= {*model.members}
        ][:MOST_SETS]

    def _missed(self, out_rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """What is missed of rows that are left out, without a name and with the best one."""
        linear = self.linear
        rows = linear.rows
        used_rows = np.setdiff1d(np.arange(len(rows.residual)), out_rows)
        model_count = self._base.shape[1] - len(rows.value)
        expected = np.concatenate([np.zeros(model_count), expected_base(rows)])
        about = About.of(self._base[used_rows], rows.residual[used_rows], expected)
        columns = about.left_by(linear.columns[used_rows])
        products = Products.of(columns, about.left)
        base = rows.residual[out_rows] - self._base[out_rows] @ (about.inverse @ about.along)
        selection = ModelSelection(
            products,
            linear.index,
            np.array([component.log_prior for component in self._components]),
            rows.free - len(out_rows),
            rows.freedom,
            rows.excess,
            self.posterior.sessions[-1].case.acting,
        )
        index, scale = selection.columns_of(self._best(selection))
        inner = np.eye(len(index)) + scale[:, None] * products.inner[np.ix_(index, index)] * scale
        sizes = scale * np.linalg.solve(inner, scale * products.along[index])
        moved = linear.columns[used_rows][:, index] @ sizes
        shift = about.inverse @ (about.basis[: len(used_rows)].T @ moved)
        correction = linear.columns[out_rows][:, index] @ sizes - self._base[out_rows] @ shift
        return base, base - correction

    def _best(self, selection: ModelSelection) -> Key:
        """What has most weight alone, or the set that has more."""
        of_kind = [component.kind in self.kinds for component in self._components]
        log = np.where(of_kind, selection.log_weights(), -math.inf)
        row, number = np.unravel_index(int(np.argmax(log)), log.shape)
        best: Key = ((int(number), SCALES[int(row)]),)
        largest = float(log[row, number])
        for key in self._sets:
            weight = selection.entry(key).log_weight
            if weight > largest:
                best, largest = key, weight
        return best
