"""One session by its cells: readings of one mounting, posture and side have one mean.

Repeats judge each other: what disagrees with them is no noise and pulls no mean. Errors that follow
each other make a mean less certain than its repeats let expect.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.arrays import (
    DEPENDENT,
    NEW_DIRECTION,
    Conditions,
    FloatArray,
    IntArray,
    Observations,
    basis_of,
    incidence,
    lengths,
    numbered,
    tilts,
    without,
    without_means,
    without_zeros,
)
from calib.identify.fit import design_of, prior_fit, within_reach
from calib.noise.reading import IndicatorFigures, Noise, reading_noise, visit_means, visit_numbers
from calib.noise.repeats import Repeats, disagreeing, set_apart, typical_mm2
from calib.noise.serial import independent, serial_correlation
from calib.posterior.distances import Distances
from calib.posterior.gaussian import About, LittleOfAll
from calib.posterior.selection import ADOPTED
from calib.posterior.statements import NOTHING, Statement
from calib.tripod.effects.bars import LegLength
from calib.tripod.effects.candidates import placed_columns
from calib.tripod.effects.drives import AxisOffset
from calib.tripod.effects.effect import AdoptedLaws, Effect, EffectInstance, Placed
from calib.tripod.effects.gauges import ROUND, SHAPES
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model

BASE = len(PARAMETER_NAMES)

FINEST_MM = 1e-5
"""No indicator reads better; with less, rounding would be taken for what readings show."""

USUAL = 3.0
"""Standard deviations from its repeats up to which a reading counts in full."""

JUMP = 13.0
"""Standard deviations between two readings of one visit from which on they are none."""

WRONG = 1e-6
"""Weight of a reading that disagrees with its repeats: it tells nothing about them."""


HOMING_MM = 0.01
"""Standard deviation of what homing again changes a joint offset by: switches of machines repeat
within a few micrometres to some hundredths."""

STEPS = 6
"""Of Gauss and Newton: from any machine within its tolerances three do."""

ALIKE = 0.8
"""Correlation of what towers are off by from the middle: owners find one radius wrong by some
tenths, and single towers by half of that."""


ROUND_GUESSED = 0.4
"""Of a radius that may be a guess so much is where each tower stands round the plate: the frame
gives that, while a radius is less what carriage and platform take up. Ten measured heights of a
printer put two of its towers 3 and 4 mm round the plate (docs/benchmarks.md)."""


def is_radial(law: Effect, place: str) -> bool:
    """Whether a parameter is how far a tower stands from the middle."""
    return law.id == AxisOffset.id and place[-1] == "r"


STATED_MM = 0.01
"""Of lengths that are as stated: bars that are measured, not made to tolerance."""


@dataclass(frozen=True, eq=False)
class SessionCase:
    """One session: the model it was measured against, and what is known of machine and indicators.

    ``tolerance_mm`` ``(6,)`` are standard deviations of joint offsets and bar lengths, and
    ``length_correlation`` how alike bars are off, from 0 to below 1. Where these
    readings tell no noise, that of ``others`` holds: of sessions with the same indicators. Effects
    of the model that are ``free``, laws at places, have other sizes than it states; places
    of one `AdoptedSize` share theirs. ``geometry``
    are parameters of the drives' lines, laws at places, with their standard deviations;
    ``radius_mm`` is that of the radius of all towers, where it may be a guess; each then stands
    elsewhere round the plate, too (`ROUND_GUESSED`). What is ``as_stated`` is as the model has it,
    but for what has a name. Joint offsets of sessions of the same ``state`` of the machine differ
    by what was ``entered_mm`` and by what homing changes, ``homing_mm``; None: they are no other
    session's. ``distances`` between marks were measured beside the readings.
    """

    model: Model
    observations: Observations
    indicator: IndicatorFigures
    tolerance_mm: FloatArray
    others: Noise | None = None
    free: AdoptedLaws = field(default_factory=dict)
    geometry: Mapping[Placed, float] = field(default_factory=dict)
    as_stated: Statement = NOTHING
    state: Hashable | None = None
    entered_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    homing_mm: float = HOMING_MM
    distances: Distances = field(default_factory=Distances.none)
    length_correlation: float = 0.0
    radius_mm: float = 0.0

    @cached_property
    def free_spread(self) -> dict[Placed, FloatArray]:
        """Standard deviations of each free law about its sizes in the model, in its units.

        Of parameters of geometry their tolerance; of an adopted effect `ADOPTED` unremarkable
        sizes, or the size itself where it is larger.
        """
        spread = {law: np.array([size]) for law, size in self.lines.items()}
        for instance in self.model.effects:
            if not isinstance(instance, EffectInstance):
                continue
            law = instance.effect, instance.place
            if law in self.free:
                least = [ADOPTED * parameter.tolerance for parameter in instance.effect.parameters]
                spread_of_values = np.maximum(least, np.abs(instance.values))
                spread[law] = np.maximum(spread_of_values, spread.get(law, spread_of_values))
        return spread

    @property
    def of_one_size(self) -> list[list[Placed]]:
        """Laws at the places that share the size of an adopted effect."""
        laws_by_size: dict[object, list[Placed]] = {}
        for law, size in self.free.items():
            laws_by_size.setdefault((law[0], size), []).append(law)
        return [laws for laws in laws_by_size.values() if len(laws) > 1]

    @property
    def acting(self) -> int:
        """How many effects were adopted, wherever each acts."""
        return len({number for number, _ in self.free.values()})

    @property
    def _bars_mm(self) -> tuple[FloatArray, FloatArray]:
        """What bars ``(3,)`` are off by, each by itself and all together, standard deviations."""
        tolerance_mm = np.maximum(self.tolerance_mm[3:], FINEST_MM)
        single_mm = math.sqrt(1.0 - self.length_correlation) * tolerance_mm
        alike_mm = math.sqrt(self.length_correlation) * tolerance_mm
        if self.as_stated.bars != "each":
            single_mm = np.minimum(single_mm, STATED_MM)
        return single_mm, 0.0 * alike_mm if self.as_stated.bars == "none" else alike_mm

    @property
    def spread_mm(self) -> FloatArray:
        """Standard deviations of the base ``(6,)``; a tolerance of 0 is a known value."""
        offsets_mm = np.maximum(self.tolerance_mm[:3], FINEST_MM)
        return np.concatenate([offsets_mm, np.hypot(*self._bars_mm)])

    @property
    def base_correlation(self) -> FloatArray:
        """Correlation ``(6, 6)`` of what joint offsets and bar lengths are off by."""
        correlation = np.eye(BASE)
        single_mm, alike_mm = self._bars_mm
        bars_mm2 = np.diag(single_mm**2) + np.outer(alike_mm, alike_mm)
        correlation[3:, 3:] = bars_mm2 / np.outer(self.spread_mm[3:], self.spread_mm[3:])
        return correlation

    @property
    def base_root(self) -> FloatArray:
        """Root ``(6, 6)`` of the covariance of joint offsets and bar lengths, mm."""
        return np.asarray(self.spread_mm[:, None] * np.linalg.cholesky(self.base_correlation))

    @property
    def lines(self) -> Mapping[Placed, float]:
        """Parameters of geometry that every model has free about 0; adopted ones have a size."""
        radius_mm = self.radius_mm if self.as_stated.guessed else 0.0
        guessed_mm = {True: radius_mm, False: ROUND_GUESSED * radius_mm}
        return {
            (law, place): math.hypot(size, guessed_mm[is_radial(law, place)])
            if law.id == AxisOffset.id
            else size
            for (law, place), size in self.geometry.items()
            if law.id in self.as_stated.free
            and (law, place) not in self.free
            and place in law.places(self.observations)
        }

    @cached_property
    def lines_root(self) -> FloatArray:
        """Root ``(k, k)`` of the covariance of these parameters, in their units.

        Towers stand on one frame: their distances from the middle are off alike.
        """
        size = np.array([*self.lines.values()])
        covariance = np.diag(size**2)
        radial = [k for k, law in enumerate(self.lines) if is_radial(*law)]
        single = np.array([self.geometry[law] for law in self.lines if is_radial(*law)])
        alike = np.sqrt(size[radial] ** 2 - (1.0 - ALIKE) * single**2)
        covariance[np.ix_(radial, radial)] += np.outer(alike, alike) - np.diag(alike**2)
        return np.linalg.cholesky(covariance)

    @property
    def named_beyond(self) -> dict[Effect, float]:
        """Laws of parameters with the tolerance beyond which each has a name, in its unit.

        Bars that are as stated have none, inf: those within their tolerance are another way's.
        """
        if not self.geometry:
            return {}
        beyond = {law: size for (law, _), size in self.geometry.items()}
        if SHAPES[0] in beyond:
            beyond[ROUND] = beyond[SHAPES[0]]
        each_bar = self.as_stated.bars != "each"
        return beyond | {LegLength(): math.inf if each_bar else float(self.tolerance_mm[3:].max())}

    @property
    def shows(self) -> bool:
        """Whether the session shows anything of a machine; readings of one posture do not."""
        observations = self.observations
        place_count = int(numbered(observations.mount, observations.posture).max(initial=-1)) + 1
        return place_count > observations.mount_count or len(self.distances) > 0

    @cached_property
    def visit(self) -> IntArray:
        """Number of the visit ``(n_readings,)`` of each reading.

        What was read in place agrees but for the indicator: a reading that jumps away from the one
        before was not read there, and is a visit by itself.
        """
        observations, visit = self.observations, visit_numbers(self.observations)
        visits = visit_means(observations, visit)
        typical = typical_mm2(Repeats.of(visits, steady=True))
        if typical is None or len(visits) == len(observations):
            return visit
        least_mm2 = np.maximum(typical, self.indicator.display_mm**2 / 12.0)
        order = np.lexsort((np.arange(len(visit)), visit))
        change_mm = np.abs(np.diff(observations.value_mm[order]))
        jump = change_mm**2 > JUMP**2 * least_mm2[observations.mount[order][1:]]
        begins = np.concatenate([[True], (np.diff(visit[order]) > 0) | jump])
        number = np.empty_like(visit)
        number[order] = np.cumsum(begins) - 1
        first = np.unique(number, return_index=True)[1]
        rank = np.empty_like(first)
        rank[np.argsort(first, kind="stable")] = np.arange(len(first))
        return rank[number]


@dataclass(frozen=True, eq=False, repr=False)
class Cells:
    """One session by its cells: ``means`` of them, with a variance ``(n_cells,)`` of each in mm².

    ``cell`` ``(n_visits,)`` numbers the cell of each visit, ``scatter_mm2`` ``(n_visits,)`` is its
    variance, ``weight`` ``(n_visits,)`` less than 1 where it lies far from its repeats; ``serial``
    correlates each with the next of its mounting. Nobody saw how the first reading of a mounting
    was reached: its approach is not known, so it shares no cell. ``noise`` is None where nothing
    tells it. Visits that stand ``apart`` disagree with their repeats: they are no noise, and
    ``excess`` is what they add to the square sum within cells.
    """

    case: SessionCase
    visits: Observations
    cell: IntArray
    means: Observations
    variance_mm2: FloatArray
    scatter_mm2: FloatArray
    weight: FloatArray
    noise: Noise | None
    serial: float
    apart: IntArray
    excess: float

    @classmethod
    def of(cls, case: SessionCase) -> Cells:
        """Group the visits of a session."""
        return cls.of_visits(case, visit_means(case.observations, case.visit))

    @classmethod
    def of_visits(cls, case: SessionCase, visits: Observations) -> Cells:
        """Group visits, which need not be those of the session as it is written."""
        cell, serial, excess, weight = visits.cell, 0.0, 0.0, np.ones(len(visits))
        repeats = Repeats.of(visits, steady=True)
        floor_mm2 = case.indicator.display_mm**2 / 12.0
        apart = np.array(disagreeing(repeats, floor_mm2), dtype=np.intp)
        noise = reading_noise(visits, case.indicator, apart.tolist(), steady=True)
        if noise and noise.repeated == "nothing" and not case.indicator.repeatability_mm:
            noise = None  # a display's step alone is the least that a reading may scatter
        if noise is None and case.others is not None:
            noise = case.others.for_indicators(visits.indicator_count)
        if noise is None:  # equal weights: what the model leaves tells the variance
            scatter = _likeliest_mm2(case, visits) / visits.averaged
        else:
            scatter = np.maximum(noise.repeatability_mm2(visits), FINEST_MM**2)
            alone = set_apart(cell, apart)
            excess = _square_within(cell, scatter, visits.value_mm) - _square_within(
                alone, scatter, visits.value_mm
            )
            serial = serial_correlation(visits, alone, scatter)
            if serial:
                scatter = scatter * correlated_variance(visits, alone, scatter, serial)
            weight = _robust_weights(Repeats.of(visits, apart.tolist(), steady=True), scatter)
            weight[apart] = WRONG
        means, variance = _means(visits, cell, scatter / weight, serial)
        shared = noise.quantisation_mm2(means) if noise else 0.0
        variance = np.maximum(variance + shared, FINEST_MM**2)
        scatters = variance, scatter, weight
        return cls(case, visits, cell, means, *scatters, noise, serial, apart, excess)

    @property
    def with_free_lines(self) -> Cells:
        """The cells where the drives' lines, and bars, are free within their tolerances."""
        if self.case.as_stated == NOTHING:
            return self
        return replace(self, case=replace(self.case, as_stated=NOTHING))

    @classmethod
    def of_all(cls, cases: Sequence[SessionCase]) -> list[Cells]:
        """Several sessions: one without repeats has the noise of those with most."""
        sessions = [cls.of(case) for case in cases]
        best = max(sessions, key=lambda cells: cells.freedom)
        return [
            cells if cells.noise else cls.of(replace(cells.case, others=best.noise))
            for cells in sessions
        ]

    @property
    def freedom(self) -> float:
        """Degrees of freedom that these readings add to what is known of the noise."""
        return self.noise.degrees_of_freedom if self.noise and not self.case.others else 0.0

    @cached_property
    def log_constant(self) -> float:
        """Log density of the readings that no model changes: their scales, and repeats that agree.

        With it the evidences of sessions with other labels, or fewer readings, compare.
        """
        visits, scatter = self.visits, self.scatter_mm2
        root = 1.0 / np.sqrt(scatter)[:, None]
        zeros = [float((independent(self.serial, root[r]) ** 2).sum()) for r in visits.mountings]
        log_scales = float(np.log(2.0 * np.pi * scatter).sum())
        log_scales += float(np.log(np.array(zeros) / (2.0 * np.pi)).sum())
        log_scales += (len(visits) - len(zeros)) * math.log(1.0 - self.serial**2)
        repeats = len(visits) - len(self.means) - len(self.apart) if self.noise else 0
        return -0.5 * (log_scales + repeats)

    @cached_property
    def _counted_mm2(self) -> FloatArray:
        return self.scatter_mm2 / self.weight

    @cached_property
    def model(self) -> Model:
        """Base parameters fitted within their tolerances. Raises NotIdentifiable."""
        case = self.case
        if not case.lines:
            return prior_fit(case.model, self.means, 1.0 / self.variance_mm2, case.spread_mm).model
        model, root = case.model, case.base_root
        for _ in range(STEPS):  # what geometry does within its tolerances is a part of the noise
            with within_reach(self.means):
                little = LittleOfAll(self.whitened(_by_geometry(case, model, self.means)))
                design = design_of(model, self.means, range(BASE), ()) @ root
                rows = np.column_stack([self.means.value_mm - model.readings(self.means), design])
                rows = little.whitened(self.whitened(rows))
                expected_mm = np.subtract(case.model.parameters_mm, model.parameters_mm)
                expected = np.asarray(np.linalg.solve(root, expected_mm), dtype=np.float64)
                about = About.of(rows[:, 1:], rows[:, 0], expected)
                step_mm = root @ (about.inverse @ about.along)
                model = model.with_parameters(model.parameters_mm + step_mm)
        return model

    def whitened(self, rows: FloatArray) -> FloatArray:
        """Rows ``(n_cells, ...)`` made independent, of unit variance, less the best zeros."""
        flat = self._independent(rows.reshape(len(rows), -1))
        return np.asarray(without(self.zeros, flat).reshape(rows.shape))

    def coloured(self, rows: FloatArray) -> FloatArray:
        """The opposite ``(n_cells, k)``, but for what zeros took."""
        if not self.serial:
            return np.asarray(rows * np.sqrt(self.variance_mm2)[:, None])
        columns = np.empty_like(rows)
        for cells, root in self._roots:
            columns[cells] = root @ rows[cells]
        return columns

    @cached_property
    def zeros(self) -> FloatArray:
        """Basis ``(n_cells, r)`` of zeros of mountings and tilts of planes, whitened."""
        columns = np.hstack([incidence(self.means.mount), tilts(self.means)])
        independent_columns = self._independent(columns)
        return basis_of(independent_columns / lengths(independent_columns), DEPENDENT)

    def _independent(self, columns: FloatArray) -> FloatArray:
        if not self.serial:
            return np.asarray(columns / np.sqrt(self.variance_mm2)[:, None])
        whitened = np.empty_like(columns)
        for rows, root in self._roots:
            whitened[rows] = np.linalg.solve(root, columns[rows])
        return whitened

    @cached_property
    def _roots(self) -> list[tuple[IntArray, FloatArray]]:
        """Cells of each mounting, and the Cholesky root of the covariance of their means."""
        shared = self.noise.quantisation_mm2(self.means) if self.noise else np.zeros(0)
        return [
            (cells, np.asarray(np.linalg.cholesky(inverse @ inverse.T + np.diag(shared[cells]))))
            for _, cells, _, inverse in _by_mounting(
                self.visits, self.cell, self._counted_mm2, self.serial
            )
        ]

    def in_time(self, columns: FloatArray, left_mm: FloatArray) -> FloatArray:
        """What columns ``(n_visits, k)`` and readings do within cells: rows ``(r, 1 + k)``.

        What is ``left_mm`` ``(n_visits,)`` of the readings comes first; independent, of unit
        variance; as many as columns differ.
        """
        rows = np.column_stack([columns, left_mm])
        root = np.sqrt(self._counted_mm2)[:, None]
        if self.serial:
            mountings = _by_mounting(self.visits, self.cell, self._counted_mm2, self.serial)
            remainder = np.vstack(
                [
                    without(basis, independent(self.serial, rows[of_mount] / root[of_mount]))
                    for of_mount, _, basis, _ in mountings
                ]
            )
        else:
            remainder = without_means(self.cell, 1.0 / self._counted_mm2, rows) / root
        # of columns that depend on each other a triangle would keep rounding as a reading
        timed = remainder[:, :-1] / lengths(remainder[:, :-1])
        basis, upper = np.linalg.qr(timed)
        common = basis_of(upper, DEPENDENT).T @ (basis.T @ remainder)
        return np.column_stack([common[:, -1], common[:, :-1]])


