"""What readings tell of a machine: weighted models, each a normal about its own fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise, starmap

import numpy as np

from calib.arrays import BLIND, FloatArray
from calib.posterior.apart import Mistake
from calib.posterior.cells import Cells
from calib.posterior.library import OTHER_BARS, Component
from calib.posterior.readings import LENGTHS, LinearSessions
from calib.posterior.selection import Key
from calib.posterior.statements import NOTHING, Statement
from calib.posterior.tool import FRAMES, RIGID, Frame, ToolField
from calib.posterior.tool_errors import InField, ToolErrors
from calib.stats import mixture_moments
from calib.tripod.effects.drives import AxisOffset
from calib.tripod.effects.effect import PER_THOUSAND, EffectInstance, Placed
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import MOVES_THE_TOOL, Model


@dataclass(frozen=True, eq=False)
class WeightedModel:
    """One model: components with their scales, weight, and the normal of its values ``(b + r,)``.

    A root of their covariance is ``base`` ``(b, b)``, which many models share, beside ``sizes``
    ``(b + r, r)``, both times ``inflated``. The base ends with sizes of the components
    ``everywhere``; ``mistakes`` of labels and readings were put right. Of the machine so much is
    ``as_stated`` as its file has it.
    """

    key: Key
    weight: float
    mean: FloatArray
    base: FloatArray
    sizes: FloatArray
    inflated: float
    everywhere: tuple[int, ...]
    mistakes: tuple[Mistake, ...] = ()
    as_stated: Statement = NOTHING

    @property
    def members(self) -> tuple[int, ...]:
        """The components of the model, beside those that every model has everywhere."""
        return tuple(k for k, _ in self.key)

    def places(self, components: Sequence[Component]) -> dict[int, slice]:
        """Where among the values those of each member are: the base comes first."""
        ends = accumulate((len(components[k].unit) for k, _ in self.key), initial=len(self.base))
        return dict(zip(self.members, starmap(slice, pairwise(ends)), strict=True))

    def variance_at(self, places: slice) -> FloatArray:
        """Variances of the values at these places, ``(m,)``."""
        squares = (self.sizes[places] ** 2).sum(axis=1)
        of_base = (self.base[places] ** 2).sum(axis=1)
        squares[: len(of_base)] += of_base
        return np.asarray(self.inflated**2 * squares)

    def variance_of(self, rows: FloatArray) -> FloatArray:
        """Variances ``(m,)`` of combinations ``(m, b + r)`` of the values."""
        roots = rows @ self.sizes, rows[:, : len(self.base)] @ self.base
        return np.asarray(self.inflated**2 * sum((root**2).sum(axis=1) for root in roots))

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the values ``(b + r, b + r)``."""
        covariance = self.sizes @ self.sizes.T
        count = len(self.base)
        covariance[:count, :count] += self.base @ self.base.T
        return np.asarray(self.inflated**2 * covariance)


@dataclass(frozen=True)
class LikelyMistake:
    """A mistake of labels or readings with its probability."""

    id: str
    where: str
    title: str
    probability: float


