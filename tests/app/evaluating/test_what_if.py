"""An effect of a stated size beside the parameters: residuals and tool follow it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import root
from scipy.spatial.transform import Rotation

import glidecal
from app.evaluating.diagnosis import adopt
from app.evaluating.what_if import FAR, Trial, choices, trial_of
from app.measuring.simulated import simulated_session
from app.report.text.caveats import caveats
from calib.arrays import FloatArray
from calib.errors import UsageError
from calib.identify.solution import Subset
from calib.posterior.tool import Frame
from calib.tripod.effects.drives import AxisDistance, AxisSquareness
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry, direct, inverse
from calib.tripod.pipeline import Model
from calib.tripod.workspace import workspace_points
from protocols.machine import Machine
from protocols.procedure import load_procedure
from tests.conftest import LONG

PLAY_MM = 0.1


@cache
def measured() -> glidecal.Session:
    return glidecal.simulate("two-station", effect="backlash:all", size=PLAY_MM, seed=3)


@cache
def tried(effect: str, subset: Subset) -> Trial:
    """An effect of the catalogue, on a set of parameters."""
    (choice,) = (c for c in choices([measured()]) if ":".join(c.key) == effect)
    return trial_of(choice, [measured()], subset=subset)


@pytest.fixture(scope="module")
def session() -> glidecal.Session:
    return measured()


def test_residuals_are_least_at_the_true_size(session: glidecal.Session) -> None:
    plain = glidecal.solve(session, subset="joint-offsets").solution
    sizes = (0.0, 0.5 * PLAY_MM, PLAY_MM, 1.5 * PLAY_MM)
    outcomes = [
        glidecal.what_if(session, effect="backlash:all", size=mm, subset="joint-offsets")
        for mm in sizes
    ]
    squares = [float(np.square(outcome.result.solution.residual_mm).sum()) for outcome in outcomes]
    assert squares[0] == pytest.approx(float(np.square(plain.residual_mm).sum()))
    assert squares[2] == min(squares)
    assert squares[2] < 0.1 * squares[0]
    # a parabola about the true size: half as far off leaves a quarter
    assert (squares[1] - squares[2]) / (squares[0] - squares[2]) == pytest.approx(0.25, abs=0.03)
    assert outcomes[2].units == ("mm",)


def test_the_tool_follows_the_size(session: glidecal.Session) -> None:
    """Against the kinematics alone: carriages that travel further by a share of their way."""
    geometry = Geometry()
    points = workspace_points(geometry)
    share = 0.5e-3
    zero, there = (inverse(geometry, tool_mm) for tool_mm in (np.zeros((1, 3)), points))
    off = direct(geometry, zero + (there - zero) * (1.0 + share)) - points
    off -= off.mean(axis=0)  # touched off
    expected = float(np.sqrt((off**2).sum(axis=-1).mean()))
    outcome = glidecal.what_if(session, effect="actuator_scale:all", size=1e3 * share)
    assert outcome.tool_mm == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("frame", ["touched-off", "aligned", "machine"])
def test_the_tool_is_judged_in_the_frame_of_the_machine_file(
    session: glidecal.Session, frame: Frame
) -> None:
    """Axes x and y that lean; the best turn of many points by Kabsch's method in scipy."""
    machine = session.opened.machine.model_copy(update={"frame": frame})
    session = replace(session, opened=session.opened.model_copy(update={"machine": machine}))
    points = workspace_points(Geometry())
    lean = 0.5e-3  # half of 1 mrad each, about where the axes meet
    drives = np.array([[1.0, lean, 0.0], [lean, 1.0, 0.0], [0.0, 0.0, 1.0]])
    pairs = zip(inverse(Geometry(), points), points, strict=True)
    wrong = np.array([meeting(drives, joints, start) for joints, start in pairs])
    if frame != "machine":
        wrong -= (wrong - points).mean(axis=0)
    if frame == "aligned":
        turn, _ = Rotation.align_vectors(points - points.mean(axis=0), wrong - points.mean(axis=0))
        wrong = turn.apply(wrong - points.mean(axis=0)) + points.mean(axis=0)
    expected = float(np.sqrt(((wrong - points) ** 2).sum(axis=-1).mean()))
    outcome = glidecal.what_if(session, effect="axis_squareness:xy", size=1.0)
    assert outcome.tool_mm == pytest.approx(expected, rel=0.01)


def meeting(drives: FloatArray, joints: FloatArray, start: FloatArray) -> FloatArray:
    """The point ``(3,)`` at a bar's length from each carriage, by scipy."""
    feet, bars = joints[:, None] * drives, np.square(Geometry().lengths)

    def too_far(tool_mm: FloatArray) -> FloatArray:
        return np.asarray(((tool_mm - feet) ** 2).sum(axis=1) - bars)

    return np.asarray(root(too_far, start).x)


