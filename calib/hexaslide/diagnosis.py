"""What is missing in a Hexa Slide's model: its own causes as columns, weighed together.

About the calibrated machine the readings are linear: parameters with their tolerances are the base,
each cause adds a few columns (`causes`). `calib.posterior.selection` weighs models of up to three.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from calib.arrays import FloatArray, IntArray, without
from calib.diagnosis.thresholds import AGREED, OPEN, SURE
from calib.errors import NotIdentifiable
from calib.hexaslide.calibration import Calibration, SeenDirections, calibrate
from calib.hexaslide.causes import (
    MISTAKE,
    AdoptedEffect,
    HexaSlideCause,
    causes_of_machine,
    mistake_at,
    mistakes_of,
    with_effects,
)
from calib.hexaslide.derivatives import jacobian
from calib.hexaslide.expectation import UNKNOWN
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.procedures import Procedure, ProcedureKind
from calib.hexaslide.residuals import Readings, postures_of, residuals
from calib.posterior.gaussian import About
from calib.posterior.selection import ADOPTED, LIGHTEST, ModelEntry, ModelSelection, Products
from calib.quantity import Quantity
from calib.stats import UNLIKELY, mixture_moments, variance_ratio_p_value

FEWEST_SPARE = 8
"""Readings beyond the parameters that they determine: fewer tell no cause from another."""

SETTLED = 1.01
"""Below this mean square of what is left, noise that was not stated is as large as that."""

MOST_LARGER = 20
"""Steps to such a noise, each to what the one before leaves."""

FAINTEST = 1e-6
"""Models of more weight count in claims: the thousands between this and `LIGHTEST` have 1 or 2 %
together, and a small cause is often among them."""

Names = tuple[tuple[str, str], ...]
"""Ids of causes with their places, sorted."""

Verdict = Literal["agrees", "explained", "ambiguous", "unexplained", "cannot-tell"]


@dataclass(frozen=True)
class CauseSize:
    """A value of what is named, else of the heaviest claim, in its unit."""

    name: Annotated[str, Quantity("value", words="which value of the cause it is")]
    value: Annotated[float, Quantity("size", kind="measured", words="how large it is, in its unit")]
    standard_uncertainty: Annotated[
        float,
        Quantity(
            "standard uncertainty", kind="uncertainty", words="standard uncertainty of the size"
        ),
    ]
    unit: Annotated[str, Quantity("unit", words="unit of both")]


@dataclass(frozen=True)
class HexaSlideClaim:
    """Causes that may be missing together, none: nothing; and the weight of that."""

    causes: Names
    weight: float


@dataclass(frozen=True, eq=False)
class HexaSlideDiagnosis:
    """The verdict; what is ``named``, each with the weight of all models that have it; what may be
    true with its weight, the heaviest first, 99 % of all. Of what is named, else of the heaviest,
    the sizes, and what it does at the platform that no parameter takes over, metres r.m.s.

    ``gap_before`` and ``gap_after`` are mean squares of what is left in noise variances, with
    p-values; ``unidentifiable`` are motions that no reading shows; ``wrong_postures`` are numbers
    of those that are named as mistakes.
    """

    verdict: Verdict
    named: tuple[HexaSlideClaim, ...]
    claims: tuple[HexaSlideClaim, ...]
    sizes: tuple[CauseSize, ...]
    platform_m: float
    gap_before: float
    p_before: float
    gap_after: float
    p_after: float
    spare: int
    unidentifiable: tuple[str, ...]
    wrong_postures: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class WeighedCauses:
    """Models of what may be missing, weighed: ``entries`` the heaviest first, none where too few
    readings are ``spare``. ``weights_of_names`` are those of every set of causes, lighter models
    with them, the heaviest first, together 1.

    ``base`` ``(n, k)`` are derivatives by the parameters in ``tolerances`` ``(k,)``, ``whitened``
    ``(n,)`` what the ``calibration`` machine leaves, both in the noise. Its ``directions`` are what
    parameters can do. ``expected`` ``(k,)`` is the machine file, by the calibrated one in
    tolerances.

    Effects that are ``adopted`` are in all of this at the sizes that they have in their model,
    ``stated`` ``(c,)`` in unremarkable sizes for the columns of all causes. ``free`` tells of each
    entry what such sizes differ by, and is a part of all of them.

    Where no model explains what is left of the stated noise, or a larger noise does it better,
    ``readings`` have one that is as large as that, ``noise_times`` the stated one: false causes
    would else explain it.
    """

    readings: Readings
    calibration: Calibration
    tolerances: FloatArray
    lead_m: float | None
    middle: FloatArray
    expected: FloatArray
    base: FloatArray
    whitened: FloatArray
    directions: SeenDirections
    causes: tuple[HexaSlideCause, ...]
    selection: ModelSelection
    entries: tuple[ModelEntry, ...]
    weights_of_names: Mapping[Names, float]
    adopted: tuple[AdoptedEffect, ...]
    stated: FloatArray
    free: ModelEntry
    noise_times: float = 1.0

    @property
    def spare(self) -> int:
        """Readings beyond the parameters and adopted sizes that they determine; none where
        parameters take up all different postures, for readings of the same tell noise alone.
        """
        rank = len(self.directions.singular)
        if self.readings.different * len(self.readings.procedure.read) <= rank:
            return 0
        return len(self.whitened) - rank - len(self.index(self.free))

    @property
    def weights(self) -> FloatArray:
        """Weights of the entries, together 1; none without any."""
        return _weights(self.entries)

    @property
    def log_evidence(self) -> float:
        """Log evidence of all entries together."""
        return float(np.logaddexp.reduce([entry.log_weight for entry in self.entries]))

    def index(self, entry: ModelEntry) -> IntArray:
        """Which of all columns of causes are a model's ``(r,)``."""
        return self.selection.columns_of(entry.key)[0]

    def columns(self, entry: ModelEntry) -> FloatArray:
        """What a model's values do to the readings ``(n, r)``."""
        of_members = (self.causes[k].columns for k in entry.members)
        return np.hstack([np.zeros((len(self.base), 0)), *of_members])

    def values(self, entry: ModelEntry) -> tuple[FloatArray, FloatArray]:
        """Mean ``(r,)`` and covariance ``(r, r)`` of a model's values, in unremarkable sizes; of
        adopted effects what they differ by from ``stated``.
        """
        index, scale = self.selection.columns_of(entry.key)
        inner = self.selection.products.inner[np.ix_(index, index)] + np.diag(scale**-2.0)
        covariance = np.asarray(np.linalg.inv(inner), dtype=np.float64)
        return np.asarray(covariance @ self.selection.products.along[index]), covariance

    def mean_square(self, entry: ModelEntry) -> tuple[float, float]:
        """What parameters and a model leave, in variances of the stated noise, and its p-value; 0
        and 1 where nothing is over.
        """
        if self.spare < 1:
            return 0.0, 1.0
        remainder = self.whitened - self.columns(entry) @ self.values(entry)[0]
        remainder = without(self.directions.left, self.noise_times * remainder)
        ratio = float(remainder @ remainder) / self.spare
        return ratio, variance_ratio_p_value(ratio, self.spare, np.inf)

    @property
    def excess(self) -> float:
        """Variance of what the heaviest model leaves by that of `readings`, at least 1."""
        return max(1.0, self.mean_square(self.entries[0])[0] / self.noise_times**2)

    def names(self, entry: ModelEntry) -> Names:
        """What a model has beside adopted effects."""
        members = (self.causes[k] for k in entry.members if k not in self.free.members)
        return tuple(sorted({(cause.id, cause.where) for cause in members}))

    @property
    def given_way(self) -> FloatArray:
        """By how much parameters in tolerances give way ``(k, c)`` to the columns of all causes."""
        columns = np.hstack([cause.columns for cause in self.causes])
        return np.asarray(-self.directions.inverse @ (self.directions.left.T @ columns))

    def mixture(self) -> tuple[FloatArray, FloatArray]:
        """Mean ``(c,)`` of all columns of causes over the models, and covariance ``(c, c)``."""
        mean, square = np.zeros(len(self.stated)), np.zeros((len(self.stated),) * 2)
        for entry, weight in zip(self.entries, self.weights.tolist(), strict=True):
            index, (values, covariance) = self.index(entry), self.values(entry)
            mean[index] += weight * values
            square[np.ix_(index, index)] += weight * (covariance + np.outer(values, values))
        return mean + self.stated, square - np.outer(mean, mean)

    def likely(self) -> dict[tuple[str, str], float]:
        """Causes with the weight of all models that have them, the likeliest first."""
        likely: dict[tuple[str, str], float] = {}
        for names, weight in self.weights_of_names.items():
            for name in names:
                likely[name] = likely.get(name, 0.0) + weight
        return dict(sorted(likely.items(), key=lambda item: (-item[1], item[0])))

    def given(self, names: Names) -> WeighedCauses:
        """Only models that have these names, perhaps none."""
        fitting = (entry for entry in self.entries if {*names} <= {*self.names(entry)})
        return replace(self, entries=tuple(fitting))

    def sizes_of(self, names: Names) -> tuple[AdoptedEffect, ...]:
        """Causes that all entries have, with their sizes as all of them weigh these."""
        effects, weights = [], self.weights
        values_of = [
            {(cause.id, cause.where): values for cause, *values in self.by_cause(entry)}
            for entry in self.entries
        ]
        for name in names:
            cause = next(cause for cause in self.causes if (cause.id, cause.where) == name)
            means, variances = np.moveaxis(np.array([values[name] for values in values_of]), 1, 0)
            moments = mixture_moments(weights, means, variances)
            sizes = ((cause.size * part).tolist() for part in moments)
            values, uncertainties = (tuple(part) for part in sizes)
            effects.append(AdoptedEffect(*name, values, deviations=uncertainties))
        return tuple(effects)

    def resized(self) -> tuple[AdoptedEffect, ...]:
        """Adopted effects with sizes that these readings, too, have been asked for."""
        if not self.entries:
            return self.adopted
        loose = tuple((effect.id, effect.where) for effect in self.adopted if not effect.held)
        sizes = {(effect.id, effect.where): effect for effect in self.sizes_of(loose)}
        return tuple(sizes.get((effect.id, effect.where), effect) for effect in self.adopted)

    def by_cause(
        self, entry: ModelEntry
    ) -> Iterator[tuple[HexaSlideCause, FloatArray, FloatArray]]:
        """The causes of a model, each with whole sizes and their variances ``(r,)``."""
        mean, covariance = self.values(entry)
        mean, variance = mean + self.stated[self.index(entry)], covariance.diagonal()
        ends = np.cumsum([len(self.selection.columns[k]) for k in entry.members], dtype=np.intp)
        causes = (self.causes[k] for k in entry.members)
        yield from zip(
            causes, np.split(mean, ends)[:-1], np.split(variance, ends)[:-1], strict=True
        )


