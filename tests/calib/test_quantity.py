"""How many decimals a figure has."""

from __future__ import annotations

import pytest

from calib.quantity import decimals


@pytest.mark.parametrize(
    ("size", "places"),
    [
        *((0.0, 4), (0.00123, 4), (0.0123, 3), (0.1, 2), (0.99, 2)),
        *((0.996, 1), (1.2, 1), (9.9, 1), (9.97, 0), (12.0, 0), (100.0, 0), (12345.0, 0)),
    ],
)
def test_a_size_has_two_digits_and_never_fewer_than_its_ones(size: float, places: int) -> None:
    assert decimals(size) == places
