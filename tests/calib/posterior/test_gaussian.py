"""Linear problems against dense formulas: covariances inverted whole, no short cut."""

from __future__ import annotations

import numpy as np
import pytest

from calib.arrays import FloatArray
from calib.posterior.gaussian import About, LittleOfAll

SHAPES = [(9, 4), (4, 9), (6, 6), (5, 0)]
"""Rows and laws: fewer laws, fewer rows, as many, none."""


def drawn(rows: int, laws: int) -> FloatArray:
    return 3.0 * np.random.default_rng(rows).normal(size=(rows, laws))


@pytest.mark.parametrize(("rows", "laws"), SHAPES)
def test_rows_are_whitened_by_the_inverse_of_the_whole_covariance(rows: int, laws: int) -> None:
    columns = drawn(rows, laws)
    full = np.eye(rows) + columns @ columns.T
    little = LittleOfAll(columns)
    values = np.random.default_rng(1).normal(size=(rows, 3))
    white = little.whitened(values)
    assert white.T @ white == pytest.approx(values.T @ np.linalg.inv(full) @ values)
    assert little.whitened(values[:, 0]) == pytest.approx(white[:, 0])
    assert little.room == pytest.approx(-0.5 * np.linalg.slogdet(full).logabsdet)


@pytest.mark.parametrize(("rows", "laws"), SHAPES)
def test_what_is_left_of_the_laws(rows: int, laws: int) -> None:
    columns = drawn(rows, laws)
    little = LittleOfAll(columns)
    inverse = np.linalg.inv(np.eye(laws) + columns.T @ columns)
    assert little.root @ little.root.T == pytest.approx(inverse)
    # values of the laws for given rows: their covariance with the rows, times the inverse of these
    values = np.random.default_rng(2).normal(size=rows)
    expected = columns.T @ np.linalg.solve(np.eye(rows) + columns @ columns.T, values)
    assert little.seen.T @ little.whitened(values) == pytest.approx(expected)


def test_a_base_whose_expectations_correlate() -> None:
    generator = np.random.default_rng(3)
    base, residual = generator.normal(size=(7, 3)), generator.normal(size=7)
    expected = generator.normal(size=3)
    root = np.tril(generator.normal(size=(3, 3))) + 2.0 * np.eye(3)
    about = About.of(base, residual, expected, np.asarray(np.linalg.inv(root), dtype=np.float64))
    prior = np.linalg.inv(root @ root.T)
    covariance = np.linalg.inv(base.T @ base + prior)
    mean = covariance @ (base.T @ residual + prior @ expected)
    assert about.inverse @ about.along == pytest.approx(mean)
    assert about.inverse @ about.inverse.T == pytest.approx(covariance)
    off = residual - base @ expected
    spread = np.eye(7) + base @ root @ root.T @ base.T
    assert about.left @ about.left == pytest.approx(off @ np.linalg.solve(spread, off))
    assert about.room == pytest.approx(-0.5 * np.linalg.slogdet(spread).logabsdet)
