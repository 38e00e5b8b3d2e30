"""The one forward simulation: command → actuator → foot → tool → touched point → reading.

Each stage is a property of a `Flow`; `simulate` reads the last one. All readings of a session pass
at once, ``n`` of them; an optional leading batch axis ``(..., )`` holds many machines. An effect
changes what one stage hands on and nothing else; the base parameters enter in the actuator stage
(joint offsets) and in the tool stage (leg lengths).

Identification, the simulated rig, replay and derivatives all call `simulate`. Every stage is
written so that complex numbers pass through it, so `derivatives` needs no formula of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from functools import cached_property
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
    """One run through the stages, each computed when it is first asked for.

    Of n readings and, as last rows, the Zero postures. A Zero row is where an indicator is mounted:
    it fixes the point that the indicator keeps. It belongs to no mounting (-1), has no temperature
    and was approached from nowhere. There is one for all, or one for each leg and one for the tool
    (`Geometry.leg_zero_mm`). Without Zero rows it goes as far as the tool. An effect may ask for
    what came before its stage. Raises UnreachablePosture where the bars do not meet.
    """

    geometry: Geometry
    parameters_mm: ArrayLike
    taken: Conditions
    command_mm: FloatArray
    effects: Sequence[StageEffect] = ()

    def through(self, stage: Stage, stage_input: NDArray[Any]) -> NDArray[Any]:
        """``stage_input`` after every effect of this stage."""
        for effect in self.effects:
            if effect.stage == stage:
                stage_input = effect.change(stage_input, self)
        return stage_input

    @cached_property
    def carriage_mm(self) -> NDArray[Any]:
        """Carriage positions ``(..., n, 3)``: command plus joint offset."""
        offset = np.asarray(self.parameters_mm)[..., None, :3]
        return self.through(Stage.ACTUATOR, self.command_mm + offset)

    @cached_property
    def foot_mm(self) -> NDArray[Any]:
        """Feet of the bars ``(..., n, 3 legs, 3)``: each carriage on the line of its drive."""
        geometry = self.geometry
        feet = geometry.origins + self.carriage_mm[..., :, None] * geometry.directions
        return self.through(Stage.FOOT, feet)

    @cached_property
    def tool_mm(self) -> NDArray[Any]:
        """Tool centre point ``(..., n, 3)``: where the three bars meet."""
        geometry = self.geometry
        lengths = geometry.lengths + np.asarray(self.parameters_mm)[..., None, 3:]
        rows = np.broadcast_to(lengths, (*lengths.shape[:-2], len(self.taken), 3))
        feet = self.foot_mm - geometry.platform
        return trilaterate(feet, self.through(Stage.TOOL, rows), geometry.side)

    @cached_property
    def _joint_mm(self) -> FloatArray:
        """Ways ``(n, 3)`` from the tool to the end of the touched bar, or to a probe beside it."""
        leg = self.taken.leg
        return np.where((leg == TOOL)[:, None], self.taken.beside_mm, self.geometry.platform[leg])

    @cached_property
    def bar_mm(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Tool end and foot of the touched bar ``(..., n, 3)``; the end may be tool or probe."""
        foot = self.foot_mm[..., np.arange(len(self.taken)), self.taken.leg, :]
        return self.tool_mm + self._joint_mm, foot

    @cached_property
    def mounted_mm(self) -> NDArray[Any]:
        """The point of the straight bar, or of the tool, touched at Zero ``(..., n, 3)``."""
        zero, leg = zero_rows(self.geometry, self.taken), self.taken.leg
        end = self.tool_mm[..., zero, :] + self._joint_mm
        station = np.where(leg == TOOL, 0.0, self.taken.station)[:, None]
        return np.asarray(end + station * (self.foot_mm[..., zero, leg, :] - end))

    @cached_property
    def fraction(self) -> NDArray[Any]:
        """Where the bar is touched ``(..., n)``: fraction of its length from the tool end.

        The indicator stands still. It was set on the bar in the Zero posture at the station of the
        mounting and keeps that coordinate along the leg's axis (papers/000, equation (10)). Over a
        plane it is set anew in each posture, at the station. A reading of the tool itself stays at
        the tool, 0.
        """
        (end, foot), along = self.bar_mm, self.geometry.directions[self.taken.leg]
        end_along = dot(end, along)
        fraction = (dot(self.mounted_mm, along) - end_along) / (dot(foot, along) - end_along)
        fraction = np.where(self.taken.over_plane, self.taken.station, fraction)
        return np.where(self.taken.leg == TOOL, 0.0, fraction)

    @cached_property
    def touched_mm(self) -> NDArray[Any]:
        """The point of the bar, or of the tool, under the indicator ``(..., n, 3)``."""
        end, foot = self.bar_mm
        return self.through(Stage.TOUCH, end + self.fraction[..., None] * (foot - end))

    def moved_along(self, touched_mm: NDArray[Any], along: FloatArray) -> NDArray[Any]:
        """How far a touched point is from that at Zero ``(..., n)``, along ``(n, 3)``.

        Over a plane its coordinate itself.
        """
        zero = np.where(self.taken.over_plane, 0.0, dot(self.mounted_mm, along))
        return np.asarray(dot(touched_mm, along) - zero)


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
    flow = Flow(geometry, parameters_mm, with_zero, command(geometry, with_zero), effects)
    moved_mm = flow.moved_along(flow.touched_mm, measuring_directions(geometry, with_zero))
    return flow.through(Stage.READING, moved_mm)[..., : len(conditions)]


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


OWN_ZEROS = (0, 1, 2, TOOL)
"""Legs of the last rows of a flow where each leg has a Zero of its own."""


def zero_rows(geometry: Geometry, conditions: Conditions) -> IntArray:
    """The row, from the end, of the Zero posture of each reading ``(n,)``, or the one of all."""
    if geometry.common_zero:
        return np.array([-1])
    return np.where(conditions.leg == TOOL, -1, conditions.leg - len(OWN_ZEROS))


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
