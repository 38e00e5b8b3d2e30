"""The tool over the workspace: where it is, how drives and errors of parameters move the tool."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np

from calib.arrays import LEG_NAMES, Conditions, FloatArray, tool_conditions
from calib.errors import CalibrationError
from calib.tripod.geometry import Geometry, Triple, inverse, tool_jacobians, trilaterate
from calib.tripod.pipeline import Flow, Model

CELLS_PER_AXIS = 6
REACH_POINTS = 9
"""Positions of each carriage, ends among them, whose tools enclose all that joint limits allow."""


@lru_cache(maxsize=8)
def workspace_box(geometry: Geometry) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest corner ``(3,)``: of the machine file, else of all that can be reached."""
    if geometry.workspace_mm is not None:
        low, high = geometry.workspace_mm
        return np.array(low), np.array(high)
    travel = np.linspace(geometry.travel_min_mm, geometry.travel_max_mm, REACH_POINTS)
    carriage = geometry.zero_mm + _grid([travel] * 3)
    feet = geometry.anchors + geometry.directions * carriage[:, :, None]
    tool = trilaterate(feet, geometry.lengths, geometry.side, refuse=False)
    tool = np.vstack([tool[~np.isnan(tool).any(axis=1)], np.zeros(3)])
    tool = tool[geometry.stands(tool)]
    return tool.min(axis=0), tool.max(axis=0)


def _middles(low: FloatArray, high: FloatArray, cells: int) -> list[FloatArray]:
    """Middles of so many cells along x, y, z."""
    part = (np.arange(cells) + 0.5) / cells
    return [a + (b - a) * part for a, b in zip(low, high, strict=True)]


@lru_cache(maxsize=16)
def workspace_points(geometry: Geometry, cells_per_axis: int = CELLS_PER_AXIS) -> FloatArray:
    """Middles ``(n_points, 3)`` of the workspace's cells where the machine may stand, mm.

    Raises CalibrationError where it stands in none.
    """
    low, high = workspace_box(geometry)
    points = _grid(_middles(low, high, cells_per_axis))
    reached_points = points[geometry.stands(points)]
    if not len(reached_points):
        limits = f"{geometry.travel_min_mm:g} … {geometry.travel_max_mm:g} mm"
        raise CalibrationError(
            "workspace",
            f"nothing of {np.round(low, 3).tolist()} … {np.round(high, 3).tolist()} mm reached",
            f"places that the joint limits {limits} and the bars allow",
            "Change workspace_mm or the joint limits in the machine file.",
        )
    reached_points.flags.writeable = False
    return reached_points


def _grid(axes: Sequence[FloatArray]) -> FloatArray:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def workspace_jacobian(geometry: Geometry) -> FloatArray:
    """Derivatives of the tool by the base parameters ``(n_points, 3, 6)``; papers/000 (5)."""
    return tool_jacobian_at(geometry, workspace_points(geometry))


def tool_jacobian_at(geometry: Geometry, tool_mm: FloatArray) -> FloatArray:
    """Derivatives of the tool by the base parameters ``(n_points, 3, 6)`` at these positions.

    Where the tool's place at Zero is set by hand, of the tool less what it does there.
    """
    jacobian = np.concatenate(tool_jacobians(geometry, tool_mm, inverse(geometry, tool_mm)), axis=2)
    if geometry.set_at_zero:
        at_zero = tool_jacobians(geometry, np.zeros(3), geometry.zero_mm)
        jacobian = jacobian - np.concatenate(at_zero, axis=1)
    return jacobian


def machine_at(model: Model, joint_mm: FloatArray, way: float) -> Flow:
    """The machine, as far as its tool, at joint coordinates ``(n, 3)``, all reached one ``way``.

    1 is upwards, -1 downwards.
    """
    conditions = reached(len(joint_mm), way)
    return Flow(model.geometry, model.parameters_mm, conditions, joint_mm, model.effects)


def reached(count: int, way: float) -> Conditions:
    """Conditions of so many postures of the tool, all carriages having come one way."""
    planned = tool_conditions(np.zeros((count, 3)))
    return replace(planned, movement=np.full((count, 3), way))


PLANES = ((0, 1), (1, 2), (0, 2))
MAP_POINTS = 7


@dataclass(frozen=True, eq=False)
class PlaneMap:
    """Values ``(n, n)`` on a plane through Zero, rows upwards; NaN where the tool does not reach.

    ``coordinate_mm`` ``(n,)`` are places across, ``up_mm`` ``(n,)`` upwards.
    """

    across: str
    up: str
    coordinate_mm: FloatArray
    up_mm: FloatArray
    value: FloatArray

    @property
    def other_up_mm(self) -> FloatArray | None:
        """``up_mm`` where it is not the same as across."""
        return None if np.array_equal(self.coordinate_mm, self.up_mm) else self.up_mm


