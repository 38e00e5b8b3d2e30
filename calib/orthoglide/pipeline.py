"""The one forward simulation: command → actuator → foot → tool → touched point → reading.

Each stage is a small function of arrays. All readings of a session pass at once, ``n`` of them; an
optional leading batch axis ``(..., )`` holds many machines. An effect changes what one stage hands
on and nothing else; the base parameters enter in the actuator stage (joint offsets) and in the
tool stage (leg lengths).

Identification, the simulated rig, replay and derivatives all call `simulate`. Every stage is
written so that complex numbers pass through it, so `derivatives` needs no formula of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.observations import Conditions, FloatArray
from calib.orthoglide.geometry import Geometry
from calib.orthoglide.kinematics import inverse, trilaterate

COMPLEX_STEP_MM = 1e-30


class Stage(StrEnum):
    """Where an effect acts, and what it is handed to change."""

    ACTUATOR = "actuator"  # carriage positions (..., n, 3), mm
    FOOT = "foot"  # feet of the three bars (..., n, 3 legs, 3), mm
    TOOL = "tool"  # lengths of the three bars (..., n, 3), mm
    TOUCH = "touch"  # touched point (..., n, 3), mm
    READING = "reading"  # reading (..., n), mm


class Effect(Protocol):
    """A change in exactly one stage."""

    @property
    def id(self) -> str:
        """Name in the catalogue, such as ``backlash``."""

    @property
    def stage(self) -> Stage:
        """The one stage whose result `change` is given."""

    def change(self, passing: NDArray[Any], flow: Flow) -> NDArray[Any]:
        """What the stage hands on instead of ``passing``; ``flow`` holds what came before."""


@dataclass(frozen=True, eq=False)
class Flow:
    """What has passed through the stages so far: n readings and, as last row, the Zero posture.

    The Zero row is where an indicator is mounted: it fixes the point that the indicator keeps. It
    belongs to no mounting (-1), has no temperature and was approached from nowhere.
    """

    geometry: Geometry
    taken: Conditions
    effects: Sequence[Effect]
    joint_offset_mm: NDArray[Any]
    length_error_mm: NDArray[Any]
    command_mm: NDArray[Any]
    carriage_mm: NDArray[Any]
    foot_mm: NDArray[Any]
    tool_mm: NDArray[Any]
    fraction: NDArray[Any]

    def through(self, stage: Stage, passing: NDArray[Any]) -> NDArray[Any]:
        """``passing`` after every effect of this stage."""
        for effect in self.effects:
            if effect.stage == stage:
                passing = effect.change(passing, self)
        return passing


def simulate(
    geometry: Geometry,
    parameters_mm: ArrayLike,
    taken: Conditions,
    effects: Sequence[Effect] = (),
) -> NDArray[Any]:
    """Readings ``(..., n_readings)`` in mm for parameters ``(..., 6)`` in mm.

    Order of the parameters: `PARAMETER_NAMES`. A reading is relative to the point of the straight
    bar that is touched in the Zero posture, so it is zero there but for effects; the unknown zero
    of each mounting is not added. Raises UnreachablePosture.
    """
    parameters = np.asarray(parameters_mm)
    with_zero = _append_zero_row(taken)
    none = np.empty(0)
    flow = Flow(
        geometry=geometry,
        taken=with_zero,
        effects=effects,
        joint_offset_mm=parameters[..., None, :3],
        length_error_mm=parameters[..., None, 3:],
        command_mm=command(geometry, with_zero),
        carriage_mm=none,
        foot_mm=none,
        tool_mm=none,
        fraction=none,
    )
    flow = replace(flow, carriage_mm=actuator(flow))
    flow = replace(flow, foot_mm=foot(flow))
    flow = replace(flow, tool_mm=tool(flow))
    flow = replace(flow, fraction=touched_fraction(flow))
    return reading(flow, touched_point(flow))[..., :-1]


def command(geometry: Geometry, taken: Conditions) -> FloatArray:
    """Joint coordinates ``(n, 3)`` that the controller commands: nominal inverse kinematics.

    Zero commands (L, L, L); displacement s along axis i commands ``L + s`` on joint i and
    ``sqrt(L^2 - s^2)`` on the others (papers/000, section 2.4). Raises UnreachablePosture.
    """
    position = np.zeros((len(taken), 3))
    position[np.arange(len(taken)), taken.leg] = taken.displacement_mm
    return inverse(position, geometry.leg_length_mm)


def actuator(flow: Flow) -> NDArray[Any]:
    """Carriage positions ``(..., n, 3)``: command plus joint offset."""
    return flow.through(Stage.ACTUATOR, flow.command_mm + flow.joint_offset_mm)


def foot(flow: Flow) -> NDArray[Any]:
    """Feet of the bars ``(..., n, 3 legs, 3)``: each carriage on its own axis."""
    feet = flow.carriage_mm[..., :, None] * np.eye(3)
    return flow.through(Stage.FOOT, feet)


def tool(flow: Flow) -> NDArray[Any]:
    """Tool centre point ``(..., n, 3)``: where the three bars meet."""
    lengths = flow.geometry.leg_length_mm + flow.length_error_mm
    rows = np.broadcast_to(lengths, (*lengths.shape[:-2], len(flow.taken), 3))
    return trilaterate(flow.foot_mm, flow.through(Stage.TOOL, rows))


def touched_fraction(flow: Flow) -> NDArray[Any]:
    """Where the bar is touched ``(..., n)``: fraction of its length from the tool end.

    The indicator stands still. It was set on the bar in the Zero posture at the station of the
    mounting and keeps that coordinate along the leg's axis (papers/000, equation (10)).
    """
    tool_along, foot_along = _along_leg(flow, flow.tool_mm), _along_leg(flow, _own_foot(flow))
    tool_zero = flow.tool_mm[..., -1, :][..., flow.taken.leg]
    index = flow.taken.leg
    foot_zero = flow.foot_mm[..., -1, :, :][..., index, index]
    kept = tool_zero + flow.taken.station * (foot_zero - tool_zero)
    return np.asarray((kept - tool_along) / (foot_along - tool_along))


def touched_point(flow: Flow) -> NDArray[Any]:
    """The point of the bar under the indicator ``(..., n, 3)``."""
    bar = _own_foot(flow) - flow.tool_mm
    return flow.through(Stage.TOUCH, flow.tool_mm + flow.fraction[..., None] * bar)


def reading(flow: Flow, touched_mm: NDArray[Any]) -> NDArray[Any]:
    """What the indicator shows ``(..., n)``: its axis of the touched point, minus that at Zero."""
    n = len(flow.taken)
    now = touched_mm[..., np.arange(n), flow.taken.axis]
    return flow.through(Stage.READING, now - _touched_at_zero(flow))


def derivatives(
    geometry: Geometry,
    parameters_mm: ArrayLike,
    taken: Conditions,
    effects: Sequence[Effect] = (),
) -> FloatArray:
    """Derivatives of the readings by the parameters ``(n_readings, 6)``, to machine precision.

    Complex step through `simulate`: the imaginary part of f(x + i h) divided by h.
    """
    base = np.asarray(parameters_mm, dtype=np.complex128)
    stepped = base + 1j * COMPLEX_STEP_MM * np.eye(len(base))
    return np.asarray(simulate(geometry, stepped, taken, effects).imag.T / COMPLEX_STEP_MM)


def _touched_at_zero(flow: Flow) -> NDArray[Any]:
    """Coordinate along the measuring axis at Zero of each reading's own station ``(..., n)``."""
    leg, axis = flow.taken.leg, flow.taken.axis
    tool_zero = flow.tool_mm[..., -1, :]
    foot_zero = flow.foot_mm[..., -1, :, :]
    return np.asarray(
        tool_zero[..., axis]
        + flow.taken.station * (foot_zero[..., leg, axis] - tool_zero[..., axis])
    )


def _along_leg(flow: Flow, point_mm: NDArray[Any]) -> NDArray[Any]:
    return np.asarray(point_mm[..., np.arange(len(flow.taken)), flow.taken.leg])


def _own_foot(flow: Flow) -> NDArray[Any]:
    """Foot of the touched leg ``(..., n, 3)``."""
    return np.asarray(flow.foot_mm[..., np.arange(len(flow.taken)), flow.taken.leg, :])


def _append_zero_row(taken: Conditions) -> Conditions:
    """The conditions with one more row: the Zero posture, in which indicators are mounted."""
    zero = {"station": 0.5, "axis": 1, "temperature_c": np.nan, "mount": -1}
    arrays = {
        f.name: np.append(getattr(taken, f.name), zero.get(f.name, 0)) for f in fields(Conditions)
    }
    return Conditions(**{name: a.astype(getattr(taken, name).dtype) for name, a in arrays.items()})