@dataclass(frozen=True, eq=False, repr=False)
class Posterior:
    """What readings tell of the machine.

    Values of the base are lengths, offsets of each session, then a little of every law. Sessions
    are as the likeliest mistakes put right leave them; ``linear`` has their components, which are
    the first.
    """

    sessions: tuple[Cells, ...]
    components: tuple[Component, ...]
    models: tuple[WeightedModel, ...]
    field: ToolField
    linear: LinearSessions

    @property
    def geometry(self) -> Geometry:
        """The nominal machine."""
        return self.sessions[0].case.model.geometry

    @property
    def parameter_count(self) -> int:
        """Lengths, and offsets of every session."""
        return LENGTHS + 3 * len(self.sessions)

    def placed(self, model: WeightedModel) -> list[tuple[int, int]]:
        """All components of a model, those everywhere first, and where the values of each begin."""
        numbers = *model.everywhere, *model.members
        ends = np.cumsum([self.parameter_count, *(len(self.components[k].unit) for k in numbers)])
        return list(zip(numbers, ends.tolist(), strict=False))

    @cached_property
    def models_in_field(self) -> list[InField]:
        """Every model in the tool's field; joint offsets are those of the last session."""
        parameters = np.zeros((self.field.rows.shape[1], self.parameter_count))
        parameters[3:6, :LENGTHS] = np.eye(3)
        parameters[:3, -3:] = np.eye(3)
        of_everywhere: dict[tuple[int, ...], tuple[FloatArray, FloatArray]] = {}
        shared: dict[int, tuple[FloatArray, FloatArray]] = {}
        models = []
        for model in self.models:
            if model.everywhere not in of_everywhere:
                laws = (self.into_field[k] for k in model.everywhere)
                unstated = self._of_tolerances(model.everywhere)
                of_everywhere[model.everywhere] = np.hstack([parameters, *laws]), unstated
            base, unstated = of_everywhere[model.everywhere]
            if id(model.base) not in shared:
                moved = base @ model.base
                shared[id(model.base)] = moved @ moved.T, moved
            count, unplaced_mm2 = base.shape[1], 0.0
            mean = self.start + base @ model.mean[:count]
            root = base @ model.sizes[:count]
            for k, places in model.places(self.components).items():
                mean = mean + self.into_field[k] @ model.mean[places]
                root = root + self.into_field[k] @ model.sizes[places]
                if (squares := self.components[k].squares) is not None:
                    moments_mm2 = model.mean[places] ** 2 + model.variance_at(places)
                    unplaced_mm2 += float(squares @ moments_mm2)
            root, shared_base = model.inflated * root, shared[id(model.base)]
            in_field = InField(model.weight, mean, *shared_base, model.inflated, root, unplaced_mm2)
            unseen = np.diag(self._unseen(model, in_field, unstated))
            models.append(replace(in_field, root=np.hstack([root, unseen[:, unseen.any(axis=0)]])))
        return models

    @cached_property
    def tool_errors(self) -> dict[Frame, ToolErrors]:
        """Tool errors of all models, in each frame."""
        metrics = self.field.metrics
        return {frame: ToolErrors(self.models_in_field, metrics[frame]) for frame in FRAMES}

    @cached_property
    def start(self) -> FloatArray:
        """Effects ``(f,)`` that the model of the sessions has, in the tool's field."""
        start = np.zeros(self.field.rows.shape[1])
        for instance in effects_of_tool(self.sessions[-1].case.model):
            start[self.field.columns[instance.effect, instance.place]] += np.real(instance.values)
        return start

    @cached_property
    def into_field(self) -> list[FloatArray]:
        """For each component what its values ``(r,)`` are in the tool's field ``(f, r)``.

        The machine has the bars of the last session, as it has its joint offsets.
        """
        last = f"session {len(self.sessions)}"
        width = self.field.rows.shape[1]
        blocks = []
        for component in self.components:
            into = np.zeros((width, len(component.unit)))
            for share in component.shares:
                for column, value in zip(
                    self.field.columns[share.effect, share.place], share.values, strict=True
                ):
                    into[column, value] += 1.0
            if (component.id, component.where) == (OTHER_BARS, last):
                into[LENGTHS : 2 * LENGTHS] = np.eye(LENGTHS)
            blocks.append(into)
        return blocks

    @cached_property
    def mean(self) -> FloatArray:
        """What is expected over all models ``(f,)``, in the tool's field."""
        return np.asarray(
            np.sum([model.weight * model.mean for model in self.models_in_field], axis=0)
        )

    @property
    def likeliest_labels(self) -> Posterior:
        """The models with the likeliest labels of the readings alone.

        Two ways to put labels right are two machines, and their mean is neither.
        """
        return self._likeliest_labels or self

    @cached_property
    def _likeliest_labels(self) -> Posterior | None:
        """The posterior by the likeliest labels; None where it is this one (no cycle of
        references).
        """
        labels = [
            frozenset((m.session, m.id, m.where) for m in model.mistakes if m.relabels)
            for model in self.models
        ]
        shares = dict.fromkeys(labels, 0.0)
        for key, model in zip(labels, self.models, strict=True):
            shares[key] += model.weight
        likeliest = max(shares, key=shares.__getitem__)
        return self._of_models([key == likeliest for key in labels])

    @property
    def for_bounds(self) -> Posterior:
        """The models that a bound rests on: not those where only what firmware fits is off.

        A bowed plate looks like a wrong radius: that firmware's factors explain the readings makes
        them likelier values, and is no reason to bound all other parts by what the file states.
        """
        return self._for_bounds or self

    @cached_property
    def _for_bounds(self) -> Posterior | None:
        return self._of_models([not model.as_stated.of_firmware for model in self.models])

    def _of_models(self, mask: Sequence[bool]) -> Posterior | None:
        """The posterior of some of its models; None where that is all of them, or none."""
        if len(set(mask)) == 1:
            return None
        models = [model for model, is_kept in zip(self.models, mask, strict=True) if is_kept]
        total = math.fsum(model.weight for model in models)
        return replace(self, models=tuple(replace(m, weight=m.weight / total) for m in models))

    def mean_of(
        self, selected: Callable[[WeightedModel], FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Combinations ``(m,)`` of the values over all models, and their standard deviations.

        ``selected`` gives the combinations ``(m, b + r)`` of each model.
        """
        weight = np.array([model.weight for model in self.models])
        pairs = [(model, selected(model)) for model in self.models]
        means = np.array([row @ model.mean for model, row in pairs])
        variances = np.array([model.variance_of(row) for model, row in pairs])
        return mixture_moments(weight, means, variances)

    def size_of(self, laws: Sequence[Placed]) -> tuple[FloatArray, FloatArray]:
        """Sizes ``(p,)`` of one law as its places share them, by how much the model's are off.

        With their standard deviations. The model is that of the sessions; laws of readings have
        sizes, too.
        """
        count = len(laws[0][0].parameters)

        def selected(model: WeightedModel) -> FloatArray:
            row = np.zeros((count, len(model.mean)))
            for k, at in self.placed(model):
                for share in self.components[k].shares:
                    if (share.effect, share.place) in laws:
                        row[range(count), [at + value for value in share.values]] += 1.0
            return row / len(laws)

        return self.mean_of(selected)

    def offset_change(self, number: int) -> tuple[FloatArray, FloatArray]:
        """By how much joint offsets ``(3,)`` of a session differ from those of the one before.

        With their standard deviations, mm.
        """
        at = LENGTHS + 3 * number

        def selected(model: WeightedModel) -> FloatArray:
            row = np.zeros((3, len(model.mean)))
            row[:, at : at + 3], row[:, at - 3 : at] = np.eye(3), -np.eye(3)
            return row

        return self.mean_of(selected)

    def value_of(self, law: Placed) -> tuple[float, float]:
        """The first value of a law at a place over all models, and its standard deviation."""
        at = self.field.columns[law][0]
        means = np.array([model.mean[at] for model in self.models_in_field])
        variance = np.array([model.variance(at) for model in self.models_in_field])
        weight = np.array([model.weight for model in self.models_in_field])
        mean, deviation = mixture_moments(weight, means, variance)
        return float(mean), float(deviation)

    def _unseen(self, model: WeightedModel, in_field: InField, unstated: FloatArray) -> FloatArray:
        """Standard deviations ``(f,)`` of what these readings do not show.

        Parameters of lines that change none of them have their tolerance, ``unstated`` ``(f,)``; so
        have shifts and turns of the whole machine.
        Of two axes that lean readings show the sum, of two that miss each other the distance. The
        rest turns or shifts the machine as a whole; it is taken to be as large, r.m.s.
        """
        deviation = unstated.copy()
        if not self.geometry.common_zero:  # readings are of the tool, in the frame of its plate
            if AxisOffset.id in model.as_stated.free:
                deviation[-3:] = np.hypot(deviation[-3:], self._turn_of_drives)
            return deviation
        acting = [(e.effect, e.place) for e in effects_of_tool(self.sessions[-1].case.model)]
        shares = (share for k in model.members for share in self.components[k].shares)
        leans: dict[str, list[Placed]] = {}
        for law in dict.fromkeys([*acting, *((share.effect, share.place) for share in shares)]):
            if law in self._turns:
                leans.setdefault(law[0].id, []).append(law)
        for laws in leans.values():
            columns = [self.field.columns[law][0] for law in laws]
            squares = [in_field.mean[at] ** 2 + in_field.variance(at) for at in columns]
            for turn, unit in map(self._turns.__getitem__, laws):
                size = unit * math.sqrt(math.fsum(squares) / len(squares))
                deviation[turn] = math.hypot(deviation[turn], size)
        return deviation

    @cached_property
    def _turn_of_drives(self) -> FloatArray:
        """Standard deviations ``(3,)`` of a turn about each axis, rad, that no contact shows.

        Parallel drives are fitted as they stand about the last one. All three are turned by the
        mean of what each is off round the plate, as far as tolerances go: where places are a guess
        the frame of the firmware is that of its last tower all the same, and a turn bends no part.
        """
        geometry, tolerances = self.geometry, self.sessions[-1].case.geometry
        if not geometry.parallel:
            return np.zeros(3)
        across_mm = [mm for (law, _), mm in tolerances.items() if law.id == AxisOffset.id]
        mean_mm = max(across_mm, default=0.0) / math.sqrt(len(geometry.anchors))
        along = geometry.directions[-1]
        radius_mm = np.linalg.norm(np.cross(along, geometry.anchors), axis=1).mean()
        return np.asarray(np.abs(along) * mean_mm / radius_mm)

    def _of_tolerances(self, everywhere: tuple[int, ...]) -> FloatArray:
        """What tolerances alone leave unseen ``(f,)`` beside the components that a base has."""
        deviation = np.zeros(self.field.rows.shape[1])
        tolerances = self.sessions[-1].case.geometry
        shares = (share for k in everywhere for share in self.components[k].shares)
        for unseen in tolerances.keys() - {(share.effect, share.place) for share in shares}:
            deviation[self.field.columns[unseen][0]] = tolerances[unseen]
        if self.geometry.common_zero:
            for law in tolerances.keys() & self._turns.keys():
                turn, unit = self._turns[law]
                deviation[turn] = math.hypot(deviation[turn], unit * tolerances[law])
        return deviation

    @cached_property
    def _turns(self) -> dict[Placed, tuple[int, float]]:
        """Laws of the field beside which a turn, or shift, of the whole machine may hide.

        Its column, from the end of the field, and unit: about, or along, the axis that is neither
        of the two at the place of the law. Laws of one id are as large as each other, r.m.s.
        """
        firsts = {"axis_squareness": (-3, PER_THOUSAND), "axis_offset": (-RIGID, 1.0)}
        turns = {}
        for law, place in self.field.columns:
            if law.id in firsts:
                first, unit = firsts[law.id]
                (third,) = {0, 1, 2} - {"xyz".index(name) for name in place[:2]}
                turns[law, place] = first + third, unit
        return turns

    @cached_property
    def distances_left(self) -> FloatArray:
        """Each distance less what the likeliest model expects of it by all else ``(n,)``.

        In standard deviations of that difference. What is left of a fit to all hides a wrong one:
        something else follows it.
        """
        model = self.models[0]
        rows, count = self.linear.rows, self.parameter_count
        places = slice(rows.cells, rows.exact)
        design = np.zeros((rows.exact - rows.cells, len(model.mean)))
        design[:, :count] = rows.base[places]
        for k, at in self.placed(model):
            unit = self.components[k].unit
            columns = self.linear.columns[places][:, self.linear.index[k]]
            design[:, at : at + len(unit)] = columns / unit
        values = model.mean.copy()
        values[:count] -= rows.value
        fitted = model.variance_of(design) / model.inflated**2
        return np.asarray(
            (rows.residual[places] - design @ values) / np.sqrt(np.maximum(1.0 - fitted, BLIND))
        )

    @property
    def likely_mistakes(self) -> tuple[LikelyMistake, ...]:
        """Each mistake with its words and probability, the likeliest first."""
        title = {
            (mistake.id, mistake.where): mistake.title
            for model in self.models
            for mistake in model.mistakes
        }
        return tuple(
            LikelyMistake(*name, title[name], share) for name, share in self.mistakes.items()
        )

    @property
    def mistakes(self) -> dict[tuple[str, str], float]:
        """Probability of each mistake of labels or readings, and its place."""
        return self._shares(lambda model: ((m.id, m.where) for m in model.mistakes))

    @property
    def places(self) -> dict[tuple[str, str], float]:
        """Probability of each id and place."""
        components = self.components
        return self._shares(lambda m: ((components[k].id, components[k].where) for k in m.members))

    def _shares(
        self, names_of: Callable[[WeightedModel], Iterable[tuple[str, str]]]
    ) -> dict[tuple[str, str], float]:
        """Weight of the models that have each name, the likeliest first."""
        shares: dict[tuple[str, str], float] = {}
        for model in self.models:
            for name in {*names_of(model)}:
                shares[name] = shares.get(name, 0.0) + model.weight
        return dict(sorted(shares.items(), key=lambda item: -item[1]))


def effects_of_tool(model: Model) -> list[EffectInstance]:
    """Effects of a model that move the tool."""
    return [
        effect
        for effect in model.effects
        if isinstance(effect, EffectInstance) and effect.stage in MOVES_THE_TOOL
    ]
