"""Exchanges of labels: what each puts where, and that the mistakes of others are among them."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.arrays import LEG_NAMES, FloatArray, IntArray, Observations
from calib.posterior.exchanges import exchanges
from tests.calib.posterior.sessions import SHORT, SWEEP

EVERY = list(exchanges(SWEEP))
NUMBERS: FloatArray = 1.0 + np.arange(len(SWEEP), dtype=np.float64)


def rows_of(taken: Observations, place: str) -> IntArray:
    leg, axis = map("xyz".index, place)
    return np.flatnonzero((taken.leg == leg) & (taken.axis == axis))


@given(number=st.integers(0, len(EVERY) - 1), seed=st.integers(0, 99))
@settings(max_examples=60, deadline=None)
def test_done_twice_an_exchange_does_nothing_but_scale(number: int, seed: int) -> None:
    one = EVERY[number]
    value: FloatArray = np.random.default_rng(seed).normal(size=len(SWEEP))
    twice = one.put_right(one.put_right(value))
    touched = np.union1d(one.here, one.there)
    scale = np.ones(len(SWEEP))
    scale[touched] = one.factor**2
    assert np.allclose(twice, scale * value, rtol=1e-12)
    assert not np.allclose(one.put_right(value), value)


def test_each_exchange_is_there_once() -> None:
    done = [tuple(one.put_right(NUMBERS).tolist()) for one in EVERY]
    assert len(set(done)) == len(done)


def test_legs_exchange_column_by_column_and_crossed() -> None:
    numbers: FloatArray = np.arange(len(SHORT), dtype=np.float64)
    legs = [one for one in exchanges(SHORT) if (one.id, one.where) == ("legs_exchanged", "x,z")]
    straight, crossed = (one.put_right(numbers) for one in legs)
    for one, pairs in ((straight, ("xz zx", "xy zy")), (crossed, ("xz zy", "xy zx"))):
        for pair in pairs:
            here, there = (rows_of(SHORT, place) for place in pair.split())
            assert one[here].tolist() == numbers[there].tolist()
            assert one[there].tolist() == numbers[here].tolist()
        untouched = [rows_of(SHORT, place) for place in ("yx", "yz")]
        assert all(one[rows].tolist() == numbers[rows].tolist() for rows in untouched)


def test_two_indicators_of_every_leg_and_two_postures_of_every_cycle_are_among_them() -> None:
    numbers = np.arange(len(SHORT), dtype=np.float64)
    done = {tuple(one.put_right(numbers).tolist()): one for one in exchanges(SHORT)}
    for leg in range(3):
        swapped = numbers.copy()
        first, second = (
            rows_of(SHORT, LEG_NAMES[leg] + LEG_NAMES[axis]) for axis in range(3) if axis != leg
        )
        swapped[first], swapped[second] = numbers[second], numbers[first]
        assert done[tuple(swapped.tolist())].id == "gauge_swap"
    for mount in range(6):
        for cycle in (1, 2, 3):
            mine = (SHORT.mount == mount) & (SHORT.cycle == cycle)
            high = np.flatnonzero(mine & (SHORT.displacement_mm == 60.0))
            low = np.flatnonzero(mine & (SHORT.displacement_mm == -100.0))
            swapped = numbers.copy()
            swapped[high], swapped[low] = numbers[low], numbers[high]
            one = done[tuple(swapped.tolist())]
            assert one.id == "postures_exchanged"
            assert one.words(SHORT) == f"+60 mm and -100 mm exchanged in cycle {cycle}"
