"""Sessions about one fit of the base, and every model that counts with its normal.

Every model has the same base: bar lengths that sessions share, joint offsets of each, and a little
of every law everywhere, for no machine is free of any. To that a model adds its components.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from calib.arrays import FloatArray, IntArray, descending, without
from calib.errors import NotIdentifiable, UnreachablePosture
from calib.posterior.cells import Cells
from calib.posterior.columns import free_columns, free_spread, linear_about, rows_and_blocks
from calib.posterior.first_takes import log_priors, reached, within_plays
from calib.posterior.gaussian import About, LittleOfAll
from calib.posterior.labels import RivalModel, SolvedSessions
from calib.posterior.library import ELSE, Component, library
from calib.posterior.library import laws as library_laws
from calib.posterior.models import LinearSessions, Posterior, WeightedModel, effects_of_tool
from calib.posterior.readings import LENGTHS, Rows
from calib.posterior.selection import SCALES, Key, ModelEntry, ModelSelection, Products
from calib.posterior.tool import laws_held, tool_field
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.candidates import placed_columns
from calib.tripod.effects.drives import Backlash
from calib.tripod.effects.effect import Effect, EffectInstance, Placed
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model

MOST_BESIDE = 3
"""Models beside which mistakes are looked for."""

MOST_NAMES = 8
"""Single names beside which first takes that depart are looked for."""

REFINED = 8
"""Models that are followed through the simulation; the others stay linear."""

STEPS = 2
BEYOND = 1.0
"""Noise variances by which a model may differ from its derivatives before it is followed."""


NEVER = 1e-12
"""Chance of a size that no machine has: it is far below 0."""

EVERYWHERE = 0.005
"""Of an unremarkable size: what every law is taken to have everywhere.

