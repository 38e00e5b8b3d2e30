"""One posterior of one or several sessions: weighted models, each a normal about its own fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.errors import NotIdentifiable
from calib.posterior.library import ELSE, SHARES, Component, library, something_else
from calib.posterior.race import Entry, Products, Race
from calib.posterior.readings import (
    LENGTHS,
    Case,
    Cells,
    Placed,
    Rows,
    placed_columns,
    rows_of,
)
from calib.posterior.tool import ToolField, tool_field
from calib.tripod.effects.drives import AxisLean, AxisOffset, Backlash, effects_of
from calib.tripod.effects.effect import PER_THOUSAND, Effect
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model

REFINED = 8
"""Models that are followed through the simulation; the others stay linear."""

STEPS = 2
BEYOND = 1.0
"""Noise variances by which a model may differ from its derivatives before it is followed."""

ELSE_UNIT_MM = 0.003
"""R.m.s. of something else that nobody would remark on, in the readings."""


MOST_UNITS = 16.0
"""Unremarkable sizes that a law without a name may have where readings hardly show it."""


@dataclass(frozen=True, eq=False)
class Weighted:
    """One model: components, weight, and the normal of base parameters and sizes ``(b + r,)``."""

    members: tuple[int, ...]
    weight: float
    mean: FloatArray
    covariance: FloatArray
    scales: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Posterior:
    """What readings tell of the machine. Base parameters are lengths, then offsets of sessions."""

    sessions: tuple[Cells, ...]
    components: tuple[Component, ...]
    models: tuple[Weighted, ...]
    field: ToolField
    columns: tuple[IntArray, ...]
    inner: FloatArray

    @property
    def geometry(self) -> Geometry:
        """The nominal machine."""
        return self.sessions[0].case.model.geometry

    @cached_property
    def into_field(self) -> list[FloatArray]:
        """For each component what its values ``(r,)`` are in the tool's field ``(6 + k, r)``."""
        width = self.field.rows.shape[1]
        found = []
        for component in self.components:
            into = np.zeros((width, len(component.unit)))
            for share in component.candidate.shares if component.candidate else ():
                for column, value in zip(
                    self.field.columns_of((share.effect, share.place)), share.values, strict=True
                ):
                    into[column, value] += 1.0
            found.append(into)
        return found

    def in_field(self, model: Weighted) -> tuple[FloatArray, FloatArray]:
        """Mean ``(6 + k,)`` and the map ``(6 + k, b + r)`` of a model's values into the field.

        Joint offsets are those of the last session.
        """
        base = len(model.mean) - sum(len(self.components[k].unit) for k in model.members)
        into = np.zeros((self.field.rows.shape[1], base))
        into[3:6, :LENGTHS] = np.eye(3)
        into[:3, base - 3 :] = np.eye(3)
        whole = np.hstack([into, *(self.into_field[k] for k in model.members)])
        return whole @ model.mean, whole

    @cached_property
    def mean(self) -> FloatArray:
        """What is expected over all models ``(6 + k,)``, in the tool's field."""
        return np.asarray(
            sum(model.weight * self.in_field(model)[0] for model in self.models), dtype=np.float64
        )

    def unseen(self, model: Weighted) -> FloatArray:
        """Standard deviations ``(6,)`` of shifts, mm, and turns, rad, that no leg reading shows.

        Of a pair of axes that leans the readings see the sum, of axes that miss each other the
        distances: the rest turns and shifts the machine as a whole.
        """
        variance = np.zeros(6)
        for k, scale in zip(model.members, model.scales, strict=True):
            component = self.components[k]
            size = scale * float(component.unit[0])
            turns = component.id == "axis_squareness"
            if not component.candidate or not (turns or component.id == "axis_offset"):
                continue
            for share in component.candidate.shares:
                (third,) = {0, 1, 2} - {"xyz".index(name) for name in share.place[:2]}
                if turns:
                    variance[3 + third] += (PER_THOUSAND * size) ** 2 / 2.0
                else:
                    variance[third] += size**2 / 2.0
        return np.sqrt(variance)

    def something_else(self, model: Weighted, metric: FloatArray) -> FloatArray:
        """Mean squares at the tool if what is left were any law without a name, one for each.

        As large as leaves as much in the readings, at most `MOST_UNITS`.
        """
        at = len(model.mean) - sum(len(self.components[k].unit) for k in model.members)
        energy = 0.0
        for k in model.members:
            width = len(self.components[k].unit)
            if self.components[k].id == ELSE:
                unit = self.components[k].unit
                index = self.columns[k]
                size = model.mean[at : at + width] / unit
                block = model.covariance[at : at + width, at : at + width] / np.outer(unit, unit)
                inner = self.inner[np.ix_(index, index)]
                energy += float(size @ inner @ size + np.trace(inner @ block))
            at += width
        squares = []
        for k, component in enumerate(self.components):
            if component.kind != "nameless" or len(component.unit) != 1:
                continue
            (column,) = self.columns[k]
            size = min(energy / max(float(self.inner[column, column]), 1e-12), MOST_UNITS**2)
            moved = self.into_field[k][:, 0] * component.unit[0]
            squares.append(size * float(moved @ metric @ moved))
        return np.array(squares)

    def probability(self, component_id: str) -> float:
        """That it is among what is true."""
        return sum(
            model.weight
            for model in self.models
            if any(self.components[k].id == component_id for k in model.members)
        )

    @property
    def places(self) -> dict[tuple[str, str], float]:
        """Probability of each id and place."""
        found: dict[tuple[str, str], float] = {}
        for model in self.models:
            for name in {(self.components[k].id, self.components[k].where) for k in model.members}:
                found[name] = found.get(name, 0.0) + model.weight
        return dict(sorted(found.items(), key=lambda item: -item[1]))


