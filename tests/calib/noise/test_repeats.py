"""Scatter of repeats: drift kept out, indicators told apart, outliers found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import Observations, observe
from calib.noise.reading import IndicatorFigures, IndicatorNoise, Noise, reading_noise
from calib.noise.repeats import Repeats, disagreeing, outlying_readings
from tests.builders import postures


def session(
    scatter_mm: float, *, drift_mm: float = 0.0, seed: int = 0, cycles: int = 3
) -> Observations:
    """Cycles on six mountings, each cycle shifted by a drift of its own."""
    generator = np.random.default_rng(seed)
    conditions = postures(repeats=cycles)
    cycle = np.zeros(len(conditions), dtype=np.intp)
    for mount in range(conditions.mount_count):
        rows = np.flatnonzero(conditions.mount == mount)
        for displacement in np.unique(conditions.displacement_mm[rows]):
            here = rows[conditions.displacement_mm[rows] == displacement]
            cycle[here] = np.arange(len(here))
    shift = drift_mm * generator.normal(size=(6, cycles))
    value = conditions.displacement_mm * 0.001 + shift[conditions.mount, cycle]
    value = value + generator.normal(scale=scatter_mm, size=len(conditions))
    return replace(
        observe(conditions, value),
        cycle=cycle,
        indicator=(conditions.axis - conditions.leg) % 3 - 1,
    )


def test_drift_from_cycle_to_cycle_is_not_noise() -> None:
    calm, drifting = session(0.002), session(0.002, drift_mm=0.5)
    noise, drifting_noise = (reading_noise(s, IndicatorFigures()) for s in (calm, drifting))
    assert noise is not None
    assert drifting_noise is not None
    assert drifting_noise.standard_deviation_mm == pytest.approx(
        noise.standard_deviation_mm, rel=1e-9
    )
    assert drifting_noise.degrees_of_freedom == pytest.approx(6 * (3 - 1) * (3 - 1))


def test_many_cycles_have_a_steady_rate_in_place_of_a_mean_each() -> None:
    """A basis of 300 cycles would be 300 columns for each mounting."""
    data = session(0.002, cycles=300)
    repeats = Repeats.of(data)
    assert {basis.shape[1] for _, basis in repeats.cycles} == {1}
    steady = replace(data, value_mm=data.value_mm + 0.02 * data.cycle / 300)
    for trial in (data, steady):
        noise = reading_noise(trial, IndicatorFigures())
        assert noise is not None
        assert noise.standard_deviation_mm == pytest.approx(0.002, rel=0.03)
    assert {basis.shape[1] for _, basis in Repeats.of(session(0.002, cycles=9)).cycles} == {8}


def test_wandering_is_told_by_its_size_and_quiet_sessions_have_none() -> None:
    sizes, quiet = [], 0
    for seed in range(200):
        calm = reading_noise(session(0.002, seed=seed), IndicatorFigures())
        restless = reading_noise(session(0.002, drift_mm=0.05, seed=seed), IndicatorFigures())
        assert calm is not None
        assert restless is not None
        assert restless.cycle_drift_mm is not None
        quiet += calm.cycle_drift_mm is None
        sizes.append(restless.cycle_drift_mm)
    assert quiet >= 192, "1 % of 200 sessions, with room for chance (p < 0.001)"
    assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(0.05, rel=0.05)


def test_scatter_against_the_two_way_formula() -> None:
    """Sum of (y - cell - cycle + mean)² over (cells - 1)(cycles - 1), balanced design."""
    data = session(0.01, drift_mm=0.1, seed=5)
    table = np.empty((6, 3, 3))
    for mount in range(6):
        for k, level in enumerate(np.unique(data.displacement_mm)):
            rows = (data.mount == mount) & (data.displacement_mm == level)
            table[mount, k, data.cycle[rows]] = data.value_mm[rows]
    residual = table - table.mean(axis=1, keepdims=True) - table.mean(axis=2, keepdims=True)
    residual += table.mean(axis=(1, 2), keepdims=True)
    sums = Repeats.of(data).sums_of_squares(data.value_mm[:, None])
    assert float(sums.sum()) == pytest.approx(float((residual**2).sum()), rel=1e-9)


def test_equal_indicators_are_pooled_at_the_stated_rate() -> None:
    kept_apart = 0
    for seed in range(300):
        noise = reading_noise(session(0.003, seed=seed), IndicatorFigures())
        assert noise is not None
        kept_apart += not noise.pooled
    assert kept_apart <= 10, "1 % of 300 sessions, with room for chance (p < 0.001)"


def test_an_indicator_with_ten_times_the_noise_is_kept_apart() -> None:
    for seed in range(20):
        data = session(0.002, seed=seed)
        generator = np.random.default_rng([seed, 1])
        louder = np.where(data.indicator == 1, generator.normal(scale=0.02, size=len(data)), 0.0)
        noise = reading_noise(replace(data, value_mm=data.value_mm + louder), IndicatorFigures())
        assert noise is not None
        assert not noise.pooled
        quiet, loud = (np.sqrt(indicator.variance_mm2) for indicator in noise.indicators)
        assert 3.0 < loud / quiet < 35.0
        repeatability = noise.repeatability_mm2(data)
        assert (
            repeatability[data.indicator == 1].min()
            > 9.0 * repeatability[data.indicator == 0].max()
        )


def test_those_that_scatter_alike_share_one_estimate_beside_a_loud_one() -> None:
    """Six mountings as indicators of their own, one ten times as loud: five keep 20 degrees."""
    honest, count = 0, 0
    for seed in range(100):
        data = replace(session(0.002, seed=seed), indicator=session(0.002).mount)
        generator = np.random.default_rng([seed, 2])
        louder = np.where(data.mount == 0, generator.normal(scale=0.02, size=len(data)), 0.0)
        noise = reading_noise(replace(data, value_mm=data.value_mm + louder), IndicatorFigures())
        assert noise is not None
        honest += noise.estimates.tolist() == [0, 1, 1, 1, 1, 1]
        count += bool(noise.outliers)
        if noise.estimates.tolist() == [0, 1, 1, 1, 1, 1]:
            assert noise.indicators[1].degrees_of_freedom == pytest.approx(20.0)
            assert noise.indicators[0].degrees_of_freedom == pytest.approx(4.0)
    assert honest >= 85
    assert count <= 30, "a loud indicator is not a row of outliers"


def test_a_mounting_without_repeats_does_not_part_the_others() -> None:
    """A stand moved for the last cycle: its mounting has one reading of each posture."""
    parted = 0
    for seed in range(100):
        data = session(0.003, seed=seed)
        again = (data.mount == 0) & (data.cycle == 2)
        mount = np.where(again, data.mount_count, data.mount)
        noise = reading_noise(replace(data, mount=mount, indicator=mount), IndicatorFigures())
        assert noise is not None
        parted += not noise.pooled
    assert parted <= 5, "1 % of 100 sessions, with room for chance"


def test_degrees_of_freedom_of_a_shared_estimate_count_once() -> None:
    """Welch and Satterthwaite by hand: (v0 + 5 v1)² / (v0²/4 + (5 v1)²/20)."""
    loud, quiet = IndicatorNoise(4e-4, 0.0, 4.0), IndicatorNoise(4e-6, 0.0, 20.0)
    noise = Noise((loud, *(quiet,) * 5), "repeats", pooled=False)
    expected = (4e-4 + 2e-5) ** 2 / (4e-4**2 / 4.0 + 2e-5**2 / 20.0)
    assert noise.degrees_of_freedom == pytest.approx(expected)


def test_a_wild_reading_is_flagged_and_still_counts() -> None:
    data = session(0.002, seed=2)
    value = data.value_mm.copy()
    value[17] += 0.05
    noise = reading_noise(replace(data, value_mm=value), IndicatorFigures())
    assert noise is not None
    assert [outlier.row for outlier in noise.outliers] == [17]
    assert noise.outliers[0].studentised > 5.0


def test_clean_sessions_have_no_wild_reading() -> None:
    flagged = sum(
        bool(outlying_readings(Repeats.of(data), 0.0))
        for data in (session(0.002, seed=seed) for seed in range(400))
    )
    assert flagged <= 12, "1 % of 400 sessions, with room for chance (p < 0.001)"


def test_studentised_residual_against_leaving_the_reading_out() -> None:
    """The definition: predict the reading from all others, divide by what they say of it."""
    data = session(0.01, seed=8)
    row = 23
    value = data.value_mm.copy()
    value[row] += 0.2
    data = replace(data, value_mm=value)
    repeats = Repeats.of(data)
    by_row = {w.row: w.studentised for w in outlying_readings(repeats, 0.0)}
    rows = np.delete(np.arange(len(data)), row)
    remaining = Repeats.of(data.take(rows))
    variance = float(remaining.sums_of_squares(value[rows, None]).sum())
    variance /= float(remaining.degrees_of_freedom.sum())
    share = 1.0 - repeats.leverage[row]
    residual = repeats.scatter(value[:, None])[row, 0]
    assert by_row[row] == pytest.approx(residual / np.sqrt(share * variance), rel=1e-9)


def test_one_cycle_tells_nothing() -> None:
    conditions = postures(repeats=1)
    data = observe(conditions, np.random.default_rng(0).normal(size=len(conditions)))
    assert float(Repeats.of(data).degrees_of_freedom.sum()) == 0.0
    assert reading_noise(data, IndicatorFigures()) is None
    assert reading_noise(data, IndicatorFigures(resolution_mm=0.01)) is not None


def exchanged(data: Observations, mount: int, cycle: int) -> tuple[Observations, list[int]]:
    """The readings of two postures of one set-up written down in each other's place, in one cycle.

    They are a millimetre or two apart.
    """
    there = np.flatnonzero((data.mount == mount) & (data.cycle == cycle))
    first, second = there[np.argsort(data.displacement_mm[there])[[0, -1]]].tolist()
    value = 10.0 * data.value_mm
    value[[first, second]] = value[[second, first]]
    return replace(data, value_mm=value), sorted([first, second])


def test_two_exchanged_postures_disagree_and_are_no_noise() -> None:
    """Repeats of two postures disagree by 1.6 mm: that leaves the scatter of the others alone."""
    for seed in range(20):
        data = session(0.002 / 10.0, seed=seed)
        clean = reading_noise(replace(data, value_mm=10.0 * data.value_mm), IndicatorFigures())
        mixed, rows = exchanged(data, mount=seed % 6, cycle=seed % 3)
        apart = disagreeing(Repeats.of(mixed), 0.0)
        noise = reading_noise(mixed, IndicatorFigures(), apart)
        assert clean is not None
        assert noise is not None
        assert set(rows) <= set(apart)
        assert len(apart) <= 3
        assert noise.standard_deviation_mm == pytest.approx(clean.standard_deviation_mm, rel=0.25)
        assert noise.degrees_of_freedom < clean.degrees_of_freedom


def test_of_two_repeats_that_disagree_neither_is_accused_alone() -> None:
    data = session(0.002, seed=4)
    data = data.take(data.cycle < 2)
    value = data.value_mm.copy()
    value[5] += 0.4
    apart = disagreeing(Repeats.of(replace(data, value_mm=value)), 0.0)
    partner = next(k for k in np.flatnonzero(data.cell == data.cell[5]).tolist() if k != 5)
    assert set(apart) == {5, partner}


def test_heavy_tails_disagree_with_nothing() -> None:
    """Student's t with 3 degrees of freedom: its tails are noise."""
    apart = 0
    for seed in range(300):
        heavy = 0.002 * np.random.default_rng([seed, 7]).standard_t(3.0, 54)
        apart += bool(disagreeing(Repeats.of(observe(session(0.0), heavy)), 0.0))
    assert apart <= 30, "one session in ten at most"


