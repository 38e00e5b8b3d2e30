"""An effect of a stated size beside the parameters: residuals and tool follow it."""

from __future__ import annotations

import numpy as np
import pytest

import glidecal
from calib.errors import UsageError
from calib.tripod.geometry import Geometry, direct, inverse
from calib.tripod.workspace import workspace_points

PLAY_MM = 0.1


@pytest.fixture(scope="module")
def session() -> glidecal.Session:
    return glidecal.simulate("two-station", effect="backlash:all", size=PLAY_MM, seed=3)


def test_residuals_are_least_at_the_true_size(session: glidecal.Session) -> None:
    plain = glidecal.solve(session, subset="joint-offsets").solution
    sizes = (0.0, 0.5 * PLAY_MM, PLAY_MM, 1.5 * PLAY_MM)
    found = [
        glidecal.what_if(session, effect="backlash:all", size=mm, subset="joint-offsets")
        for mm in sizes
    ]
    left = [float(np.square(one.solved.solution.residual_mm).sum()) for one in found]
    assert left[0] == pytest.approx(float(np.square(plain.residual_mm).sum()))
    assert left[2] == min(left)
    assert left[2] < 0.1 * left[0]
    # a parabola about the true size: half as far off leaves a quarter
    assert (left[1] - left[2]) / (left[0] - left[2]) == pytest.approx(0.25, abs=0.03)
    assert found[2].units == ("mm",)


def test_the_tool_follows_the_size(session: glidecal.Session) -> None:
    """Against the kinematics alone: carriages that travel further by a share of their way."""
    geometry = Geometry()
    points = workspace_points(geometry)
    share = 0.5e-3
    zero, there = (inverse(geometry, tool_mm) for tool_mm in (np.zeros((1, 3)), points))
    off = direct(geometry, zero + (there - zero) * (1.0 + share)) - points
    expected = float(np.sqrt((off**2).sum(axis=-1).mean()))
    found = glidecal.what_if(session, effect="actuator_scale:all", size=1e3 * share)
    assert found.tool_mm == pytest.approx(expected, rel=1e-3)


def test_what_is_not_known_is_refused(session: glidecal.Session) -> None:
    with pytest.raises(UsageError, match="backlash:all"):
        glidecal.what_if(session, effect="backlash:nowhere", size=0.1)
    with pytest.raises(UsageError, match="values of backlash:all: found 2"):
        glidecal.what_if(session, effect="backlash:all", size=[0.1, 0.2])