def plane_map(
    geometry: Geometry,
    plane: tuple[int, int],
    points: int,
    values: Callable[[FloatArray], FloatArray],
) -> PlaneMap:
    """What ``values`` gives for places of the tool ``(n, 3)``, over the workspace's box."""
    axes = _middles(*workspace_box(geometry), points)
    across, up = axes[plane[0]], axes[plane[1]]
    tool = np.zeros((points, points, 3))
    tool[:, :, plane[0]] = across[None, :]
    tool[:, :, plane[1]] = up[:, None]
    on_plane, stands = np.full((points, points), np.nan), geometry.stands(tool)
    on_plane[stands] = values(tool[stands])
    return PlaneMap("xyz"[plane[0]], "xyz"[plane[1]], across, up, on_plane)


def transmission(geometry: Geometry, tool_mm: FloatArray) -> FloatArray:
    """Velocity transmission factors ``(..., 3)``, the largest first: tool over carriages.

    Singular values of the derivatives of the tool by the carriages; papers/000, section 2.1.
    """
    by_carriages, _ = tool_jacobians(geometry, tool_mm, inverse(geometry, tool_mm))
    return np.asarray(np.linalg.svd(by_carriages, compute_uv=False))


def distortion(geometry: Geometry, tool_mm: FloatArray) -> FloatArray:
    """The factor ``(...)`` that is furthest from 1, or its inverse if that is larger."""
    factors = transmission(geometry, tool_mm)
    return np.maximum(factors[..., 0], 1.0 / factors[..., 2])


def passive_angles(geometry: Geometry, tool_mm: FloatArray) -> FloatArray:
    """Angles θ and β of each leg ``(..., 3 legs, 2)`` in rad; papers/000, equation (1).

    The bar from the carriage is L (-cos θ cos β) along its drive, L sin θ cos β along the first
    and -L sin β along the second direction across: of leg x along y and z, of y along z and x, of
    z along x and y, else radial and tangential (`Geometry.across`). The paper prints the first
    without its minus, against s = +1 in (3).
    """
    bars = geometry.bars(tool_mm)
    names = list(geometry.across)
    angles = np.empty((*bars.shape[:-1], 2))
    for leg, name in enumerate(LEG_NAMES):
        of_leg = sorted(drive for drive in names if drive[0] == name)
        cyclic = [name + LEG_NAMES[(leg + k) % 3] for k in (1, 2)]
        first, second = (
            geometry.across[drive] for drive in (cyclic if geometry.common_zero else of_leg)
        )
        bar = bars[..., leg, :]
        angles[..., leg, 0] = np.arctan2(bar @ first, -bar @ geometry.directions[leg])
        angles[..., leg, 1] = np.arcsin(np.clip(-bar @ second, -1.0, 1.0))
    return angles


WORKING_MODES = tuple(product((1, -1), repeat=3))
"""The signs s of papers/000 (3); a machine of this family is assembled as the first."""


@dataclass(frozen=True)
class WorkingMode:
    """Signs in papers/000 (3) and the carriages from Zero, mm, that give the same tool."""

    signs: tuple[int, ...]
    carriage_mm: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class PostureOfTool:
    """One place of the tool, and the other solutions of papers/000 (2).

    ``theta_deg``, ``beta_deg`` ``(3 legs,)`` are passive angles, ``modes`` all working modes, the
    machine's own first, ``assembly_mm`` ``(3,)`` is where the bars of its carriages meet as well.
    ``stands`` tells whether joint limits allow it.
    """

    tool_mm: Triple
    stands: bool
    theta_deg: FloatArray
    beta_deg: FloatArray
    factors: FloatArray
    modes: tuple[WorkingMode, ...]
    assembly_mm: FloatArray


def posture_of_tool(geometry: Geometry, tool_mm: Triple) -> PostureOfTool:
    """Angles, factors and every solution at a place. Raises UnreachablePosture."""
    tool = np.array(tool_mm)
    carriage = inverse(geometry, tool)
    covered = np.sqrt(geometry.reach_mm2(tool))
    travels = carriage + (np.array(WORKING_MODES) - 1.0) * covered - geometry.zero_mm
    feet = geometry.anchors + geometry.directions * carriage[:, None]
    theta, beta = np.degrees(passive_angles(geometry, tool)).T
    return PostureOfTool(
        tool_mm,
        bool(geometry.stands(tool[None])[0]),
        theta,
        beta,
        transmission(geometry, tool),
        tuple(
            WorkingMode(signs, tuple(travel))
            for signs, travel in zip(WORKING_MODES, travels.tolist(), strict=True)
        ),
        trilaterate(feet, geometry.lengths, -geometry.side),
    )


@dataclass(frozen=True, eq=False)
class LargestCube:
    """Lowest corner ``(3,)`` and side, mm."""

    low_mm: FloatArray
    side_mm: float


