"""Values for firmware of printers, part by part; `tests.app.exports.test_towers` has the files."""

from __future__ import annotations

import numpy as np
import pytest

from calib.tripod.pipeline import Model
from calib.tripod.towers import TowerEntries, each_alone, entered
from protocols.machine import load_machine

GEOMETRY = load_machine("linear-delta").geometry()
EVERY = TowerEntries(lengths=True, radii=True, angles=True, travels=True)
ONE_LENGTH = TowerEntries(lengths=False, radii=True, angles=True, travels=True)
OFF = Model(GEOMETRY, (0.4, -0.2, 0.1, 0.3, -0.25, 0.1))


def test_each_part_is_named_with_what_the_firmware_leaves_of_it() -> None:
    every = dict(each_alone(OFF, EVERY))
    assert list(every) == ["d_rho", "d_L"]
    assert max(every.values()) < 0.01
    one = dict(each_alone(OFF, ONE_LENGTH))
    assert one["d_rho"] < 0.01
    assert one["d_L"] > 3.0 * every["d_L"], "bars that are unlike"
    bars = OFF.with_parameters(np.array([0.0, 0.0, 0.0, 0.3, -0.25, 0.1]))
    assert [name for name, _ in each_alone(bars, EVERY)] == ["d_L"]


def test_contacts_are_as_uneven_as_before_where_nothing_is_entered() -> None:
    x, y = np.meshgrid([-60.0, 0.0, 60.0], [-60.0, 0.0, 60.0])
    height = 0.02 * np.random.default_rng(1).normal(size=x.size)
    places = np.column_stack([x.ravel(), y.ravel(), height])
    now, after = entered(Model(GEOMETRY), EVERY).uneven_mm(places, np.zeros(9))
    assert (now, after) == pytest.approx((height.std(), height.std()), rel=1e-6)
    over = np.linspace(0.0, 0.1, 9)
    lifted = entered(Model(GEOMETRY), EVERY).uneven_mm(places, over)
    assert lifted == pytest.approx([(height - over).std()] * 2, rel=1e-6)
    assert entered(OFF, EVERY).uneven_mm(places, np.zeros(9))[1] > 2.0 * height.std()
