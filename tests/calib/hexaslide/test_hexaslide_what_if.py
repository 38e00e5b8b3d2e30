"""Moved sizes of causes, beside what the program does where they are adopted at these."""

from __future__ import annotations

import numpy as np
import pytest

from calib.hexaslide.causes import AdoptedEffect
from calib.hexaslide.diagnosis import weighed
from calib.hexaslide.what_if import PostureTrial
from protocols.hexaslide import load_hexaslide
from tests.blind.hexaslide import LEAD_M, Hidden, Plain, measured

FILE = load_hexaslide()
NAME = ("rail_scale", "rail 3")


@pytest.fixture(scope="module")
def trial() -> PostureTrial:
    chance = np.random.default_rng(22)
    hidden = Hidden("rail_scale", 2, 5e-4)
    readings = measured(Plain(FILE, chance), FILE, "position", hidden, chance)
    tolerances = FILE.tolerances.of(readings.procedure.parameters)
    models = weighed(readings, FILE.whole(), tolerances, LEAD_M)
    return PostureTrial.of(models, NAME, FILE.whole())


@pytest.mark.parametrize("size", [0.0, 0.3, 1.2])
def test_what_is_left_is_what_a_fit_leaves_beside_that_size(
    trial: PostureTrial, size: float
) -> None:
    """A fit to readings with carriages moved so is not linear."""
    models = trial.models
    constant = AdoptedEffect(*NAME, (size,), held=True)
    beside = weighed(
        models.readings, FILE.whole(), models.tolerances, models.lead_m, (constant,), models.middle
    )
    square = beside.mean_square(beside.free)[0]
    assert trial.at((size,)).times_noise ** 2 == pytest.approx(square, rel=0.01)


def test_the_best_size_leaves_least_and_steps_stay_in_bounds(trial: PostureTrial) -> None:
    (best,), (deviation,) = trial.best, trial.deviations
    assert best == pytest.approx(0.5, abs=3.5 * deviation)
    squares = [trial.at((best + by * deviation,)).times_noise ** 2 for by in (-1, 0, 1)]
    assert squares[1] == min(squares)
    assert (squares[0] - squares[1]) * trial.models.spare == pytest.approx(1.0, rel=1e-6)
    (step,) = trial.sizes.steps
    assert 0.3 * deviation < step <= deviation
    assert trial.sizes.moved((best,), 0, 10**6)[0] == 10.0
    at = trial.at((0.5,))
    assert at.alone_m > 0.0
    assert at.misled_m > 0.0
    assert trial.at((1.0,)).misled_m == pytest.approx(2.0 * at.misled_m)
