"""Mistakes in the data one by one, where each is hardest to tell from something else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import FloatArray, IntArray, Observations
from calib.diagnosis.results import CleanedReadings, Diagnosis, Finding
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import Cells, SessionCase
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from tests.calib.diagnosis.diagnosed_sessions import (
    LAWS,
    SHORT,
    SWEEP,
    TWO_STATION,
    case,
    diagnose,
    mistakes,
    names,
    possible,
    with_readings,
    with_values,
)
from tests.conftest import LONG, first_quick

SCATTER_MM = 0.002
SINGLE = ("wild_reading", "label_error")


def approached(observations: Observations) -> Observations:
    """Approaches as the labels tell them, by a loop of its own."""
    approach = np.zeros(len(observations))
    before: dict[int, tuple[float, float]] = {}
    for row, (mount, level) in enumerate(
        zip(observations.mount.tolist(), observations.displacement_mm.tolist(), strict=True)
    ):
        last, sign = before.get(mount, (level, 0.0))
        sign = float(np.sign(level - last)) or sign
        before[mount] = level, sign
        approach[row] = sign
    return replace(observations, approach=approach)


def rows_of(observations: Observations, mount: int) -> IntArray:
    return np.flatnonzero(observations.mount == mount)


def rows_at(observations: Observations, mount: int, level_mm: float) -> IntArray:
    there = (observations.mount == mount) & (observations.displacement_mm == level_mm)
    return np.flatnonzero(there)


def shifted(observations: Observations, rows: IntArray, by_mm: float) -> Observations:
    value = observations.value_mm.copy()
    value[rows] += by_mm
    return replace(observations, value_mm=value)


def reading(observations: Observations, row: int, value_mm: float) -> Observations:
    value = observations.value_mm.copy()
    value[row] = value_mm
    return replace(observations, value_mm=value)


def posture_put_at(
    observations: Observations, mount: int, level_mm: float, value_mm: float
) -> Observations:
    """All readings of one posture shifted alike, as an effect may: their median is there."""
    rows = rows_at(observations, mount, level_mm)
    return shifted(observations, rows, value_mm - float(np.median(observations.value_mm[rows])))


def under_level(observations: Observations, row: int, level_mm: float) -> Observations:
    levels = observations.displacement_mm.copy()
    levels[row] = level_mm
    return approached(replace(observations, displacement_mm=levels))


def under_mount(observations: Observations, row: int, mount: int) -> Observations:
    """A reading that was written down in the table of another indicator."""
    partner = rows_of(observations, mount)[0]
    moved = {}
    for name in ("leg", "axis", "station", "mount"):
        moved[name] = getattr(observations, name).copy()
        moved[name][row] = moved[name][partner]
    return approached(replace(observations, **moved))


def place_of(observations: Observations, row: int) -> str:
    return "xyz"[observations.leg[row]] + "xyz"[observations.axis[row]]


def diagnosed(session: SessionCase, observations: Observations) -> Diagnosis:
    return diagnose([with_readings(session, observations)], CATALOGUE)


def noise_mm(session: SessionCase) -> float:
    noise = Cells.of(session).noise
    return noise.standard_deviation_mm if noise else math.nan


def the_mistake(diagnosis: Diagnosis) -> Finding:
    (mistake,) = mistakes(diagnosis)
    return mistake


def cleaned(diagnosis: Diagnosis) -> CleanedReadings:
    (session,) = diagnosis.cleaned
    return session


def left_out(diagnosis: Diagnosis, count: int) -> list[int]:
    return sorted({*range(count)} - {*cleaned(diagnosis).rows.tolist()})


def single(diagnosis: Diagnosis) -> list[Finding]:
    return [mistake for mistake in mistakes(diagnosis) if mistake.id in SINGLE]


@pytest.mark.parametrize(
    ("conditions", "first", "by_mm"),
    first_quick(
        [
            (SHORT, 2, 0.05),
            (SHORT, 7, -0.05),
            (SWEEP, 11, 0.05),
            (SWEEP, 12, -0.1),
            (SWEEP, 17, 0.05),
        ],
        several=True,
    ),
)
def test_a_slip_is_no_drift_and_no_wild_reading(
    conditions: Observations, first: int, by_mm: float
) -> None:
    """Before the third reading, or between two cycles, repeats of one approach cannot tell."""
    session = case(conditions, seed=first)
    observations = session.observations
    rows = rows_of(observations, 3)
    diagnosis = diagnosed(session, shifted(observations, rows[first:], by_mm))
    slip = the_mistake(diagnosis)
    assert (slip.id, slip.where) == ("stand_slip", place_of(observations, rows[first]))
    assert f"before the reading at {observations.posture_words(rows[first])}" in slip.title
    slipped = np.flatnonzero(cleaned(diagnosis).slips)
    assert slipped.tolist() == rows[first:].tolist()
    assert np.unique(cleaned(diagnosis).observations.mount[rows]).size == 2


@LONG
@pytest.mark.parametrize("seed", first_quick(range(3)))
def test_slip_drift_and_wild_readings_are_told_apart(seed: int) -> None:
    session = case(SWEEP, seed=seed)
    clean = session.observations
    rows = rows_of(clean, 2)
    slip = diagnosed(session, shifted(clean, rows[9:], 0.05))
    assert "stand_slip" in {mistake.id for mistake in mistakes(slip)}
    wandering = clean.value_mm.copy()
    wandering[rows] += np.linspace(0.0, 0.1, len(rows))
    wild = shifted(clean, rows[[9]], 0.2)
    for readings in (replace(clean, value_mm=wandering), wild, clean):
        ids = {mistake.id for mistake in mistakes(diagnosed(session, readings))}
        assert "stand_slip" not in ids


@LONG
@pytest.mark.parametrize("conditions", first_quick([SHORT, SWEEP, TWO_STATION]))
@pytest.mark.parametrize("play_mm", first_quick([0.0, 0.03]))
@pytest.mark.parametrize(
    ("size", "sessions"), first_quick([(5.0, 2), (1.0, 2), (25.0, 4)], several=True)
)
def test_a_steady_drift_is_no_slip_whatever_the_play(
    conditions: Observations, play_mm: float, size: float, sessions: int
) -> None:
    """Of a drift of 5 or less none is called so even where a slip is as likely as none."""
    for seed in range(sessions):
        effects = (EffectInstance(LAWS["backlash"], "y", (play_mm,)),) if play_mm else ()
        session = case(conditions, *effects, seed=seed)
        observations = session.observations
        drift = 0.05 * (observations.time_s - observations.time_s[0]) / 3600.0
        diagnosis = diagnose(
            [with_values(session, observations.value_mm + size * drift)], CATALOGUE
        )
        assert "stand_slip" not in {mistake.id for mistake in mistakes(diagnosis)}


@LONG
def test_a_wrong_label_that_leaves_no_repeat() -> None:
    """+41 mm is never approached from below; the reading stands alone and its neighbour turns."""
    session = case(SWEEP, seed=2)
    observations = session.observations
    row = int(rows_of(observations, 2)[9])
    assert observations.displacement_mm[row] == -71.0
    diagnosis = diagnosed(session, under_level(observations, row, 41.0))
    mistake = the_mistake(diagnosis)
    assert (mistake.id, mistake.where) == ("label_error", "yx")
    assert mistake.title == "one reading is wrong, at +41 mm, cycle 1; it fits -71 mm"
    assert left_out(diagnosis, len(observations)) == [row]


@LONG
def test_two_readings_under_one_label_and_the_wrong_one_is_told() -> None:
    """Zero written down as +60 mm: both stand beside each other, repeats of one approach."""
    session = case(SHORT, seed=2)
    row = int(rows_of(session.observations, 1)[0])
    diagnosis = diagnosed(session, under_level(session.observations, row, 60.0))
    mistake = the_mistake(diagnosis)
    assert mistake.title == "one reading is wrong, at +60 mm, cycle 1; it fits Zero"
    assert left_out(diagnosis, len(session.observations)) == [row]


@LONG
@pytest.mark.parametrize("conditions", first_quick([SHORT, SWEEP]))
def test_a_reading_under_the_other_leg(conditions: Observations) -> None:
    session = case(conditions, seed=3)
    observations = session.observations
    row = int(rows_of(observations, 0)[2])
    mount = int(observations.mount[(observations.leg == 2) & (observations.axis == 1)][0])
    diagnosis = diagnosed(session, under_mount(observations, row, mount))
    mistake = the_mistake(diagnosis)
    assert (mistake.id, mistake.where) == ("label_error", "zy")
    assert mistake.title.endswith("it fits leg X")
    assert left_out(diagnosis, len(observations)) == [row]


@LONG
def test_a_wrong_label_beside_a_drift() -> None:
    session = case(SHORT, EffectInstance(LAWS["thermal_drift"], "x", (400.0,)), seed=4)
    observations = session.observations
    mount = int(observations.mount[(observations.leg == 1) & (observations.axis == 0)][0])
    row = int(rows_of(observations, mount)[2])
    mistake = the_mistake(diagnosed(session, under_level(observations, row, 0.0)))
    assert (mistake.id, mistake.where) == ("label_error", "yx")
    assert mistake.title.endswith("it fits -100 mm")


def test_of_two_repeats_the_other_postures_tell_which_is_wild() -> None:
    """+60 mm is read twice; a law that goes through all others goes through one of the two."""
    session = case(SWEEP, seed=5)
    rows = rows_of(session.observations, 4)[[2, 13]]
    assert session.observations.displacement_mm[rows].tolist() == [60.0, 60.0]
    diagnosis = diagnosed(session, shifted(session.observations, rows[:1], 0.1))
    assert the_mistake(diagnosis).id == "wild_reading"
    assert left_out(diagnosis, len(session.observations)) == rows[:1].tolist()


@LONG
@pytest.mark.parametrize(
    ("end", "ids"),
    first_quick([(0, {"first_take", "wild_reading"}), (-1, {"wild_reading"})], several=True),
)
def test_at_either_end_a_reading_that_stands_apart_is_left_out(end: int, ids: set[str]) -> None:
    """A stand that moved before the last one, or after the first, would leave the same readings."""
    session = case(SWEEP, seed=6)
    row = rows_of(session.observations, 1)[[end]]
    diagnosis = diagnosed(session, shifted(session.observations, row, 0.1))
    assert {name for name, _ in possible(diagnosis)} == ids
    assert {*row.tolist()} <= {*left_out(diagnosis, len(session.observations))}  # both of the stand


def test_a_flicker_of_the_display_is_no_wild_reading() -> None:
    session = case(SHORT, seed=7, scatter_mm=1e-9)
    row = rows_of(session.observations, 1)[[4]]
    steps = np.round(session.observations.value_mm / 0.001) * 0.001
    flickering = with_values(session, steps)
    flickering = with_readings(session, shifted(flickering.observations, row, 0.002))
    stepped = replace(flickering, indicator=IndicatorFigures(0.001))
    diagnosis = diagnose([stepped], CATALOGUE)
    assert (single(diagnosis), diagnosis.verdict) == ([], "agrees")


@pytest.mark.parametrize("factor", first_quick([25.4, 1.0 / 25.4]))
def test_readings_in_inches_bring_their_scatter_with_them(factor: float) -> None:
    session = case(SWEEP, EffectInstance(LAWS["gauge_gain"], "xy", (1.0,)), seed=8)
    observations = session.observations
    rows = rows_of(observations, 3)
    value = observations.value_mm.copy()
    value[rows] *= factor
    diagnosis = diagnose([with_values(session, value)], CATALOGUE)
    mistake = the_mistake(diagnosis)
    assert (mistake.id, mistake.where) == ("unit_mixup", place_of(observations, rows[0]))
    assert np.allclose(cleaned(diagnosis).observations.value_mm, observations.value_mm)


def exchanged(session: SessionCase, first: IntArray, second: IntArray) -> SessionCase:
    value = session.observations.value_mm.copy()
    value[first], value[second] = value[second], value[first].copy()
    return with_values(session, value)


def read_along(observations: Observations, leg: int, axis: int) -> IntArray:
    return np.flatnonzero((observations.leg == leg) & (observations.axis == axis))


@LONG
@pytest.mark.parametrize("seed", first_quick(range(3)))
def test_indicators_swapped_at_one_station_only(seed: int) -> None:
    session = case(TWO_STATION, seed=seed)
    observations = session.observations
    station = float(np.unique(observations.station)[seed % 2])
    first, second = (
        rows[observations.station[rows] == station]
        for rows in (read_along(observations, 1, 0), read_along(observations, 1, 2))
    )
    diagnosis = diagnose([exchanged(session, first, second)], CATALOGUE)
    assert names(diagnosis) == [("gauge_swap", "y")]
    assert diagnosis.effects[0].title.endswith(f"at station {station:g}")
    assert diagnosis.verdict == "explained"


@LONG
@pytest.mark.parametrize("seed", first_quick(range(3)))
def test_indicators_swapped_at_all_stations_are_one_mistake(seed: int) -> None:
    session = case(TWO_STATION, seed=seed)
    first, second = (read_along(session.observations, 2, axis) for axis in (0, 1))
    mistake = the_mistake(diagnose([exchanged(session, first, second)], CATALOGUE))
    assert (mistake.id, mistake.where) == ("gauge_swap", "z")
    assert mistake.title == "indicators exchanged"


@LONG
@pytest.mark.parametrize("seed", first_quick(range(3)))
def test_swapped_indicators_beside_a_strong_effect(seed: int) -> None:
    session = case(SWEEP, EffectInstance(LAWS["axis_offset"], "xy", (0.6,)), seed=seed)
    first, second = (read_along(session.observations, 1, axis) for axis in (0, 2))
    diagnosis = diagnose([exchanged(session, first, second)], CATALOGUE)
    assert ("gauge_swap", "y") in names(diagnosis)
    assert {finding.id for finding in diagnosis.effects} == {"gauge_swap", "axis_offset"}


@pytest.mark.parametrize("conditions", first_quick([SHORT, SWEEP, TWO_STATION]))
@pytest.mark.parametrize(
    ("effect", "where", "values"),
    first_quick(
        [
            ("backlash", "y", (0.08,)),
            ("thermal_drift", "z", (3000.0,)),
            ("leg_taper", "zx", (0.4,)),
            ("gauge_gain", "xy", (8.0,)),
            ("axis_offset", "xy", (2.0,)),
        ],
        several=True,
    ),
)
def test_strong_effects_are_no_mistakes(
    conditions: Observations, effect: str, where: str, values: tuple[float, ...]
) -> None:
    """Each is ten times the scatter of a reading or more, somewhere in the session."""
    for seed in range(2):
        session = case(conditions, EffectInstance(LAWS[effect], where, values), seed=seed)
        plain = case(conditions, seed=seed)
        change = np.abs(session.observations.value_mm - plain.observations.value_mm)
        assert change.max() > 10.0 * SCATTER_MM
        assert mistakes(diagnose([session], CATALOGUE)) == []


@LONG
@pytest.mark.parametrize(
    ("conditions", "sessions"),
    first_quick([(SWEEP, 4), (SWEEP, 12), (TWO_STATION, 12)], several=True),
)
def test_repeats_read_in_place_get_no_name(conditions: Observations, sessions: int) -> None:
    """Every posture is off by the scatter of a reading; the repeats do not show it."""
    keys = np.stack([conditions.mount, conditions.displacement_mm, conditions.approach])
    cell = np.unique(keys, axis=1, return_inverse=True)[1].ravel()
    doubts, count = 0, 0
    for seed in range(sessions):
        session = case(conditions, seed=seed)
        noise = SCATTER_MM * np.random.default_rng([7, seed]).normal(size=cell.max() + 1)
        diagnosis = diagnose([with_values(session, session.observations.value_mm + noise[cell])])
        assert diagnosis.verdict != "explained"
        doubts += diagnosis.verdict in ("unexplained", "partly-explained")
        count += bool(diagnosis.effects)
    assert doubts >= sessions - sessions // 6
    assert count <= 1


@pytest.mark.parametrize("off", first_quick([0.0, 2.0]))
def test_a_reading_that_another_posture_has_is_a_wrong_label(off: float) -> None:
    session = case(SWEEP, seed=2)
    row, partner = (int(rows_at(session.observations, 2, level)[1]) for level in (22.0, -37.0))
    there = float(session.observations.value_mm[partner])
    diagnosis = diagnosed(session, reading(session.observations, row, there + off * SCATTER_MM))
    (mistake,) = single(diagnosis)
    assert (mistake.id, mistake.title.rpartition("; ")[2]) == ("label_error", "it fits -37 mm")
    assert left_out(diagnosis, len(session.observations)) == [row]


@pytest.mark.parametrize(
    ("conditions", "level"), first_quick([(SWEEP, -37.0), (TWO_STATION, 60.0)], several=True)
)
@pytest.mark.parametrize("by_mm", first_quick([0.05, -0.3]))
def test_a_posture_that_was_another_in_all_cycles(
    conditions: Observations, level: float, by_mm: float
) -> None:
    session = case(conditions, seed=2)
    rows = rows_at(session.observations, 2, level)
    diagnosis = diagnosed(session, shifted(session.observations, rows, by_mm))
    mistake = the_mistake(diagnosis)
    assert (mistake.id, mistake.where) == (
        "posture_off",
        place_of(session.observations, int(rows[0])),
    )
    assert f"all readings at {level:+.0f} mm are off" in mistake.title
    assert diagnosis.verdict == "explained"
    assert left_out(diagnosis, len(conditions)) == sorted(rows.tolist())


def test_of_three_postures_none_is_called_another() -> None:
    """A law of travel goes through any three."""
    session = case(SHORT, seed=2)
    rows = rows_at(session.observations, 2, 60.0)
    diagnosis = diagnosed(session, shifted(session.observations, rows, 0.05))
    assert mistakes(diagnosis) == []
    assert diagnosis.verdict == "unexplained"


@LONG
def test_a_repeat_that_fits_elsewhere_is_not_moved_when_others_show_the_wild_one() -> None:
    """Two repeats of one approach contradict each other; those from the other side tell."""
    session = case(TWO_STATION, seed=1)
    wild, innocent = rows_at(session.observations, 3, 22.0)[[0, 2]]
    assert session.observations.approach[wild] == session.observations.approach[innocent]
    value = float(session.observations.value_mm[innocent])
    observations = posture_put_at(session.observations, 3, 60.0, value)
    observations = reading(observations, int(wild), value + 2500.0 * SCATTER_MM)
    diagnosis = diagnosed(session, observations)
    (mistake,) = single(diagnosis)
    assert (mistake.id, mistake.indistinguishable_from) == ("wild_reading", ())
    assert left_out(diagnosis, len(observations)) == [wild]


@LONG
def test_a_reading_of_heavy_tails_is_not_moved() -> None:
    """Too near to be called wild: that it fits another place as well proves nothing."""
    session = case(SWEEP, seed=3)
    row = int(rows_at(session.observations, 1, 22.0)[2])
    mean = float(np.median(session.observations.value_mm[rows_at(session.observations, 1, 22.0)]))
    there = mean + 0.87 * 17.0 * SCATTER_MM
    observations = reading(posture_put_at(session.observations, 1, 41.0, there), row, there)
    assert single(diagnosed(session, observations)) == []


@LONG
@pytest.mark.parametrize("conditions", first_quick([SHORT, SWEEP, TWO_STATION]))
@pytest.mark.parametrize("size_mm", first_quick([0.1, 0.4, 5.0]))
def test_two_mistakes_do_not_hide_each_other(conditions: Observations, size_mm: float) -> None:
    """Each of them alone would make the other look like scatter."""
    for seed in range(3):
        session = case(conditions, seed=seed)
        observations = session.observations
        first, second = (int(rows_of(observations, mount)[4]) for mount in (0, 3))
        value = observations.value_mm.copy()
        value[[first, second]] += size_mm, -1.1 * size_mm
        diagnosis = diagnose([with_values(session, value)], CATALOGUE)
        assert len(single(diagnosis)) == 2
        assert {first, second} <= {*left_out(diagnosis, len(observations))}


@LONG
def test_two_mistakes_are_not_reported_as_noise() -> None:
    session = case(SHORT, seed=4)
    value = session.observations.value_mm.copy()
    value[rows_of(session.observations, 1)[4]] += 0.4
    value[rows_of(session.observations, 5)[7]] -= 0.4
    session = with_values(session, value)
    diagnosis = diagnose([session], CATALOGUE)
    assert diagnosis.verdict != "agrees"
    assert [effect.id for effect in diagnosis.effects] == ["wild_reading", "wild_reading"]
    assert noise_mm(session) == pytest.approx(SCATTER_MM, rel=0.5)


def wildest(noises: Sequence[FloatArray], count: int) -> list[tuple[int, FloatArray]]:
    """Of sessions by their noise, with their numbers: a mistake is named where one reading is far
    off, so those with the farthest are tried for all.
    """
    order = sorted(enumerate(noises), key=lambda item: -float(np.abs(item[1]).max()))
    return order[:count]


@pytest.mark.parametrize("count", first_quick([3, 10]))
@pytest.mark.parametrize("conditions", first_quick([SHORT, SWEEP, TWO_STATION]))
def test_heavy_tails_hold_no_wrong_labels(conditions: Observations, count: int) -> None:
    """Of forty sessions; were labels doubted from 6 standard deviations on, three would fail."""
    noises = [
        SCATTER_MM * np.random.default_rng([8, seed]).standard_t(3, len(conditions))
        for seed in range(40)
    ]
    for seed, noise in wildest(noises, count):
        session = case(conditions, seed=seed, scatter_mm=1e-9)
        diagnosis = diagnose([with_values(session, session.observations.value_mm + noise)])
        assert "label_error" not in {effect.id for effect in mistakes(diagnosis)}


@LONG
def test_two_wrong_labels_are_both_told() -> None:
    session = case(SHORT, seed=4)
    observations = session.observations
    levels = observations.displacement_mm.copy()
    first, second = int(rows_at(observations, 1, 60.0)[1]), int(rows_at(observations, 5, 0.0)[1])
    levels[first], levels[second] = -100.0, 60.0
    session = with_readings(session, replace(observations, displacement_mm=levels))
    diagnosis = diagnose([session], CATALOGUE)
    assert [effect.id for effect in diagnosis.effects] == ["label_error", "label_error"]
    assert noise_mm(session) == pytest.approx(SCATTER_MM, rel=0.5)
    assert left_out(diagnosis, len(observations)) == [first, second]


@LONG
@pytest.mark.parametrize("conditions", first_quick([SHORT, SWEEP, TWO_STATION]))
def test_first_readings_off_by_a_large_play_are_not_wild(conditions: Observations) -> None:
    """Before the first reading nobody knows from where the machine came."""
    plays = [EffectInstance(LAWS["backlash"], leg, (0.5,)) for leg in "xyz"]
    for seed in range(4):
        assert single(diagnose([case(conditions, *plays, seed=seed)], CATALOGUE)) == []


@LONG
@pytest.mark.parametrize("count", first_quick([4, 14]))
@pytest.mark.parametrize("conditions", first_quick([SHORT, SWEEP, TWO_STATION]))
def test_indicators_that_scatter_unequally_are_no_mistakes(
    conditions: Observations, count: int
) -> None:
    """One of six scatters three times as much as the others, in forty sessions."""
    noises = []
    for seed in range(40):
        larger = np.where(conditions.mount == seed % conditions.mount_count, 3.0, 1.0)
        noise = SCATTER_MM * np.random.default_rng([8, seed]).normal(size=len(conditions))
        noises.append(noise * larger)
    for seed, noise in wildest(noises, count):
        session = case(conditions, seed=seed, scatter_mm=1e-9)
        diagnosis = diagnose([with_values(session, session.observations.value_mm + noise)])
        assert single(diagnosis) == []