def weighed(
    readings: Readings,
    nominal: HexaSlide,
    tolerances: FloatArray,
    lead_m: float | None = None,
    adopted: Sequence[AdoptedEffect] = (),
    middle: FloatArray | None = None,
) -> WeighedCauses:
    """Weigh the causes of readings in the order in which they were taken, noise stated;
    ``tolerances`` ``(k,)`` of the procedure's parameters, ``lead_m`` of the drives' screws.
    ``adopted`` effects are in every model; they are some of `causes_of_machine`. Scale and bow are
    about the ``middle`` ``(6,)`` of the sliders, None: that of these readings.

    Raises NotIdentifiable without stated noise, and as `calibrate`.
    """
    models, times = _weighed(readings, nominal, tolerances, lead_m, adopted, middle), 1.0
    left_over = models.mean_square(models.free)
    if models.entries and left_over[1] < UNLIKELY:
        noisy, larger, square = models, 1.0, left_over[0]
        for _ in range(MOST_LARGER):
            larger *= square**0.5
            noisier = readings.noisier(larger)
            noisy = _weighed(noisier, nominal, tolerances, lead_m, adopted, middle)
            square = noisy.mean_square(noisy.entries[0])[0]  # in this noise
            if square < SETTLED:
                break
        unexplained = models.mean_square(models.entries[0])[1] < UNLIKELY
        odds = math.log(OPEN) - models.spare * math.log(larger)
        if unexplained or noisy.log_evidence + odds > models.log_evidence:
            models, times = noisy, larger
    causes = tuple(
        replace(cause, size=times * cause.size) if cause.id == MISTAKE else cause
        for cause in models.causes
    )
    return replace(models, noise_times=times, causes=causes)


