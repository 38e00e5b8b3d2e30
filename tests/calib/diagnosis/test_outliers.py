"""Wild readings that look like wrong labels, and mistakes that hide each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from calib.arrays import IntArray, Observations
from calib.diagnosis.cleaning import clean
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.outliers import (
    REACH,
    Label,
    evened,
    labels_near,
    odds_of_label,
    other_labels,
    relabelled,
    set_outliers_right,
)
from calib.diagnosis.policy import POLICY
from calib.diagnosis.results import Named
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from tests.calib.diagnosis.diagnosed_sessions import LAWS, SHORT, SWEEP, TWO_STATION, case

SCATTER_MM = 0.002


def rows_at(observed: Observations, mount: int, level_mm: float) -> IntArray:
    there = (observed.mount == mount) & (observed.displacement_mm == level_mm)
    return np.flatnonzero(there)


def reading(observed: Observations, row: int, value_mm: float) -> Observations:
    value = observed.value_mm.copy()
    value[row] = value_mm
    return replace(observed, value_mm=value)


def posture_put_at(
    observed: Observations, mount: int, level_mm: float, value_mm: float
) -> Observations:
    """All readings of one posture shifted alike, as an effect may: their median is there."""
    rows = rows_at(observed, mount, level_mm)
    value = observed.value_mm.copy()
    value[rows] += value_mm - np.median(value[rows])
    return replace(observed, value_mm=value)


@pytest.mark.parametrize("off", [0.0, 1.0, 2.0])
def test_a_wild_reading_where_another_posture_reads_is_not_moved(off: float) -> None:
    """It agrees with another posture by accident; every posture was read as often as elsewhere."""
    one = case(SWEEP, seed=2)
    row = int(rows_at(one.observed, 2, 22.0)[1])
    there = float(one.observed.value_mm[row]) + 30.0 * SCATTER_MM
    observed = posture_put_at(one.observed, 2, -37.0, there)
    observed = reading(observed, row, there + off * SCATTER_MM)
    (found,) = set_outliers_right(observed)
    assert "wild_reading" in {found.id, *(each.id for each in found.or_else)}
    assert found.rows.tolist() == [row]
    left = np.delete(np.arange(len(observed)), row)
    assert np.array_equal(found.corrected.displacement_mm, observed.displacement_mm[left])
    assert np.array_equal(found.corrected.mount, observed.mount[left])


@pytest.mark.parametrize(("off", "first"), [(0.0, "label_error"), (3.0, "wild_reading")])
def test_a_fit_that_may_be_an_accident_is_told_with_both_names(off: float, first: str) -> None:
    """The nearer to the repeats elsewhere, the likelier a wrong label."""
    one = case(SWEEP, seed=2)
    row = int(rows_at(one.observed, 2, 22.0)[1])
    there = float(one.observed.value_mm[row]) + 60.0 * SCATTER_MM
    observed = posture_put_at(one.observed, 2, -37.0, there)
    (found,) = set_outliers_right(reading(observed, row, there + off * SCATTER_MM))
    (other,) = {"label_error", "wild_reading"} - {first}
    assert (found.id, found.or_else) == (first, (Named(other, "yx"),))
    words = {
        "wild_reading": "one outlier at +22 mm, cycle 1",
        "label_error": "the reading at +22 mm, cycle 1 belongs to -37 mm",
    }
    assert found.title == f"{words[first]}, or {words[other]}; it is not used"
    assert len(found.corrected) == len(observed) - 1


def test_the_same_reading_is_moved_where_the_counts_of_postures_say_so() -> None:
    """As before, and it is the reading that -37 mm has too few of."""
    one = case(SWEEP, seed=2)
    row = int(rows_at(one.observed, 2, -37.0)[1])
    there = float(np.median(one.observed.value_mm[rows_at(one.observed, 2, 22.0)]))
    observed = posture_put_at(one.observed, 2, -37.0, there + 60.0 * SCATTER_MM)
    levels = observed.displacement_mm.copy()
    levels[row] = 22.0
    (found,) = set_outliers_right(replace(observed, displacement_mm=levels))
    assert (found.id, found.or_else) == ("label_error", ())
    assert found.title.endswith("belongs to -37 mm")
    assert np.array_equal(found.corrected.displacement_mm, observed.displacement_mm)


def test_a_repeat_that_fits_elsewhere_is_not_moved_when_others_show_the_wild_one() -> None:
    """Two repeats of one approach contradict each other; those from the other side tell."""
    one = case(TWO_STATION, seed=1)
    wild, innocent = rows_at(one.observed, 3, 22.0)[[0, 2]]
    assert one.observed.approach[wild] == one.observed.approach[innocent]
    value = float(one.observed.value_mm[innocent])
    observed = posture_put_at(one.observed, 3, 60.0, value)
    observed = reading(observed, int(wild), value + 2500.0 * SCATTER_MM)
    (found,) = set_outliers_right(observed)
    assert (found.id, found.or_else) == ("wild_reading", ())
    assert found.rows.tolist() == [wild]


@pytest.mark.parametrize("wild", [0, 1])
@pytest.mark.parametrize("far", [40.0, 400.0])
def test_of_two_repeats_the_innocent_one_is_not_moved(wild: int, far: float) -> None:
    """It happens to read what another posture reads; the wild one fits nowhere."""
    one = case(SWEEP, seed=5)
    rows = rows_at(one.observed, 4, 60.0)
    assert len(rows) == 2
    innocent = float(one.observed.value_mm[rows[1 - wild]])
    observed = posture_put_at(one.observed, 4, -71.0, innocent)
    observed = reading(observed, int(rows[wild]), innocent - far * SCATTER_MM)
    (found,) = set_outliers_right(observed)
    named = {found.id, *(each.id for each in found.or_else)}
    assert "wild_reading" in named
    assert sorted(found.rows.tolist()) == rows.tolist()
    assert found.title.endswith("none of them is used")
    assert len(found.corrected) == len(observed) - 2


def test_a_reading_of_heavy_tails_is_not_moved() -> None:
    """Too near to be called wild: that it fits another place as well proves nothing."""
    one = case(SWEEP, seed=3)
    row = int(rows_at(one.observed, 1, 22.0)[2])
    mean = float(np.median(one.observed.value_mm[rows_at(one.observed, 1, 22.0)]))
    there = mean + 0.87 * POLICY.wild_sd * SCATTER_MM
    observed = reading(posture_put_at(one.observed, 1, 41.0, there), row, there)
    assert set_outliers_right(observed) == []


@pytest.mark.parametrize("taken", [SHORT, SWEEP, TWO_STATION])
@pytest.mark.parametrize("size_mm", [0.1, 0.4, 5.0])
def test_two_mistakes_do_not_hide_each_other(taken: Observations, size_mm: float) -> None:
    """Each of them alone would make the other look like scatter."""
    for seed in range(3):
        observed = case(taken, seed=seed).observed
        first, second = (int(np.flatnonzero(observed.mount == mount)[4]) for mount in (0, 3))
        value = observed.value_mm.copy()
        value[[first, second]] += size_mm, -1.1 * size_mm
        found = set_outliers_right(replace(observed, value_mm=value))
        assert len(found) == 2
        taken_out = {first, second}
        rest = found[-1].corrected.value_mm
        assert not taken_out & set(np.flatnonzero(np.isin(value, rest)).tolist())
        assert {each.id for each in found} <= {"wild_reading", "label_error"}


def test_two_mistakes_are_not_reported_as_noise() -> None:
    one = case(SHORT, seed=4)
    value = one.observed.value_mm.copy()
    value[np.flatnonzero(one.observed.mount == 1)[4]] += 0.4
    value[np.flatnonzero(one.observed.mount == 5)[7]] -= 0.4
    found = diagnose([one.with_readings(replace(one.observed, value_mm=value))], CATALOGUE)
    assert found.verdict != "agrees"
    assert [each.id for each in found.effects] == ["wild_reading", "wild_reading"]
    assert found.noise_mm == pytest.approx(SCATTER_MM, rel=0.5)


@pytest.mark.parametrize("taken", [SHORT, SWEEP, TWO_STATION])
def test_heavy_tails_hold_no_wrong_labels(taken: Observations) -> None:
    for seed in range(40):
        observed = case(taken, seed=seed, scatter_mm=1e-9).observed
        noise = SCATTER_MM * np.random.default_rng([8, seed]).standard_t(3, len(observed))
        found = set_outliers_right(replace(observed, value_mm=observed.value_mm + noise))
        assert "label_error" not in {each.id for each in found}


def test_two_wrong_labels_are_both_put_right() -> None:
    one = case(SHORT, seed=4)
    levels = one.observed.displacement_mm.copy()
    first, second = int(rows_at(one.observed, 1, 60.0)[1]), int(rows_at(one.observed, 5, 0.0)[1])
    levels[first], levels[second] = -100.0, 60.0
    wrong = replace(one.observed, displacement_mm=levels)
    found = diagnose([one.with_readings(wrong)], CATALOGUE)
    assert [each.id for each in found.effects] == ["label_error", "label_error"]
    assert found.noise_mm == pytest.approx(SCATTER_MM, rel=0.5)
    corrected = clean([one.with_readings(wrong)])[0][0].observed
    assert np.array_equal(corrected.displacement_mm, one.observed.displacement_mm)


@pytest.mark.parametrize("taken", [SHORT, SWEEP, TWO_STATION])
def test_first_readings_off_by_a_large_play_are_not_wild(taken: Observations) -> None:
    """Before the first reading nobody knows from where the machine came."""
    plays = [EffectInstance(LAWS["backlash"], leg, (0.5,)) for leg in "xyz"]
    for seed in range(4):
        assert set_outliers_right(case(taken, *plays, seed=seed).observed) == []


@pytest.mark.parametrize("taken", [SHORT, SWEEP, TWO_STATION])
def test_indicators_that_scatter_unequally_are_no_mistakes(taken: Observations) -> None:
    """One of six scatters three times as much as the others."""
    for seed in range(40):
        observed = case(taken, seed=seed, scatter_mm=1e-9).observed
        noise = SCATTER_MM * np.random.default_rng([8, seed]).normal(size=len(observed))
        noise *= np.where(observed.mount == seed % observed.mount_count, 3.0, 1.0)
        assert set_outliers_right(replace(observed, value_mm=observed.value_mm + noise)) == []


@pytest.mark.parametrize("fit", [0.0, 0.7, 3.0])
@pytest.mark.parametrize(("even", "times"), [(0.0, 1.0), (1.0, 10.0), (-1.0, 0.1)])
def test_the_odds_are_densities_of_a_fit_and_of_an_accident(
    fit: float, even: float, times: float
) -> None:
    by_accident = 7 / (2.0 * REACH * 50.0)
    expected = times * float(stats.t.pdf(fit, 4)) / by_accident
    assert odds_of_label(50.0, fit, 7, even) == pytest.approx(expected)


def posture_at(observed: Observations, level_mm: float) -> int:
    return int(observed.level[observed.displacement_mm == level_mm][0])


def test_a_changed_label_that_evens_the_postures() -> None:
    observed = case(SWEEP, seed=1).observed
    row = int(rows_at(observed, 2, -37.0)[1])
    uneven = relabelled(observed, row, Label(2, posture_at(observed, 22.0), ""))
    assert evened(uneven, observed) == 1.0
    assert evened(observed, uneven) == -1.0
    assert (
        evened(uneven, relabelled(observed, row, Label(2, posture_at(observed, 41.0), ""))) == 0.0
    )


def test_a_changed_leg_that_evens_the_postures() -> None:
    observed = case(SWEEP, seed=1).observed
    row = int(rows_at(observed, 2, -37.0)[1])
    (other,) = (each for each in other_labels(observed, row) if each.mount != 2)
    assert (other.words, other.posture) == ("leg Z", posture_at(observed, -37.0))
    uneven = relabelled(observed, row, other)
    assert evened(uneven, observed) == 1.0
    assert evened(observed, uneven) == -1.0


def test_the_labels_that_an_accident_may_hit() -> None:
    """Postures that read 0, 1, 2, … mm: a reading of 0 mm that shows 3 mm may lie up to 4.5 off."""
    one = case(SWEEP).observed
    levels = np.unique(one.displacement_mm)
    observed = replace(one, value_mm=np.searchsorted(levels, one.displacement_mm).astype(float))
    row = int(rows_at(observed, 2, float(levels[0]))[0])
    observed = reading(observed, row, 3.0)
    near, within_reach = labels_near(observed, row)
    assert [each.words for each in near] == [f"{level:+g} mm" for level in levels[2:5].tolist()]
    other_leg = 1
    assert within_reach == 4 + other_leg
