"""What the posterior will be after further readings, before these are taken.

In each model everything is linear about its own solution, so its covariance after the readings is
known beforehand, and where its mean goes if another model is true. Weights change by the expected
log Bayes factors. What is entered is projected again from the mean of the mixture.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import Conditions, FloatArray, IntArray, incidence, joined, rows_of, tilts
from calib.identify.fit import design_of
from calib.posterior.correction import projector_of, quantile_mm
from calib.posterior.library import ELSE, instances, something_else
from calib.posterior.posterior import InField, Posterior
from calib.posterior.readings import BASE, LENGTHS, Cells, Placed, placed_columns
from calib.posterior.tool import Frame
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
"""Of the largest mean square at the tool: directions of the field that move it less are left out."""


@dataclass(frozen=True, eq=False)
class Readings:
    """Expected means of cells ``(n,)``, in standard deviations, without zeros of mountings.

    ``columns`` ``(n, f)`` are derivatives by the tool's field, ``own`` ``(n, e)`` those by something
    else, whose part that no session has shown is ``fresh`` ``(n, k)``; ``loose`` ``(n, 3)`` is what
    joint offsets of their own do, per standard deviation. ``followed`` has expected means and
    columns of the models that have derivatives of their own.
    """

    expected: FloatArray
    columns: FloatArray
    own: FloatArray
    fresh: FloatArray
    loose: FloatArray
    followed: tuple[tuple[FloatArray, FloatArray], ...]

    def with_offsets_apart(self, spread_mm: FloatArray) -> Readings:
        """With joint offsets of their own, expected within ``spread_mm`` ``(3,)`` of these."""
        apart = np.ones(self.columns.shape[1])
        apart[:3] = 0.0
        return replace(
            self,
            columns=self.columns * apart,
            loose=self.columns[:, :3] * spread_mm,
            followed=tuple((expected, columns * apart) for expected, columns in self.followed),
        )

    @classmethod
    def together(cls, every: Sequence[Readings]) -> Readings:
        """Several set-ups one after the other."""
        fresh = np.zeros(
            (sum(len(one.fresh) for one in every), sum(one.fresh.shape[1] for one in every))
        )
        row = column = 0
        for one in every:
            rows, columns = one.fresh.shape
            fresh[row : row + rows, column : column + columns] = one.fresh
            row, column = row + rows, column + columns
        each = zip(*(one.followed for one in every), strict=True)
        return cls(
            np.concatenate([one.expected for one in every]),
            np.vstack([one.columns for one in every]),
            np.vstack([one.own for one in every]),
            fresh,
            np.vstack([one.loose for one in every]),
            tuple(
                (np.concatenate([e for e, _ in some]), np.vstack([c for _, c in some]))
                for some in each
            ),
        )


@dataclass(frozen=True, eq=False)
class Outcome:
    """What is expected after readings: the bound, and how far models are apart.

    ``bound_mm`` is the mean over the models that may be true. ``separation`` ``(h, h)`` is what
    model j leaves of the readings that are expected if model i is true, in noise variances.
    """

    bound_mm: float
    separation: FloatArray


@dataclass(frozen=True, eq=False)
class Forecast:
    """The posterior as the planner sees it: some of its models, in a frame, with what is entered.

    ``index`` are the columns of the field that are entered. ``shown`` ``(q, f)`` is a root of the
    frame's metric, ``entered`` ``(q, f)`` the same of what is entered for an expected field.
    """

    posterior: Posterior
    numbers: IntArray
    weight: FloatArray
    shown: FloatArray
    entered: FloatArray

    @classmethod
    def of(cls, posterior: Posterior, frame: Frame, index: Sequence[int]) -> Forecast:
        """The heaviest models, and of the others every so many, which stand for those between."""
        weight = np.array([model.weight for model in posterior.models])
        order = np.argsort(-weight, kind="stable")
        step = max(1, -(-(len(order) - HEAVIEST) // HEAVIEST))
        light = order[HEAVIEST:]
        groups = [light[k : k + step] for k in range(0, len(light), step)]
        numbers = [*order[:HEAVIEST].tolist(), *(int(some[len(some) // 2]) for some in groups)]
        weights = [*weight[order[:HEAVIEST]], *(float(weight[some].sum()) for some in groups)]
        square, axes = np.linalg.eigh(posterior.field.metrics[frame])
        kept = square > SHOWN**2 * square[-1]
        shown = np.sqrt(square[kept])[:, None] * axes[:, kept].T
        entered = shown[:, list(index)] @ projector_of(posterior, index, frame)
        return cls(
            posterior, np.array(numbers), np.array(weights) / sum(weights), shown, entered
        )

    @cached_property
    def cells(self) -> Cells:
        """The last session: its offsets are those of the machine as it is."""
        return self.posterior.sessions[-1]

    @cached_property
    def noise_mm2(self) -> tuple[float, float]:
        """Variance of a reading that repeats reduce, and what repeats share, as found."""
        cells = self.cells
        scatter = float(np.median(cells.scatter_mm2 * cells.visited.averaged))
        shared = cells.noise.quantisation_mm2(cells.means) if cells.noise else np.zeros(1)
        return scatter, float(np.mean(shared))

    @cached_property
    def fields(self) -> list[InField]:
        """The models in the tool's field."""
        every = self.posterior.models_in_field
        return [every[k] for k in self.numbers.tolist()]

    @cached_property
    def truths(self) -> list[tuple[int, float]]:
        """Models that are taken to be true, and the weight that each stands for."""
        along = np.cumsum(self.weight) / self.weight.sum()
        chosen = np.searchsorted(along, (np.arange(TRUTHS) + 0.5) / TRUTHS)
        number, times = np.unique(chosen, return_counts=True)
        return list(zip(number.tolist(), (times / TRUTHS).tolist(), strict=True))

    @cached_property
    def followed(self) -> list[int]:
        """The models that have derivatives at their own solution."""
        models = [self.posterior.models[k] for k in self.numbers.tolist()]
        return [k for k, model in enumerate(models) if model.members][:FOLLOWED]

    @cached_property
    def _else(self) -> FloatArray:
        """Errors of each posture's own ``(n_cells, e)`` in the last session."""
        return something_else(self.cells.means)

    @cached_property
    def groups(self) -> list[_Group]:
        """Models by the base that they share, and by how large something else is expected."""
        own = [self._own(k) for k in range(len(self.numbers))]
        keys = [(id(field.base_root), size) for field, (_, _, size) in zip(self.fields, own)]
        of_key: dict[tuple[int, float], list[int]] = {}
        for k, key in enumerate(keys):
            of_key.setdefault(key, []).append(k)
        return [
            _Group.of(rows, [self.fields[k] for k in rows], [own[k] for k in rows], self)
            for rows in of_key.values()
        ]

    def _own(self, k: int) -> tuple[FloatArray, FloatArray, float]:
        """Mean ``(e,)``, root ``(e, r)`` and size of something else in the last session."""
        model, width = self.posterior.models[int(self.numbers[k])], self._else.shape[1]
        mean, root, size = np.zeros(width), np.zeros((width, model.sizes.shape[1])), 0.0
        starts = self.posterior.starts(model)
        for member, scale, at in zip(model.members, model.scales, starts, strict=True):
            component = self.posterior.components[member]
            end = at + len(component.unit)
            if component.id == ELSE and end - at >= width:
                mean, root = model.mean[end - width : end], model.sizes[end - width : end]
                size = scale * float(component.unit[0])
        return mean, root, size

    @cached_property
    def machines(self) -> list[tuple[Model, FloatArray]]:
        """Each of the models `followed`, and what its machine has not ``(f,)``: a little of all."""
        known, first = self.cells.case.model, self.posterior.parameter_count - 3
        every = []
        for k in self.followed:
            model, rest = self.posterior.models[int(self.numbers[k])], self.fields[k].mean.copy()
            rest -= self.posterior.start
            rest[:BASE] = 0.0
            effects = []
            for member, at in zip(model.members, self.posterior.starts(model), strict=True):
                component = self.posterior.components[member]
                values = model.mean[at : at + len(component.unit)]
                rest -= self.posterior.into_field[member] @ values
                effects += list(instances(component, values))
            parameters = np.concatenate([model.mean[first : first + 3], model.mean[:LENGTHS]])
            machine = known.with_effects((*known.effects, *effects)).with_parameters(parameters)
            every.append((machine, rest))
        return every

    def readings(
        self,
        set_ups: Sequence[Conditions],
        change: Callable[[Model], Model] = lambda model: model,
        *,
        offsets_apart: bool = False,
    ) -> list[Readings]:
        """What each set-up is expected to show of a machine after a ``change``.

        With ``offsets_apart`` joint offsets are not those of the sessions, as after others were
        entered: the readings have to show them again.
        """
        means, counts = zip(*(_cells(taken) for taken in set_ups), strict=True)
        every = joined(means)
        model = change(self.cells.model)
        start, columns = model.readings(every), self._columns(model, every)
        each = []
        for k, (machine, rest) in zip(self.followed, self.machines, strict=True):
            members = self.posterior.models[int(self.numbers[k])].members
            acting = {
                (share.effect, share.place)
                for member in members
                for share in self.posterior.components[member].shares
            }
            machine = change(machine)
            own = self._columns(machine, every, acting, columns)
            each.append((machine.readings(every) + own @ rest, own))
        found, row = [], 0
        for taken, count in zip(means, counts, strict=True):
            rows = slice(row, row + len(taken))
            row += len(taken)
            whiten = self._whitening(taken, count)
            own, fresh = self._something_else(taken)
            found.append(
                Readings(
                    whiten @ start[rows],
                    whiten @ columns[rows],
                    whiten @ own,
                    whiten @ fresh,
                    np.zeros((len(whiten), 0)),
                    tuple((whiten @ e[rows], whiten @ c[rows]) for e, c in each),
                )
            )
        spread_mm = self.cells.case.tolerance_mm[:3]
        return [one.with_offsets_apart(spread_mm) if offsets_apart else one for one in found]

    def _columns(
        self,
        model: Model,
        taken: Conditions,
        laws: Collection[Placed] | None = None,
        start: FloatArray | None = None,
    ) -> FloatArray:
        """Derivatives ``(n, f)`` by the field at a model; of other than these laws as ``start``."""
        columns = np.zeros((len(taken), self.shown.shape[1])) if start is None else start.copy()
        columns[:, :BASE] = design_of(model, taken, range(BASE), ())
        wanted = self.posterior.field.placed if laws is None else laws
        effects = list(dict.fromkeys(effect for effect, _ in wanted))
        for law, own in placed_columns(model, taken, effects).items():
            if law in wanted:
                columns[:, list(self.posterior.field.columns_of(law))] = own
        return columns

    def _whitening(self, taken: Conditions, count: FloatArray) -> FloatArray:
        """Makes means of cells independent, of unit variance, and free of zeros ``(m, n)``."""
        scatter, shared = self.noise_mm2
        root = np.sqrt(np.maximum(scatter / count + shared, 1e-10))
        zeros = np.hstack([incidence(taken.mount), tilts(taken)]) / root[:, None]
        basis, singular, _ = np.linalg.svd(zeros)
        rank = int((singular > 1e-9 * singular[0]).sum())
        return np.asarray(basis[:, rank:].T / root)

    def _something_else(self, taken: Conditions) -> tuple[FloatArray, FloatArray]:
        """What errors of postures do elsewhere: by those of the session, and what is new."""
        old, count = self._else, len(self.cells.means)
        both = something_else(joined([self.cells.means, taken]))
        known = np.linalg.pinv(both[:count], rcond=1e-6)
        _, singular, turned = np.linalg.svd(both[:count])
        free = turned[int((singular > 1e-6 * singular[0]).sum()) :]
        return np.asarray(both[count:] @ (known @ old)), np.asarray(both[count:] @ free.T)

    def after(self, readings: Readings | None, models: Sequence[int] = ()) -> Outcome:
        """What is expected after these readings; None: what is known now.

        Separations are those of these ``models`` of the forecast.
        """
        if readings is None:
            now = [group.now() for group in self.groups]
            return Outcome(self._bound_mm(now, self.weight, None), np.zeros((0, 0)))
        updated = [group.updated(readings, self.followed) for group in self.groups]
        place = {k: (one, j) for one in updated for j, k in enumerate(one.group.rows.tolist())}
        total = 0.0
        for true, share in self.truths:
            up, j = place[true]
            log = np.log(self.weight)
            for other in updated:
                log[other.group.rows] -= other.against(up, j)
            weight = np.exp(log - log.max())
            moved = up.expected[:, j]
            total += share * self._bound_mm(updated, weight / weight.sum(), moved)
        separation = np.zeros((len(models), len(models)))
        for i, true in enumerate(models):
            up, j = place[true]
            for k, other in enumerate(models):
                against, at = place[other]
                separation[i, k] = against.square(up.expected[:, j])[at]
        return Outcome(total, separation)

    def _bound_mm(
        self, updated: Sequence[_Updated], weight: FloatArray, true: FloatArray | None
    ) -> float:
        """The bound of a mixture; means go where readings ``true`` ``(n,)`` take them."""
        count, q = len(self.weight), len(self.shown)
        mean = np.zeros((2 * q, count))
        for up in updated:
            mean[:, up.group.rows] = up.means(true)
        off = mean[:q] - (mean[q:] @ weight)[:, None]
        distances = np.zeros((count, 3))
        distances[:, 0] = weight
        for up in updated:
            distances[up.group.rows, 1:] = up.distances(off[:, up.group.rows])
        kept = weight > LIGHT
        return quantile_mm(distances[kept])