def _weighed(
    readings: Readings,
    nominal: HexaSlide,
    tolerances: FloatArray,
    lead_m: float | None,
    adopted: Sequence[AdoptedEffect],
    middle: FloatArray | None,
) -> WeighedCauses:
    """Weigh the causes by the noise that the readings have."""
    if readings.noise_m is None:
        raise NotIdentifiable(
            "diagnosis", "no stated noise", "noise_mm and noise_deg in the procedure file"
        )
    if readings.procedure.kind is ProcedureKind.POSE_INVERSE:  # noise is in what is measured
        procedure = Procedure.of(ProcedureKind.POSE_FORWARD).on(nominal)
        readings = replace(readings, procedure=procedure)
    middle = readings.sliders.mean(axis=0) if middle is None else middle
    acting = with_effects(readings, nominal, lead_m, adopted, middle)
    calibrated = calibrate(acting, nominal)
    machine, names = calibrated.machine, readings.procedure.parameters
    tolerances = np.minimum(tolerances, UNKNOWN)
    postures = postures_of(acting, machine)
    residual, slopes = residuals(acting, machine, postures)
    noise = readings.value_noise
    base = (slopes / noise[:, None]).reshape(residual.values.size, -1) * tolerances
    expected = (nominal.parameters(names) - machine.parameters(names)) / tolerances
    whitened = (residual.values / noise).ravel()
    of_machine = causes_of_machine(readings, machine, postures, lead_m, middle)
    causes = (*of_machine, *mistakes_of(readings, machine, postures))
    selection = _selection(About.of(base, whitened, expected), causes, len(whitened))
    by_name = {(effect.id, effect.where): effect for effect in adopted}
    places = [by_name.get((cause.id, cause.where)) for cause in causes]
    stated = [
        np.divide(effect.values, cause.size) if effect else np.zeros(len(cause.names))
        for effect, cause in zip(places, causes, strict=True)
    ]
    free = (
        (k, max(ADOPTED, float(np.abs(stated[k]).max())))
        for k, effect in enumerate(places)
        if effect and not effect.held
    )
    models = WeighedCauses(
        readings=readings,
        calibration=calibrated,
        tolerances=tolerances,
        lead_m=lead_m,
        middle=middle,
        expected=expected,
        base=base,
        whitened=whitened,
        directions=SeenDirections.of(base),
        causes=causes,
        selection=selection,
        entries=(),
        weights_of_names={},
        adopted=tuple(adopted),
        stated=np.concatenate(stated),
        free=ModelEntry(tuple(free), 0.0),
    )
    if models.spare < FEWEST_SPARE:
        return models
    looked_for = [k for k, effect in enumerate(places) if effect is None]
    entries = tuple(_entries(models, looked_for))
    weights, weights_of_names = _weights(entries), dict[Names, float]()
    for entry, weight in zip(entries, weights.tolist(), strict=True):
        names_of_entry = models.names(entry)
        weights_of_names[names_of_entry] = weights_of_names.get(names_of_entry, 0.0) + weight
    heaviest_first = sorted(weights_of_names.items(), key=lambda item: (-item[1], item[0]))
    return replace(
        models,
        entries=entries[: int((weights > LIGHTEST).sum())],
        weights_of_names=dict(heaviest_first),
    )


