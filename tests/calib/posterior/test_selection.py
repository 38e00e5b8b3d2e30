"""Models are weighed as by their marginal likelihood, worked out densely by scipy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, product

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from calib.arrays import FloatArray, IntArray
from calib.posterior.selection import (
    CAUSES,
    LIGHTEST,
    LOG_SCALES,
    NARROW,
    SCALES,
    TRIPLES_FROM,
    ModelSelection,
    Products,
)

ROWS = 14
Weights = dict[tuple[tuple[int, float], ...], float]


def columns_of(widths: Sequence[int]) -> list[IntArray]:
    ends = np.cumsum(widths)
    pairs = zip(ends - widths, ends, strict=True)
    return [np.arange(first, last, dtype=np.intp) for first, last in pairs]


def selection_of(
    design: FloatArray, y: FloatArray, columns: Sequence[IntArray], freedom: float
) -> ModelSelection:
    prior = np.log(np.arange(1.0, len(columns) + 1.0) / 20.0)
    products = Products.of(design, y)
    return ModelSelection(products, columns, prior, len(y), freedom)


def dense_log_evidence(
    design: FloatArray, y: FloatArray, selection: ModelSelection, model: Sequence[tuple[int, float]]
) -> float:
    """Of ``y`` with normal sizes integrated: a normal, or Student's t where noise is estimated."""
    covariance = np.eye(len(y))
    for k, scale in model:
        block = scale * design[:, selection.columns[k]]
        covariance += block @ block.T
    if math.isinf(selection.freedom):
        return float(multivariate_normal(np.zeros(len(y)), covariance).logpdf(y))
    return float(multivariate_t(np.zeros(len(y)), covariance, df=int(selection.freedom)).logpdf(y))


def dense(design: FloatArray, y: FloatArray, selection: ModelSelection, largest: int) -> Weights:
    """Weights of all models of at most so many components, normalised."""
    log: Weights = {}
    for count in range(largest + 1):
        for members in combinations(range(len(selection.columns)), count):
            for rows in product(range(len(SCALES)), repeat=count):
                model = tuple((k, SCALES[r]) for k, r in zip(members, rows, strict=True))
                prior = math.log(CAUSES[count]) + sum(selection.log_prior[k] for k in members)
                prior += sum(LOG_SCALES[r] for r in rows)
                log[model] = dense_log_evidence(design, y, selection, model) + float(prior)
    top = max(log.values())
    total = math.fsum(math.exp(value - top) for value in log.values())
    return {model: math.exp(value - top) / total for model, value in log.items()}


def weights_of(selection: ModelSelection) -> Weights:
    entries = selection.entries()
    largest = max(entry.log_weight for entry in entries)
    shares = [math.exp(entry.log_weight - largest) for entry in entries]
    return {
        entry.key: share / math.fsum(shares) for entry, share in zip(entries, shares, strict=True)
    }


@pytest.mark.parametrize("freedom", [math.inf, 9.0])
@pytest.mark.parametrize("seed", range(4))
def test_weights_are_those_of_all_models_of_up_to_three(seed: int, freedom: float) -> None:
    rng = np.random.default_rng(seed)
    columns = columns_of((1, 2, 1, 3))
    design = rng.normal(size=(ROWS, 7))
    y = rng.normal(size=ROWS) + design[:, :3] @ rng.normal(size=3) * seed
    selection = selection_of(design, y, columns, freedom)
    expected, weights = dense(design, y, selection, 3), weights_of(selection)
    assert len(list(combinations(columns, 2))) <= TRIPLES_FROM  # so no triple is left untried
    best = max(expected, key=expected.__getitem__)
    for model, weight in weights.items():
        ratio = expected[model] / expected[best]
        assert weight / weights[best] == pytest.approx(ratio, rel=1e-6), model
    # three components stand at the best scales of a pair of them: little else is missing
    untried = {model for model, w in expected.items() if w > 2.0 * LIGHTEST} - weights.keys()
    assert all(len(model) == 3 for model in untried)
    assert math.fsum(expected[model] for model in untried) < 0.01


def test_a_pair_of_which_neither_helps_alone_is_found_among_many() -> None:
    """Each of the two takes up next to nothing alone; forty others take up more by chance."""
    rng = np.random.default_rng(5)
    noise = rng.normal(size=(ROWS, 40))
    shared, hidden = np.linalg.qr(rng.normal(size=(ROWS, 2)))[0].T
    first, second = 20.0 * shared + hidden, 20.0 * shared - hidden
    design = np.column_stack([noise, first, second])
    y = 30.0 * hidden + 0.3 * rng.normal(size=ROWS)
    selection = selection_of(design, y, columns_of((1,) * 42), math.inf)
    square, _ = selection.one_more()  # what each leaves alone
    assert (np.argsort(square.min(axis=0))[:25] < 40).all()
    assert selection.entries()[0].members == (40, 41)


def test_a_wide_component_runs_beside_narrow_ones() -> None:
    """Something else has more columns than are paired at once."""
    rng = np.random.default_rng(2)
    columns = columns_of((1, 1, NARROW + 1))
    design = rng.normal(size=(ROWS + 6, NARROW + 3))
    y = rng.normal(size=ROWS + 6) + 40.0 * design[:, 0] + design[:, 2:] @ np.full(NARROW + 1, 2.0)
    selection = selection_of(design, y, columns, math.inf)
    expected, weights = dense(design, y, selection, 3), weights_of(selection)
    model = max(expected, key=expected.__getitem__)
    assert {k for k, _ in model} >= {0, 2}
    assert weights[model] == pytest.approx(expected[model], rel=0.01)


def test_components_that_are_the_same_have_the_same_weight() -> None:
    rng = np.random.default_rng(8)
    design = rng.normal(size=(ROWS, 3))
    design[:, 1] = design[:, 0]
    y = rng.normal(size=ROWS) + 9.0 * design[:, 0]
    selection = selection_of(design, y, columns_of((1, 1, 1)), math.inf)
    alike = ModelSelection(
        selection.products, selection.columns, np.full(3, -3.0), selection.free, selection.freedom
    )
    weights = weights_of(alike)
    for scale in SCALES:
        first, second = weights.get(((0, scale),), 0.0), weights.get(((1, scale),), 0.0)
        assert first == pytest.approx(second, rel=1e-9)


@pytest.mark.parametrize("freedom", [math.inf, 9.0])
def test_the_best_single_component_for_other_readings_is_that_of_all_weighed_densely(
    freedom: float,
) -> None:
    rng = np.random.default_rng(4)
    columns, subset = columns_of((1, 2, 1, 3)), (1, 2)
    design = rng.normal(size=(ROWS, 7))
    first, *others = rng.normal(size=(4, ROWS)) * np.array([[1.0], [1.0], [3.0], [9.0]])
    selection = selection_of(design, first, columns, freedom)
    y = np.array(others).T
    best = selection.best_singles(design.T @ y, (y**2).sum(axis=0), subset)
    nothing = [dense_log_evidence(design, readings, selection, ()) for readings in others]
    for readings, weight, plain in zip(others, best, nothing, strict=True):
        expected = max(
            dense_log_evidence(design, readings, selection, ((k, scale),))
            + selection.log_prior[k]
            + log_scale
            for k in subset
            for scale, log_scale in zip(SCALES, LOG_SCALES, strict=True)
        )
        square = np.array(float(readings @ readings))
        of_nothing = float(selection.log_evidence(square, np.zeros(())))
        assert weight - of_nothing == pytest.approx(expected + math.log(CAUSES[1]) - plain)
