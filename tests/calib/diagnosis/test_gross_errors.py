"""Mistakes in the data one by one, where each is hardest to tell from something else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import IntArray, Observations
from calib.diagnosis.cleaning import clean
from calib.diagnosis.diagnose import DOUBT, diagnose
from calib.diagnosis.gross_errors import find_shift
from calib.diagnosis.outliers import Label, relabelled, set_outliers_right
from calib.diagnosis.problem import Case
from calib.diagnosis.results import Finding
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from tests.calib.diagnosis.diagnosed_sessions import LAWS, SHORT, SWEEP, TWO_STATION, case

SCATTER_MM = 0.002


def approached(observed: Observations) -> Observations:
    """Approaches as the labels tell them, by a loop of its own."""
    found = np.zeros(len(observed))
    before: dict[int, tuple[float, float]] = {}
    for row, (mount, level) in enumerate(
        zip(observed.mount.tolist(), observed.displacement_mm.tolist(), strict=True)
    ):
        last, sign = before.get(mount, (level, 0.0))
        sign = float(np.sign(level - last)) or sign
        before[mount] = level, sign
        found[row] = sign
    return replace(observed, approach=found)


def rows_of(observed: Observations, mount: int) -> IntArray:
    return np.flatnonzero(observed.mount == mount)


def shifted(observed: Observations, rows: IntArray, by_mm: float) -> Observations:
    value = observed.value_mm.copy()
    value[rows] += by_mm
    return replace(observed, value_mm=value)


def under_level(observed: Observations, row: int, level_mm: float) -> Observations:
    levels = observed.displacement_mm.copy()
    levels[row] = level_mm
    return approached(replace(observed, displacement_mm=levels))


def mistakes(one: Case, observed: Observations) -> list[Finding]:
    return clean([one.with_readings(observed)], CATALOGUE)[1]


@pytest.mark.parametrize(
    ("taken", "first", "by_mm"),
    [(SHORT, 2, 0.05), (SHORT, 7, -0.05), (SWEEP, 11, 0.05), (SWEEP, 12, -0.1), (SWEEP, 17, 0.05)],
)
def test_a_slip_is_no_drift_and_no_wild_reading(
    taken: Observations, first: int, by_mm: float
) -> None:
    """Before the third reading, or between two cycles, repeats of one approach cannot tell."""
    clean_one = case(taken, seed=first).observed
    rows = rows_of(clean_one, 3)
    shift = find_shift(shifted(clean_one, rows[first:], by_mm))
    assert shift is not None
    assert shift.rows[0] == rows[first]
    assert f"before the reading at {clean_one.posture_words(rows[first])}" in shift.title
    assert np.abs(shift.corrected.value_mm - clean_one.value_mm).max() < 0.008


@pytest.mark.parametrize("taken", [SHORT, SWEEP, TWO_STATION])
@pytest.mark.parametrize("play_mm", [0.0, 0.03])
def test_a_steady_drift_is_no_slip_whatever_the_play(taken: Observations, play_mm: float) -> None:
    for seed in range(4):
        effects = (EffectInstance(LAWS["backlash"], "y", (play_mm,)),) if play_mm else ()
        observed = case(taken, *effects, seed=seed).observed
        drift = 0.05 * (observed.time_s - observed.time_s[0]) / 3600.0
        for size in (1.0, 5.0, 25.0):
            assert find_shift(replace(observed, value_mm=observed.value_mm + size * drift)) is None


def test_a_wrong_label_that_leaves_no_repeat() -> None:
    """+41 mm is never approached from below; the reading stands alone and its neighbour turns."""
    one = case(SWEEP, seed=2)
    row = int(rows_of(one.observed, 2)[9])
    assert one.observed.displacement_mm[row] == -71.0
    wrong = under_level(one.observed, row, 41.0)
    (found,) = set_outliers_right(wrong)
    assert (found.id, found.where) == ("label_error", "yx")
    assert found.rows.tolist() == [row]
    assert found.title == "the reading at +41 mm, cycle 1 belongs to -71 mm"
    assert np.array_equal(found.corrected.displacement_mm, one.observed.displacement_mm)
    assert np.array_equal(found.corrected.approach, approached(one.observed).approach)


def test_two_readings_under_one_label_and_the_wrong_one_is_told() -> None:
    """Zero written down as +60 mm: both stand beside each other, repeats of one approach."""
    one = case(SHORT, seed=2)
    row = int(rows_of(one.observed, 1)[0])
    wrong = under_level(one.observed, row, 60.0)
    (found,) = set_outliers_right(wrong)
    assert found.rows.tolist() == [row]
    assert found.title == "the reading at +60 mm, cycle 1 belongs to +0 mm"


@pytest.mark.parametrize("taken", [SHORT, SWEEP])
def test_a_reading_under_the_other_leg(taken: Observations) -> None:
    one = case(taken, seed=3)
    row = int(rows_of(one.observed, 0)[2])
    other = int(one.observed.mount[(one.observed.leg == 2) & (one.observed.axis == 1)][0])
    posture = int(one.observed.level[row])
    wrong = approached(relabelled(one.observed, row, Label(other, posture, "")))
    (found,) = set_outliers_right(wrong)
    assert (found.id, found.where) == ("label_error", "zy")
    assert found.title.endswith("belongs to leg X")
    assert np.array_equal(found.corrected.mount, one.observed.mount)


def test_a_wrong_label_beside_a_drift() -> None:
    one = case(SHORT, EffectInstance(LAWS["thermal_drift"], "x", (400.0,)), seed=4)
    mount = int(one.observed.mount[(one.observed.leg == 1) & (one.observed.axis == 0)][0])
    row = int(rows_of(one.observed, mount)[2])
    (found,) = mistakes(one, under_level(one.observed, row, 0.0))
    assert (found.id, found.where) == ("label_error", "yx")
    assert found.title.endswith("belongs to -100 mm")


def test_of_two_repeats_neither_can_be_called_wild() -> None:
    """+60 mm is read twice: one of the two is an outlier, and nothing tells which."""
    one = case(SWEEP, seed=5)
    rows = rows_of(one.observed, 4)[[2, 13]]
    assert one.observed.displacement_mm[rows].tolist() == [60.0, 60.0]
    found = set_outliers_right(shifted(one.observed, rows[:1], 0.1))
    assert [each.id for each in found] == ["wild_reading"]
    assert sorted(found[0].rows.tolist()) == rows.tolist()
    assert found[0].title == (
        "one reading is an outlier, at +60 mm, cycle 1 or at +60 mm, cycle 2; none of them is used"
    )
    assert len(found[0].corrected) == len(one.observed) - 2


@pytest.mark.parametrize(("end", "words"), [(0, "moved after it"), (-1, "moved before it")])
def test_at_either_end_a_slip_would_leave_the_same_readings(end: int, words: str) -> None:
    one = case(SWEEP, seed=6)
    row = rows_of(one.observed, 1)[[end]]
    found = diagnose([one.with_readings(shifted(one.observed, row, 0.1))], CATALOGUE)
    (mistake,) = found.effects
    assert mistake.id == "wild_reading"
    assert mistake.title.endswith(f"or the stand {words}")
    assert [(each.id, each.where) for each in mistake.indistinguishable_from] == [
        ("stand_slip", mistake.where)
    ]
    assert found.verdict == "ambiguous"


def test_a_flicker_of_the_display_is_no_wild_reading() -> None:
    one = case(SHORT, seed=7, scatter_mm=1e-9)
    row = rows_of(one.observed, 1)[[4]]
    steps = np.round(one.observed.value_mm / 0.001) * 0.001
    flickering = shifted(replace(one.observed, value_mm=steps), row, 0.002)
    assert set_outliers_right(flickering)
    assert set_outliers_right(flickering, step_mm=0.001) == []


@pytest.mark.parametrize("factor", [25.4, 1.0 / 25.4])
def test_readings_in_inches_bring_their_scatter_with_them(factor: float) -> None:
    one = case(SWEEP, EffectInstance(LAWS["gauge_gain"], "xy", (1.0,)), seed=8)
    rows = rows_of(one.observed, 3)
    value = one.observed.value_mm.copy()
    value[rows] *= factor
    found = mistakes(one, replace(one.observed, value_mm=value))
    place = "xyz"[one.observed.leg[rows[0]]] + "xyz"[one.observed.axis[rows[0]]]
    assert [(each.id, each.where) for each in found] == [("unit_mixup", place)]
    (corrected,) = clean([one.with_readings(replace(one.observed, value_mm=value))])[0]
    assert np.allclose(corrected.observed.value_mm, one.observed.value_mm)


@pytest.mark.parametrize("seed", range(3))
def test_indicators_swapped_at_one_station_only(seed: int) -> None:
    one = case(TWO_STATION, seed=seed)
    station = float(np.unique(one.observed.station)[seed % 2])
    first, second = (
        np.flatnonzero(
            (one.observed.leg == 1)
            & (one.observed.axis == axis)
            & (one.observed.station == station)
        )
        for axis in (0, 2)
    )
    value = one.observed.value_mm.copy()
    value[first], value[second] = value[second], value[first].copy()
    found = diagnose([one.with_readings(replace(one.observed, value_mm=value))], CATALOGUE)
    assert [(each.id, each.where) for each in found.effects] == [("gauge_swap", "y")]
    assert found.effects[0].title.endswith(f"at station {station:g}")
    assert found.verdict == "explained"


@pytest.mark.parametrize("seed", range(3))
def test_indicators_swapped_at_all_stations_are_one_mistake(seed: int) -> None:
    one = case(TWO_STATION, seed=seed)
    first, second = (
        np.flatnonzero((one.observed.leg == 2) & (one.observed.axis == axis)) for axis in (0, 1)
    )
    value = one.observed.value_mm.copy()
    value[first], value[second] = value[second], value[first].copy()
    (found,) = mistakes(one, replace(one.observed, value_mm=value))
    assert (found.id, found.where) == ("gauge_swap", "z")
    assert found.title == "indicators exchanged"


@pytest.mark.parametrize("seed", range(3))
def test_swapped_indicators_beside_a_strong_effect(seed: int) -> None:
    one = case(SWEEP, EffectInstance(LAWS["axis_offset"], "xy", (0.6,)), seed=seed)
    first, second = (
        np.flatnonzero((one.observed.leg == 1) & (one.observed.axis == axis)) for axis in (0, 2)
    )
    value = one.observed.value_mm.copy()
    value[first], value[second] = value[second], value[first].copy()
    found = diagnose([one.with_readings(replace(one.observed, value_mm=value))], CATALOGUE)
    named = {(each.id, each.where) for each in found.effects}
    assert ("gauge_swap", "y") in named
    assert {each.id for each in found.effects} == {"gauge_swap", "axis_offset"}


@pytest.mark.parametrize("taken", [SHORT, SWEEP, TWO_STATION])
@pytest.mark.parametrize(
    ("effect", "where", "values"),
    [
        ("backlash", "y", (0.08,)),
        ("thermal_drift", "z", (3000.0,)),
        ("leg_taper", "zx", (0.4,)),
        ("gauge_gain", "xy", (8.0,)),
        ("axis_offset", "xy", (2.0,)),
    ],
)
def test_strong_effects_are_no_mistakes(
    taken: Observations, effect: str, where: str, values: tuple[float, ...]
) -> None:
    """Each is ten times the scatter of a reading or more, somewhere in the session."""
    for seed in range(2):
        one = case(taken, EffectInstance(LAWS[effect], where, values), seed=seed)
        plain = case(taken, seed=seed)
        assert np.abs(one.observed.value_mm - plain.observed.value_mm).max() > 10.0 * SCATTER_MM
        assert mistakes(one, one.observed) == []


@pytest.mark.parametrize("taken", [SWEEP, TWO_STATION])
def test_repeats_read_in_place_get_no_name(taken: Observations) -> None:
    """Every posture is off by the scatter of a reading; the repeats do not show it."""
    keys = np.stack([taken.mount, taken.displacement_mm, taken.approach])
    cell = np.unique(keys, axis=1, return_inverse=True)[1].ravel()
    doubts = 0
    for seed in range(12):
        one = case(taken, seed=seed)
        own = SCATTER_MM * np.random.default_rng([7, seed]).normal(size=cell.max() + 1)
        locked = replace(one.observed, value_mm=one.observed.value_mm + own[cell])
        found = diagnose([one.with_readings(locked)], CATALOGUE)
        assert found.effects == ()
        doubts += DOUBT in found.remarks or found.verdict == "unexplained"
    assert doubts >= 10
