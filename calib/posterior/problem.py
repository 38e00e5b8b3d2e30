"""Sessions about one fit of the base, and every model that counts with its normal.

Every model has the same base: bar lengths that sessions share, joint offsets of each, and a little
of every law everywhere, for no machine is free of any. To that a model adds its components.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from calib.arrays import FloatArray, IntArray, descending, without
from calib.errors import NotIdentifiable, UnreachablePosture
from calib.posterior.apart import Mistake
from calib.posterior.cells import Cells
from calib.posterior.first_takes import WithinPlay, log_priors, reached
from calib.posterior.gaussian import About, LittleOfAll
from calib.posterior.library import ELSE, library
from calib.posterior.library import laws as library_laws
from calib.posterior.models import Posterior, WeightedModel, effects_of_tool
from calib.posterior.readings import (
    LENGTHS,
    Rows,
    free_columns,
    linear_about,
    rows_and_blocks,
)
from calib.posterior.selection import SCALES, ModelEntry, ModelSelection, Products
from calib.posterior.tool import laws_held, tool_field
from calib.tripod.effects.candidates import placed_columns
from calib.tripod.effects.drives import Backlash
from calib.tripod.effects.effect import Effect, EffectInstance, Placed
from calib.tripod.pipeline import Model

NAMED = ("named", "beside")
"""Kinds of components that are effects with a name."""

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
class Way:
    """How sessions may have come about: their cells, its log prior, and mistakes put right.

    ``with_play``: only where a carriage has a play that reaches what stands apart.
    """

    sessions: Sequence[Cells]
    log_prior: float = 0.0
    mistakes: tuple[Mistake, ...] = ()
    with_play: bool = False

    def solved(self, effects: Sequence[Effect]) -> SolvedSessions:
        """What may be true of the sessions: models are weighed, then have a normal each.

        ``effects`` are those of the library. The heaviest models follow the simulation.
        Where none has a play that the way needs, the log evidence is -inf. Raises NotIdentifiable.
        """
        problem = PosteriorProblem(self.sessions, effects)
        models, log_evidence = problem.weighted()
        if self.with_play:
            models, log_share = reached(models, problem.within, problem.components)
            log_evidence += log_share
        case, geometry = problem.sessions[-1].case, problem.sessions[0].case.model.geometry
        acting = ((effect.effect, effect.place) for effect in effects_of_tool(case.model))
        laws = dict.fromkeys([*problem.rows.places, *laws_held(geometry), *acting, *case.geometry])
        posterior = Posterior(
            problem.sessions,
            problem.components,
            tuple(models),
            tool_field(geometry, tuple(laws)),
            problem.linear,
        )
        return SolvedSessions(self, problem, posterior, log_evidence + problem.log_constant)


@dataclass(frozen=True, eq=False)
class SolvedSessions:
    """Sessions that came about in one way, with what may be true of them and its log evidence."""

    way: Way
    problem: PosteriorProblem
    posterior: Posterior
    log_evidence: float

    @property
    def log_weight(self) -> float:
        """Log weight with the priors of the way and of its mistakes."""
        priors = (mistake.log_prior for mistake in self.way.mistakes)
        return self.log_evidence + self.way.log_prior + sum(priors)


class PosteriorProblem:
    """All sessions about one fit of the base: the columns of every component in their rows.

    They are per unit of the components. Every model has a little of those ``everywhere``, laws at
    single places; ``base`` ``(n, b)`` are derivatives by the base, per standard deviation of what
    is expected. First takes stand apart ``within`` a play; components are from the ``selection``.
    """

    def __init__(self, sessions: Sequence[Cells], effects: Sequence[Effect]) -> None:
        """The problem of sessions of one machine: ``effects`` are those of the library."""
        self.sessions, case = tuple(sessions), sessions[-1].case
        models = [cells.model for cells in sessions]
        lengths = np.mean([model.parameters_mm[3:] for model in models], axis=0)
        models = [
            model.with_parameters(np.concatenate([model.parameters_mm[:3], lengths]))
            for model in models
        ]
        measured = [(model, cells.means) for model, cells in zip(models, sessions, strict=True)]
        every_law = library_laws(models[0].geometry, effects)
        placed = [placed_columns(model, means, every_law) for model, means in measured]
        components = library(measured, effects, case.named_beyond, placed)
        self.linear, self.components = linear_about(sessions, models, components, placed)
        self.rows = rows = self.linear.rows
        self.everywhere = tuple(k for k, law in enumerate(self.components) if law.at_one_place)
        self._unit = np.concatenate([component.unit for component in self.components])
        columns, index = self.linear.columns, self.linear.index
        no_law = np.zeros((len(columns), 0))  # one posture shows no law
        laws = [columns[:, index[k]] / self.components[k].unit for k in self.everywhere]
        self._base_root = self._root_of_base()
        self.base = np.hstack([rows.base, no_law, *laws]) @ self._base_root
        self._laws = LittleOfAll(self.base[:, len(rows.spread) :])
        self._plain = self._about(rows)
        self._white = self._laws.whitened(columns)
        self._remainder = self._plain.left_by(self._white)
        self.within = [takes for takes in map(WithinPlay.of, sessions) if takes]
        self._log_usual, log_prior = log_priors(self.within, self.components)
        products = Products.of(self._remainder, self._plain.left)
        noise = rows.free, rows.freedom, rows.excess
        self.selection = ModelSelection(products, index, log_prior, *noise, case.acting)

    def _root_of_base(self) -> FloatArray:
        """Standard deviations of the base ``(b, b)``, of parameters that are off alike a root.

        Of every law everywhere a little of its unit, or that of an adopted effect about its size in
        the model.
        """
        case, at = self.sessions[-1].case, len(self.rows.spread)
        spread, little, places = [self.rows.spread], [np.zeros(at)], dict[Placed, IntArray]()
        for component in self.components:
            if law := component.at_one_place:
                little.append(EVERYWHERE * component.unit)
                places[law] = at + np.arange(len(component.unit))
                at += len(component.unit)
                spread.append(case.free_spread.get(law, little[-1]))
        root = np.diag(np.concatenate(spread))
        numbers = [number for number, law in enumerate(case.lines) if law in places]
        index = [int(places[law][0]) for law in case.lines if law in places]
        root[np.ix_(index, index)] = np.linalg.cholesky(
            (case.lines_root @ case.lines_root.T)[np.ix_(numbers, numbers)]
        )
        for laws in case.of_one_size:  # beside it each has a little of its own, as any law
            alike = [places[law] for law in laws if law in places]
            for place in alike[1:]:
                root[place, alike[0]] = root[place, place]
                root[place, place] = np.concatenate(little)[place]
        return root

    def _about(self, rows: Rows) -> About:
        """Lengths and offsets about rows, where they have derivatives of their own."""
        base_rows = self.base[:, : len(rows.spread)].copy()
        base_rows[: rows.exact] = (rows.base * rows.spread)[: rows.exact]
        expected = (rows.prior - rows.value) / rows.spread
        base_rows, residual = self._laws.whitened(base_rows), self._laws.whitened(rows.residual)
        about = About.of(base_rows, residual, expected, rows.whitening)
        return replace(about, room=about.room + self._laws.room)

    @cached_property
    def entries(self) -> list[ModelEntry]:
        """The models that count, the heaviest first."""
        return self.selection.entries()

    @cached_property
    def log_constant(self) -> float:
        """What log weights of the selection lack to compare with those of other problems."""
        of_way = self._log_of_states() + self.log_of_lines + self._log_usual
        return self.rows.log_constant + of_way

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
        return self._plain.room - self._about(replace(self.rows, whitening=alone)).room

    def _means_of(self, number: int) -> slice:
        """Rows of the means of cells of a session by its number."""
        begin = sum(len(cells.means) for cells in self.sessions[:number])
        return slice(begin, begin + len(self.sessions[number].means))

    def rivals(self, number: int, *, alone: bool) -> list[tuple[float, FloatArray]]:
        """Models that may be true beside a mistake in a session by its number.

        The heaviest, the plain one first, or single names ``alone``: log weights, and columns
        ``(n_cells, r)`` in the session, each of the size that the model expects. Those of adopted
        effects are among them. Something else explains any mistake away.
        """
        ids = [component.id for component in self.components]
        names = (e for e in self.entries if e.members and all(ids[k] != ELSE for k in e.members))
        heaviest = [self.selection.entry(()), *islice(names, MOST_BESIDE)]
        cells, rows, linear = self.sessions[number], self._means_of(number), self.linear
        free = free_columns(self.components, linear.columns, linear.index, cells.case)
        models = []
        for entry in self._single_names() if alone else heaviest:
            index, scale = self.selection.columns_of(entry.key)
            columns = np.hstack([linear.columns[rows][:, index] * scale, free[rows]])
            models.append((entry.log_weight + self.log_constant, cells.coloured(columns)))
        return models

    def _single_names(self) -> list[ModelEntry]:
        """The likeliest names, each alone at its likeliest place; play at every place."""
        log = self.selection.log_weights()
        best = {
            k: (float(log[row, k]), row)
            for k, row in enumerate(np.argmax(log, axis=0).tolist())
            if self.components[k].kind in NAMED
        }
        ordered = descending([*best], lambda k: best[k][0])
        names = {self.components[k].id: k for k in reversed(ordered)}
        likeliest = [k for k in ordered if names[self.components[k].id] == k][:MOST_NAMES]
        plays = [k for k in ordered if self.components[k].id == Backlash.id]
        keys = [((k, SCALES[best[k][1]]),) for k in dict.fromkeys([*likeliest, *plays])]
        return [self.selection.entry(key) for key in keys]

    def with_one_name(self, number: int, change_mm: FloatArray) -> FloatArray:
        """Log weight ``(m,)`` of the best single name where means of a session's cells differ.

        By ``change_mm`` ``(n_cells, m)``.
        """
        rows = np.zeros((len(self.rows.residual), change_mm.shape[1]))
        rows[self._means_of(number)] = self.sessions[number].whitened(change_mm)
        residual = self._plain.left[:, None] + self._plain.left_by(self._laws.whitened(rows))
        names = [k for k, component in enumerate(self.components) if component.kind in NAMED]
        return self.log_constant + self.selection.best_singles(
            self._remainder.T @ residual, (residual**2).sum(axis=0), names
        )

    def weighted(self) -> tuple[list[WeightedModel], float]:
        """The models that count, the heaviest first, and the log evidence of all of them."""
        weighed = {e.key: self._model(e, follow=k < REFINED) for k, e in enumerate(self.entries)}
        best = max(self.entries, key=lambda entry: weighed[entry.key][0])
        if weighed[best.key][1]:
            weighed |= {e.key: self._model(e, follow=True) for e in self._fewer(best)}
        log = np.array([log_weight for log_weight, *_ in weighed.values()])
        share = np.exp(log - log.max())
        log_evidence = float(log.max() + math.log(share.sum()))
        share /= share.sum()
        models = [
            replace(model, weight=float(w))
            for (*_, model), w in zip(weighed.values(), share, strict=True)
        ]
        return sorted(models, key=lambda model: -model.weight), log_evidence

    def _fewer(self, best: ModelEntry) -> list[ModelEntry]:
        """The best model without each of its components, at each scale that was not followed.

        A component may have stood for what is beyond the derivatives of the others.
        """
        parts = [(*best.key[:k], *best.key[k + 1 :]) for k in range(len(best.key))]
        fewer = {entry.members: entry for entry in map(self.selection.entry, parts)}
        members_of_entries = {entry.members for entry in self.entries}
        light = [entry for entry in self.entries[REFINED:] if entry.members in fewer]
        return [
            *light,
            *(entry for members, entry in fewer.items() if members not in members_of_entries),
        ]

    def _model(self, entry: ModelEntry, *, follow: bool) -> tuple[float, float, WeightedModel]:
        """Log weight of a model, what it gained where it was followed, and its normal.

        What the noise adds to its deviations is in it. Sizes that no machine has below 0 have half
        a normal as prior, twice as high there.
        """
        fit, gained = self._fitted(entry), 0.0
        if follow and entry.members:
            fit, gained = self._followed(entry, fit)
        inflated, selection = 1.0, self.selection
        if not math.isinf(selection.freedom):
            freedom = max(selection.freedom + selection.free - 2.0, 1.0)
            inflated = math.sqrt(max((selection.freedom + fit.square) / freedom, 1.0))
        index, _ = selection.columns_of(entry.key)
        at = len(fit.base) + np.flatnonzero(self._one_sided[index])
        deviation = inflated * np.sqrt((fit.sizes[at] ** 2).sum(axis=1))
        possible = 2.0 * np.maximum(ndtr(fit.mean[at] / deviation), NEVER)
        log_weight = entry.log_weight + gained + float(np.log(possible).sum())
        normal = fit.mean, fit.base, fit.sizes, inflated
        return log_weight, gained, WeightedModel(entry.key, 0.0, *normal, self.everywhere)

    @cached_property
    def _one_sided(self) -> NDArray[np.bool_]:
        """Whether no machine has the value of a column below 0 ``(k,)``.

        Beside an effect that the model has already, less of it is possible.
        """
        acting = {
            (instance.effect.id, instance.place)
            for cells in self.sessions
            for instance in cells.case.model.effects
            if isinstance(instance, EffectInstance)
        }
        one_sided = np.zeros(len(self._unit), dtype=bool)
        for component, index in zip(self.components, self.linear.index, strict=True):
            for share in component.shares:
                if (share.effect.id, share.place) not in acting:
                    least = [parameter.least == 0.0 for parameter in share.effect.parameters]
                    one_sided[index[[*share.values]]] |= least
        return one_sided

    def _root(self, about: About) -> FloatArray:
        """A root ``(b, b)`` of the covariance of the base; what laws do follows from the others."""
        laws, count = self._laws, len(self.rows.residual)
        projected = -laws.seen.T @ (about.basis[:count])
        zeros = np.zeros((len(about.inverse), len(laws.root)))
        root = np.block([[about.inverse, zeros], [projected, laws.root]])
        return np.asarray(self._base_root @ root)

    def _moved(self, about: About, along: FloatArray, remainder: FloatArray) -> FloatArray:
        """Values of the base ``(b, ...)`` for rows ``along`` the basis and those it has left."""
        laws = self._laws.seen.T @ remainder[: len(self.rows.residual)]
        return np.asarray(self._base_root @ np.concatenate([about.inverse @ along, laws]))

    @cached_property
    def _plain_fit(self) -> ModelFit:
        """The base alone; its ``sizes`` ``(b, k)`` are what each column moves it by."""
        about = self._plain
        along = about.basis[: len(self._white)].T @ self._white
        mean = self._moved(about, about.along, about.left)
        mean[: len(self.rows.value)] += self.rows.value
        moved = self._moved(about, along, self._remainder)
        return ModelFit(mean, self._root(about), moved, self.selection.products.square, about.room)

    def _fitted(self, entry: ModelEntry) -> ModelFit:
        """A model by its derivatives alone."""
        (index, scale), products = self.selection.columns_of(entry.key), self.selection.products
        plain, unit = self._plain_fit, self._unit[index] * scale
        inner = np.eye(len(index)) + scale[:, None] * products.inner[np.ix_(index, index)] * scale
        root = np.linalg.inv(np.linalg.cholesky(inner)).T
        inverse = root @ root.T
        sizes = inverse @ (scale * products.along[index])
        moved = plain.sizes[:, index] * scale
        mean = np.concatenate([plain.mean - moved @ sizes, unit * sizes])
        square = products.square - float(scale * products.along[index] @ sizes)
        room = plain.room + float(np.log(root.diagonal()).sum())
        root_of_model = np.vstack([-moved @ root, unit[:, None] * root])
        return ModelFit(mean, plain.base, root_of_model, square, room)

    def _followed(self, entry: ModelEntry, fit: ModelFit) -> tuple[ModelFit, float]:
        """The fit about the model's own solution, and the log evidence that this gains."""
        linear = fit
        try:
            models = self._models(entry, fit.mean)
            beyond = self._beyond(models, entry, fit.mean)
            if float(beyond @ beyond) < BEYOND:
                return fit, 0.0
            for _ in range(STEPS):
                fit = self._refitted(models, entry, fit.mean)
                models = self._models(entry, fit.mean)
        except (NotIdentifiable, UnreachablePosture, ValueError):
            return fit, 0.0
        fits = [(fit.square, fit.room), (linear.square, linear.room)]
        evidence = self.selection.log_evidence(*np.array(fits).T)
        return fit, float(evidence[0] - evidence[1])

    def _values(self, entry: ModelEntry, mean: FloatArray) -> list[FloatArray]:
        """Values of each member."""
        ends = np.cumsum([len(self.linear.index[k]) for k in entry.members])
        return np.split(mean[len(self._base_root) :], ends[:-1])

    def _models(self, entry: ModelEntry, mean: FloatArray) -> list[Model]:
        """Each session's machine with the parameters and effects of a model."""
        values_of_members = zip(entry.members, self._values(entry, mean), strict=True)
        effects = [e for k, values in values_of_members for e in self.components[k].effects(values)]
        models = []
        for number, cells in enumerate(self.sessions):
            nominal = cells.case.model
            offsets = mean[LENGTHS + 3 * number : LENGTHS + 3 * number + 3]
            acting = nominal.with_effects((*nominal.effects, *effects))
            models.append(acting.with_parameters(np.concatenate([offsets, mean[:LENGTHS]])))
        return models

    def _beyond(self, models: Sequence[Model], entry: ModelEntry, mean: FloatArray) -> FloatArray:
        """What simulations of a model leave less what its derivatives do ``(exact,)``, whitened.

        Of means of cells and of distances. A little of all and something else are in neither.
        """
        sessions, rows = [*zip(self.sessions, models, strict=True)], self.rows
        simulated = [
            cells.whitened(cells.means.value_mm - model.readings(cells.means))
            for cells, model in sessions
        ]
        simulated += [
            cells.case.distances.residual(model)
            for cells, model in sessions
            if len(cells.case.distances)
        ]
        linear = rows.residual - rows.base @ (mean[: len(rows.value)] - rows.value)
        for k, values in zip(entry.members, self._values(entry, mean), strict=True):
            if self.components[k].candidate:
                linear -= self.linear.columns[:, self.linear.index[k]] @ (
                    values / self.components[k].unit
                )
        return np.concatenate(simulated) - linear[: rows.exact]

    def _refitted(self, models: Sequence[Model], entry: ModelEntry, mean: FloatArray) -> ModelFit:
        """One step of Gauss and Newton; readings within cells stay as they were.

        A law that acts twice, the second time from nothing, has the derivatives of the first for
        laws that are linear; the others are few and small (sine of a tilt).
        """
        members = [self.components[k] for k in entry.members]
        near, blocks = rows_and_blocks(self.sessions, models, members, within=False)
        index, scale = self.selection.columns_of(entry.key)
        unit, exact = self._unit[index], self.rows.exact
        block, at, begin = self.linear.columns[:, index], np.zeros(len(index)), 0
        values_of_members = self._values(entry, mean)
        for component, columns, values in zip(members, blocks, values_of_members, strict=True):
            places = slice(begin, begin + len(values))
            begin = places.stop
            if component.candidate:
                block[:exact, places] = columns * component.unit
                at[places] = values / component.unit
        residual = np.concatenate([near.residual, self.rows.residual[exact:] - block[exact:] @ at])
        rows = replace(near, residual=residual, spread=self.rows.spread)
        about, white = self._about(rows), self._laws.whitened(block * scale)
        columns, along = about.left_by(white), about.basis[: len(white)].T @ white
        basis, root = np.linalg.qr(np.vstack([columns, np.eye(len(scale))]))
        inverse = np.linalg.inv(root)
        target = np.concatenate([about.left, -at / scale])
        sizes, remainder = inverse @ (basis.T @ target), without(basis, target)
        mean = self._moved(about, about.along - along @ sizes, about.left - columns @ sizes)
        mean[: len(rows.value)] += rows.value
        moved = self._moved(about, along, columns)
        root_of_model = np.vstack([-moved @ inverse, (unit * scale)[:, None] * inverse])
        room = about.room - float(np.log(np.abs(root.diagonal())).sum())
        values = np.concatenate([mean, unit * (at + scale * sizes)])
        square = float(remainder @ remainder)
        return ModelFit(values, self._root(about), root_of_model, square, room)


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