def _weights(entries: Sequence[ModelEntry]) -> FloatArray:
    """Weights of models ``(n,)``, together 1."""
    logs = np.array([entry.log_weight for entry in entries])
    weights = np.exp(logs - logs.max(initial=-math.inf))
    return np.asarray(weights / weights.sum())


def _entries(models: WeighedCauses, looked_for: Sequence[int]) -> Iterator[ModelEntry]:
    """Models of causes ``looked_for``, the ``free`` ones in each of them."""
    selection, free = models.selection, models.free
    (shown, along, _), products = selection.explained_by(free.key), selection.products
    remainder = Products(
        products.inner - shown.T @ shown,
        products.along - along @ shown,
        products.square - float(along @ along),
    )
    columns, prior = [selection.columns[k] for k in looked_for], selection.log_prior[[*looked_for]]
    further = replace(
        selection,
        products=remainder,
        columns=columns,
        log_prior=prior,
        acting=len(free.members),
    )
    for entry in further.entries(FAINTEST):
        members = ((looked_for[k], scale) for k, scale in entry.key)
        yield ModelEntry((*members, *free.key), entry.log_weight)


def diagnosis_from(models: WeighedCauses) -> HexaSlideDiagnosis:
    """Names, sizes and the gap, from the weights."""
    readings, entries = models.readings, models.entries
    before = after = models.mean_square(models.free)
    verdict: Verdict = "cannot-tell"
    sizes: tuple[CauseSize, ...] = ()
    platform_m = 0.0
    sure_claims = tuple(
        HexaSlideClaim((cause,), weight)
        for cause, weight in sorted(models.likely().items())
        if weight >= SURE
    )
    claims = tuple(_claims(models.weights_of_names))
    if entries:
        sure_names = tuple(sorted(cause for claim in sure_claims for cause in claim.causes))
        names = sure_names or claims[0].causes
        best = next((entry for entry in entries if models.names(entry) == names), entries[0])
        after = models.mean_square(best)
        if after[1] < UNLIKELY:
            verdict = "unexplained"
        elif models.weights_of_names.get((), 0.0) >= AGREED:
            verdict = "agrees"
        else:
            verdict = "explained" if sure_claims else "ambiguous"
        sizes = tuple(_cause_sizes(models, best))
        platform_m = _at_platform(models, best)
    return HexaSlideDiagnosis(
        verdict=verdict,
        named=sure_claims,
        claims=claims,
        sizes=sizes,
        platform_m=platform_m,
        gap_before=before[0],
        p_before=before[1],
        gap_after=after[0],
        p_after=after[1],
        spare=models.spare,
        unidentifiable=models.calibration.unidentifiable,
        wrong_postures=tuple(
            readings.number(row)
            for row in range(len(readings.sliders))
            if any(mistake_at(readings, row) in claim.causes for claim in sure_claims)
        ),
    )


