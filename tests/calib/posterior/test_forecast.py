"""What is expected after further readings, worked out here by dense matrices of one model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
import pytest

from calib.arrays import Conditions, FloatArray
from calib.posterior.cells import HOMING_MM
from calib.posterior.forecast import Forecast
from calib.posterior.measurements import set_up
from calib.posterior.mixture import UpdatedGroup
from calib.posterior.models import Posterior, WeightedModel
from calib.posterior.posterior import posterior
from calib.posterior.tool import Frame
from calib.tripod.pipeline import Model, StageEffect
from tests.calib.posterior.hidden_machines import SHORT, hidden, session
from tests.conftest import LONG

STEP = 1e-3
ZERO_MM = 1e2
"""Spread of the zero of a mounting: free."""

FRAME: Frame = "touched-off"
OFFSETS = [0, 1, 2]
TAKEN = set_up(1, 0.3, (0.0, 24.0, 60.0, 24.0, -40.0, -100.0), 3, 20.0)


@pytest.fixture(scope="module")
def unsure() -> Posterior:
    """Several names stay open: play or a screw."""
    case, _ = session(SHORT, hidden("backlash", "x", 0.03), seed=2, scatter_mm=0.003)
    return posterior([case])


@pytest.fixture(scope="module")
def adopted() -> Posterior:
    """The same of a machine whose model has the play of another drive."""
    play = hidden("backlash", "y", 0.05)
    case, _ = session(SHORT, hidden("backlash", "x", 0.03), play, seed=3, scatter_mm=0.003)
    return posterior([replace(case, model=case.model.with_effects((play,)))])


def machine_of(result: Posterior, model: WeightedModel, values: FloatArray) -> Model:
    """The machine of these values of a model, all of them in the simulation."""
    effects: list[StageEffect] = [*result.sessions[-1].case.model.effects]
    at = result.parameter_count
    for k in (*model.everywhere, *model.members):
        component = result.components[k]
        model_dense = values[at : at + len(component.unit)]
        at += len(component.unit)
        if model_dense.any():
            effects += component.effects(model_dense)
    return Model(
        parameters_mm=(*values[3:6].tolist(), *values[:3].tolist()), effects=tuple(effects)
    )


class Dense:
    """One model and readings of one set-up: means of cells, with zeros as unknowns."""

    def __init__(
        self, result: Posterior, model: WeightedModel, conditions: Conditions, mm2: float
    ) -> None:
        first = np.unique(conditions.cell, return_index=True)[1]
        cells = conditions.take(first)
        at = model.mean.copy()
        self.expected = machine_of(result, model, at).readings(cells)
        deviation = np.sqrt(model.variance_at(slice(None)))
        moved = []
        for k, size in enumerate(deviation.tolist()):
            step = np.zeros(len(at))
            step[k] = STEP * size
            up, down = (machine_of(result, model, at + s * step) for s in (1.0, -1.0))
            moved.append((up.readings(cells) - down.readings(cells)) / (2.0 * STEP * size))
        self.columns = np.column_stack(moved)
        self.before = model.covariance
        zeros = ZERO_MM**2 * np.equal.outer(cells.mount, cells.mount)
        noise = np.diag(model.inflated**2 * mm2 / np.bincount(conditions.cell))
        by_offsets = self.columns[:, result.parameter_count - 3 : result.parameter_count]
        homed = (model.inflated * HOMING_MM) ** 2 * by_offsets @ by_offsets.T
        self.spread = self.columns @ self.before @ self.columns.T + zeros + noise + homed
        self.gain = self.before @ self.columns.T @ np.linalg.inv(self.spread)
        self.after = self.before - self.gain @ self.columns @ self.before
        into = np.zeros((result.field.rows.shape[1], len(at)))
        into[3:6, :3], into[:3, 3:6] = np.eye(3), np.eye(3)
        begin = result.parameter_count
        for k in (*model.everywhere, *model.members):
            for share in result.components[k].shares:
                for column, value in zip(
                    result.field.columns[share.effect, share.place], share.values, strict=True
                ):
                    into[column, begin + value] += 1.0
            begin += len(result.components[k].unit)
        self.into = into

    def square(self, result: Posterior) -> float:
        """Expected mean square at the tool about the mean, after the readings."""
        metric = self.into.T @ result.field.metrics[FRAME] @ self.into
        return float(np.trace(metric @ self.after))


@dataclass(frozen=True, eq=False)
class Known:
    """Models by their numbers: after `TAKEN` by the forecast, and by dense matrices."""

    result: Posterior
    forecast: Forecast
    after: dict[int, tuple[UpdatedGroup, int]]
    dense: dict[int, Dense]

    @classmethod
    def of(cls, result: Posterior) -> Known:
        """The heaviest models whose members are laws."""
        forecast = Forecast(result, FRAME, OFFSETS)
        (readings,) = forecast.readings([TAKEN])
        after = {
            forecast.numbers.tolist()[k]: (updated, j)
            for group in forecast.groups
            for updated in [UpdatedGroup(group, readings, forecast.followed)]
            for j, k in enumerate(group.rows.tolist())
        }
        order = np.argsort([-model.weight for model in result.models]).tolist()
        members = {k: [result.components[m] for m in result.models[k].members] for k in order}
        laws = [k for k in order if all(component.candidate for component in members[k])]
        mm2 = forecast.noise_mm2[0]
        dense = {k: Dense(result, result.models[k], TAKEN, mm2) for k in laws[:3]}
        return cls(result, forecast, after, dense)


@pytest.fixture(scope="module")
def both_ways(unsure: Posterior) -> Known:
    """Three models both ways."""
    return Known.of(unsure)


@LONG
def test_covariances_after_readings_are_those_of_dense_matrices(both_ways: Known) -> None:
    metric = both_ways.result.field.metrics[FRAME]
    for number, dense in both_ways.dense.items():
        updated, j = both_ways.after[number]
        off = np.zeros((len(both_ways.forecast.shown), len(updated.group.rows)))
        square = float(updated.squares_at_tool.moments(off)[j, 0])
        assert square == pytest.approx(dense.square(both_ways.result), rel=0.01)
        before = float(np.trace(dense.into.T @ metric @ dense.into @ dense.before))
        assert square < 0.9 * before


@LONG
def test_means_go_where_the_readings_of_another_model_take_them(both_ways: Known) -> None:
    for (true, first), (rival, second) in permutations(both_ways.dense.items(), 2):
        moved = second.into @ (second.gain @ (first.expected - second.expected))
        truth, j = both_ways.after[true]
        updated, i = both_ways.after[rival]
        change = updated.means(truth.expected[:, j])[:, i] - updated.group.tool_mean[:, i]
        forecast = both_ways.forecast
        expected = np.concatenate([forecast.shown @ moved, forecast.entered @ moved])
        size = np.abs(expected).max()
        assert size > 3e-5
        assert np.abs(change - expected).max() < 0.05 * size


def test_weights_change_by_the_divergence_of_the_expected_readings(both_ways: Known) -> None:
    for (true, model_dense), (second, dense) in product(both_ways.dense.items(), repeat=2):
        off = model_dense.expected - dense.expected
        square = float(off @ np.linalg.solve(dense.spread, off))
        logs = np.linalg.slogdet(dense.spread)[1] - np.linalg.slogdet(model_dense.spread)[1]
        wide = float(np.trace(np.linalg.solve(dense.spread, model_dense.spread))) - len(off)
        (truth, j), (updated, at) = both_ways.after[true], both_ways.after[second]
        divergence = updated.log_factor(truth, j)[at]
        assert divergence == pytest.approx(0.5 * (wide + square + logs), rel=0.05, abs=0.05)
        square_left = updated.squares(truth.expected[:, [j]])[0, at]
        assert square_left == pytest.approx(square, rel=0.05, abs=0.02)
        assert divergence == pytest.approx(0.0, abs=1e-6) if true == second else divergence > 0.0


def test_models_are_apart_by_what_each_leaves_of_the_others_readings(both_ways: Known) -> None:
    """Worked out for these models alone, in any order."""
    (readings,) = both_ways.forecast.readings([TAKEN])
    dense = dict(reversed(both_ways.dense.items()))
    numbers = both_ways.forecast.numbers.tolist()
    (apart,) = both_ways.forecast.apart([readings], [numbers.index(number) for number in dense])
    for (i, model_dense), (j, second) in product(enumerate(dense.values()), repeat=2):
        off = model_dense.expected - second.expected
        square = float(off @ np.linalg.solve(second.spread, off))
        assert apart[i, j] == pytest.approx(square, rel=0.05, abs=0.02)
    assert apart.max() > 1.0


def test_nothing_read_changes_nothing(unsure: Posterior) -> None:
    forecast = Forecast(unsure, FRAME, OFFSETS)
    there = set_up(0, 0.5, (0.0,), 1, 20.0)  # one posture: its zero takes it
    (readings,) = forecast.readings([there])
    assert forecast.after_mm(readings) == pytest.approx(forecast.now_mm, rel=1e-6)


def without_zeros(forecast: Forecast) -> FloatArray:
    """The inverse covariance ``(n, n)`` of cells of `TAKEN` by their noise; a zero is anything."""
    conditions = TAKEN.take(np.unique(TAKEN.cell, return_index=True)[1])
    scatter, shared = forecast.noise_mm2
    inverse = np.diag(1.0 / (scatter / np.bincount(TAKEN.cell) + shared))
    zeros = np.eye(int(conditions.mount.max()) + 1)[conditions.mount]
    kept = inverse @ zeros
    return np.asarray(inverse - kept @ np.linalg.solve(zeros.T @ kept, kept.T))


@LONG
@pytest.mark.parametrize("shared_mm2", [0.0, 0.002**2])
@pytest.mark.parametrize("name", ["unsure", "adopted"])
def test_each_model_expects_the_readings_of_its_own_machine(
    name: str, shared_mm2: float, request: pytest.FixtureRequest
) -> None:
    """Also of noise that repeats share, and of models that are linear about the session's fit."""
    unsure: Posterior = request.getfixturevalue(name)
    forecast = Forecast(unsure, FRAME, OFFSETS)
    vars(forecast)["noise_mm2"] = forecast.noise_mm2[0], shared_mm2
    (readings,) = forecast.readings([TAKEN])
    inverse, cells = without_zeros(forecast), np.unique(TAKEN.cell, return_index=True)[1]
    linear = {
        k: updated.expected[:, j]
        for group in forecast.groups
        for updated in [UpdatedGroup(group, readings, forecast.followed)]
        for j, k in enumerate(group.rows.tolist())
        if k not in forecast.followed
    }
    followed = dict(zip(forecast.followed, readings.followed, strict=True))
    assert len(followed) > 5
    assert len(linear) > 20
    for k, number in enumerate(forecast.numbers.tolist()):
        model = unsure.models[number]
        if not all(unsure.components[member].candidate for member in model.members):
            continue
        off_mm = machine_of(unsure, model, model.mean).readings(TAKEN.take(cells))
        size = float(off_mm @ inverse @ off_mm)
        expected = followed[k][0] if k in followed else linear[k]
        near = 1e-6 if k in followed else 2e-3
        assert float(expected @ expected) == pytest.approx(size, rel=near)


def test_readings_that_separate_names_lower_the_bound(unsure: Posterior) -> None:
    """What is true gains weight, whichever of the open names it is."""
    forecast = Forecast(unsure, FRAME, OFFSETS)
    (readings,) = forecast.readings([TAKEN])
    assert forecast.after_mm(readings) < 0.9 * forecast.now_mm
    updated = [UpdatedGroup(group, readings, forecast.followed) for group in forecast.groups]
    for true in updated:
        for j, k in enumerate(true.group.rows.tolist()):
            weight = forecast.weight_if(updated, true, j)
            assert weight.sum() == pytest.approx(1.0)
            assert weight[k] > forecast.weight[k]
