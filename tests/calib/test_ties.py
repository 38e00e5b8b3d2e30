"""Equal but for rounding: the first one, in every order of magnitude."""

from __future__ import annotations

import numpy as np
import pytest

from calib.arrays import descending, largest, ranks

LAST_BIT = np.array([1.0, 1.0 + 1e-15, 1.0 - 1e-15])


@pytest.mark.parametrize("size", [1e-15, 1.0, 1e12])
def test_the_first_of_those_alike(size: float) -> None:
    for turned in (LAST_BIT, LAST_BIT[::-1], np.roll(LAST_BIT, 1)):
        assert largest(size * turned) == 0
        assert ranks(size * turned).tolist() == [0, 0, 0]
        assert descending("xyz", dict(zip("xyz", size * turned, strict=True)).__getitem__) == [
            *"xyz"
        ]


def test_what_differs_is_told_apart() -> None:
    values = np.array([1.0, 1.0 + 1e-8, -2.0, 5.0, 5.0])
    assert ranks(values).tolist() == [2, 1, 3, 0, 0]
    assert largest(values) == 3
    assert largest(-values) == 2


def test_numbers_that_cancel_are_judged_beside_their_unit() -> None:
    values = np.array([1e-14, -1e-14, 2e-14])
    assert ranks(values).tolist() == [1, 2, 0]
    assert ranks(values, 1.0).tolist() == [0, 0, 0]
    assert largest(values, 1.0) == 0


def test_infinite_and_no_numbers() -> None:
    values = np.array([-np.inf, 1.0, np.inf, -np.inf])
    assert ranks(values).tolist() == [2, 1, 0, 2]
    assert largest(values) == 2
    assert largest(np.array([-np.inf, -np.inf])) == 0
    assert ranks(np.array([])).tolist() == []
    assert descending([], float) == []
