from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from calib import arrays
from calib.arrays import (
    DEPENDENT,
    basis_by_products,
    basis_of,
    condition,
    incidence,
    lengths,
    named_inside,
    null_space,
    numbered,
    onto,
    rank_of,
    rows_of,
    squares_in,
    svd_of_all,
    without,
    without_means,
)
from tests.builders import conditions_of

ROOT = Path(arrays.__file__).parents[1]
BY_HAND = re.compile(r"([\w.\[\]]+) @ \(\1\.T @")


def test_projections_are_written_in_one_place() -> None:
    rooms = [path for room in ("app", "calib") for path in (ROOT / room).rglob("*.py")]
    assert {path.name for path in rooms if BY_HAND.search(path.read_text("utf-8"))} == {"arrays.py"}


def test_a_projection_and_what_it_leaves() -> None:
    basis = basis_of(np.array([[1.0, 2.0], [1.0, 2.0], [0.0, 0.0]]), DEPENDENT)
    assert basis.shape == (3, 1)
    rows = np.array([3.0, 1.0, 5.0])
    assert onto(basis, rows) == pytest.approx([2.0, 2.0, 0.0])
    assert without(basis, rows) == pytest.approx([1.0, -1.0, 5.0])
    assert squares_in(basis, rows) == pytest.approx(8.0)


def test_ranks_are_cut_by_the_largest_or_by_what_the_columns_were() -> None:
    faint = np.diag([1e-5, 1e-6])
    assert rank_of(faint, 1e-3) == 2
    assert rank_of(faint, 1e-3, 1.0) == 0
    assert rank_of(np.zeros((4, 0)), 1e-3) == rank_of(np.zeros((4, 2)), 1e-3) == 0


def test_a_basis_by_products_is_the_same() -> None:
    columns = np.random.default_rng(3).normal(size=(40, 4)) @ np.diag([1.0, 5.0, 2.0, 0.0])
    first, second = basis_by_products(columns), basis_of(columns, DEPENDENT)
    assert first @ first.T == pytest.approx(second @ second.T, abs=1e-12)
    assert basis_by_products(1e-14 * columns).shape == (40, 0)


def test_null_spaces_and_values_of_few_rows() -> None:
    rows = np.array([[1.0, 1.0, 0.0]])
    assert np.abs(rows @ null_space(rows)).max() < 1e-15
    left_vectors, singular, right = svd_of_all(rows)
    assert left_vectors.shape == (1, 3)
    assert right.shape == (3, 3)
    assert singular == pytest.approx([np.sqrt(2.0), 0.0, 0.0])
    assert condition(np.diag([4.0, 2.0, 0.0]), 2) == pytest.approx(2.0)


def test_a_vector_of_a_space_is_named_once() -> None:
    first, second = np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    motions = [("one", first), ("again", 2.0 * first), ("out", second)]
    inside, remainder = named_inside(np.eye(3)[:, :2], motions)
    assert [name for _, name in inside] == ["one"]
    assert np.abs(remainder[:, 0]) == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0.0])


def test_groups_are_numbered_in_the_order_of_their_keys() -> None:
    group = numbered(np.array([1, 0, 1, 0]), np.array([5.0, 7.0, -5.0, 7.0]))
    assert group.tolist() == [2, 0, 1, 0]
    assert [rows.tolist() for rows in rows_of(group)] == [[1, 3], [2], [0]]
    assert rows_of(group[:0]) == []
    assert lengths(incidence(group)) == pytest.approx(np.sqrt([2.0, 1.0, 1.0]))


def test_means_of_groups_are_weighted() -> None:
    rows, weight = np.array([[1.0], [4.0], [9.0]]), np.array([2.0, 1.0, 1.0])
    deviations = without_means(np.array([0, 0, 1]), weight, rows)
    assert deviations == pytest.approx(np.array([[-1.0], [2.0], [0.0]]))


def test_no_readings_have_no_mounting_and_no_indicator() -> None:
    conditions = conditions_of("sweep")
    assert (conditions.mount_count, conditions.indicator_count) == (
        len(np.unique(conditions.mount)),
        len(np.unique(conditions.indicator)),
    )
    nothing = conditions.take(np.zeros(0, dtype=np.intp))
    assert (len(nothing), nothing.mount_count, nothing.indicator_count) == (0, 0, 0)