With 0.03 half of the effects of half the noise, r.m.s. in the readings, drowned in it, and the tool
kept a quarter more of laws outside the library. With 0.003 a sound machine is corrected worse.
"""


@dataclass(frozen=True, eq=False)
class PosteriorProblem:
    """All sessions about one fit of the base: rows, and the columns of every component.

    ``columns`` ``(n, k)`` are per unit of the components; ``index`` says which are whose.
    """

    sessions: tuple[Cells, ...]
    components: tuple[Component, ...]
    rows: Rows
    columns: FloatArray
    index: tuple[IntArray, ...]
    placed: tuple[Placed, ...]

    @classmethod
    def of(cls, sessions: tuple[Cells, ...], effects: Sequence[Effect] | None) -> PosteriorProblem:
        """The problem of sessions of one machine: ``effects`` are those of the library, or all."""
        models = _with_common_lengths([cells.model for cells in sessions])
        measured = [(model, cells.means) for model, cells in zip(models, sessions, strict=True)]
        effects = CATALOGUE if effects is None else effects
        every_law = library_laws(models[0].geometry, effects)
        placed = [placed_columns(model, means, every_law) for model, means in measured]
        components = library(measured, effects, sessions[-1].case.named_beyond, placed)
        linear, sized, placed_laws = linear_about(sessions, models, components, placed)
        return cls(sessions, sized, linear.rows, linear.columns, linear.index, placed_laws)

    @cached_property
    def everywhere(self) -> tuple[int, ...]:
        """Components of which every model has a little: laws at single places."""
        return tuple(
            k
            for k, component in enumerate(self.components)
            if component.candidate and component.candidate.arrangement == "one"
        )

    @cached_property
    def by_base(self) -> FloatArray:
        """Derivatives ``(n, b)`` by the values of the base."""
        no_law = np.zeros((len(self.columns), 0))  # one posture shows no law
        laws = [self.columns[:, self.index[k]] / self.components[k].unit for k in self.everywhere]
        return np.hstack([self.rows.base, no_law, *laws])

    @cached_property
    def base(self) -> FloatArray:
        """Derivatives ``(n, b)`` by the base, per standard deviation of what is expected."""
        return np.asarray(self.by_base @ self.base_root)

    def spread_of(self, k: int) -> FloatArray:
        """Standard deviations ``(r,)`` of the values of a component everywhere.

        A little of its unit, or that of an adopted effect about its size in the model.
        """
        component = self.components[k]
        free = free_spread(component, self.sessions[-1].case)
        return EVERYWHERE * component.unit if free is None else free

    @cached_property
    def base_root(self) -> FloatArray:
        """Standard deviations of the base ``(b, b)``, of parameters that are off alike a root."""
        root = np.diag(np.concatenate([self.rows.spread, *map(self.spread_of, self.everywhere)]))
        case = self.sessions[-1].case
        little, places, at = EVERYWHERE * np.ones(len(root)), {}, len(self.rows.spread)
        for k in self.everywhere:
            (share,) = self.components[k].shares
            places[share.effect, share.place] = at + np.arange(len(self.components[k].unit))
            little[places[share.effect, share.place]] *= self.components[k].unit
            at += len(self.components[k].unit)
        numbers = [number for number, law in enumerate(case.lines) if law in places]
        index = [int(places[law][0]) for law in case.lines if law in places]
        root[np.ix_(index, index)] = np.linalg.cholesky(
            (case.lines_root @ case.lines_root.T)[np.ix_(numbers, numbers)]
        )
        for laws in case.of_one_size:  # beside it each has a little of its own, as any law
            alike = [places[law] for law in laws if law in places]
            for own in alike[1:]:
                root[own, alike[0]], root[own, own] = root[own, own], little[own]
        return root

    def solved(self, *, with_play: bool = False) -> SolvedSessions[Posterior]:
        """Models are weighed, then have a normal each; the heaviest follow the simulation.

        ``with_play``: of models in which a play reaches first takes that stand apart; without any
        the log evidence is -inf.
        """
        about = self._plain
        columns, residual = about.left_by(self._laws.whitened(self.columns)), about.left
        within = within_plays(self.sessions)
        log_usual, log_prior = log_priors(within, self.components)
        selection = ModelSelection(
            Products(columns.T @ columns, columns.T @ residual, float(residual @ residual)),
            self.index,
            log_prior,
            self.rows.free,
            self.rows.freedom,
            self.rows.excess,
            self.sessions[-1].case.acting,
        )
        entries = selection.entries()
        models, log_evidence = self._weighted(selection, entries, about)
        if with_play:
            models, log_share = reached(models, within, self.components)
            log_evidence += log_share
        acting = effects_of_tool(self.sessions[-1].case.model)
        placed_laws = [(instance.effect, instance.place) for instance in acting]
        lines = self.sessions[-1].case.geometry
        laws = dict.fromkeys([*self.placed, *laws_held(self.geometry), *placed_laws, *lines])
        field = tool_field(self.geometry, tuple(laws))
        linear = LinearSessions(self.rows, self.columns, self.index)
        result = Posterior(self.sessions, self.components, tuple(models), field, linear)
        constant = self.rows.log_constant + self._log_of_states() + self.log_of_lines + log_usual
        # something else explains any mistake away
        of_names = [entry for entry in entries if entry.members and not self._else(entry)]
        heaviest = [selection.entry(()), *of_names[:MOST_BESIDE]]

        def beside(number: int, *, alone: bool) -> list[RivalModel]:
            models = self._single_names(selection) if alone else heaviest
            return [RivalModel(m.log_weight + constant, self._beside(number, m)) for m in models]

        names = [k for k, law in enumerate(self.components) if law.kind in ("named", "beside")]

        def with_one_name(number: int, change_mm: FloatArray) -> FloatArray:
            changed = self._laws.whitened(self._changed(number, change_mm))
            changed_rows = about.left[:, None] + about.left_by(changed)
            return constant + selection.best_singles(
                columns.T @ changed_rows, (changed_rows**2).sum(axis=0), names
            )

        return SolvedSessions(result, log_evidence + constant, beside, with_one_name)

    @cached_property
    def _laws(self) -> LittleOfAll:
        """A little of every law, which is the same about all models."""
        return LittleOfAll(self.base[:, len(self.rows.spread) :])

    @cached_property
    def _plain(self) -> About:
        """The base about the rows, without any component."""
        return self._about_of(self.rows)

    def _about_of(self, rows: Rows) -> About:
        """Lengths and offsets about rows, where they have derivatives of their own."""
        base_rows = self.base[:, : len(rows.spread)].copy()
        base_rows[: rows.exact] = (rows.base * rows.spread)[: rows.exact]
        expected = (rows.prior - rows.value) / rows.spread
        base_rows, residual = self._laws.whitened(base_rows), self._laws.whitened(rows.residual)
        about = About.of(base_rows, residual, expected, rows.whitening)
        return replace(about, room=about.room + self._laws.room)

    def _root(self, about: About) -> FloatArray:
        """A root ``(b, b)`` of the covariance of the base; what laws do follows from the others."""
        laws, count = self._laws, len(self.rows.residual)
        projected = -laws.seen.T @ (about.basis[:count])
        zeros = np.zeros((len(about.inverse), len(laws.root)))
        root = np.block([[about.inverse, zeros], [projected, laws.root]])
        return np.asarray(self.base_root @ root)

    def _moved(self, about: About, along: FloatArray, remainder: FloatArray) -> FloatArray:
        """Values of the base ``(b, ...)`` for rows ``along`` the basis and those it has left."""
        laws = self._laws.seen.T @ remainder[: len(self.rows.residual)]
        return np.asarray(self.base_root @ np.concatenate([about.inverse @ along, laws]))

    @property
    def log_of_lines(self) -> float:
        """What lengths and lines of drives that are free add to the log evidence.

        Less what offsets cost: these are never the question. 0 where lines have no tolerance.
        """
        rows = self.rows
        if not any(cells.case.geometry for cells in self.sessions):
            return 0.0
        offsets = (rows.base * rows.spread)[:, LENGTHS:]
        white = rows.whitening[LENGTHS:, LENGTHS:]
        no_expectation = np.zeros(offsets.shape[1])
        alone = About.of(offsets, np.zeros(len(offsets)), no_expectation, white)
        return self._plain.room - alone.room

    def _log_of_states(self) -> float:
        """What expecting the same joint offsets of several sessions adds to the log evidence.

        Mistakes are compared without what offsets cost: these are never the question.
        """
        alone = np.eye(len(self.rows.whitening))
        alone[:LENGTHS, :LENGTHS] = self.rows.whitening[:LENGTHS, :LENGTHS]
        if np.array_equal(self.rows.whitening, alone):
            return 0.0
        return self._plain.room - self._about_of(replace(self.rows, whitening=alone)).room

    def _changed(self, number: int, change_mm: FloatArray) -> FloatArray:
        """Rows ``(n, m)`` by which other means of cells ``(n_cells, m)`` of a session differ."""
        begin = sum(len(cells.means) for cells in self.sessions[:number])
        rows = np.zeros((len(self.rows.residual), change_mm.shape[1]))
        rows[begin : begin + len(change_mm)] = self.sessions[number].whitened(change_mm)
        return rows

    def _single_names(self, selection: ModelSelection) -> list[ModelEntry]:
        """The likeliest names, each alone at its likeliest place; play at every place."""
        log = selection.log_weights()
        best = {
            k: (float(log[row, k]), row)
            for k, row in enumerate(np.argmax(log, axis=0).tolist())
            if self.components[k].kind in ("named", "beside")
        }
        ordered = descending([*best], lambda k: best[k][0])
        names = {self.components[k].id: k for k in reversed(ordered)}
        likeliest = [k for k in ordered if names[self.components[k].id] == k][:MOST_NAMES]
        plays = [k for k in ordered if self.components[k].id == Backlash.id]
        return [
            selection.entry(((k, SCALES[best[k][1]]),)) for k in dict.fromkeys([*likeliest, *plays])
        ]

    def _else(self, entry: ModelEntry) -> bool:
        return any(self.components[k].id == ELSE for k in entry.members)

    def _beside(self, number: int, entry: ModelEntry) -> FloatArray:
        """Columns ``(n_cells, r)`` of a model in a session, each of the size that it expects.

        Those of adopted effects are among them.
        """
        begin = sum(len(cells.means) for cells in self.sessions[:number])
        cells = self.sessions[number]
        expected_columns = self.columns[:, self._index(entry)] * self._unit(entry)[1]
        free = free_columns(self.components, self.columns, self.index, cells.case)
        return cells.coloured(np.hstack([expected_columns, free])[begin : begin + len(cells.means)])

    @property
    def geometry(self) -> Geometry:
        """The nominal machine."""
        return self.sessions[0].case.model.geometry

    def _weighted(
        self, selection: ModelSelection, entries: Sequence[ModelEntry], about: About
    ) -> tuple[list[WeightedModel], float]:
        models_by_key: dict[Key, tuple[float, WeightedModel]] = {}
        gained_by_key: dict[Key, float] = {}
        white = self._laws.whitened(self.columns)
        along = about.basis[: len(white)].T @ white
        moved = self._moved(about, along, about.left_by(white))
        mean = self._moved(about, about.along, about.left)
        mean[: len(self.rows.value)] += self.rows.value
        plain = ModelFit(mean, self._root(about), moved, selection.products.square, about.room)

        def add(entry: ModelEntry, *, follow: bool) -> None:
            fit, gained = self._fitted(entry, selection.products, plain), 0.0
            if follow and entry.members:
                fit, gained = self._followed(selection, entry, fit, about.room)
            model, gained_by_key[entry.key] = self._model(selection, entry, fit), gained
            log_weight = entry.log_weight + gained + self._log_possible(model)
            models_by_key[entry.key] = log_weight, model

        for number, entry in enumerate(entries):
            add(entry, follow=number < REFINED)
        best = max(entries, key=lambda entry: models_by_key[entry.key][0])
        if gained_by_key[best.key]:
            for entry in _fewer(selection, entries, best):
                add(entry, follow=True)
        log = np.array([log_weight for log_weight, _ in models_by_key.values()])
        share = np.exp(log - log.max())
        log_evidence = float(log.max() + math.log(share.sum()))
        share /= share.sum()
        models = [
            replace(model, weight=float(w))
            for (_, model), w in zip(models_by_key.values(), share, strict=True)
        ]
        return sorted(models, key=lambda model: -model.weight), log_evidence

    def _model(self, selection: ModelSelection, entry: ModelEntry, fit: ModelFit) -> WeightedModel:
        """The model with what its noise adds to its deviations; not weighed yet."""
        inflated = 1.0
        if not math.isinf(selection.freedom):
            inflation = (selection.freedom + fit.square) / max(
                selection.freedom + selection.free - 2.0, 1.0
            )
            inflated = math.sqrt(max(inflation, 1.0))
        members = entry.members, entry.scales, 0.0
        return WeightedModel(*members, fit.mean, fit.base, fit.sizes, inflated, self.everywhere)

    @cached_property
    def _one_sided(self) -> list[list[int]]:
        """The values of each component that no machine has below 0.

        Beside an effect that the model has already, less of it is possible.
        """
        acting = {
            (instance.effect.id, instance.place)
            for cells in self.sessions
            for instance in cells.case.model.effects
            if isinstance(instance, EffectInstance)
        }
        return [
            [
                value
                for share in component.shares
                for value, parameter in zip(share.values, share.effect.parameters, strict=True)
                if parameter.least == 0.0 and (share.effect.id, share.place) not in acting
            ]
            for component in self.components
        ]

    def _log_possible(self, model: WeightedModel) -> float:
        """Sizes that no machine has below 0 have half a normal as prior, twice as high there."""
        at, log = len(model.base), 0.0
        for k in model.members:
            for place in {at + value for value in self._one_sided[k]}:
                deviation = math.sqrt(float(model.variance_at(slice(place, place + 1))[0]))
                chance = float(ndtr(model.mean[place] / deviation))
                log += math.log(2.0 * max(chance, NEVER))
            at += len(self.components[k].unit)
        return log

    def _index(self, entry: ModelEntry) -> IntArray:
        return np.concatenate([np.zeros(0, np.intp), *(self.index[k] for k in entry.members)])

    def _unit(self, entry: ModelEntry) -> tuple[FloatArray, FloatArray]:
        """Unit and scale ``(r,)`` of each size of a model."""
        units = [self.components[k].unit for k in entry.members]
        scales = [s * np.ones(len(u)) for s, u in zip(entry.scales, units, strict=True)]
        return np.concatenate([np.zeros(0), *units]), np.concatenate([np.zeros(0), *scales])

    def _fitted(self, entry: ModelEntry, products: Products, plain: ModelFit) -> ModelFit:
        """A model by its derivatives alone.

        Of the ``plain`` one ``sizes`` ``(b, k)`` are what each column moves the base by.
        """
        unit, scale = self._unit(entry)
        index = self._index(entry)
        inner = np.eye(len(index)) + scale[:, None] * products.inner[np.ix_(index, index)] * scale
        root = np.linalg.inv(np.linalg.cholesky(inner)).T
        inverse = root @ root.T
        sizes = inverse @ (scale * products.along[index])
        moved = plain.sizes[:, index] * scale
        mean = np.concatenate([plain.mean - moved @ sizes, unit * scale * sizes])
        square = products.square - float(scale * products.along[index] @ sizes)
        room = plain.room + float(np.log(root.diagonal()).sum())
        root_of_model = np.vstack([-moved @ root, (unit * scale)[:, None] * root])
        return ModelFit(mean, plain.base, root_of_model, square, room)

    def _refitted(
        self, entry: ModelEntry, rows: Rows, block: FloatArray, at: FloatArray
    ) -> ModelFit:
        """The fit about a solution; ``block`` ``(n, r)`` is per unit, ``at`` ``(r,)`` in units."""
        unit, scale = self._unit(entry)
        about, white = self._about_of(rows), self._laws.whitened(block * scale)
        columns, along = about.left_by(white), about.basis[: len(white)].T @ white
        basis, root = np.linalg.qr(np.vstack([columns, np.eye(len(scale))]))
        inverse = np.linalg.inv(root)
        target = np.concatenate([about.left, -at / scale])
        sizes = inverse @ (basis.T @ target)
        remainder = without(basis, target)
        mean = self._moved(about, about.along - along @ sizes, about.left - columns @ sizes)
        mean[: len(rows.value)] += rows.value
        moved = self._moved(about, along, columns)
        root_of_model = np.vstack([-moved @ inverse, (unit * scale)[:, None] * inverse])
        room = about.room - float(np.log(np.abs(root.diagonal())).sum())
        values = np.concatenate([mean, unit * (at + scale * sizes)])
        return ModelFit(
            values, self._root(about), root_of_model, float(remainder @ remainder), room
        )

    def _followed(
        self, selection: ModelSelection, entry: ModelEntry, fit: ModelFit, plain_room: float
    ) -> tuple[ModelFit, float]:
        """The fit about the model's own solution, and the log evidence that this gains."""
        evidence_before = selection.log_evidence(
            np.array(fit.square), np.array(fit.room - plain_room)
        )
        try:
            models = self._models(entry, fit.mean)
            beyond = self._residual(models, entry, fit) - self._linear_residual(entry, fit)
            if float(beyond @ beyond) < BEYOND:
                return fit, 0.0
            for _ in range(STEPS):
                fit = self._about(models, entry, fit)
                models = self._models(entry, fit.mean)
        except (NotIdentifiable, UnreachablePosture, ValueError):
            return fit, 0.0
        evidence = selection.log_evidence(np.array(fit.square), np.array(fit.room - plain_room))
        return fit, float(evidence - evidence_before)

    def _values(self, entry: ModelEntry, mean: FloatArray) -> list[FloatArray]:
        """Values of each member."""
        widths = [len(self.components[k].unit) for k in entry.members]
        return np.split(mean[self.base.shape[1] :], np.cumsum(widths))[: len(widths)]

    def _models(self, entry: ModelEntry, mean: FloatArray) -> tuple[Model, ...]:
        """Each session's machine with the parameters and effects of a model."""
        effects = [
            effect
            for k, values in zip(entry.members, self._values(entry, mean), strict=True)
            if (candidate := self.components[k].candidate)
            for effect in candidate.effects(values)
        ]
        models = []
        for number, cells in enumerate(self.sessions):
            nominal = cells.case.model
            offsets = mean[LENGTHS + 3 * number : LENGTHS + 3 * number + 3]
            models.append(
                nominal.with_effects((*nominal.effects, *effects)).with_parameters(
                    np.concatenate([offsets, mean[:LENGTHS]])
                )
            )
        return tuple(models)

    def _linear_part(self, entry: ModelEntry, mean: FloatArray) -> FloatArray:
        """What of these ``(exact,)`` is in no `_models`: a little of all, something else."""
        first = len(self.rows.spread)
        part = self.by_base[:, first:] @ mean[first : self.by_base.shape[1]]
        for k, values in zip(entry.members, self._values(entry, mean), strict=True):
            if not self.components[k].candidate:
                part = part + self.columns[:, self.index[k]] @ (values / self.components[k].unit)
        return np.asarray(part[: self.rows.exact])

    def _residual(self, models: Sequence[Model], entry: ModelEntry, fit: ModelFit) -> FloatArray:
        """What a model leaves of means of cells and of distances ``(exact,)``, whitened."""
        parts = [
            cells.whitened(cells.means.value_mm - model.readings(cells.means))
            for cells, model in zip(self.sessions, models, strict=True)
        ]
        parts += [
            cells.case.distances.residual(model)
            for cells, model in zip(self.sessions, models, strict=True)
            if len(cells.case.distances)
        ]
        return np.concatenate(parts) - self._linear_part(entry, fit.mean)

    def _linear_residual(self, entry: ModelEntry, fit: ModelFit) -> FloatArray:
        """The residual by derivatives alone ``(exact,)``."""
        count, base = self.rows.exact, fit.mean[: self.by_base.shape[1]].copy()
        base[: len(self.rows.value)] -= self.rows.value
        sizes = fit.mean[len(base) :] / self._unit(entry)[0]
        columns = self.columns[:count, self._index(entry)]
        return np.asarray(
            self.rows.residual[:count] - self.by_base[:count] @ base - columns @ sizes
        )

    def _about(self, models: Sequence[Model], entry: ModelEntry, fit: ModelFit) -> ModelFit:
        """One step of Gauss and Newton; readings within cells stay as they were.

        A law that acts twice, the second time from nothing, has the derivatives of the first for
        laws that are linear; the others are few and small (sine of a tilt).
        """
        members = [self.components[k] for k in entry.members]
        near, _, blocks = rows_and_blocks(self.sessions, models, members, within=False)
        block = self.columns[:, self._index(entry)].copy()
        at = np.zeros(block.shape[1])
        residual = self.rows.residual.copy()
        residual[: near.exact] = near.residual
        begin = 0
        for component, columns, values in zip(
            members, blocks, self._values(entry, fit.mean), strict=True
        ):
            end = begin + len(component.unit)
            if component.candidate:
                block[: near.exact, begin:end] = columns * component.unit
                at[begin:end] = values / component.unit
            begin = end
        within = self.rows.exact
        residual[within:] -= block[within:] @ at
        rows = replace(near, residual=residual, spread=self.rows.spread)
        return self._refitted(entry, rows, block, at)