SCATTERS_MM = np.geomspace(1e-3, 1.0, 61)
"""Of a probe that nobody stated, and of what else tells a contact from a plain machine."""

PROBED_MM, PROBED_TIMES = 0.03, 3.0
"""Contacts scatter about a machine within its tolerances by so much, times or over so much
(standard deviation): probes, dirt and plates. Else seven contacts of a printer that is off by
tenths would be noise; medians of 0.02 to 0.05 mm predict contacts left out of published files of
Klipper alike (`tests.blind.saved_contacts`)."""


def _likeliest_mm2(case: SessionCase, visits: Observations) -> float:
    """The variance of readings with which a machine within its tolerances is likeliest, mm²."""
    within = design_of(case.model, visits, range(BASE), ()) @ case.base_root
    lines = _by_geometry(case, case.model, visits)
    rows = np.column_stack([visits.value_mm - case.model.readings(visits), within, lines])
    centred = without_zeros(visits, visits.averaged, rows)
    axes, singular, _ = np.linalg.svd(centred[:, 1:], full_matrices=False)
    along = (axes.T @ centred[:, 0]) ** 2
    variances = SCATTERS_MM[:, None] ** 2 + singular**2
    likelihood = -0.5 * (np.log(variances) + along / variances).sum(axis=1)
    # all other directions only scatter; of each mounting one is its zero, which nothing does
    degrees = len(visits) - len(singular) - visits.mount_count
    residual_mm2 = max(float(centred[:, 0] @ centred[:, 0] - along.sum()), 0.0)
    likelihood -= degrees * np.log(SCATTERS_MM) + 0.5 * residual_mm2 / SCATTERS_MM**2
    if visits.contact.all():
        likelihood -= 0.5 * (np.log(SCATTERS_MM / PROBED_MM) / math.log(PROBED_TIMES)) ** 2
    return float(SCATTERS_MM[likelihood.argmax()] ** 2)