def posterior(cases: Sequence[Case], effects: Sequence[Effect] | None = None) -> Posterior:
    """Of these sessions together. Raises NotIdentifiable where one cannot be fitted."""
    sessions = tuple(Cells.of(case) for case in cases)
    return _Builder.of(sessions, effects).make()


HELD: tuple[Effect, ...] = (Backlash(), AxisOffset(), AxisLean())
"""What controllers can hold beside the library."""


@dataclass(frozen=True, eq=False)
class _Builder:
    sessions: tuple[Cells, ...]
    models: tuple[Model, ...]
    components: tuple[Component, ...]
    order: tuple[Placed, ...]
    rows: Rows
    joined: FloatArray
    columns: tuple[IntArray, ...]

    @classmethod
    def of(cls, sessions: tuple[Cells, ...], effects: Sequence[Effect] | None) -> _Builder:
        models = _with_common_lengths([cells.model for cells in sessions])
        taken = [(model, cells.means) for model, cells in zip(models, sessions, strict=True)]
        known = library(taken, effects)
        known.append(
            Component(ELSE, "all", ELSE, np.full(1, ELSE_UNIT_MM), None, math.log(SHARES[ELSE]))
        )
        laws = dict.fromkeys(s.effect for c in known if c.candidate for s in c.candidate.shares)
        placed = [placed_columns(model, means, tuple(laws)) for model, means in taken]
        order = tuple(dict.fromkeys(one for each in placed for one in each))
        widths = [len(effect.parameters) for effect, _ in order]
        rows = rows_of(sessions, models, placed, order, widths)
        starts = dict(zip(order, np.cumsum([0, *widths]).tolist(), strict=False))
        blocks, columns, begin = [], [], 0
        for number, component in enumerate(known):
            if component.candidate:
                block = np.zeros((len(rows.residual), len(component.unit)))
                for share in component.candidate.shares:
                    first = starts[share.effect, share.place]
                    for at, value in enumerate(share.values):
                        block[:, value] += rows.columns[:, first + at]
                block = block * component.unit
            else:
                block = ELSE_UNIT_MM * _else_rows(sessions, len(rows.residual))
                known[number] = replace(component, unit=np.full(block.shape[1], ELSE_UNIT_MM))
            blocks.append(block)
            columns.append(np.arange(begin, begin + block.shape[1], dtype=np.intp))
            begin += block.shape[1]
        joined = np.hstack(blocks)
        return cls(sessions, models, tuple(known), order, rows, joined, tuple(columns))

    def make(self) -> Posterior:
        rows = self.rows
        count = len(rows.spread)
        # tolerances are rows beside the readings: no product of derivatives loses digits
        upper = np.vstack([rows.base * rows.spread, np.eye(count)])
        basis, _ = np.linalg.qr(upper)
        below = np.zeros((count, self.joined.shape[1] + 1))
        below[:, -1] = (rows.prior - rows.value) / rows.spread
        others = np.vstack([np.column_stack([self.joined, rows.residual]), below])
        left = others - basis @ (basis.T @ others)
        columns, residual = left[:, :-1], left[:, -1]
        race = Race(
            Products(columns.T @ columns, columns.T @ residual, float(residual @ residual)),
            self.columns,
            np.array([component.log_prior for component in self.components]),
            rows.free,
            rows.freedom,
        )
        entries = race.run()
        weighted = self._weighted(race, entries)
        placed = tuple(
            dict.fromkeys(
                [
                    *(one for one in self.order),
                    *((e, p) for e in effects_of(HELD, self.geometry) for p in _all_places(e)),
                    *((e, p) for e in _held(self.geometry) for p in _all_places(e)),
                ]
            )
        )
        field = tool_field(self.geometry, placed)
        return Posterior(
            self.sessions,
            self.components,
            tuple(weighted),
            field,
            self.columns,
            race.products.inner,
        )

    @property
    def geometry(self) -> Geometry:
        return self.models[0].geometry

    def _weighted(self, race: Race, entries: Sequence[Entry]) -> list[Weighted]:
        """Each model with its normal; the heaviest followed through the simulation."""
        found = []
        log = np.empty(len(entries))
        plain_room = self._plain_room()
        for number, entry in enumerate(entries):
            mean, covariance, square, room = self._solved(
                entry, self.rows, self._block(entry.members), np.zeros(0)
            )
            log[number] = entry.log_weight
            if number < REFINED and entry.members:
                values = self._followed(entry, mean)
                if values is not None:
                    mean, covariance, after, room_after = values
                    gained = race.log_evidence(np.array(after), np.array(room_after - plain_room))
                    before = race.log_evidence(np.array(square), np.array(room - plain_room))
                    log[number] += float(gained - before)
                    square = after
            if not math.isinf(race.freedom):
                more = (race.freedom + square) / max(race.freedom + race.free - 2.0, 1.0)
                covariance = covariance * max(more, 1.0)
            found.append(Weighted(entry.members, 0.0, mean, covariance, entry.scales))
        share = np.exp(log - log.max())
        share /= share.sum()
        return [replace(one, weight=float(w)) for one, w in zip(found, share, strict=True)]

    def _block(self, members: tuple[int, ...]) -> FloatArray:
        """Columns ``(n, r)`` of these components, per unit of their values."""
        if not members:
            return np.zeros((len(self.rows.residual), 0))
        return np.hstack(
            [self.joined[:, self.columns[k]] / self.components[k].unit for k in members]
        )

    def _plain_room(self) -> float:
        inner = self.rows.base * self.rows.spread
        return -0.5 * float(np.linalg.slogdet(np.eye(inner.shape[1]) + inner.T @ inner)[1])

    def _solved(
        self, entry: Entry, rows: Rows, block: FloatArray, at: FloatArray
    ) -> tuple[FloatArray, FloatArray, float, float]:
        """Mean and covariance of base and sizes, what is left, and the room.

        ``at`` are the sizes about which ``rows`` are linear; nothing where that is zero.
        """
        sizes = np.concatenate(
            [
                scale * self.components[k].unit
                for k, scale in zip(entry.members, entry.scales, strict=True)
            ]
            or [np.zeros(0)]
        )
        now = np.concatenate([rows.value, at if len(at) else np.zeros(len(sizes))])
        expected = np.concatenate([rows.prior, np.zeros(len(sizes))])
        spread = np.concatenate([rows.spread, sizes])
        upper = np.vstack([np.hstack([rows.base, block]) * spread, np.eye(len(spread))])
        target = np.concatenate([rows.residual, (expected - now) / spread])
        basis, root = np.linalg.qr(upper)
        inverse = spread[:, None] * np.linalg.inv(root)
        step = inverse @ (basis.T @ target)
        left = target - basis @ (basis.T @ target)
        room = -float(np.log(np.abs(root.diagonal())).sum())
        return now + step, inverse @ inverse.T, float(left @ left), room

    def _followed(
        self, entry: Entry, mean: FloatArray
    ) -> tuple[FloatArray, FloatArray, float, float] | None:
        """The same about the model's own solution; None where its derivatives do."""
        members = [self.components[k] for k in entry.members]
        result = None
        for _ in range(STEPS):
            base, sizes = mean[: len(self.rows.value)], mean[len(self.rows.value) :]
            try:
                models = self._models(members, base, sizes)
                if result is None and not self._bends(models, mean, entry):
                    return None
                rows, block = self._about(models, members, sizes)
                result = self._solved(entry, rows, block, sizes)
            except (NotIdentifiable, ValueError):
                return None
            mean = result[0]
        return result

    def _models(
        self, members: Sequence[Component], base: FloatArray, sizes: FloatArray
    ) -> tuple[Model, ...]:
        effects, begin = [], 0
        for component in members:
            values = sizes[begin : begin + len(component.unit)]
            begin += len(values)
            if component.candidate:
                effects += list(component.candidate.effects(values))
        return tuple(
            cells.case.model.with_effects((*cells.case.model.effects, *effects)).with_parameters(
                np.concatenate([base[LENGTHS + 3 * n : LENGTHS + 3 * n + 3], base[:LENGTHS]])
            )
            for n, cells in enumerate(self.sessions)
        )

    def _bends(self, models: Sequence[Model], mean: FloatArray, entry: Entry) -> bool:
        """Whether readings differ from what derivatives say."""
        from calib.arrays import without_zeros

        rows = []
        for cells, model in zip(self.sessions, models, strict=True):
            off = cells.means.value_mm - model.readings(cells.means)
            weight = 1.0 / cells.variance_mm2
            rows.append(np.sqrt(weight) * without_zeros(cells.means, weight, off))
        count = len(self.rows.value)
        block = self._block(entry.members)
        ours = [k for k, c in zip(entry.members, self._widths(entry), strict=True) if c]
        del ours
        linear = self.rows.residual - self.rows.base @ (mean[:count] - self.rows.value)
        linear = linear - block @ mean[count:]
        straight = self._cell_rows(linear)
        beyond = np.concatenate(rows) - straight
        # something else is in no model
        begin = count
        for k in entry.members:
            width = len(self.components[k].unit)
            if not self.components[k].candidate:
                part = self.joined[:, self.columns[k]] / self.components[k].unit
                beyond = beyond - self._cell_rows(part @ mean[begin : begin + width])
            begin += width
        return float(beyond @ beyond) > BEYOND

    def _widths(self, entry: Entry) -> list[int]:
        return [len(self.components[k].unit) for k in entry.members]

    def _cell_rows(self, rows: FloatArray) -> FloatArray:
        """Of stacked rows those that are means of cells."""
        found, begin = [], 0
        for cells, timed in zip(self.sessions, self._timed, strict=True):
            found.append(rows[begin : begin + len(cells.means)])
            begin += len(cells.means) + timed
        return np.concatenate(found)

    @cached_property
    def _timed(self) -> list[int]:
        total = len(self.rows.residual) - sum(len(cells.means) for cells in self.sessions)
        return [total // len(self.sessions)] * len(self.sessions)

    def _about(
        self, models: Sequence[Model], members: Sequence[Component], sizes: FloatArray
    ) -> tuple[Rows, FloatArray]:
        """Rows about models that hold their effects, and the columns of these ``(n, r)``."""
        laws = tuple(
            dict.fromkeys(s.effect for c in members if c.candidate for s in c.candidate.shares)
        )
        placed = [
            placed_columns(model.with_effects(_without(model, laws)), cells.means, laws)
            if False
            else _own_columns(model, cells, members)
            for model, cells in zip(models, self.sessions, strict=True)
        ]
        order = tuple(dict.fromkeys(one for each in placed for one in each))
        widths = [len(effect.parameters) for effect, _ in order]
        rows = rows_of(self.sessions, models, placed, order, widths)
        starts = dict(zip(order, np.cumsum([0, *widths]).tolist(), strict=False))
        blocks = []
        begin = 0
        residual = rows.residual
        for component in members:
            width = len(component.unit)
            if component.candidate:
                block = np.zeros((len(rows.residual), width))
                for share in component.candidate.shares:
                    first = starts[share.effect, share.place]
                    for at, value in enumerate(share.values):
                        block[:, value] += rows.columns[:, first + at]
            else:
                block = _else_rows(self.sessions, len(rows.residual), self._timed_of(rows))
                residual = residual - block @ sizes[begin : begin + width]
            blocks.append(block)
            begin += width
        return replace(rows, residual=residual), np.hstack(blocks)

    def _timed_of(self, rows: Rows) -> int:
        total = len(rows.residual) - sum(len(cells.means) for cells in self.sessions)
        return total // len(self.sessions)


def _without(model: Model, laws: Sequence[Effect]) -> tuple:  # type: ignore[type-arg]
    return tuple(e for e in model.effects if getattr(e, "effect", None) not in laws)


def _own_columns(
    model: Model, cells: Cells, members: Sequence[Component]
) -> dict[Placed, FloatArray]:
    """Derivatives by the values of effects that the model holds, where they are.

    A law that acts twice, the second time from nothing, has the derivatives of the first for laws
    that are linear; the others are few and small (sine of a tilt).
    """
    laws = tuple(
        dict.fromkeys(s.effect for c in members if c.candidate for s in c.candidate.shares)
    )
    return placed_columns(model, cells.means, laws)


def _with_common_lengths(models: Sequence[Model]) -> tuple[Model, ...]:
    lengths = np.mean([model.parameters_mm[3:] for model in models], axis=0)
    return tuple(
        model.with_parameters(np.concatenate([model.parameters_mm[:3], lengths]))
        for model in models
    )


def _else_rows(sessions: Sequence[Cells], total: int, timed: int | None = None) -> FloatArray:
    """Columns of something else ``(n, r)``, per mm, each session with its own; whitened."""
    from calib.arrays import without_zeros

    if timed is None:
        timed = (total - sum(len(cells.means) for cells in sessions)) // len(sessions)
    blocks = []
    for cells in sessions:
        columns = something_else(cells.means)
        weight = 1.0 / cells.variance_mm2
        blocks.append(np.sqrt(weight)[:, None] * without_zeros(cells.means, weight, columns))
    found = np.zeros((total, sum(block.shape[1] for block in blocks)))
    row = column = 0
    for block in blocks:
        found[row : row + len(block), column : column + block.shape[1]] = block
        row += len(block) + timed
        column += block.shape[1]
    return found


def _held(geometry: Geometry) -> tuple[Effect, ...]:
    """Each foot's own lean and shift, whatever the drives."""
    across = tuple(geometry.across)
    return AxisOffset(across), AxisLean(across)


def _all_places(effect: Effect) -> tuple[str, ...]:
    return tuple(getattr(effect, "where", ()))