def _selection(about: About, causes: tuple[HexaSlideCause, ...], free: int) -> ModelSelection:
    columns = about.left_by(np.hstack([cause.columns for cause in causes]))
    widths = [cause.columns.shape[1] for cause in causes]
    starts = np.cumsum([0, *widths[:-1]])
    index = [np.arange(at, at + w, dtype=np.intp) for at, w in zip(starts, widths, strict=True)]
    places = Counter(name for name, _ in {(cause.id, cause.where) for cause in causes})
    # each kind is as likely, and so is each of its places
    prior = [math.log(cause.share / (len(places) * places[cause.id])) for cause in causes]
    products = Products.of(columns, about.left)
    return ModelSelection(products, index, np.array(prior), free, math.inf)


def _claims(weights: Mapping[Names, float]) -> Iterator[HexaSlideClaim]:
    """The heaviest first, until little is left out."""
    remainder = 1.0
    for names, weight in weights.items():
        yield HexaSlideClaim(names, weight)
        remainder -= weight
        if remainder <= OPEN:
            break


def _cause_sizes(models: WeighedCauses, entry: ModelEntry) -> Iterator[CauseSize]:
    for cause, values, variances in models.by_cause(entry):
        rows = zip(cause.names, values.tolist(), np.sqrt(variances).tolist(), strict=True)
        for name, value, deviation in rows:
            label = f"{cause.where}, {name}"
            yield CauseSize(label, cause.size * value, cause.size * deviation, cause.unit)


