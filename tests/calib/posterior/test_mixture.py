"""Models after further readings, of matrices drawn at random: against dense distributions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from calib.arrays import FloatArray
from calib.posterior.mixture import ExpectedReadings, Group, UpdatedGroup
from calib.posterior.tool_errors import InField

FIELD, READINGS, SHOWN = 7, 5, 4
ABOUT = np.linspace(-1.0, 1.0, FIELD)


@dataclass
class Drawn:
    """What a model in the tool's field consists of."""

    mean: FloatArray
    root: FloatArray
    inflated: float
    base_root: FloatArray


def group_of(
    generator: np.random.Generator, rows: list[int], widths: list[int], size_mm: float
) -> tuple[Group, list[Drawn]]:
    """Models of so many sizes beside a base that they share, and what stands for the tool."""
    base = generator.normal(size=(FIELD, 3))
    models = []
    for width in widths:
        inflated = float(generator.uniform(1.0, 2.0))
        mean, sizes = generator.normal(size=FIELD), generator.normal(size=(FIELD, width))
        models.append(Drawn(mean, inflated * sizes, inflated, base))
    tool = np.random.default_rng(99).normal(size=(2 * SHOWN, FIELD))
    fields: list[InField] = models  # type: ignore[assignment]
    return Group(rows, fields, size_mm, ABOUT, tool), models


class Dense:
    """A model of a group and readings, without sharing anything."""

    def __init__(
        self, group: Group, model: Drawn, j: int, readings: ExpectedReadings, followed: list[int]
    ) -> None:
        number = int(group.rows[j])
        sizes = model.root / model.inflated
        columns = readings.columns
        self.expected = readings.expected + columns @ (model.mean - ABOUT)
        of_sizes = columns
        if number in followed:
            self.expected, of_sizes = readings.followed[followed.index(number)]
        seen = np.hstack([columns @ model.base_root, of_sizes @ sizes])
        noise = np.hstack([group.size_mm * readings.own, readings.loose])
        self.spread = np.eye(len(seen)) + seen @ seen.T + noise @ noise.T
        tool = np.random.default_rng(99).normal(size=(2 * SHOWN, FIELD))
        root = tool @ np.hstack([model.base_root, sizes])
        self.gain = root @ seen.T @ np.linalg.inv(self.spread)
        self.mean = tool @ model.mean
        self.after = model.inflated**2 * (root @ root.T - self.gain @ seen @ root.T)
        self.inflated = model.inflated


@pytest.mark.parametrize("seed", range(3))
def test_groups_of_models_are_those_of_dense_matrices(seed: int) -> None:
    generator = np.random.default_rng(seed)
    followed = [3, 1]
    readings = ExpectedReadings(
        generator.normal(size=READINGS),
        generator.normal(size=(READINGS, FIELD)),
        generator.normal(size=(READINGS, 2)),
        generator.normal(size=(READINGS, 1)),
        tuple(
            (generator.normal(size=READINGS), generator.normal(size=(READINGS, FIELD)))
            for _ in followed
        ),
    )
    groups = [
        group_of(generator, [0, 3, 4], [2, 1, 0], 0.0),
        group_of(generator, [1, 2], [1, 3], 0.7),
    ]
    updated = [UpdatedGroup(group, readings, followed) for group, _ in groups]
    dense = [
        [Dense(group, model, j, readings, followed) for j, model in enumerate(models)]
        for group, models in groups
    ]
    truths = [
        (update, j, dense[g][j]) for g, update in enumerate(updated) for j in range(len(dense[g]))
    ]
    for update, j, true in truths:
        assert update.expected[:, j] == pytest.approx(true.expected)
    seen = generator.normal(size=READINGS)
    off = generator.normal(size=(SHOWN, 3))
    for update, models in zip(updated, dense, strict=True):
        count = len(models)
        means, squares = update.means(seen), update.squares(seen[:, None])[0]
        distances = update.squares_at_tool.moments(off[:, :count])
        factors = [(update.log_factor(truth, j), true) for truth, j, true in truths]
        for k, model in enumerate(models):
            errors = seen - model.expected
            assert means[:, k] == pytest.approx(model.mean + model.gain @ errors)
            square = float(errors @ np.linalg.solve(model.spread, errors)) / model.inflated**2
            assert squares[k] == pytest.approx(square)
            after, apart = model.after[:SHOWN, :SHOWN], off[:, k]
            moments = (
                float(np.trace(after) + apart @ apart),
                float(2.0 * (after**2).sum() + 4.0 * apart @ after @ apart),
            )
            assert distances[k] == pytest.approx(moments)
            for factor, true in factors:
                wide = float(np.trace(np.linalg.solve(model.spread, true.spread))) - READINGS
                logs = np.linalg.slogdet(model.spread)[1] - np.linalg.slogdet(true.spread)[1]
                away = true.expected - model.expected
                gone = float(away @ np.linalg.solve(model.spread, away)) / model.inflated**2
                assert factor[k] == pytest.approx(0.5 * (wide + gone + logs), abs=1e-9)


def test_set_ups_together_are_read_one_after_the_other() -> None:
    """Each has errors of postures of its own; what joint offsets do is the same."""
    generator = np.random.default_rng(1)
    group, _ = group_of(generator, [0], [2], 0.5)
    parts = [
        ExpectedReadings(
            generator.normal(size=n),
            generator.normal(size=(n, FIELD)),
            generator.normal(size=(n, 2)),
            generator.normal(size=(n, 1)),
            ((generator.normal(size=n), generator.normal(size=(n, FIELD))),),
        )
        for n in (3, 2)
    ]
    both = ExpectedReadings.together(parts)
    update = UpdatedGroup(group, both, [0])
    first = UpdatedGroup(group, replace(both, own=np.zeros((5, 0))), [0])
    noise = update.lower @ update.lower.T - first.lower @ first.lower.T
    own = [0.25 * part.own @ part.own.T for part in parts]
    assert noise[:3, :3] == pytest.approx(own[0])
    assert noise[3:, 3:] == pytest.approx(own[1])
    assert noise[:3, 3:] == pytest.approx(np.zeros((3, 2)), abs=1e-12)
    assert update.expected[:, 0] == pytest.approx(
        np.concatenate([part.followed[0][0] for part in parts])
    )
