"""A linear delta as firmware of printers knows it, fitted to an identified model.

Upright towers stand about the middle of the plate. With the tool at (x, y, z) the carriage of bar i
is at z + sqrt(L_i^2 - |(x, y) - tower_i|^2). Firmware holds lengths, radii, sometimes angles, where
each switch is along its tower, and how far a step moves each carriage. Readings against a plate do
not show what raises all switches alike: it is chosen so that the tool keeps its height in the
middle of the plate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.arrays import LEG_NAMES, FloatArray
from calib.errors import ImpossibleRequest, UnreachablePosture
from calib.tripod.controller import tool_error_mm
from calib.tripod.effects.drives import ActuatorScale, AxisOffset, Backlash
from calib.tripod.effects.effect import PER_THOUSAND, EffectInstance
from calib.tripod.geometry import Geometry, trilaterate
from calib.tripod.pipeline import Model, Stage, StageEffect
from calib.tripod.workspace import machine_at, workspace_points

UPRIGHT = 1e-6
"""By so much a part of a tower's direction may differ from that of z."""

ON_CIRCLE_MM = 0.01
"""By so much the towers of a machine file may miss one circle: its numbers are rounded."""

LEAST_MM = 1e-4
"""Less at the tool is nothing: no indicator of a workshop shows it."""

STEP = 1e-8
"""Relative size of the last step of the fit: its steps shrink quadratically."""

SLOPE_STEP = 1e-4
"""Of a derivative's differences, both ways, in mm, radians and shares: its square is nothing."""


RESTRAINT = 0.02
"""What a millimetre in an entry costs at the tool that is no part of the model: entries may follow
what firmware cannot hold, but bars ten millimetres shorter would do it here and nowhere else."""


@dataclass(frozen=True)
class TowerEntries:
    """Whether firmware has a length for each bar; a radius, an angle, a travel for each tower.

    Else one length and one radius serve all three, and angles and travels stay as they are.
    """

    lengths: bool
    radii: bool
    angles: bool
    travels: bool


ON_ONE_CIRCLE = TowerEntries(lengths=True, radii=False, angles=True, travels=True)
"""Klipper, RepRapFirmware, Marlin."""

ALIKE_BARS = TowerEntries(lengths=False, radii=True, angles=True, travels=True)
"""Smoothieware."""

RAILS = TowerEntries(lengths=False, radii=True, angles=True, travels=False)
"""TwinCAT's P_3Z: what an axis travels is no value of its kinematics."""

ALL_ALIKE = TowerEntries(lengths=False, radii=False, angles=False, travels=False)
"""LinuxCNC's lineardeltakins."""


@dataclass(frozen=True, eq=False)
class Towers:
    """Lengths of the bars, distances of the towers from the middle, their angles from x.

    Each is ``(3,)``.
    """

    length_mm: FloatArray
    radius_mm: FloatArray
    angle_deg: FloatArray

    @classmethod
    def of(cls, geometry: Geometry, *, one_circle: bool = False) -> Towers:
        """What the controller believes now. Raises ImpossibleRequest for other machines.

        With ``one_circle`` towers at unequal distances from the middle are another machine, too.
        """
        upright = np.abs(geometry.directions - (0.0, 0.0, 1.0)).max() < UPRIGHT
        across = geometry.anchors[:, :2]
        radii = np.hypot(*across.T)
        if not upright or (one_circle and np.ptp(radii) > ON_CIRCLE_MM):
            radii_words = ", ".join(f"{radius:.3f}" for radius in radii)
            raise ImpossibleRequest(
                "kinematics of upright towers",
                f"towers at {radii_words} mm from the tool"
                if upright
                else "drives along other lines",
                "three drives along +z" + " at one distance from it" * one_circle,
                "Is this the machine file of what the controller believes?",
            )
        angles = np.degrees(np.arctan2(across[:, 1], across[:, 0])) % 360.0
        return cls(geometry.lengths, np.full(3, radii.mean()) if one_circle else radii, angles)

    @property
    def span_mm(self) -> FloatArray:
        """How far each carriage is above the tool in the middle ``(3,)``."""
        return np.sqrt(self.length_mm**2 - self.radius_mm**2)

    @property
    def feet_mm(self) -> FloatArray:
        """Where the towers stand about the tool ``(3, 2)``."""
        angle = np.radians(self.angle_deg)
        return np.asarray((self.radius_mm * [np.cos(angle), np.sin(angle)]).T)

    def apart_deg(self, angles_deg: Sequence[float]) -> list[list[float]]:
        """How far each of these places is from the tower of each drive, degrees."""
        turn = self.angle_deg - np.array(angles_deg)[:, None]
        return [*np.abs((turn + 180.0) % 360.0 - 180.0).tolist()]

    def carriages_mm(self, tool_mm: FloatArray) -> FloatArray:
        """Heights of the carriages ``(n, 3)`` that the firmware commands for tools ``(n, 3)``.

        Raises UnreachablePosture where a bar is shorter than its way across.
        """
        across_mm2 = ((tool_mm[:, None, :2] - self.feet_mm) ** 2).sum(axis=-1)
        if (across_mm2 > self.length_mm**2).any():
            raise UnreachablePosture(
                "values for the firmware",
                f"bars of {', '.join(f'{mm:.1f}' for mm in self.length_mm.tolist())} mm, which do "
                "not reach all of the workspace",
                "readings of one machine",
                "Were values changed between these contacts? Probe again.",
            )
        return np.asarray(tool_mm[:, 2:] + np.sqrt(self.length_mm**2 - across_mm2))