def _by_geometry(case: SessionCase, model: Model, conditions: Conditions) -> FloatArray:
    """What each parameter of geometry does to readings ``(n, k)``, per standard deviation, mm."""
    laws = list(dict.fromkeys(effect for effect, _ in case.lines))
    placed = placed_columns(model, conditions, laws, case.lines)
    columns = [placed[law] for law in case.lines]
    return np.hstack([np.zeros((len(conditions), 0)), *columns]) @ case.lines_root


def _by_mounting(
    visits: Observations, cell: IntArray, scatter_mm2: FloatArray, serial: float
) -> Iterator[tuple[IntArray, IntArray, FloatArray, FloatArray]]:
    """Each mounting's visits, its cells, a basis of these, and the root of their covariance.

    The basis ``(n, c)`` is orthonormal among errors made independent; times the inverse root
    ``(c, c)`` it estimates the means.
    """
    for rows in visits.mountings:
        cells, number = np.unique(cell[rows], return_inverse=True)
        columns = np.eye(len(cells))[number] / np.sqrt(scatter_mm2[rows])[:, None]
        basis, upper = np.linalg.qr(independent(serial, columns))
        yield rows, cells, basis, np.linalg.inv(upper)


def _means(
    visits: Observations, cell: IntArray, scatter_mm2: FloatArray, serial: float
) -> tuple[Observations, FloatArray]:
    """Means of cells by least squares, and their variances ``(n_cells,)``, mm²."""
    rows = np.unique(cell, return_index=True)[1]
    values = np.column_stack([visits.value_mm, visits.time_s])
    if not serial:
        total = np.bincount(cell, 1.0 / scatter_mm2)
        value_mm, time_s = (np.bincount(cell, column / scatter_mm2) / total for column in values.T)
        variance = 1.0 / total
    else:
        value_mm, time_s, variance = (np.empty(len(rows)) for _ in range(3))
        for of_mount, cells, basis, inverse in _by_mounting(visits, cell, scatter_mm2, serial):
            whitened_values = values[of_mount] / np.sqrt(scatter_mm2[of_mount])[:, None]
            value_mm[cells], time_s[cells] = (
                inverse @ (basis.T @ independent(serial, whitened_values))
            ).T
            variance[cells] = (inverse**2).sum(axis=1)
    together = np.bincount(cell, visits.averaged).astype(np.float64)
    means = replace(visits.take(rows), value_mm=value_mm, averaged=together, time_s=time_s)
    return means, variance


