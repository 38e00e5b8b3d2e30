"""What the hidden machine truly does at the tool, with offsets and lengths entered."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from tests.blind.forward import LEG_MM, FloatArray, Hidden, feet_of, tool_of

Commanded = Callable[[FloatArray, float], FloatArray]
"""Tool places ``(n, 3)`` and the way by which carriages come (1 up, -1 down) → the joint
coordinates ``(n, 3)``, absolute (`LEG_MM` at Zero), that a controller sends for them, all mm."""

LIMITS_MM = (-100.0, 60.0)
HIGHEST_MM = 84.0
"""Of the tool: drives at their upper limits hold it at 83 mm along each coordinate."""
PER_AXIS = 9


def reachable_mm() -> FloatArray:
    """Middles ``(n, 3)`` of the cells where nominal joints keep their limits."""
    low, high = LIMITS_MM[0], HIGHEST_MM
    axis = low + (np.arange(PER_AXIS) + 0.5) * (high - low) / PER_AXIS
    points = np.array(list(product(axis, repeat=3)))
    travel = _joints(points, np.full(3, LEG_MM)) - LEG_MM
    inside = ((travel >= LIMITS_MM[0] - 1e-9) & (travel <= LIMITS_MM[1] + 1e-9)).all(axis=1)
    return np.asarray(points[inside])


def _joints(tool_mm: FloatArray, lengths_mm: FloatArray) -> FloatArray:
    across = (tool_mm**2).sum(axis=1, keepdims=True) - tool_mm**2
    return np.asarray(tool_mm + np.sqrt(lengths_mm**2 - across))


def entered(offsets_mm: FloatArray, lengths_mm: FloatArray) -> Commanded:
    """A controller that holds joint offsets ``(3,)`` and errors of bar lengths ``(3,)``.

    The controller's joint is the true one less the entered offset, for bars of L + entered length.
    """
    return lambda tool_mm, _: _joints(tool_mm, LEG_MM + lengths_mm) - offsets_mm


def reached_mm(hidden: Hidden, joints_mm: FloatArray, way: float) -> FloatArray:
    """Where the tool is ``(n, 3)`` for joints ``(n, 3)``, all carriages having come one way."""
    return tool_of(hidden, feet_of(hidden, joints_mm, np.full(joints_mm.shape, way)))


def errors_mm(hidden: Hidden, commanded: Commanded) -> FloatArray:
    """Tool less where it was sent ``(2 n, 3)``, all carriages having come up, then down."""
    targets = reachable_mm()
    off = [reached_mm(hidden, commanded(targets, way), way) - targets for way in (1.0, -1.0)]
    return np.concatenate(off)


def tool_errors_mm(hidden: Hidden, offsets_mm: FloatArray, lengths_mm: FloatArray) -> FloatArray:
    """The same with these joint offsets and lengths entered."""
    return errors_mm(hidden, entered(offsets_mm, lengths_mm))


def rms_mm(errors_mm: FloatArray) -> float:
    """R.m.s. distance."""
    return float(np.sqrt((errors_mm**2).sum(axis=1).mean()))


def without_rigid_motion(errors_mm: FloatArray) -> FloatArray:
    """The same less the best small shift and turn, which a workpiece's alignment takes up."""
    places = np.tile(reachable_mm(), (len(errors_mm) // len(reachable_mm()), 1))
    rigid = np.zeros((len(errors_mm), 3, 6))
    for k in range(3):
        rigid[:, k, k] = 1.0
        rigid[:, :, 3 + k] = np.cross(np.eye(3)[k], places)
    columns = rigid.reshape(-1, 6)
    flat = errors_mm.ravel()
    return np.asarray(flat - columns @ np.linalg.lstsq(columns, flat, rcond=None)[0]).reshape(-1, 3)