@dataclass(frozen=True, eq=False)
class EnteredTowers:
    """What firmware with these entries is to hold in place of ``now``.

    That is ``towers``, with a step longer by the part ``stretch`` ``(3,)``, and with carriages
    higher by ``change_mm`` ``(3,)`` where the tool is at Zero. ``before_mm`` and ``after_mm`` are
    the tool's r.m.s. error over the workspace as `tool_error_mm` counts it; ``moved_mm`` ``(3,)``
    is how far from its present place the tool then stands when it is sent to Zero.
    """

    entries: TowerEntries
    now: Towers
    towers: Towers
    change_mm: FloatArray
    stretch: FloatArray
    before_mm: float
    after_mm: float
    moved_mm: FloatArray

    def uneven_mm(self, tool_mm: ArrayLike, over_mm: ArrayLike) -> tuple[float, float]:
        """Deviation of heights over a plate from their mean, r.m.s.: as now, and with the values.

        The firmware believed the tool at ``tool_mm`` ``(n, 3)`` as it was ``over_mm`` ``(n,)`` over
        the plate. With the values it believes it elsewhere, the carriages being where they were.
        """
        tool, over = np.asarray(tool_mm, dtype=float), np.asarray(over_mm, dtype=float)
        feet = np.zeros((len(tool), 3, 3))
        feet[:, :, :2] = self.towers.feet_mm
        above_zero = self.now.carriages_mm(tool) - self.now.span_mm
        feet[:, :, 2] = self.now.span_mm + (1.0 + self.stretch) * above_zero + self.change_mm
        first, second = feet[0, 1] - feet[0, 0], feet[0, 2] - feet[0, 0]
        below = -1.0 if np.cross(first, second)[2] > 0.0 else 1.0
        then = trilaterate(feet, self.towers.length_mm, below)
        return float((tool[:, 2] - over).std()), float((then[:, 2] - over).std())

    def turns_mm(self, now_mm: Sequence[float]) -> list[float]:
        """Travel that firmware is to count for a turn, or a step, of each motor, as now ``now_mm``.

        Steps per mm are the inverse of it.
        """
        return [*((1.0 + self.stretch) * np.array(now_mm)).tolist()]

    def endstops_mm(self, now_mm: Sequence[float]) -> list[float]:
        """Heights of the tool over the middle at which the switches of drives x, y, z trip.

        ``now_mm`` are those held now. Each carriage is then higher by sqrt(L^2 - R^2), and on its
        way up to the switch its steps are longer.
        """
        up = (1.0 + self.stretch) * np.array(now_mm)
        return [*(up + self.now.span_mm + self.change_mm - self.towers.span_mm).tolist()]


def tower_model(model: Model, change_mm: FloatArray, kept_effects: Sequence[StageEffect]) -> Model:
    """What joints are to hold of a model whose towers went into the kinematics."""
    return model.with_parameters(np.concatenate([change_mm, np.zeros(3)])).with_effects(
        tuple(kept_effects)
    )