def _square_within(cell: IntArray, scatter_mm2: FloatArray, value_mm: FloatArray) -> float:
    """Square sum of readings about the means of their cells, over their variances."""
    return float((without_means(cell, 1.0 / scatter_mm2, value_mm) ** 2 / scatter_mm2).sum())


def correlated_variance(
    visits: Observations, cell: IntArray, scatter_mm2: FloatArray, serial: float
) -> float:
    """Variance of correlated errors over what their repeats show: these follow each other.

    A steady drift of each mounting is no error.
    """
    square, free = 0.0, 0
    for rows, _, basis, _ in _by_mounting(visits, cell, scatter_mm2, serial):
        order = np.linspace(-1.0, 1.0, len(rows))
        columns = (
            np.column_stack([order, visits.value_mm[rows]]) / np.sqrt(scatter_mm2[rows])[:, None]
        )
        drift, residual = without(basis, independent(serial, columns)).T
        along = float(drift @ drift)
        square += float(residual @ residual) - (
            float(drift @ residual) ** 2 / along if along > 1e-9 else 0.0
        )
        free += max(len(rows) - basis.shape[1] - 1, 0)
    return square / free if free and square > 0.0 else 1.0


def _robust_weights(repeats: Repeats, scatter_mm2: FloatArray) -> FloatArray:
    """Weights ``(n_visits,)`` with which what lies far from its repeats does not pull the mean.

    Huber's: 1 up to `USUAL` standard deviations, from there on falling with the distance; what all
    readings of a cycle share is no distance. A cell of few readings, of which one lies far, is
    known less well.
    """
    residual_mm = repeats.scatter(repeats.observations.value_mm)
    share = np.maximum(1.0 - repeats.leverage, NEW_DIRECTION)
    averaged = repeats.observations.averaged
    distance = np.abs(residual_mm) / np.sqrt(averaged * scatter_mm2 * share)
    return np.asarray(USUAL / np.maximum(distance, USUAL))