@LONG
def test_every_effect_of_a_diagnosis_can_be_tried() -> None:
    """Refused before: what does nothing on a machine without errors, as a wrong gain, what is
    beside the catalogue, and one direction of a drive.
    """
    session = glidecal.simulate("two-station", effect="straightness:xy", size=0.2, seed=3)
    effects = glidecal.diagnose(session).to_frame()
    tried = {":".join(choice.key) for choice in choices([session])}
    names = set(effects["effect"] + ":" + effects["where"])
    assert "straightness:xy" in names <= tried
    assert {"gauge_gain:xy", "gauge_tilt:all", "joint_clearance:z"} <= tried
    assert glidecal.what_if(session, effect="straightness:xy", size=0.2).tool_mm > 0.01


def test_parameters_that_ignore_it_mislead_the_tool(session: glidecal.Session) -> None:
    """Against the kinematics alone: offsets of before entered where drives are longer."""
    geometry = Geometry()
    points = workspace_points(geometry)
    subset: Subset = "joint-offsets"
    share = 0.5e-3
    outcome = glidecal.what_if(
        session, effect="actuator_scale:all", size=1e3 * share, subset=subset
    )
    entered = np.array(glidecal.solve(session, subset=subset).solution.values_mm)
    true_mm = outcome.result.solution.values_mm
    zero = inverse(geometry, np.zeros((1, 3)))
    commanded = inverse(geometry, points) - entered
    carriage = commanded + true_mm + share * (commanded - zero)
    off = direct(geometry, carriage) - points
    off -= off.mean(axis=0)  # touched off
    expected = float(np.sqrt((off**2).sum(axis=-1).mean()))
    assert outcome.misled_mm == pytest.approx(expected, rel=1e-6)
    assert outcome.trial.without.misled_mm == pytest.approx(0.0, abs=1e-9)


def test_the_figures_of_one_set_are_those_of_the_whole() -> None:
    trial = tried("backlash:all", "both")
    for mm in (0.0, 0.03, PLAY_MM):
        alone, solution = trial.at([mm]).solution, trial.at([mm]).result.solution
        assert (alone.values_mm == solution.values_mm).all()
        assert (alone.predicted_mm == solution.predicted_mm).all()
        assert alone.rms_after_mm == solution.rms_after_mm


def test_what_fits_best_is_what_a_model_gives(session: glidecal.Session, tmp_path: Path) -> None:
    trial = tried("backlash:all", "both")
    (fitted,) = trial.fitted
    assert fitted.value == pytest.approx(PLAY_MM, abs=3.0 * fitted.standard_uncertainty)
    model = trial.beside.model_copy(update={"effects": (trial.entry,)})
    path = tmp_path / "model.json"
    path.write_text(model.text(), encoding="utf-8")
    (refit,) = glidecal.solve(session, subset="both", model=path).solution.sizes
    assert (refit.value, refit.standard_uncertainty) == (fitted.value, fitted.standard_uncertainty)
    # and no other size leaves less
    (step,) = trial.sizes.steps
    assert step <= fitted.standard_uncertainty < 2.5 * step
    near = [trial.at([fitted.value + k * step]).solution for k in (-3, 0, 3)]
    statistics = [neighbour.lack_of_fit.statistic for neighbour in near if neighbour.lack_of_fit]
    assert len(statistics) == 3
    assert statistics[1] == min(statistics)


@LONG
def test_an_effect_of_the_model_is_held_in_place_of_being_fitted(
    session: glidecal.Session, tmp_path: Path
) -> None:
    trial = tried("backlash:all", "both")
    for entry, sizes in ((trial.entry, 1), (trial.entry.held_at([0.02]), 0)):
        path = tmp_path / f"{sizes}.json"
        model = trial.beside.model_copy(update={"effects": (entry,)})
        path.write_text(model.text(), encoding="utf-8")
        result = glidecal.solve(session, subset="both", model=path)
        assert len(result.solution.sizes) == sizes
        assert result.held == ((), ("backlash (all): play = +0.02 mm",))[1 - sizes]
        outcome = glidecal.what_if(
            session, effect="backlash:all", size=0.02, subset="both", model=path
        )
        expected = trial.at([0.02]).solution.predicted_mm
        assert outcome.result.solution.predicted_mm.tolist() == expected.tolist()
    assert result.solution.predicted_mm.tolist() == expected.tolist()
    assert "Held as a person stated it, not fitted: backlash" in "\n".join(caveats(result))


