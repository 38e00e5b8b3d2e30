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

from calib.arrays import TOOL, Conditions, FloatArray, IntArray
from calib.errors import CalibrationError
from calib.tripod.geometry import PARAMETER_NAMES, Geometry, dot, inverse, trilaterate

COMPLEX_STEP_MM = 1e-30
"""Nothing is subtracted, so it may be small; squares of it vanish beside every real part."""


class Stage(StrEnum):
    """Where an effect acts, and what it is handed to change."""

    ACTUATOR = "actuator"  # carriage positions (..., n, 3), mm
    FOOT = "foot"  # feet of the three bars (..., n, 3 legs, 3), mm
    TOOL = "tool"  # lengths of the three bars (..., n, 3), mm
    TOUCH = "touch"  # touched point (..., n, 3), mm
    READING = "reading"  # reading (..., n), mm


MOVES_THE_TOOL = (Stage.ACTUATOR, Stage.FOOT, Stage.TOOL)
"""Stages of the machine; the others are of what is touched and read."""


class StageEffect(Protocol):
    """A change in exactly one stage."""

    @property
    def id(self) -> str:
        """Name in the catalogue, such as ``backlash``."""

    @property
    def stage(self) -> Stage:
        """The one stage whose result `change` is given."""

    def change(self, stage_input: NDArray[Any], flow: Flow) -> NDArray[Any]:
        """What the stage hands on instead of ``stage_input``; ``flow`` holds what came before."""


@dataclass(frozen=True, eq=False)
class Flow:
    """What has passed through the stages so far: n readings and, as last rows, the Zero postures.

    A Zero row is where an indicator is mounted: it fixes the point that the indicator keeps. It
    belongs to no mounting (-1), has no temperature and was approached from nowhere. There is one
    for all, or one for each leg and one for the tool (`Geometry.leg_zero_mm`).
    """

    geometry: Geometry
    taken: Conditions
    effects: Sequence[StageEffect]
    joint_offset_mm: NDArray[Any]
    length_error_mm: NDArray[Any]
    command_mm: NDArray[Any]
    carriage_mm: NDArray[Any]
    foot_mm: NDArray[Any]
    tool_mm: NDArray[Any]
    fraction: NDArray[Any]

    def through(self, stage: Stage, stage_input: NDArray[Any]) -> NDArray[Any]:
        """``stage_input`` after every effect of this stage."""
        for effect in self.effects:
            if effect.stage == stage:
                stage_input = effect.change(stage_input, self)
        return stage_input


def simulate(
    geometry: Geometry,
    parameters_mm: ArrayLike,
    conditions: Conditions,
    effects: Sequence[StageEffect] = (),
) -> NDArray[Any]:
    """Readings ``(..., n_readings)`` in mm for parameters ``(..., 6)`` in mm.

    Order of the parameters: `PARAMETER_NAMES`. A reading is relative to the point of the straight
    bar, or of the tool, that is touched in the Zero posture, so it is zero there but for effects;
    the unknown zero of each mounting is not added. Over a plane it is the coordinate itself. Raises
    UnreachablePosture.
    """
    with_zero = _append_zero_rows(geometry, conditions)
    flow = posture(geometry, parameters_mm, with_zero, command(geometry, with_zero), effects)
    flow = replace(flow, fraction=touched_fraction(flow))
    return reading(flow, touched_point(flow))[..., : len(conditions)]


def posture(
    geometry: Geometry,
    parameters_mm: ArrayLike,
    conditions: Conditions,
    command_mm: FloatArray,
    effects: Sequence[StageEffect] = (),
) -> Flow:
    """The machine as far as the tool, for joint coordinates ``(n, 3)``; see `simulate`."""
    flow = driven(geometry, parameters_mm, conditions, command_mm, effects)
    flow = replace(flow, foot_mm=foot(flow))
    return replace(flow, tool_mm=tool(flow))