def entered(model: Model, entries: TowerEntries) -> EnteredTowers:
    """The values that leave least of the model's error at the tool, r.m.s. over the workspace.

    Least squares in tool space, both ways round, through the same stages as identification; what
    departs from the model's own bars and towers must gain more than a little (`RESTRAINT`). Travels
    stay as they are where the model's carriages go as far as they are commanded. Where
    the tool's place at Zero is set by hand, what moves the tool alike everywhere is free: then its
    height there stays as it is, and its place too where towers may stand anywhere. Raises
    ImpossibleRequest as `Towers.of`.
    """
    from scipy.optimize import least_squares  # 0.1 s to import: only where used

    geometry = model.geometry
    now = Towers.of(geometry, one_circle=not entries.radii)
    points = workspace_points(geometry)
    places = np.concatenate([points, np.zeros((1, 3))])
    travels = entries.travels and any(
        effect.stage == Stage.ACTUATOR and getattr(effect, "id", "") != Backlash.id
        for effect in model.effects
    )
    counts = [
        3,
        3 if entries.radii else 1,
        3 if entries.lengths else 1,
        3 * entries.angles,
        3 * travels,
    ]
    ends = np.cumsum(counts)

    def read(values: FloatArray) -> tuple[Towers, FloatArray, FloatArray]:
        change, radius, length, angle, stretch = np.split(values, ends[:-1])
        turned = np.degrees(angle) if entries.angles else 0.0
        towers = Towers(now.length_mm + length, now.radius_mm + radius, now.angle_deg + turned)
        return towers, change, stretch if travels else np.zeros(3)

    def believed_mm(values: FloatArray, tool_mm: FloatArray) -> FloatArray:
        towers, change, stretch = read(values)
        above_zero = towers.carriages_mm(tool_mm) - change - now.span_mm
        return np.asarray(geometry.zero_mm + above_zero / (1.0 + stretch))

    def off_mm(candidates: FloatArray, way: float) -> FloatArray:
        """Errors of the tool at all points and at Zero ``(n_candidates, n_points + 1, 3)``."""
        believed = np.concatenate([believed_mm(values, places) for values in candidates])
        tool_mm = machine_at(model, believed, way).tool_mm
        return np.asarray(tool_mm.reshape(len(candidates), len(places), 3) - places)

    zeros, own_values = np.zeros(ends[-1]), _of_model(model, now, entries, travels=travels)
    sizes = (1.0, now.radius_mm.mean(), np.abs(points[:, 2]).max())
    across = np.repeat(sizes, [sum(counts[1:3]), *counts[3:]])
    across *= RESTRAINT * entries.lengths  # one length, or one radius, follows what it must
    free_shift = slice(0, 3) if entries.radii and entries.angles else slice(2, 3)
    ways = (1.0, -1.0) if model.effects else (1.0,)
    standing = {way: off_mm(zeros[None], way)[0, -1] for way in ways}

    def rows(candidates: FloatArray) -> FloatArray:
        """What is to be small ``(n_candidates, n_rows)``: all in one simulation for each way."""
        apart = across * (candidates - own_values)[:, 3:]
        parts = [math.sqrt(len(ways) * len(points)) * apart]
        for way in ways:
            off = off_mm(candidates, way)
            at_zero, off = off[:, -1], off[:, :-1]
            if geometry.set_at_zero:
                # as heavy as all places together squared: it is no part of the bargain
                parts.append(len(points) * (at_zero - standing[way])[:, free_shift])
                off = off - at_zero[:, None]
            parts.append(off.reshape(len(candidates), -1))
        return np.concatenate(parts, axis=1)

    def residual(values: FloatArray) -> FloatArray:
        return np.asarray(rows(values[None])[0])

    def slopes(values: FloatArray) -> FloatArray:
        step = SLOPE_STEP * np.eye(len(values))
        ahead, behind = np.split(rows(np.concatenate([values + step, values - step])), 2)
        return np.asarray((ahead - behind).T / (2.0 * SLOPE_STEP))

    fit = least_squares(residual, own_values, slopes, xtol=STEP, ftol=None, gtol=None)
    solution = np.asarray(fit.x)
    towers, change, stretch = read(solution)
    moved_mm = off_mm(solution[None], 1.0)[0, -1] - standing[1.0]
    after_mm = tool_error_mm(model, lambda tool_mm: believed_mm(solution, tool_mm))
    before_mm = tool_error_mm(model)
    return EnteredTowers(entries, now, towers, change, stretch, before_mm, after_mm, moved_mm)


def _of_model(model: Model, now: Towers, entries: TowerEntries, *, travels: bool) -> FloatArray:
    """Bars and towers of a model as entries, switches first, as far as there are entries."""
    feet, across, stretch = now.feet_mm.copy(), model.geometry.across, np.zeros(3)
    for effect in model.effects:
        if not isinstance(effect, EffectInstance):
            continue
        if effect.id == AxisOffset.id:
            way = across[effect.place][:2]
            feet[LEG_NAMES.index(effect.place[0])] += np.real(effect.values[0]) * way
        elif effect.id == ActuatorScale.id:
            drives = [LEG_NAMES.index(name) for name in effect.place]
            stretch[drives] += PER_THOUSAND * np.real(effect.values)
    if not entries.radii:  # three towers stand on one circle wherever they are: about its middle
        ways = 2.0 * (feet[1:] - feet[0])
        feet -= np.linalg.solve(ways, (feet[1:] ** 2).sum(axis=1) - (feet[0] ** 2).sum())
    radius = np.hypot(*feet.T) - now.radius_mm
    angle = np.arctan2(feet[:, 1], feet[:, 0]) - np.radians(now.angle_deg)
    turned = (angle + np.pi) % (2.0 * np.pi) - np.pi
    switches, lengths = np.split(np.array(model.parameters_mm), 2)
    return np.concatenate(
        [
            switches,
            radius if entries.radii else [radius.mean()],
            lengths if entries.lengths else [lengths.mean()],
            turned if entries.angles else [],
            stretch if travels else [],
        ]
    )


def each_alone(model: Model, entries: TowerEntries) -> Iterator[tuple[str, float]]:
    """What `entered` leaves of each part of the model by itself, mm r.m.s.: names and figures."""
    nominal = Model(model.geometry)
    for name, part in (("d_rho", slice(0, 3)), ("d_L", slice(3, 6))):
        values = np.zeros(6)
        values[part] = model.parameters_mm[part]
        if values.any():
            yield name, entered(nominal.with_parameters(values), entries).after_mm
    for effect_id in dict.fromkeys(effect.id for effect in model.effects):
        alike = tuple(effect for effect in model.effects if effect.id == effect_id)
        yield effect_id, entered(nominal.with_effects(alike), entries).after_mm