@dataclass(frozen=True, eq=False)
class _Group:
    """Models ``rows`` of a forecast that share a base, their sizes side by side.

    Column k of ``sizes`` ``(f, R)`` belongs to model ``owner[k]``; ``blocks`` are the columns
    ``(m, r)`` of models of r sizes. ``base`` ``(f, b)`` is the root that they share, ``mean``
    ``(f, M)`` without effects that the model of the sessions has. ``own`` are roots and means of
    something else, ``size`` how large it is expected.
    """

    rows: IntArray
    owner: IntArray
    blocks: tuple[IntArray, ...]
    base: FloatArray
    sizes: FloatArray
    mean: FloatArray
    own: FloatArray
    own_mean: FloatArray
    size: float
    inflated: FloatArray
    tool_base: FloatArray
    tool_sizes: FloatArray
    tool_mean: FloatArray
    start: FloatArray

    @classmethod
    def of(
        cls,
        rows: Sequence[int],
        fields: Sequence[InField],
        own: Sequence[tuple[FloatArray, FloatArray, float]],
        forecast: Forecast,
    ) -> _Group:
        """Of these models in the tool's field."""
        posterior = forecast.posterior
        roots = [one.root / one.inflated for one in fields]
        widths = np.array([root.shape[1] for root in roots], dtype=np.intp)
        firsts = np.cumsum([0, *widths[:-1]])
        blocks = [
            firsts[widths == width][:, None] + np.arange(width) for width in np.unique(widths) if width
        ]
        # columns of what no leg shows come last and do nothing to something else
        own_roots = [
            np.hstack([root, np.zeros((len(root), width - root.shape[1]))])
            for (_, root, _), width in zip(own, widths.tolist(), strict=True)
        ]
        both = np.vstack([forecast.shown, forecast.entered])
        mean = np.column_stack([one.mean for one in fields])
        sizes = np.hstack(roots)
        at = np.zeros(len(mean))
        at[:BASE] = forecast.cells.model.parameters_mm
        return cls(
            np.array(rows, dtype=np.intp),
            np.repeat(np.arange(len(rows)), widths),
            tuple(blocks),
            fields[0].base_root,
            sizes,
            mean - posterior.start[:, None],
            np.hstack(own_roots),
            np.column_stack([one for one, _, _ in own]),
            own[0][2],
            np.array([one.inflated for one in fields]),
            both @ fields[0].base_root,
            both @ sizes,
            both @ mean,
            at,
        )

    def sums(self, values: FloatArray) -> FloatArray:
        """Of columns ``(R,)`` for each model ``(M,)``."""
        return np.asarray(np.bincount(self.owner, values, len(self.rows)))

    def now(self) -> _Updated:
        """As it is known now."""
        nothing = np.zeros((0, 0))
        q = len(self.tool_base) // 2
        count, width = len(self.rows), len(self.owner)
        return _Updated(
            self,
            self.tool_base[:q] @ self.tool_base[:q].T,
            self.tool_sizes,
            np.zeros((0, width)),
            np.zeros((2 * q, 0)),
            nothing,
            np.zeros((0, count)),
            np.zeros((0, width)),
            np.zeros(count),
        )

    def updated(self, readings: Readings, followed: Sequence[int]) -> _Updated:
        """With the covariance after these readings."""
        q, n = len(self.tool_base) // 2, len(readings.expected)
        shown = readings.columns @ self.base
        loose, fresh = readings.loose, self.size * readings.fresh
        square = np.eye(n) + shown @ shown.T + loose @ loose.T + fresh @ fresh.T
        lower = np.linalg.cholesky(square)
        white = np.linalg.inv(lower)
        sizes = readings.columns @ self.sizes + readings.own @ self.own
        away = self.mean - self.start[:, None]
        expected = readings.expected[:, None] + readings.columns @ away + readings.own @ self.own_mean
        for number, (means, columns) in zip(followed, readings.followed, strict=True):
            for j in np.flatnonzero(self.rows == number).tolist():
                mine = np.flatnonzero(self.owner == j)
                sizes[:, mine] = columns @ self.sizes[:, mine] + readings.own @ self.own[:, mine]
                expected[:, j] = means + readings.own @ self.own_mean[:, j]
        sizes = white @ sizes
        gain = (self.tool_base @ shown.T) @ white.T
        moved = self.tool_sizes - gain @ sizes
        seen, tool = np.zeros_like(sizes), np.zeros_like(moved)
        room = np.full(len(self.rows), float(np.log(lower.diagonal()).sum()))
        for block in self.blocks:
            inside = np.moveaxis(sizes[:, block], 1, 0)
            inner = np.swapaxes(inside, 1, 2) @ inside + np.eye(block.shape[1])
            root = np.swapaxes(np.linalg.inv(np.linalg.cholesky(inner)), 1, 2)
            seen[:, block] = np.moveaxis(inside @ root, 0, 1)
            tool[:, block] = np.moveaxis(np.moveaxis(moved[:, block], 1, 0) @ root, 0, 1)
            logs = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
            room[self.owner[block[:, 0]]] -= logs
        base = self.tool_base[:q] @ self.tool_base[:q].T - gain[:q] @ gain[:q].T
        return _Updated(self, base, tool, seen, gain, white, expected, sizes, room)