def driven(
    geometry: Geometry,
    parameters_mm: ArrayLike,
    conditions: Conditions,
    command_mm: FloatArray,
    effects: Sequence[StageEffect] = (),
) -> Flow:
    """The flow as far as the carriages, which need not reach each other."""
    parameters, empty = np.asarray(parameters_mm), np.empty(0)
    flow = Flow(
        geometry=geometry,
        taken=conditions,
        effects=effects,
        joint_offset_mm=parameters[..., None, :3],
        length_error_mm=parameters[..., None, 3:],
        command_mm=command_mm,
        carriage_mm=empty,
        foot_mm=empty,
        tool_mm=empty,
        fraction=empty,
    )
    return replace(flow, carriage_mm=actuator(flow))


def command(geometry: Geometry, conditions: Conditions) -> FloatArray:
    """Joint coordinates ``(n, 3)`` that the controller commands: nominal inverse kinematics.

    On an Orthoglide Zero commands (L, L, L); displacement s along axis i commands ``L + s`` on
    joint i and ``sqrt(L^2 - s^2)`` on the others (papers/000, section 2.4). Raises
    UnreachablePosture.
    """
    return inverse(geometry, commanded_tool(geometry, conditions))


def commanded_tool(geometry: Geometry, conditions: Conditions) -> FloatArray:
    """Tool positions ``(n, 3)`` from Zero that the controller is told, mm."""
    along = conditions.displacement_mm[:, None] * geometry.directions[conditions.leg]
    return np.asarray(geometry.leg_zero_mm[conditions.leg] + conditions.position_mm + along)


def actuator(flow: Flow) -> NDArray[Any]:
    """Carriage positions ``(..., n, 3)``: command plus joint offset."""
    return flow.through(Stage.ACTUATOR, flow.command_mm + flow.joint_offset_mm)


def foot(flow: Flow) -> NDArray[Any]:
    """Feet of the bars ``(..., n, 3 legs, 3)``: each carriage on the line of its drive."""
    geometry = flow.geometry
    feet = geometry.origins + flow.carriage_mm[..., :, None] * geometry.directions
    return flow.through(Stage.FOOT, feet)


def tool(flow: Flow) -> NDArray[Any]:
    """Tool centre point ``(..., n, 3)``: where the three bars meet."""
    geometry = flow.geometry
    lengths = geometry.lengths + flow.length_error_mm
    rows = np.broadcast_to(lengths, (*lengths.shape[:-2], len(flow.taken), 3))
    feet = flow.foot_mm - geometry.platform
    return trilaterate(feet, flow.through(Stage.TOOL, rows), geometry.side)


def touched_fraction(flow: Flow) -> NDArray[Any]:
    """Where the bar is touched ``(..., n)``: fraction of its length from the tool end.

    The indicator stands still. It was set on the bar in the Zero posture at the station of the
    mounting and keeps that coordinate along the leg's axis (papers/000, equation (10)). Over a
    plane it is set anew in each posture, at the station. A reading of the tool itself stays at
    the tool, 0.
    """
    leg = flow.taken.leg
    along = flow.geometry.directions[leg]
    end_along, foot_along = dot(_own_end(flow), along), dot(_own_foot(flow), along)
    end_zero = dot(_own_end_at_zero(flow), along)
    foot_zero = dot(_own_foot_at_zero(flow), along)
    point = end_zero + flow.taken.station * (foot_zero - end_zero)
    fraction = (point - end_along) / (foot_along - end_along)
    if flow.taken.over_plane.any():
        fraction = np.where(flow.taken.over_plane, flow.taken.station, fraction)
    return np.where(leg == TOOL, 0.0, fraction) if TOOL in leg else np.asarray(fraction)


def touched_point(flow: Flow) -> NDArray[Any]:
    """The point of the bar, or of the tool, under the indicator ``(..., n, 3)``."""
    end = _own_end(flow)
    bar = _own_foot(flow) - end
    return flow.through(Stage.TOUCH, end + flow.fraction[..., None] * bar)


