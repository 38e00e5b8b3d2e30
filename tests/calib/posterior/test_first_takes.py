"""First takes within a play: the play keeps its size, and the take is named."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from calib.arrays import IntArray, Observations
from calib.posterior.apart import LOG_RANGE
from calib.posterior.cells import Cells, SessionCase
from calib.posterior.first_takes import WITHIN, WithinPlay, first_takes_apart
from calib.posterior.library import library
from calib.posterior.posterior import posterior
from calib.posterior.selection import SCALES
from calib.tripod.effects.drives import Backlash
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model
from tests.calib.posterior.sessions import SCATTER_MM, SHORT, SWEEP, case, with_values
from tests.conftest import first_quick

PLAY_MM = 0.05
PLAY = EffectInstance(Backlash(), "x", (PLAY_MM,))


def first_rows(observations: Observations) -> IntArray:
    """The first readings that play of x moves, of legs y and z."""
    first = np.unique(observations.mount, return_index=True)[1]
    return np.asarray(first[observations.axis[first] == 0])


def play_mm(observations: Observations) -> np.ndarray:
    """What the play does to each of them when the carriage came down."""
    rows = observations.take(first_rows(observations))
    down, up = (
        Model(effects=(PLAY,)).readings(replace(rows, movement=np.full((len(rows), 3), way)))
        for way in (-1.0, 1.0)
    )
    return np.asarray(down - up)


def within(observations: Observations, shares: tuple[float, float], seed: int) -> SessionCase:
    """A session with play of x, whose first takes stand within it."""
    session = case(observations, PLAY, seed=seed)
    value = session.observations.value_mm.copy()
    value[first_rows(observations)] += np.array(shares) * play_mm(observations)
    return with_values(session, value)


@pytest.mark.parametrize("observations", first_quick([SHORT, SWEEP]), ids=["short", "sweep"])
@pytest.mark.parametrize("shares", first_quick([(0.5, 0.4), (0.6, 0.0)]))
def test_a_first_take_within_a_play_is_named_and_the_play_keeps_its_size(
    observations: Observations, shares: tuple[float, float]
) -> None:
    answer = posterior([within(observations, shares, seed=21)])
    where = "all" if all(shares) else "y"
    assert answer.mistakes["first_take", where] > 0.5
    assert answer.places["backlash", "x"] > 0.9
    (column,) = answer.field.columns[Backlash(), "x"]
    size_mm = answer.mean[column]
    square = sum(
        model.weight
        * (
            model.inflated**2 * model.base[column, column]
            + (model.root[column] ** 2).sum()
            + (model.mean[column] - size_mm) ** 2
        )
        for model in answer.models_in_field
    )
    assert abs(size_mm - PLAY_MM) < 2.0 * math.sqrt(square)


@pytest.mark.parametrize("observations", first_quick([SHORT, SWEEP]), ids=["short", "sweep"])
@pytest.mark.parametrize("settled_mm", first_quick([0.06, 0.2]))
def test_a_stand_that_settled_is_named_beside_the_play_of_another_carriage(
    observations: Observations, settled_mm: float
) -> None:
    """Something else would explain both, and play of all carriages much of it."""
    session = case(observations, PLAY, seed=26)
    value = session.observations.value_mm.copy()
    first = np.unique(observations.mount, return_index=True)[1]
    value[first[observations.leg[first] == 2]] += settled_mm
    answer = posterior([with_values(session, value)])
    assert answer.mistakes["first_take", "z"] > 0.5
    assert answer.places["backlash", "x"] > 0.5


def test_without_a_play_a_little_departure_is_no_mistake() -> None:
    session = case(SWEEP, seed=22)
    value = session.observations.value_mm.copy()
    first = first_rows(SWEEP)[0]
    value[first] = value[SWEEP.posture == SWEEP.posture[first]].max() + 4.5 * SCATTER_MM
    changed = with_values(session, value)
    assert first_takes_apart(Cells.of(changed), 0) is not None
    answer = posterior([changed])
    assert answer.mistakes.get(("first_take", "y"), 0.0) < 0.05
    assert not [id_ for (id_, _), p in answer.places.items() if id_ == "backlash" and p > 0.2]


def test_an_adopted_play_makes_a_first_take_within_it_usual() -> None:
    session = within(SWEEP, (0.5, 0.0), seed=23)
    variant = replace(session, model=Model(effects=(PLAY,)), free={(Backlash(), "x"): (0, "")})
    assert posterior([variant]).mistakes["first_take", "y"] > 0.5


def test_a_play_reaches_one_first_take_and_every_far_one() -> None:
    session = case(SWEEP, PLAY, seed=25)
    value = session.observations.value_mm.copy()
    first = first_rows(SWEEP)
    value[first] += np.array([0.5, 0.4]) * play_mm(SWEEP)
    for more_mm, reached in ((0.0, True), (0.2, False)):
        value[first[0]] += more_mm
        cells = Cells.of(with_values(session, value))
        mistake = first_takes_apart(cells, 0)
        assert mistake is not None
        within = WithinPlay.of(Cells.of_visits(cells.case, mistake.visits))
        assert within is not None
        assert within.reached_by({"x": PLAY_MM}) == reached
        assert not within.reached_by({"y": PLAY_MM})
        assert not within.reached_by({"x": 0.1 * PLAY_MM})


def test_prior_of_a_first_take_within_a_play() -> None:
    """Density of a normal of the play's size, over that of a mistake of any size."""
    cells = Cells.of(within(SWEEP, (0.5, 0.4), seed=24))
    mistake = first_takes_apart(cells, 0)
    assert mistake is not None
    right = Cells.of_visits(cells.case, mistake.visits)
    first = WithinPlay.of(right)
    assert first is not None
    assert WithinPlay.of(cells) is None
    of_any_size = math.log(WITHIN) - np.log(2.0 * LOG_RANGE * first.off_mm).sum()
    assert mistake.log_prior == pytest.approx(of_any_size)
    expected_mm = np.abs([0.5, 0.4] * play_mm(SWEEP))
    assert first.off_mm == pytest.approx(expected_mm, abs=4.0 * SCATTER_MM)
    components = library([(right.model, right.means)])
    adopted, log_odds = first.log_more(components)
    assert adopted == 0.0
    (number,) = [k for k, c in enumerate(components) if (c.id, c.where) == ("backlash", "x")]
    unit_mm = 0.01 * np.abs(play_mm(SWEEP)) / PLAY_MM
    for row, scale in enumerate(SCALES):
        log = norm.logpdf(first.off_mm, scale=scale * unit_mm)
        log += np.log(2.0 * LOG_RANGE * first.off_mm)
        assert log_odds[row, number] == pytest.approx(log[log > 0.0].sum(), abs=0.02)
    columns = [k for k, component in enumerate(components) if component.id != "backlash"]
    assert not log_odds[:, columns].any()