@dataclass(frozen=True, eq=False)
class Workspace:
    """Where the tool can be, and how evenly the drives move it there.

    The box is ``stated`` in the machine file or all that joint limits allow; ``reached`` is the
    share of it where the machine may stand, ``inside`` the share of that with every factor within
    1/limit … limit, ``cube`` the largest one of these that was found, wherever joint limits allow
    it. ``theta_deg``, ``beta_deg`` ``(3 legs, 2)`` are lowest and highest passive angles.
    """

    low_mm: FloatArray
    high_mm: FloatArray
    stated: bool
    reached: float
    volume_mm3: float
    lowest_factor: float
    highest_factor: float
    at_zero: FloatArray
    limit: float
    inside: float
    cube: LargestCube | None
    theta_deg: FloatArray
    beta_deg: FloatArray
    maps: tuple[PlaneMap, ...]


SCAN_CELLS = 24
"""Cells along each axis that shares and extremes are looked for in."""


def workspace_of(geometry: Geometry, limit: float) -> Workspace:
    """The workspace, the factors over it, and the cut at a limit of these."""
    low, high = workspace_box(geometry)
    points = workspace_points(geometry, SCAN_CELLS)
    factors, share = transmission(geometry, points), len(points) / SCAN_CELLS**3
    within = np.maximum(factors[:, 0], 1.0 / factors[:, 2]) <= limit
    angles = np.degrees(passive_angles(geometry, points))
    ends = np.stack([angles.min(axis=0), angles.max(axis=0)], axis=-1)
    return Workspace(
        low_mm=low,
        high_mm=high,
        stated=geometry.workspace_mm is not None,
        reached=share,
        volume_mm3=share * float(np.prod(high - low)),
        lowest_factor=float(factors.min()),
        highest_factor=float(factors.max()),
        at_zero=transmission(geometry, np.zeros(3)),
        limit=limit,
        inside=float(within.mean()),
        cube=largest_cube(geometry, limit),
        theta_deg=ends[:, 0],
        beta_deg=ends[:, 1],
        maps=tuple(
            plane_map(geometry, plane, MAP_POINTS, lambda tool: distortion(geometry, tool))
            for plane in PLANES
        ),
    )


SCAN_NODES = 31
"""Along the longest side of what is reached, for a first guess of the largest cube."""

FINEST_MM = 0.1
BESIDE = np.array(list(product((-0.5, 0.0, 0.5), repeat=3)))
HERE = len(BESIDE) // 2
GROWN = np.array(list(product((-1.0, -0.5, 0.0, 0.5), repeat=3)))
CLEARER = 1e-6
"""So much nearer to 1 the factors must come for a cube to move without growing."""


def largest_cube(geometry: Geometry, limit: float) -> LargestCube | None:
    """The largest cube where every factor is within 1/limit … limit.

    The machine may stand everywhere in it; None where there is none. Found among the nodes of a
    grid over all that the joint limits allow, then moved and grown in steps down to `FINEST_MM`.
    """
    low, high = workspace_box(replace(geometry, workspace_mm=None))
    step = float((high - low).max()) / (SCAN_NODES - 1)
    axes = [np.arange(a, b, step) for a, b in zip(low, high, strict=True)]
    nodes = _grid(axes)
    inside = _worst(geometry, nodes, 0.0) <= limit
    fitting, count = inside.reshape([len(axis) for axis in axes]), 0
    while True:  # cubes of one node more, where all eight of these fit
        shifts = product((slice(None, -1), slice(1, None)), repeat=3)
        larger = np.logical_and.reduce([fitting[shift] for shift in shifts])
        if not larger.any():
            break
        fitting, count = larger, count + 1
    if not count:
        return None
    first = np.argwhere(fitting)
    side = count * step
    corners = np.stack([axis[k] for axis, k in zip(axes, first.T, strict=True)], axis=1)
    low = corners[int(_worst(geometry, corners, side).argmin())]
    while step > FINEST_MM:
        grown = low + step * GROWN
        larger = _worst(geometry, grown, side + step)
        best = int(larger.argmin())
        if larger[best] <= limit:
            low, side = grown[best], side + step
            continue
        moved = low + step * BESIDE  # to where the next step may fit
        moved_worst = _worst(geometry, moved, side)
        best = int(moved_worst.argmin())
        if moved_worst[best] < moved_worst[HERE] - CLEARER:
            low = moved[best]
        else:
            step /= 2.0
    return LargestCube(low, side)


def _worst(geometry: Geometry, low: FloatArray, side: float) -> FloatArray:
    """The largest `distortion` ``(n,)`` in cubes of a side; infinite where one is not reached.

    At their corners, and nearest to the drives' lines, where carriages go furthest.
    """
    ends = np.stack([np.zeros_like(low), np.full_like(low, side)], axis=1)
    near = np.clip(geometry.anchors - low[:, None, :], 0.0, side)
    along = np.concatenate([ends, near], axis=1)[:, : 5 if side else 1]  # (n, nodes, 3)
    index = np.array(list(product(range(along.shape[1]), repeat=3)))
    tool = low[:, None, :] + np.stack([along[:, index[:, k], k] for k in range(3)], axis=-1)
    worst, stands = np.full(tool.shape[:2], np.inf), geometry.stands(tool)
    worst[stands] = distortion(geometry, tool[stands])
    return np.asarray(worst.max(axis=1))
