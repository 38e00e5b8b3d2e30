"""Cells of a session against the whole covariance of its visits, and readings that lie far off."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_t

from calib.arrays import FloatArray, numbered, observe, tool_conditions
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import Cells, SessionCase, correlated_variance
from calib.posterior.readings import log_of_student
from calib.posterior.screening import even_mm
from tests.calib.posterior.sessions import SCATTER_MM, SHORT, SWEEP, case, with_values


def covariance(cells: Cells) -> FloatArray:
    """Of the errors of all visits, from its definition."""
    visits, rho = cells.visits, cells.serial
    visit = np.zeros(len(visits))
    for rows in visits.mountings:
        visit[rows] = np.arange(len(rows))
    apart = np.abs(np.subtract.outer(visit, visit))
    together = visits.mount[:, None] == visits.mount
    root = np.sqrt(cells.scatter_mm2 / cells.weight)
    return np.asarray(np.where(together, rho**apart, 0.0) * np.outer(root, root))


def correlated(seed: int) -> Cells:
    session = case(SWEEP, seed=seed)
    generator = np.random.default_rng(seed)
    value = session.observations.value_mm.copy()
    for rows in session.observations.mountings:
        error = generator.normal(size=len(rows))
        for k, n in pairwise(range(len(rows))):
            error[n] = 0.8 * error[k] + 0.6 * error[n]
        value[rows] += 5.0 * SCATTER_MM * error
    return Cells.of(with_values(session, value))


def test_means_of_correlated_errors_are_those_of_least_squares() -> None:
    cells = correlated(3)
    assert cells.serial > 0.4
    precision = np.linalg.inv(covariance(cells))
    groups = np.eye(len(cells.means))[cells.cell]
    of_means = np.linalg.inv(groups.T @ precision @ groups)
    expected = of_means @ groups.T @ precision @ cells.visits.value_mm
    assert cells.means.value_mm == pytest.approx(expected, abs=1e-9)
    assert cells.variance_mm2 == pytest.approx(of_means.diagonal(), rel=1e-9)


def test_the_variance_of_correlated_errors_is_not_biased() -> None:
    """Errors of variance 1 that follow each other as supposed, and a drift: 1 on average."""
    visits = case(SWEEP).observations
    cell = Cells.of(case(SWEEP)).cell
    generator = np.random.default_rng(6)
    variances = []
    for _ in range(300):
        value = np.linspace(0.0, 9.0, len(visits))
        for rows in visits.mountings:
            error = generator.normal(size=len(rows))
            for k in range(1, len(rows)):
                error[k] = 0.6 * error[k - 1] + 0.8 * error[k]
            value[rows] += error
        drawn = replace(visits, value_mm=value)
        variances.append(correlated_variance(drawn, cell, np.ones(len(visits)), 0.6))
    spread = float(np.std(variances)) / np.sqrt(len(variances))
    assert np.mean(variances) == pytest.approx(1.0, abs=4.0 * spread)
    assert 4.0 * spread < 0.07


@pytest.mark.parametrize("serial", [False, True])
def test_whitened_rows_have_the_information_of_all_visits_beside_their_zeros(serial: bool) -> None:
    cells = correlated(5) if serial else Cells.of(case(SWEEP, seed=5))
    columns = np.random.default_rng(0).normal(size=(len(cells.means), 4))
    precision = np.linalg.inv(covariance(cells))
    zeros = np.eye(cells.visits.mount_count)[cells.visits.mount]
    at_visits = columns[cells.cell]
    product = precision @ zeros
    beside = precision - product @ np.linalg.solve(zeros.T @ product, product.T)
    whitened = cells.whitened(columns)
    assert whitened.T @ whitened == pytest.approx(at_visits.T @ beside @ at_visits, rel=1e-6)
    again = cells.whitened(cells.coloured(whitened))
    assert again == pytest.approx(whitened, abs=1e-9)


@given(seed=st.integers(0, 2**16))
@settings(max_examples=20, deadline=None)
def test_without_outliers_a_mean_is_a_mean(seed: int) -> None:
    cells = Cells.of(case(SHORT, seed=seed))
    counted = cells.weight == 1.0
    plain = np.bincount(cells.cell, cells.visits.value_mm) / np.bincount(cells.cell)
    untouched = np.bincount(cells.cell, counted) == np.bincount(cells.cell)
    assert untouched.mean() > 0.8
    if not cells.serial:
        assert cells.means.value_mm[untouched] == pytest.approx(plain[untouched], abs=1e-12)


def test_a_reading_that_does_not_fit_its_repeats_is_no_noise_and_hardly_pulls_their_mean() -> None:
    clean = case(SHORT, seed=7)
    row = int(np.flatnonzero(clean.observations.displacement_mm == 60.0)[4])
    value = clean.observations.value_mm.copy()
    value[row] += 1.0
    before, after = Cells.of(clean), Cells.of(with_values(clean, value))
    assert before.noise is not None
    assert after.noise is not None
    assert after.apart.tolist() == [row]
    sigma_mm = before.noise.standard_deviation_mm
    assert after.noise.standard_deviation_mm == pytest.approx(sigma_mm, rel=0.2)
    moved = np.abs(after.means.value_mm - before.means.value_mm)[before.cell[row]]
    assert moved < 3.0 * sigma_mm, "a third of it would be 0.33 mm"


def test_first_readings_share_no_cell() -> None:
    cells = Cells.of(case(SHORT))
    first = np.unique(cells.visits.mount, return_index=True)[1]
    assert np.bincount(cells.cell)[cells.cell[first]].tolist() == [1] * 6


def test_evidences_of_other_mountings_compare() -> None:
    """The density of all readings with wide zeros, from the whole covariance, up to one constant.

    A stated instrument and no repeats: nothing is estimated.
    """
    complete = case(SHORT, seed=2)
    once = complete.observations.take(complete.observations.cycle == 1)
    figures = IndicatorFigures(repeatability_mm=SCATTER_MM)
    session = replace(complete, observations=once, indicator=figures)
    mount = once.mount.copy()
    mount[2] = once.mount_count
    wide_mm2 = 1e2

    def density(cells: Cells) -> tuple[float, float]:
        residual = cells.whitened(cells.means.value_mm)
        ours = cells.log_constant - 0.5 * float(residual @ residual)
        zeros = np.eye(cells.visits.mount_count)[cells.visits.mount]
        spread = covariance(cells) + wide_mm2 * zeros @ zeros.T
        value = cells.visits.value_mm
        square = float(value @ np.linalg.solve(spread, value))
        log_det = float(np.linalg.slogdet(2.0 * np.pi * spread)[1])
        prior = 0.5 * zeros.shape[1] * np.log(2.0 * np.pi * wide_mm2)
        return ours, -0.5 * (square + log_det) + prior

    for visits in (once, replace(once, mount=numbered(mount))):
        cells = Cells.of_visits(session, visits)
        assert cells.freedom == np.inf
        ours, theirs = density(cells)
        assert ours == pytest.approx(theirs, abs=0.01)


def test_a_session_without_repeats_has_the_noise_of_the_others_and_adds_none() -> None:
    several = case(SWEEP, seed=1)
    once = replace(several, observations=several.observations.take(several.observations.cycle == 1))
    levels = once.observations.level
    first = np.unique(np.stack([once.observations.mount, levels]), axis=1, return_index=True)[1]
    once = replace(once, observations=once.observations.take(np.sort(first)))
    assert Cells.of(once).noise is None
    all_cells = Cells.of_all([once, several])
    noise = all_cells[1].noise
    assert noise is not None
    assert all_cells[0].scatter_mm2 == pytest.approx(noise.standard_deviation_mm**2)
    assert [cells.freedom for cells in all_cells] == [0.0, noise.degrees_of_freedom]
    (alone,) = Cells.of_all([once])
    assert alone.noise is None


@pytest.mark.parametrize("seed", range(5))
def test_single_heights_that_scatter_do_not_bend_the_bars(seed: int) -> None:
    """Ten heights over a plate, once each, off by 0.3 mm of nothing that the machine can be.

    With the scatter guessed as a hundredth of the readings bars of 203 mm, known to 0.5 mm, came
    out at 194 mm.
    """
    chance = np.random.default_rng(seed)
    session = case(SWEEP, seed=seed)
    turns, radii = np.arange(9) * 2.0 * np.pi / 9.0, np.repeat([35.0, 70.0], [3, 6])
    places = radii[:, None] * np.stack([np.cos(turns), np.sin(turns), 0.0 * turns], axis=1)
    heights = observe(
        tool_conditions(np.vstack([np.zeros(3), places])), 0.3 * chance.standard_normal(10)
    )
    once = replace(session, observations=heights, indicator=IndicatorFigures())
    cells = Cells.of(once)
    assert cells.noise is None
    assert 0.1 < np.sqrt(cells.scatter_mm2[0]) < 0.6
    off = np.array(cells.model.parameters_mm) / once.tolerance_mm
    assert np.abs(off).max() < 3.0


@pytest.mark.parametrize("freedom", [1, 7])
@pytest.mark.parametrize("count", [1, 5])
def test_student_by_its_power_and_what_is_before_it(freedom: int, count: int) -> None:
    """Up to the root of 2 pi a reading, which a normal density has, too."""
    value = np.linspace(-1.0, 2.0, count)
    power = -0.5 * (freedom + count) * np.log(freedom + value @ value)
    density = multivariate_t(np.zeros(count), np.eye(count), df=freedom).logpdf(value)
    expected = density + 0.5 * count * np.log(2.0 * np.pi)
    assert log_of_student(freedom, count) + power == pytest.approx(expected)
    assert log_of_student(0.0, count) == log_of_student(np.inf, count) == 0.0


def test_where_a_stand_moved_readings_have_the_noise_of_their_display() -> None:
    """Repeats that agree to the digit differ by rounding; the moved one is no noise of all."""
    session = case(SHORT, seed=2)
    value = 0.01 * np.round(session.observations.value_mm / 0.01)
    cell = Cells.of(session).cell
    first = np.unique(cell, return_index=True)[1]
    value = value[first][cell]  # every repeat is the same
    assert even_mm(Cells.of(_at_steps(session, value))) == pytest.approx(0.01 / np.sqrt(12.0))
    moved = value + 5.0 * (session.observations.mount == 0) * (session.observations.cycle == 3)
    assert even_mm(Cells.of(_at_steps(session, moved))) == pytest.approx(0.01 / np.sqrt(12.0))


def _at_steps(session: SessionCase, value_mm: FloatArray) -> SessionCase:
    stepped = with_values(session, value_mm)
    return replace(stepped, indicator=IndicatorFigures(resolution_mm=0.01))