def reading(flow: Flow, touched_mm: NDArray[Any]) -> NDArray[Any]:
    """What the indicator shows ``(..., n)``: its axis of the touched point, minus that at Zero.

    Over a plane nothing is subtracted.
    """
    along = measuring_directions(flow.geometry, flow.taken)
    return flow.through(Stage.READING, moved_along(flow, touched_mm, along))


def moved_along(flow: Flow, touched_mm: NDArray[Any], along: FloatArray) -> NDArray[Any]:
    """How far the touched point is from the straight bar at Zero ``(..., n)``, along ``(n, 3)``."""
    zero = np.where(flow.taken.over_plane, 0.0, _touched_at_zero(flow, along))
    return np.asarray(dot(touched_mm, along) - zero)


def measuring_directions(geometry: Geometry, conditions: Conditions) -> FloatArray:
    """Unit vectors ``(n, 3)`` along which indicators read.

    On a leg across its drive, towards the one that the axis names; at the tool along that
    coordinate.
    """
    ways = np.concatenate([geometry.read_along, np.eye(3)[None]])
    return np.asarray(ways[conditions.leg, conditions.axis])


def derivatives(
    geometry: Geometry,
    parameters_mm: ArrayLike,
    conditions: Conditions,
    effects: Sequence[StageEffect] = (),
) -> FloatArray:
    """Derivatives of the readings by the parameters ``(n_readings, 6)``, to machine precision.

    Complex step through `simulate`: the imaginary part of f(x + i h) divided by h.
    """
    return readings_and_derivatives(geometry, parameters_mm, conditions, effects)[1]


def readings_and_derivatives(
    geometry: Geometry,
    parameters_mm: ArrayLike,
    conditions: Conditions,
    effects: Sequence[StageEffect] = (),
) -> tuple[FloatArray, FloatArray]:
    """Readings ``(n_readings,)`` and `derivatives`: the step is too small for the real part."""
    base = np.asarray(parameters_mm, dtype=np.complex128)
    stepped = base + 1j * COMPLEX_STEP_MM * np.eye(len(base))
    stepped_readings = simulate(geometry, stepped, conditions, effects)
    return np.asarray(stepped_readings[0].real), np.asarray(
        stepped_readings.imag.T / COMPLEX_STEP_MM
    )


def _touched_at_zero(flow: Flow, along: FloatArray) -> NDArray[Any]:
    """Coordinate along ``(n, 3)`` at Zero of each reading's own station ``(..., n)``."""
    end_zero = dot(_own_end_at_zero(flow), along)
    foot_zero = dot(_own_foot_at_zero(flow), along)
    station = np.where(flow.taken.leg == TOOL, 0.0, flow.taken.station)
    return np.asarray(end_zero + station * (foot_zero - end_zero))


def _own_foot(flow: Flow) -> NDArray[Any]:
    """Foot of the touched leg ``(..., n, 3)``."""
    return np.asarray(flow.foot_mm[..., np.arange(len(flow.taken)), flow.taken.leg, :])


def _own_end(flow: Flow) -> NDArray[Any]:
    """Tool end of the touched bar ``(..., n, 3)``, or the tool, or a probe beside it."""
    return np.asarray(flow.tool_mm + _joint(flow))


def _own_end_at_zero(flow: Flow) -> NDArray[Any]:
    tool = flow.tool_mm[..., -1:, :]
    if not flow.geometry.common_zero:
        tool = flow.tool_mm[..., own_zero_rows(flow.taken), :]
    return np.asarray(tool + _joint(flow))


def _own_foot_at_zero(flow: Flow) -> NDArray[Any]:
    leg = flow.taken.leg
    if flow.geometry.common_zero:
        return np.asarray(flow.foot_mm[..., -1, :, :][..., leg, :])
    return np.asarray(flow.foot_mm[..., own_zero_rows(flow.taken), leg, :])


def own_zero_rows(visits: Conditions) -> IntArray:
    """The row of the Zero posture of each reading's leg ``(n,)``, from the end."""
    return np.where(visits.leg == TOOL, -1, visits.leg - len(OWN_ZEROS))