def test_beside_a_steady_drift_the_scatter_is_that_of_the_readings() -> None:
    """Times that are not those of the cycle before let a drift pass for scatter between cycles."""
    data = session(0.0)
    uneven = np.sort(np.random.default_rng(1).uniform(0.0, 600.0, len(data)))
    noise = 0.001 * np.random.default_rng(2).normal(size=len(data))
    drifting = replace(data, time_s=uneven, value_mm=data.value_mm + noise + 0.001 * uneven)
    of_cycles, steady = Repeats.of(drifting), Repeats.of(drifting, steady=True)
    assert steady.standard_deviation_mm == pytest.approx(0.001, rel=0.3)
    assert of_cycles.standard_deviation_mm is not None
    assert of_cycles.standard_deviation_mm > 0.003


def test_one_repeat_a_mounting_tells_the_noise_although_a_drift_could_explain_it() -> None:
    """The step of the display is not the noise where readings came back to Zero."""
    data = session(0.02)
    subset = data.take((data.cycle == 0) | ((data.cycle == 1) & (data.displacement_mm == 0.0)))
    once = replace(subset, cycle=np.zeros(len(subset), dtype=np.intp))
    stated = IndicatorFigures(resolution_mm=0.001)
    noise = reading_noise(once, stated, steady=True)
    assert noise is not None
    assert (noise.source, noise.degrees_of_freedom) == ("repeats", 6.0)
    assert noise.standard_deviation_mm == pytest.approx(0.02, rel=0.6)
