"""Normal scores against the standard library, quantiles of mixtures against draws."""

from __future__ import annotations

import math
from fractions import Fraction
from statistics import NormalDist

import numpy as np
import pytest

from calib.stats import (
    mixture_moments,
    mixture_uncertainties,
    normal_scores,
    root_quantile,
)


def test_normal_scores_are_quantiles_of_the_ranks() -> None:
    values = np.array([3.0, -1.0, 7.0, 0.5])
    normal = NormalDist()
    expected = [normal.inv_cdf((rank - 0.375) / 4.25) for rank in (3, 1, 4, 2)]
    assert normal_scores(values) == pytest.approx(expected, abs=1e-12)
    assert normal_scores(np.array([5.0])) == pytest.approx([0.0])


def test_moments_of_a_mixture_are_those_of_its_models_in_fractions() -> None:
    weights, means, variances = (1, 3, 4), (3, -1, 5), (2, 0, 1)
    mean = sum(Fraction(w, 8) * m for w, m in zip(weights, means, strict=True))
    square = sum(
        Fraction(w, 8) * (v + m * m) for w, m, v in zip(weights, means, variances, strict=True)
    )
    parts = (np.array(part, dtype=float)[:, None] for part in (means, variances))
    moments = mixture_moments(np.array(weights) / 8.0, *parts)
    assert moments[0] == pytest.approx(float(mean))
    assert moments[1] == pytest.approx(math.sqrt(square - mean**2))


def test_models_that_agree_have_no_deviation_and_no_rounding_below_it() -> None:
    weight = np.full(7, 1.0 / 7.0)
    means = np.full((7, 3), [1234.567, -0.1, 0.0])
    mean, deviation = mixture_moments(weight, means, np.zeros((7, 3)))
    assert mean == pytest.approx(means[0])
    assert (deviation >= 0.0).all()
    assert (deviation < 1e-12).all()


def test_uncertainties_of_a_mixture_are_those_of_many_draws() -> None:
    weight, off = np.array([0.9, 0.1]), np.array([[0.0, 0.2], [3.0, 0.2]])
    variance = np.array([[1.0, 0.04], [0.25, 0.04]])
    standard, expanded = mixture_uncertainties(weight, off, variance)
    random = np.random.default_rng(1)
    model = random.choice(2, size=400_000, p=weight)
    drawn = off[model] + np.sqrt(variance[model]) * random.normal(size=(len(model), 2))
    assert standard == pytest.approx(np.sqrt((drawn**2).mean(axis=0)), rel=0.01)
    assert (np.abs(drawn) <= expanded).mean(axis=0) == pytest.approx(0.95, abs=0.002)
    alone = mixture_uncertainties(np.ones(1), np.zeros((1, 1)), np.full((1, 1), 4.0))
    assert alone[1] == pytest.approx(2.0 * NormalDist().inv_cdf(0.975))


@pytest.mark.parametrize("share", [0.0, 0.001, 0.01, 0.04, 0.3])
def test_a_model_of_little_weight_makes_no_bound_smaller(share: float) -> None:
    """The quantile of a mixture against draws: most of the weight at 0.01 mm, some at 1 mm."""
    generator = np.random.default_rng(8)
    weights, sizes, degrees = np.array([1.0 - share, share]), np.array([1e-5, 1e-3]), 4
    means = sizes**2
    quantile = root_quantile(weights, means, 2.0 * means**2 / degrees, 0.95)
    drawn = sizes[(generator.random(200_000) < share).astype(int)]
    off = drawn * np.sqrt(generator.chisquare(degrees, len(drawn)) / degrees)
    assert float((off > quantile).mean()) == pytest.approx(0.05, abs=0.003)