def _joint(flow: Flow) -> FloatArray:
    """Ways ``(n, 3)`` from the tool to the end of the touched bar, or to a probe beside it."""
    leg = flow.taken.leg
    of_tool = (leg == TOOL)[:, None]
    return np.where(of_tool, flow.taken.beside_mm, flow.geometry.platform[leg])


OWN_ZEROS = (0, 1, 2, TOOL)
"""Legs of the last rows of a flow where each leg has a Zero of its own."""


def _append_zero_rows(geometry: Geometry, visits: Conditions) -> Conditions:
    """The conditions with more rows: the Zero postures, in which indicators are mounted."""
    nan = np.nan  # station and axis are some that are valid: these rows are no readings
    zero = {"station": 0.5, "axis": 1, "temperature_c": nan, "mount": -1, "along_mm": nan}
    legs = (0,) if geometry.common_zero else OWN_ZEROS
    arrays = {}
    for name in (f.name for f in fields(Conditions)):
        column = getattr(visits, name)
        rows = np.full((len(legs), *column.shape[1:]), zero.get(name, 0), dtype=column.dtype)
        if name == "leg":
            rows[:] = legs
        arrays[name] = np.concatenate([column, rows])
    return Conditions(**arrays)


@dataclass(frozen=True)
class Model:
    """Nominal geometry, identified parameters (mm, order of `PARAMETER_NAMES`) and effects."""

    geometry: Geometry = Geometry()
    parameters_mm: tuple[float, ...] = (0.0,) * len(PARAMETER_NAMES)
    effects: tuple[StageEffect, ...] = ()

    def __post_init__(self) -> None:
        if len(self.parameters_mm) != len(PARAMETER_NAMES) or not np.all(
            np.isfinite(self.parameters_mm)
        ):
            raise CalibrationError(
                "parameters of the model",
                str(self.parameters_mm),
                f"{len(PARAMETER_NAMES)} finite numbers: {', '.join(PARAMETER_NAMES)}",
            )

    def readings(self, conditions: Conditions) -> FloatArray:
        """Simulated readings ``(n_readings,)`` in mm, without the zeros of the mountings."""
        return np.asarray(simulate(self.geometry, self.parameters_mm, conditions, self.effects))

    def with_effects(self, effects: tuple[StageEffect, ...]) -> Model:
        """The model with other effects."""
        return replace(self, effects=effects)

    def with_parameters(self, parameters_mm: FloatArray) -> Model:
        """The model with other parameters ``(6,)``, mm."""
        return replace(self, parameters_mm=tuple(float(v) for v in parameters_mm))


ZERO_SPREAD_MM = 0.5
"""Standard deviation of where an operator leaves the zero of a freshly mounted indicator."""

TILT_SPREAD = 1e-3
"""The same of a reference plane's tilt along a leg, 1 mm in 1 m: a machine's table, not scraped."""


def measure(
    model: Model,
    conditions: Conditions,
    *,
    scatter_mm: float,
    resolution_mm: float,
    generator: np.random.Generator | int,
) -> FloatArray:
    """Readings ``(n_readings,)`` in mm as indicators would show them.

    ``scatter_mm`` is the standard deviation of each re-approach, ``resolution_mm`` the step of the
    display (0 for none). The generator, or its seed, draws zeros, tilts of planes and scatter.
    """
    generator = np.random.default_rng(generator)
    zeros = generator.normal(scale=ZERO_SPREAD_MM, size=conditions.mount_count)
    values = model.readings(conditions) + zeros[conditions.mount]
    values = values + generator.normal(scale=1.0, size=len(conditions)) * scatter_mm
    if conditions.over_plane.any():
        tilt = generator.normal(scale=TILT_SPREAD, size=conditions.mount_count)
        values = values + np.nan_to_num(tilt[conditions.mount] * conditions.along_mm)
    return round_to(values, resolution_mm)


def round_to(values_mm: FloatArray, resolution_mm: float) -> FloatArray:
    """Values rounded to the nearest step of the display; unchanged for a step of 0."""
    return np.round(values_mm / resolution_mm) * resolution_mm if resolution_mm > 0 else values_mm
