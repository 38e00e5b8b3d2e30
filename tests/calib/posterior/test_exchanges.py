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


def rows_of(observations: Observations, place: str) -> IntArray:
    leg, axis = map("xyz".index, place)
    return np.flatnonzero((observations.leg == leg) & (observations.axis == axis))


@given(number=st.integers(0, len(EVERY) - 1), seed=st.integers(0, 99))
@settings(max_examples=60, deadline=None)
def test_done_twice_an_exchange_does_nothing_but_scale(number: int, seed: int) -> None:
    exchange = EVERY[number]
    value: FloatArray = np.random.default_rng(seed).normal(size=len(SWEEP))
    twice = exchange.put_right(exchange.put_right(value))
    touched = np.union1d(exchange.here, exchange.there)
    scale = np.ones(len(SWEEP))
    scale[touched] = exchange.factor**2
    assert np.allclose(twice, scale * value, rtol=1e-12)
    assert not np.allclose(exchange.put_right(value), value)


def test_each_exchange_is_there_once() -> None:
    done = [tuple(exchange.put_right(NUMBERS).tolist()) for exchange in EVERY]
    assert len(set(done)) == len(done)


def test_legs_exchange_column_by_column_and_crossed() -> None:
    numbers: FloatArray = np.arange(len(SHORT), dtype=np.float64)
    legs = [
        exchange
        for exchange in exchanges(SHORT)
        if (exchange.id, exchange.where) == ("legs_exchanged", "x,z")
    ]
    straight, crossed = (exchange.put_right(numbers) for exchange in legs)
    for values, pairs in ((straight, ("xz zx", "xy zy")), (crossed, ("xz zy", "xy zx"))):
        for pair in pairs:
            here, there = (rows_of(SHORT, place) for place in pair.split())
            assert values[here].tolist() == numbers[there].tolist()
            assert values[there].tolist() == numbers[here].tolist()
        untouched = [rows_of(SHORT, place) for place in ("yx", "yz")]
        assert all(values[rows].tolist() == numbers[rows].tolist() for rows in untouched)


def test_two_indicators_of_every_leg_and_two_postures_of_every_cycle_are_among_them() -> None:
    numbers = np.arange(len(SHORT), dtype=np.float64)
    done = {tuple(exchange.put_right(numbers).tolist()): exchange for exchange in exchanges(SHORT)}
    for leg in range(3):
        swapped = numbers.copy()
        first, second = (
            rows_of(SHORT, LEG_NAMES[leg] + LEG_NAMES[axis]) for axis in range(3) if axis != leg
        )
        swapped[first], swapped[second] = numbers[second], numbers[first]
        assert done[tuple(swapped.tolist())].id == "gauge_swap"
    for mount in range(6):
        for cycle in (1, 2, 3):
            gauge_rows = (SHORT.mount == mount) & (SHORT.cycle == cycle)
            high = np.flatnonzero(gauge_rows & (SHORT.displacement_mm == 60.0))
            low = np.flatnonzero(gauge_rows & (SHORT.displacement_mm == -100.0))
            swapped = numbers.copy()
            swapped[high], swapped[low] = numbers[low], numbers[high]
            swap = done[tuple(swapped.tolist())]
            assert swap.id == "postures_exchanged"
            assert swap.words(SHORT) == f"+60 mm and -100 mm exchanged in cycle {cycle}"
        high, low = (
            np.flatnonzero((SHORT.mount == mount) & (SHORT.displacement_mm == at))
            for at in (60.0, -100.0)
        )
        swapped = numbers.copy()
        swapped[high], swapped[low] = numbers[low], numbers[high]
        assert done[tuple(swapped.tolist())].words(SHORT) == (
            "+60 mm and -100 mm exchanged in all cycles"
        )
