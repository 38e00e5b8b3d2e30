"""Normal scores against the standard library's normal distribution."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest

from calib.stats import normal_scores


def test_normal_scores_are_quantiles_of_the_ranks() -> None:
    values = np.array([3.0, -1.0, 7.0, 0.5])
    normal = NormalDist()
    expected = [normal.inv_cdf((rank - 0.375) / 4.25) for rank in (3, 1, 4, 2)]
    assert normal_scores(values) == pytest.approx(expected, abs=1e-12)
    assert normal_scores(np.array([5.0])) == pytest.approx([0.0])