@given(start=st.floats(-0.3, 0.3), steps=st.lists(st.sampled_from((-10, -1, 1, 10)), max_size=30))
def test_steps_meet_round_sizes_and_keep_within_bounds(start: float, steps: list[int]) -> None:
    trial = tried("actuator_scale:all", "joint-offsets")
    (step,) = trial.sizes.steps
    values: tuple[float, ...] = (start,)
    for by in steps:
        before, values = values[0], trial.sizes.moved(values, 0, by)
        way = 1 if by > 0 else -1
        assert 0.0 <= way * (values[0] - before) <= abs(by) * step * (1 + 1e-6)
        if abs(values[0]) < 9.0:
            assert abs(values[0] / step - round(values[0] / step)) < 1e-6
            assert abs(values[0] - before) > (abs(by) - 1) * step * (1 - 1e-6)
        assert abs(values[0]) <= FAR * trial.parameters[0].tolerance


def test_play_is_never_below_nothing() -> None:
    trial = tried("backlash:all", "joint-offsets")
    assert trial.sizes.moved((0.0,), 0, -1) == (0.0,)
    assert trial.sizes.moved((trial.sizes.steps[0],), 0, -10) == (0.0,)


def test_what_is_not_known_is_refused(session: glidecal.Session) -> None:
    with pytest.raises(UsageError, match="backlash:all"):
        glidecal.what_if(session, effect="backlash:nowhere", size=0.1)
    with pytest.raises(UsageError, match=r"'nothing:x'. Allowed: axis_squareness, ") as problem:
        glidecal.what_if(session, effect="nothing:x", size=0.1)
    assert len(str(problem.value)) < 400  # a name each, not all its places
    with pytest.raises(UsageError, match="values of backlash:all: found 2"):
        glidecal.what_if(session, effect="backlash:all", size=[0.1, 0.2])


def test_a_size_beyond_all_measure_is_the_size_that_is_refused(session: glidecal.Session) -> None:
    """Before: the limits of the machine file were to be checked."""
    with pytest.raises(UsageError, match=r"size of backlash:all: found 1e\+09 mm\.") as problem:
        glidecal.what_if(session, effect="backlash:all", size=1e9)
    assert "machine file" not in str(problem.value)


def test_a_size_may_be_a_number_of_numpy(session: glidecal.Session) -> None:
    sizes: tuple[Any, ...] = (np.array(0.1), np.float64(0.1), np.array([0.1]))
    for size in sizes:
        assert glidecal.what_if(session, effect="backlash:all", size=size).values == (0.1,)


LEANS, DISTANCES = {"xy": 1.0, "yz": -0.8, "xz": 0.6}, {"xy": 0.2, "yz": -0.15, "zx": 0.12}


def test_axes_that_are_named_together_can_be_tried_and_adopted(tmp_path: Path) -> None:
    """Out of square and apart at once: two laws of one name, which a model has one by one."""
    machine = Machine()
    truth = Model(machine.geometry()).with_effects(
        (
            *(EffectInstance(AxisSquareness(), place, (lean,)) for place, lean in LEANS.items()),
            *(EffectInstance(AxisDistance(), place, (mm,)) for place, mm in DISTANCES.items()),
        )
    )
    session = simulated_session(
        load_procedure("two-station", machine.geometry()),
        machine,
        truth,
        seed=3,
        scatter_mm=0.002,
        resolution_mm=0.001,
    )
    diagnosed = glidecal.diagnose(session)
    (named,) = diagnosed.diagnosis.effects
    assert (named.id, named.where) == ("axis_squareness", "axes")
    sizes = (*LEANS.values(), *DISTANCES.values())
    outcome = glidecal.what_if(session, effect="axis_squareness:axes", size=sizes)
    assert outcome.values == sizes
    assert outcome.units == (*["mrad"] * 3, *["mm"] * 3)
    assert outcome.solution.rms_after_mm < 0.004
    (choice, *_) = choices([session], None, diagnosed)
    assert choice.key == ("axis_squareness", "axes")
    best = trial_of(choice, [session]).sizes.best
    assert best == pytest.approx(sizes, abs=0.1)
    model = adopt(diagnosed, tmp_path / "m.json")
    assert [(entry.id, entry.where) for entry in model.effects] == [
        ("axis_squareness", "xy,yz,xz"),
        ("axis_offset", "xy,yz,zx"),
    ]
    values = [size.value for entry in model.effects for size in entry.parameters.values()]
    assert values == pytest.approx(sizes, abs=0.1)
    again = glidecal.diagnose(session, model=tmp_path / "m.json")
    assert again.diagnosis.verdict == "agrees"
