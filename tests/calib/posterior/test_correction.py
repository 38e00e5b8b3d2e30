"""What is entered is a projection, and its bound that of the whole posterior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import FloatArray
from calib.posterior.correction import HOLDS, Holds, correction, parts_of
from calib.posterior.library import POWERS
from calib.posterior.models import Posterior, WeightedModel
from calib.posterior.posterior import posterior
from calib.posterior.tool import FRAMES, Frame
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import Empirical
from calib.tripod.workspace import workspace_points
from tests.calib.posterior.hidden_machines import SHORT, SWEEP, hidden, session
from tests.conftest import LONG, first_quick

DRAWS = 4_000


@pytest.fixture(scope="module")
def unsure() -> Posterior:
    """Several names stay open."""
    case, _ = session(SHORT, hidden("backlash", "x", 0.03), seed=2, scatter_mm=0.003)
    return posterior([case])


def in_frame(result: Posterior, error: FloatArray, frame: Frame) -> FloatArray:
    """Mean squares ``(k,)`` of errors ``(3 n, k)`` less the best shift, or shift and turn."""
    places = np.tile(workspace_points(result.geometry), (2, 1))
    if frame != "machine":
        columns = [np.tile(np.eye(3), (len(places), 1))]
        if frame == "aligned":
            turned = [np.cross(axis, places) for axis in np.eye(3)]
            columns.append(np.stack(turned, axis=-1).reshape(-1, 3))
        free = np.hstack(columns)
        error = error - free @ np.linalg.lstsq(free, error, rcond=None)[0]
    return np.asarray((error**2).sum(axis=0) / len(places))


def drawn(result: Posterior, generator: np.random.Generator, count: int) -> FloatArray:
    """Machines drawn from the mixture ``(f, count)``."""
    models = result.models_in_field
    weight = np.array([model.weight for model in models])
    draws = []
    for number, times in enumerate(generator.multinomial(count, weight / weight.sum())):
        model = models[number]
        covariance = model.inflated**2 * model.base + model.root @ model.root.T
        square, axes = np.linalg.eigh(covariance)
        root = axes * np.sqrt(np.maximum(square, 0.0))
        draws.append(model.mean[:, None] + root @ generator.standard_normal((len(square), times)))
    return np.hstack(draws)


@LONG
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("holds", HOLDS)
def test_the_bound_is_what_975_of_1000_machines_drawn_from_the_posterior_keep(
    unsure: Posterior, holds: Holds, frame: Frame
) -> None:
    entered = correction(unsure, holds, frame)
    machines = drawn(unsure, np.random.default_rng(1), DRAWS)
    error = unsure.field.rows @ (machines - entered.off.values[:, None])
    kept_mm = float(np.sqrt(np.quantile(in_frame(unsure, error, frame), 0.975)))
    assert entered.off.bound_mm[frame] == pytest.approx(kept_mm, rel=0.08)


@pytest.mark.parametrize("frame", FRAMES)
def test_no_other_values_leave_less(unsure: Posterior, frame: Frame) -> None:
    entered = correction(unsure, "kinematics", frame)
    generator = np.random.default_rng(2)
    columns = [k for parts in parts_of(unsure, "kinematics").values() for _, i in parts for k in i]
    off = unsure.field.rows @ (unsure.mean - entered.off.values)
    least = float(in_frame(unsure, off[:, None], frame)[0])
    for _ in range(40):
        variant = entered.off.values.copy()
        variant[columns] += 1e-3 * generator.standard_normal(len(columns))
        moved = unsure.field.rows @ (unsure.mean - variant)
        assert float(in_frame(unsure, moved[:, None], frame)[0]) > least - 1e-9


def test_more_in_the_controller_and_more_freedom_of_the_frame_leave_no_more(
    unsure: Posterior,
) -> None:
    for frame in FRAMES:
        entered = [correction(unsure, holds, frame).off.values for holds in HOLDS]
        expected = [unsure.tool_errors[frame].expected_mm(values) for values in entered]
        assert expected == sorted(expected, reverse=True)
    bound = correction(unsure, "kinematics").off.bound_mm
    assert bound["aligned"] <= bound["touched-off"] <= bound["machine"]


def test_the_true_machine_is_within_the_bound_where_nothing_else_is_hidden() -> None:
    case, machine = session(SWEEP, seed=7)
    result = posterior([case])
    truth = np.zeros(len(result.mean))
    truth[:6] = machine.parameters_mm
    for frame in FRAMES:
        entered = correction(result, "kinematics", frame)
        off = result.field.rows @ (truth - entered.off.values)
        assert float(in_frame(result, off[:, None], frame)[0]) <= entered.off.bound_mm[frame] ** 2
        assert entered.off.bound_mm[frame] < 0.04


@pytest.mark.parametrize(("weight", "entered"), [(0.35, False), (0.49, True), (0.60, True)])
def test_play_that_is_likelier_not_there_is_entered_for_a_large_gain_alone(
    unsure: Posterior, weight: float, entered: bool
) -> None:
    """Of no play and one play, of weight p, entering p of it lowers the mean square by p."""

    def members(model: WeightedModel) -> list[tuple[str, str]]:
        return [(unsure.components[k].id, unsure.components[k].where) for k in model.members]

    play = next(model for model in unsure.models if members(model) == [("backlash", "x")])
    base = len(play.base)
    plain = replace(play, key=(), mean=play.mean[:base], sizes=play.sizes[:base])
    models = (replace(plain, weight=1.0 - weight), replace(play, weight=weight))
    entry = correction(replace(unsure, models=models), "play")
    assert [part.part for part in entry.left_out] == ([] if entered else ["play"])
    if not entered:
        assert "likelier to raise" in entry.left_out[0].reason


def test_a_controller_that_takes_offsets_and_bars_is_told_those_of_the_only_model() -> None:
    case, _ = session(SWEEP, seed=7)
    result = posterior([case])
    (plain,) = (model for model in result.models if not model.members)
    only = replace(result, models=(replace(plain, weight=1.0),))
    lengths_mm, offsets_mm = plain.mean[:3], plain.mean[3:6]
    assert np.abs(plain.mean[:6]).min() > 0.01
    told = np.array(correction(only, "kinematics", "machine").model.parameters_mm)
    assert told == pytest.approx([*offsets_mm, *lengths_mm], abs=1e-4)
    told = np.array(correction(only, "offsets", "machine").model.parameters_mm)
    assert told[:3] == pytest.approx(offsets_mm, abs=0.1)
    assert not told[3:].any()


def test_travel_by_any_power_of_it_is_entered_as_tables() -> None:
    """Whatever a drive does by its own travel, a table of its joint corrects."""
    case, _ = session(SWEEP, EffectInstance(Empirical((POWERS[-1],)), "x", (0.05,)), seed=3)
    result = posterior([case])
    tables = dict(parts_of(result, "kinematics")["tables"])
    columns = tables["table of x"]
    for name in POWERS:
        assert set(result.field.columns[Empirical((name,)), "x"]) <= set(columns)


@pytest.mark.parametrize("law", first_quick(["axis_offset", "straightness"]))
def test_tables_do_no_harm_between_the_places_where_the_tool_is_judged(law: str) -> None:
    """Waves of a screw that follow an error of another kind fit it at these places alone."""
    case, _ = session(SWEEP, hidden(law, "xy", 0.2), seed=4)
    result = posterior([case])
    places = workspace_points(result.geometry)
    spacing = np.diff(np.unique(places[:, 0]))[0]
    between = places[np.linalg.norm(places, axis=1) < 80.0] + 0.37 * spacing
    rows = result.field.rows_at(between, "touched-off")

    def left_mm(holds: Holds) -> float:
        values = correction(result, holds).off.values
        return float(np.sqrt(((rows @ (result.mean - values)) ** 2).sum(axis=-1).mean()))

    assert left_mm("tables") < 1.02 * left_mm("offsets")
