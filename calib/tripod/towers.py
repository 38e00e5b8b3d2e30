"""A linear delta as firmware of printers knows it, fitted to an identified model.

Upright towers stand on one circle about the middle of the plate. With the tool at (x, y, z) the
carriage of bar i is at z + sqrt(L_i^2 - |(x, y) - tower_i|^2). Firmware holds the lengths, the
radius, sometimes the angles, and where each switch is along its tower.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calib.arrays import FloatArray
from calib.errors import ImpossibleRequest
from calib.tripod.controller import tool_error_mm
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model, StageEffect
from calib.tripod.workspace import machine_at, workspace_points

UPRIGHT = 1e-6
"""By so much a part of a tower's direction may differ from that of z."""

ON_CIRCLE_MM = 0.01
"""By so much the towers of a machine file may miss one circle: its numbers are rounded."""

LEAST_MM = 1e-4
"""Less at the tool is nothing: no indicator of a workshop shows it."""

STEP = 1e-8
"""Relative size of the last step of the fit: its steps shrink quadratically."""


@dataclass(frozen=True, eq=False)
class Towers:
    """Lengths of the bars ``(3,)``, the radius, and the angle of each tower from x ``(3,)``."""

    length_mm: FloatArray
    radius_mm: float
    angle_deg: FloatArray

    @classmethod
    def of(cls, geometry: Geometry) -> Towers:
        """What the controller believes now. Raises ImpossibleRequest for other machines."""
        upright = np.abs(geometry.directions - (0.0, 0.0, 1.0)).max() < UPRIGHT
        across = geometry.anchors[:, :2]
        radii = np.hypot(*across.T)
        if not upright or np.ptp(radii) > ON_CIRCLE_MM:
            shown = ", ".join(f"{radius:.3f}" for radius in radii)
            raise ImpossibleRequest(
                "kinematics of upright towers",
                f"towers at {shown} mm from the tool" if upright else "drives along other lines",
                "three drives along +z whose bars span the same distance at Zero",
                "Is this the machine file of what the controller believes?",
            )
        angles = np.degrees(np.arctan2(across[:, 1], across[:, 0])) % 360.0
        return cls(geometry.lengths, float(radii.mean()), angles)

    @property
    def span_mm(self) -> FloatArray:
        """How far each carriage is above the tool in the middle ``(3,)``."""
        return np.sqrt(self.length_mm**2 - self.radius_mm**2)

    @property
    def feet_mm(self) -> FloatArray:
        """Where the towers stand about the tool ``(3, 2)``."""
        angle = np.radians(self.angle_deg)
        return np.asarray(self.radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1))

    def apart_deg(self, angles_deg: Sequence[float]) -> list[list[float]]:
        """How far each of these places is from the tower of each drive, degrees."""
        turn = self.angle_deg - np.array(angles_deg)[:, None]
        found: list[list[float]] = np.abs((turn + 180.0) % 360.0 - 180.0).tolist()
        return found

    def carriages_mm(self, tool_mm: FloatArray) -> FloatArray:
        """Heights of the carriages ``(n, 3)`` that the firmware commands for tools ``(n, 3)``."""
        across = tool_mm[:, None, :2] - self.feet_mm
        return np.asarray(tool_mm[:, 2:] + np.sqrt(self.length_mm**2 - (across**2).sum(axis=-1)))


@dataclass(frozen=True, eq=False)
class Entered:
    """What firmware that holds ``now`` is to hold: ``towers``, switches higher by ``change_mm``.

    ``change_mm`` ``(3,)`` are the carriages at the switches. ``before_mm`` and ``after_mm`` are the
    tool's r.m.s. error over the workspace as `tool_error_mm` counts it; ``at_zero_mm`` ``(3,)`` is
    where the tool then stands when it is sent to Zero.
    """

    now: Towers
    towers: Towers
    change_mm: FloatArray
    before_mm: float
    after_mm: float
    at_zero_mm: FloatArray

    def endstops_mm(self, now_mm: Sequence[float]) -> list[float]:
        """Heights of the tool over the middle at which the switches of drives x, y, z trip.

        ``now_mm`` are those held now. Each carriage is then higher by sqrt(L^2 - R^2).
        """
        found = np.array(now_mm) + self.now.span_mm + self.change_mm - self.towers.span_mm
        stops: list[float] = found.tolist()
        return stops


def tower_model(model: Model, change_mm: FloatArray, kept: Sequence[StageEffect]) -> Model:
    """What joints are to hold of a model whose towers went into the kinematics."""
    return model.with_parameters(np.concatenate([change_mm, np.zeros(3)])).with_effects(tuple(kept))


def entered(model: Model, *, each_tower: bool) -> Entered:
    """The values that leave least of the model's error at the tool, r.m.s. over the workspace.

    With ``each_tower`` every bar has a length and every tower an angle, else all bars have one
    length and the angles stay. Least squares in tool space, both ways round, through the same
    stages as identification. Raises ImpossibleRequest as `Towers.of`.
    """
    now, geometry = Towers.of(model.geometry), model.geometry
    points = workspace_points(geometry)
    base = -geometry.anchors[:, 2]

    def read(values: FloatArray) -> tuple[Towers, FloatArray]:
        if each_tower:
            length, angle = now.length_mm + values[4:7], now.angle_deg + np.degrees(values[7:])
        else:
            length, angle = now.length_mm + values[4], now.angle_deg
        return Towers(length, now.radius_mm + values[3], angle), values[:3]

    def believed_mm(values: FloatArray, tool_mm: FloatArray) -> FloatArray:
        towers, change = read(values)
        return towers.carriages_mm(tool_mm) + base - change

    def off_mm(values: FloatArray) -> FloatArray:
        zero = np.zeros((1, 3))
        rows = []
        for way in (1.0, -1.0) if model.effects else (1.0,):
            off = machine_at(model, believed_mm(values, points), way).tool_mm - points
            if geometry.set_at_zero:
                at_zero = machine_at(model, believed_mm(values, zero), way).tool_mm
                # kept at its height: else all switches together could be anywhere
                rows.append(at_zero[:, 2])
                off = off - at_zero
            rows.append(off.ravel())
        return np.concatenate(rows)

    start = np.zeros(10 if each_tower else 5)
    found = least_squares(off_mm, start, xtol=STEP, ftol=None, gtol=None).x
    towers, change = read(found)
    stands = machine_at(model, believed_mm(found, np.zeros((1, 3))), 1.0).tool_mm[0]
    after_mm = tool_error_mm(model, lambda tool_mm: believed_mm(found, tool_mm))
    return Entered(now, towers, change, tool_error_mm(model), after_mm, stands)


def each_alone(model: Model, *, each_tower: bool) -> Iterator[tuple[str, float]]:
    """What `entered` leaves of each part of the model by itself, mm r.m.s.: names and figures."""
    nominal = Model(model.geometry)
    for name, part in (("d_rho", slice(0, 3)), ("d_L", slice(3, 6))):
        values = np.zeros(6)
        values[part] = model.parameters_mm[part]
        if values.any():
            yield name, entered(nominal.with_parameters(values), each_tower=each_tower).after_mm
    for effect_id in dict.fromkeys(one.id for one in model.effects):
        same = tuple(one for one in model.effects if one.id == effect_id)
        yield effect_id, entered(nominal.with_effects(same), each_tower=each_tower).after_mm