def _at_platform(models: WeighedCauses, entry: ModelEntry) -> float:
    """R.m.s. movement of the platform's origin by a model that no parameter takes over, metres."""
    if not entry.members:
        return 0.0
    machine = models.calibration.machine
    postures = postures_of(models.readings, machine)
    mean = models.values(entry)[0] + models.stated[models.index(entry)]
    shift = np.hstack([models.causes[k].places for k in entry.members]) @ mean
    forward = Procedure.of(ProcedureKind.POSE_FORWARD).on(machine)
    derivatives = jacobian(forward, machine.geometry, postures)
    places = np.asarray(derivatives[:, :3]).reshape(len(shift), -1)
    remainder = shift - places @ np.linalg.lstsq(places, shift, rcond=1e-10)[0]
    return float(np.sqrt((remainder**2).sum() / len(postures)))


PARTS = 5
"""Of the postures: each is left out once, as `solve` keeps a fifth of them out."""


@dataclass(frozen=True)
class LeftOutGap:
    """R.m.s. of what is missed of postures that are left out, in standard deviations of the noise:
    without and with names whose size the other postures tell.
    """

    before: float
    after: float


def left_out_gap(models: WeighedCauses, names: Names) -> LeftOutGap | None:
    """Every ``PARTS``-th posture left out in turn; ``models`` are those that have the names.

    Adopted effects are fitted on both sides. None where the others are too few.
    """
    rows = np.arange(len(models.whitened)).reshape(len(models.readings.sliders), -1)
    if len(rows) < PARTS or models.spare - rows[::PARTS].size < FEWEST_SPARE:
        return None
    best = models.entries[0]
    widths = [len(models.selection.columns[k]) for k in best.members]
    scaled = models.columns(best) * models.selection.columns_of(best.key)[1]
    of_model = np.repeat([k in models.free.members for k in best.members], widths)
    is_named = [(models.causes[k].id, models.causes[k].where) in names for k in best.members]
    of_names = np.repeat(is_named, widths)
    squares = np.zeros(2)
    for part in range(PARTS):
        out = rows[part::PARTS].ravel()
        for number, columns in enumerate((of_model, of_model | of_names)):
            errors = _missed(models, scaled[:, columns], out)
            squares[number] += errors @ errors
    before, after = (models.noise_times * np.sqrt(squares / len(models.whitened))).tolist()
    return LeftOutGap(before, after)


def _missed(models: WeighedCauses, columns: FloatArray, out: IntArray) -> FloatArray:
    """What is missed of rows ``out`` by parameters and ``columns`` ``(n, r)`` fitted to others."""
    base = np.hstack([models.base, columns])
    expected = np.concatenate([models.expected, np.zeros(columns.shape[1])])
    inside = np.setdiff1d(np.arange(len(base)), out)
    about = About.of(base[inside], models.whitened[inside], expected)
    return np.asarray(models.whitened[out] - base[out] @ (about.inverse @ about.along))