@dataclass(frozen=True, eq=False)
class _Updated:
    """A group after readings.

    Covariance at the tool is ``base`` ``(q, q)`` beside roots ``tool`` ``(2q, R)``. A departure of
    the readings, made ``white`` ``(n, n)``, moves means by ``gain`` ``(2q, n)`` and by ``tool``
    times ``seen`` ``(n, R)``; ``room`` ``(M,)`` are logs of the roots of determinants.
    """

    group: _Group
    base: FloatArray
    tool: FloatArray
    seen: FloatArray
    gain: FloatArray
    white: FloatArray
    expected: FloatArray
    sizes: FloatArray
    room: FloatArray

    def _departure(self, true: FloatArray) -> FloatArray:
        return np.asarray(self.white @ (true[:, None] - self.expected))

    def means(self, true: FloatArray | None) -> FloatArray:
        """At the tool ``(2q, M)`` where these are the readings ``(n,)``."""
        if true is None:
            return self.group.tool_mean
        departure = self._departure(true)
        along = (self.seen * departure[:, self.group.owner]).sum(axis=0)
        means = self.group.tool_mean + self.gain @ departure
        if len(along):
            member = np.zeros((len(along), means.shape[1]))
            member[np.arange(len(along)), self.group.owner] = along
            means = means + self.tool @ member
        return np.asarray(means)

    def square(self, true: FloatArray) -> FloatArray:
        """What each model leaves of these readings ``(M,)``, in noise variances."""
        departure = self._departure(true)
        along = (self.seen * departure[:, self.group.owner]).sum(axis=0)
        left = (departure**2).sum(axis=0) - self.group.sums(along**2)
        return np.asarray(left / self.group.inflated**2)

    def against(self, up: _Updated, j: int) -> FloatArray:
        """Expected log Bayes factor ``(M,)`` of a model j that is true against each."""
        mine = np.flatnonzero(up.group.owner == j)
        root = np.linalg.inv(up.white)
        covered = self.white @ np.hstack([root, root @ up.sizes[:, mine]])
        spread = covered @ covered.T
        inside = self.group.sums((self.seen * (spread @ self.seen)).sum(axis=0))
        wide = float(np.trace(spread)) - inside - len(self.white)
        log = self.room - up.room[j]
        return np.asarray(0.5 * (wide + self.square(up.expected[:, j])) + log)

    def distances(self, off: FloatArray) -> FloatArray:
        """Mean and variance ``(M, 2)`` of the mean square at the tool; means are ``off`` ``(q, M)``."""
        q, group = len(off), self.group
        root, more = self.tool[:q], group.inflated**2
        through = self.base @ root
        inner = np.zeros(len(group.rows))
        for block in group.blocks:
            some = np.moveaxis(root[:, block], 1, 0)
            inner[group.owner[block[:, 0]]] = ((np.swapaxes(some, 1, 2) @ some) ** 2).sum(axis=(1, 2))
        size = more * (float(np.trace(self.base)) + group.sums((root**2).sum(axis=0)))
        square = float((self.base**2).sum()) + inner
        square = more**2 * (square + 2.0 * group.sums((root * through).sum(axis=0)))
        along = (off * (self.base @ off)).sum(axis=0)
        along = along + group.sums((root * off[:, group.owner]).sum(axis=0) ** 2)
        size = size + (off**2).sum(axis=0)
        return np.column_stack([size, 2.0 * square + 4.0 * more * along])


def _cells(taken: Conditions) -> tuple[Conditions, FloatArray]:
    """One reading of each cell, and how many it has ``(n,)``."""
    first = np.unique(taken.cell, return_index=True)[1]
    return taken.take(first), np.bincount(taken.cell).astype(np.float64)