def _fewer(
    selection: ModelSelection, entries: Sequence[ModelEntry], best: ModelEntry
) -> list[ModelEntry]:
    """The best model without each of its components, at each scale that was not followed.

    A component may have stood for what is beyond the derivatives of the others.
    """
    parts = [(*best.key[:k], *best.key[k + 1 :]) for k in range(len(best.key))]
    fewer = {tuple(member for member, _ in part): selection.entry(part) for part in parts}
    members_of_entries = {entry.members for entry in entries}
    light = [entry for entry in entries[REFINED:] if entry.members in fewer]
    return [
        *light,
        *(entry for members, entry in fewer.items() if members not in members_of_entries),
    ]


@dataclass(frozen=True, eq=False)
class ModelFit:
    """Values of a model ``(b + r,)``, a root of their covariance, what is left, and the room.

    ``base`` and ``sizes`` as in `WeightedModel`.
    """

    mean: FloatArray
    base: FloatArray
    sizes: FloatArray
    square: float
    room: float


def _with_common_lengths(models: Sequence[Model]) -> tuple[Model, ...]:
    lengths = np.mean([model.parameters_mm[3:] for model in models], axis=0)
    return tuple(
        model.with_parameters(np.concatenate([model.parameters_mm[:3], lengths]))
        for model in models
    )
