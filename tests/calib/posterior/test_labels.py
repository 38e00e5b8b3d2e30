"""Mistakes in readings: named where they are, with their aliases, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import FloatArray, IntArray, Observations
from calib.noise.reading import IndicatorFigures
from calib.posterior.apart import PRIOR, single_readings
from calib.posterior.cells import Cells, SessionCase
from calib.posterior.labels import MovedReadings
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.posterior.problem import PosteriorProblem
from calib.posterior.screening import Screen
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.drives import Backlash
from calib.tripod.effects.effect import EffectInstance
from tests.calib.posterior.sessions import SCATTER_MM, SHORT, SWEEP, case, with_values
from tests.conftest import LONG, first_quick


def named(answer: Posterior, least: float = 0.5) -> list[tuple[str, str]]:
    return [name for name, p in answer.mistakes.items() if p >= least]


def rows_of(
    observations: Observations, place: str, displacement_mm: float | None = None
) -> IntArray:
    leg, axis = map("xyz".index, place)
    rows = (observations.leg == leg) & (observations.axis == axis)
    if displacement_mm is not None:
        rows &= observations.displacement_mm == displacement_mm
    return np.flatnonzero(rows)


def changed(session: SessionCase, rows: IntArray, value_mm: FloatArray) -> Posterior:
    value = session.observations.value_mm.copy()
    value[rows] = value_mm
    return posterior([with_values(session, value)])


@pytest.mark.parametrize("observations", [SHORT, SWEEP], ids=["short", "sweep"])
@pytest.mark.parametrize("seed", first_quick(range(3)))
def test_in_a_clean_session_nothing_is_exchanged(observations: Observations, seed: int) -> None:
    assert not named(posterior([case(observations, seed=seed)]), least=0.05)


def test_a_play_is_no_mistake() -> None:
    session = case(SWEEP, EffectInstance(Backlash(), "y", (0.04,)), seed=4)
    answer = posterior([session])
    assert answer.places[("backlash", "y")] > 0.9
    assert not [name for name in named(answer) if name[0] != "first_take"]


def test_a_reversed_indicator() -> None:
    session = case(SHORT, seed=1)
    rows = rows_of(SHORT, "yz")
    assert named(changed(session, rows, -session.observations.value_mm[rows])) == [
        ("gauge_sign", "yz")
    ]


def test_an_indicator_reversed_on_both_legs_that_it_read() -> None:
    """Tables do not tell which readings one indicator took."""
    session = case(SHORT, seed=1)
    rows = np.concatenate([rows_of(SHORT, table) for table in ("xz", "yz")])
    answer = changed(session, rows, -session.observations.value_mm[rows])
    assert named(answer) == [("gauge_sign", "along z")]


@pytest.mark.parametrize("factor", first_quick([1000.0, 1.0 / 25.4, 25.4]))
@pytest.mark.parametrize(
    ("place", "tables"),
    first_quick([("z", ["zx", "zy"]), ("zx", ["zx"]), ("along z", ["xz", "yz"])], several=True),
)
def test_another_unit_of_a_leg_or_an_indicator(
    factor: float, place: str, tables: list[str]
) -> None:
    session = case(SHORT, seed=2)
    rows = np.concatenate([rows_of(SHORT, table) for table in tables])
    assert named(changed(session, rows, factor * session.observations.value_mm[rows])) == [
        ("unit_mixup", place)
    ]


def test_exchanged_indicators_and_the_exchange_of_legs_that_is_the_same_are_both_named() -> None:
    """What leaves the same readings has the same evidence: only their priors differ."""
    session = case(SHORT, seed=3)
    first, second = rows_of(SHORT, "zx"), rows_of(SHORT, "zy")
    value = session.observations.value_mm
    rows = np.concatenate([first, second])
    answer = changed(session, rows, np.concatenate([value[second], value[first]]))
    chances = answer.mistakes
    swap, legs = chances[("gauge_swap", "z")], chances[("legs_exchanged", "x,y")]
    assert swap + legs > 0.95
    # one place of three against one of six
    ratio = 2.0 * PRIOR["gauge_swap"] / PRIOR["legs_exchanged"]
    assert swap / legs == pytest.approx(ratio, rel=1.0)


def test_two_postures_of_a_cycle_are_no_noise() -> None:
    session = case(SHORT, seed=5)
    rows = np.array([rows_of(SHORT, "xy", 60.0)[1], rows_of(SHORT, "xy", -100.0)[1]])
    answer = changed(session, rows, session.observations.value_mm[rows[::-1]])
    assert named(answer) == [("postures_exchanged", "xy")]
    noise = answer.sessions[0].noise
    assert noise is not None
    assert noise.standard_deviation_mm == pytest.approx(0.002, rel=0.5)


def test_a_stand_that_moved_is_named_with_its_first_reading() -> None:
    session = case(SWEEP, seed=6)
    rows = rows_of(SWEEP, "yx")[9:]
    answer = changed(session, rows, session.observations.value_mm[rows] + 0.05)
    assert named(answer) == [("stand_slip", "yx")]
    (title,) = {m.title for model in answer.models for m in model.mistakes if model.weight > 0.5}
    words = SWEEP.posture_words(int(rows[0]))
    assert title == f"the stand moved before the reading at {words}, cycle {SWEEP.cycle[rows[0]]}"


@pytest.mark.parametrize("off_mm", first_quick([0.1, 2.0]))
def test_a_typing_error_is_named_and_pulls_nothing(off_mm: float) -> None:
    session = case(SHORT, seed=8)
    rows = rows_of(SHORT, "zy", -100.0)[:1]
    answer = changed(session, rows, session.observations.value_mm[rows] + off_mm)
    assert named(answer) == [("wild_reading", "zy")]
    clean = posterior([session])
    # one reading fewer of offsets that the tolerance of the bars leaves open by 0.07 mm
    assert np.abs(answer.mean - clean.mean)[:3].max() < 0.035


def test_a_reading_of_another_posture_is_a_wrong_label() -> None:
    session = case(SHORT, seed=9)
    rows, wrong = rows_of(SHORT, "xz", -100.0)[1:2], rows_of(SHORT, "xz", 60.0)
    answer = changed(session, rows, session.observations.value_mm[wrong[:1]])
    assert named(answer) == [("label_error", "xz")]
    (title,) = {m.title for model in answer.models for m in model.mistakes if model.weight > 0.5}
    assert title == "one reading is wrong, at -100 mm, cycle 2; it fits +60 mm"


@pytest.mark.parametrize("off_mm", first_quick([0.02, 0.06, 0.1]))
def test_a_stand_that_settles_after_its_first_take_is_no_play(off_mm: float) -> None:
    session = case(SHORT, seed=10)
    first = np.array([rows_of(SHORT, "yx")[0], rows_of(SHORT, "yz")[0]])
    answer = changed(session, first, session.observations.value_mm[first] + off_mm)
    assert named(answer) == [("first_take", "y")]
    assert sum(share for (id_, _), share in answer.places.items() if id_ == "backlash") < 0.1


@LONG
def test_weights_of_all_ways_to_put_a_session_right_are_one() -> None:
    session = case(SHORT, seed=3)
    first, second = rows_of(SHORT, "zx"), rows_of(SHORT, "zy")
    value = session.observations.value_mm
    rows = np.concatenate([first, second])
    answer = changed(session, rows, np.concatenate([value[second], value[first]]))
    assert sum(model.weight for model in answer.models) == pytest.approx(1.0)
    assert all(max(model.members, default=0) < len(answer.components) for model in answer.models)


@LONG
def test_a_mistake_in_one_of_two_sessions_is_that_of_the_one() -> None:
    first, second = case(SHORT, seed=1), case(SHORT, seed=1)
    value = second.observations.value_mm.copy()
    value[rows_of(SHORT, "yz")] *= -1.0
    for sessions in ([first, with_values(second, value)], [with_values(second, value), first]):
        assert named(posterior(sessions)) == [("gauge_sign", "yz")]


@LONG
def test_where_the_noise_is_stated_a_mistake_is_named_all_the_same() -> None:
    """Log evidences have another origin there: below zero."""
    session = case(SWEEP, seed=1)
    once = session.observations.take(session.observations.cycle == 1)
    figures = IndicatorFigures(repeatability_mm=SCATTER_MM)
    rows = rows_of(once, "yz")
    stated = replace(session, observations=once, indicator=figures)
    assert named(changed(stated, rows, -once.value_mm[rows])) == [("gauge_sign", "yz")]


def test_the_single_readings_that_are_tried_are_those_whose_omission_leaves_least() -> None:
    """Least squares with a zero of its own for each in turn; far-off postures bend the fit."""
    session = case(SWEEP, seed=3)
    value = session.observations.value_mm + np.random.default_rng(3).normal(0.0, 0.02, len(SWEEP))
    cells = Cells.of(with_values(session, value))
    screen = Screen(cells)
    count = len(cells.visits)
    without_one = []
    for row in range(count):
        own = np.zeros((len(screen.left), 1))
        own[row] = 1.0
        design = np.hstack([screen.basis, own])
        errors = screen.left - design @ np.linalg.lstsq(design, screen.left, rcond=None)[0]
        without_one.append(float(errors @ errors))
    expected = np.argsort(without_one, kind="stable")[:12].tolist()
    assert [int(suspect.groups[0][0]) for suspect in single_readings(screen)] == expected
    raw = np.argsort(-(screen.left[:count] ** 2), kind="stable")[:12].tolist()
    assert raw != expected


def test_exchanges_beside_one_name_are_those_that_leave_the_plain_fit_least() -> None:
    """Of all of them, one by one by least squares."""
    session = case(SWEEP, EffectInstance(Backlash(), "y", (0.04,)), seed=4)
    cells = Cells.of(session)
    screen = Screen(cells)
    moved, log_weights = MovedReadings(screen), []

    def with_one_name(change_mm: FloatArray) -> FloatArray:
        log_weights.append(change_mm)
        return np.zeros(change_mm.shape[1])

    mistakes = [mistake for _, mistake in moved.beside_one_name(screen, with_one_name)]
    squares = []
    for value_mm in moved.values_mm.T:
        rows = np.concatenate([(value_mm - screen.predicted_mm) / screen.root, screen.expected])
        errors = rows - screen.basis @ np.linalg.lstsq(screen.basis, rows, rcond=None)[0]
        squares.append(float(errors @ errors))
    order = np.argsort(squares, kind="stable")[:24]
    every = [moved.every[k] for k in order]
    assert [(m.id, m.where) for m in mistakes] == [(e.id, e.where) for e in every]
    changed = [moved.values_mm[:, k] - cells.visits.value_mm for k in order]
    weight = cells.weight / cells.scatter_mm2
    expected = [
        [np.average(change[cells.cell == n], weights=weight[cells.cell == n]) for change in changed]
        for n in range(len(cells.means))
    ]
    assert log_weights[0] == pytest.approx(np.array(expected), abs=1e-9)


def test_beside_a_mistake_stands_nothing_or_names_and_alone_one_name() -> None:
    session = case(SWEEP, EffectInstance(Backlash(), "y", (0.04,)), seed=4)
    problem = PosteriorProblem((Cells.of(session),), CATALOGUE)
    plain, *heaviest = problem.rivals(0, alone=False)
    assert plain[1].shape[1] == 0
    assert heaviest
    assert all(columns.shape[1] for _, columns in heaviest)
    assert min(log_weight for log_weight, _ in heaviest) > plain[0]
    alone = problem.rivals(0, alone=True)
    assert alone
    assert all(columns.shape[1] for _, columns in alone)
