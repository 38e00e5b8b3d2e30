"""Derivatives as papers/001 took them: forward differences through the forward kinematics.

Only to show what they do to its test; `calib.hexaslide.procedures` has the exact ones.
"""

from __future__ import annotations

import numpy as np

from calib.errors import CalibrationError
from calib.hexaslide.geometry import ConstraintLink, Geometry
from calib.hexaslide.kinematics import forward_near, inverse, rotation
from calib.hexaslide.parameters import NAMES, values, with_values
from calib.hexaslide.procedures import COMPONENTS, Kind, Procedure
from calib.observations import FloatArray

STEP = 1e-7
"""The paper's step, metres."""


def differenced(
    procedure: Procedure, geometry: Geometry, postures: FloatArray, link: ConstraintLink | None
) -> FloatArray:
    """Derivatives ``(p, r, k)`` as `procedures.jacobian`, each wrong by about 1e-7.

    Raises CalibrationError where a step leaves what can be reached.
    """
    sliders = inverse(geometry, postures)
    start = np.concatenate([values(geometry), _link_values(procedure, link)])
    own = [*range(len(NAMES)), *(len(NAMES) + k for k in procedure.link_columns)]
    if procedure.kind is not Kind.CONSTRAINT_LINK:
        own = own[: len(NAMES)]

    def read(parameters: FloatArray) -> FloatArray:
        changed = with_values(geometry, parameters[: len(NAMES)])
        if procedure.kind is Kind.POSE_INVERSE:
            return np.asarray(inverse(changed, postures))
        moved = forward_near(changed, sliders, postures)
        if procedure.kind is Kind.CONSTRAINT_LINK:
            return _misses(moved, parameters[len(NAMES) :])
        return np.asarray(moved[:, [COMPONENTS.index(name) for name in procedure.measured]])

    before = read(start)
    steps = STEP * np.eye(len(start))[own]
    return np.stack([(read(start + step) - before) / STEP for step in steps], axis=-1)


def _link_values(procedure: Procedure, link: ConstraintLink | None) -> FloatArray:
    """Both ends and the length ``(7,)``; none where there is no link to read."""
    if procedure.kind is not Kind.CONSTRAINT_LINK:
        return np.zeros(0)
    if link is None:
        raise CalibrationError("constraint link", "none", "one in the machine file")
    return np.concatenate([link.platform_end, link.base_end, [link.length_m]])


def _misses(postures: FloatArray, link: FloatArray) -> FloatArray:
    """How much longer than the link its ends are apart ``(p, 1)``."""
    ends = postures[:, :3] + rotation(postures[:, 3:]) @ link[:3] - link[3:6]
    return np.asarray(np.sqrt((ends * ends).sum(axis=1)) - link[6])[:, None]
