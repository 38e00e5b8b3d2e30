"""Nominal geometry of three drives and bars, its postures, closed-form kinematics."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations, product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.arrays import LEG_NAMES, FloatArray, IntArray
from calib.errors import CalibrationError, UnreachablePosture

PARAMETER_NAMES = ("d_rho_x", "d_rho_y", "d_rho_z", "d_L_x", "d_L_y", "d_L_z")
"""The base parameters: joint offsets, then leg length errors; both in mm."""

TOLERANCE_MM = 5.0
"""No machine is put together so badly: an error of this size would be seen without measuring."""

LEAST_VOLUME = 1e-3
"""Of the three unit vectors along the bars: below it the tool can move with every drive at rest."""

LEAST_SLOPE = 0.02
"""Of a bar along its drive: below it the carriage cannot move the tool."""

MOST_ASKEW = 0.1
"""Of a bar to its drive at Zero: more, and it slides under an indicator further than that reads."""

MOST_ALIKE = 0.9
"""Cosine of two drives: nearer to parallel, neither leads across the other."""

UNIT = 1e-6
"""By so much the square of a direction given to `Geometry` may differ from 1."""

USABLE_BAR = (0.05, 0.95)
"""Fractions of a bar, from the tool end, that an indicator may touch: clear of joints and stand."""

USUAL_ANGLES_DEG = (210.0, 330.0, 90.0)
"""Of the first, second and third tower of printers, from x, anticlockwise."""

FURTHEST_DEG = 30.0
"""A tower that stands further from such a place is another one."""

Pair = tuple[float, float]
Triple = tuple[float, float, float]
Three = tuple[Triple, Triple, Triple]

Coordinates = Iterable[Any]
"""The three of vectors, arrays of one shape."""

COORDINATES: Three = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
NOWHERE: Three = ((0.0, 0.0, 0.0),) * 3


@dataclass(frozen=True)
class Geometry:
    """Nominal dimensions in mm; the defaults are the prototype of papers/000, section 2.1.

    Positions count from the tool in the Zero posture. ``leg_length_mm`` is the length of each bar,
    ``origin_mm`` and ``direction`` (unit vectors) tell each drive's line and where its coordinate
    counts from, ``platform_mm`` where each bar is held, from the tool. Seen from the platform the
    carriage is ahead, in the drive's direction. ``travel_max_mm`` and ``travel_min_mm`` are limits
    of every carriage about Zero; on an Orthoglide at the same time the displacements of the
    postures Max and Min. ``workspace_mm`` is the box, lowest and highest corner, that errors of the
    tool are judged over; None: all that the joint limits allow. With ``set_at_zero``
    these errors count from the tool's place at Zero, which is set by hand. ``gravity`` is the unit
    vector of the pull of weight, ``screw_lead_mm`` the travel of a carriage for one turn, None if
    not known. ``load`` is the weight carried now, in units of the usual one. ``usable_bar`` are the
    fractions of each bar, from the tool end, between which an indicator may touch it;
    ``plane_mm`` is from where to where along each leg a reference plane reaches, None: everywhere.

    Raises CalibrationError for a machine that cannot stand at Zero or is singular there.
    """

    leg_length_mm: Triple = (310.25, 310.25, 310.25)
    travel_max_mm: float = 60.0
    travel_min_mm: float = -100.0
    parallelogram_width_mm: float = 80.0
    tool_radius_mm: float = 31.0
    gravity: Triple = (0.0, 0.0, -1.0)
    screw_lead_mm: float | None = None
    load: float = 1.0
    origin_mm: Three = NOWHERE
    direction: Three = COORDINATES
    platform_mm: Three = NOWHERE
    workspace_mm: tuple[Triple, Triple] | None = None
    set_at_zero: bool = False
    usable_bar: tuple[Pair, Pair, Pair] = (USABLE_BAR,) * 3
    plane_mm: Pair | None = None

    def __post_init__(self) -> None:
        sizes = [
            ("parallelogram_width_mm", self.parallelogram_width_mm),
            ("tool_radius_mm", self.tool_radius_mm),
            *(("leg_length_mm", length) for length in self.leg_length_mm),
        ]
        for name, size in sizes:
            if not size > 0:
                raise CalibrationError(name, f"{size:g}", "a positive length in mm")
        for name, (low, high) in zip(LEG_NAMES, self.usable_bar, strict=True):
            if not 0.0 <= low < high <= 1.0:
                raise CalibrationError(
                    f"usable_bar of bar {name}",
                    f"{low:g} … {high:g}, not a part of it",
                    "fractions from the tool end, 0 ≤ first < second ≤ 1",
                )
        shortest = min(self.leg_length_mm) if self.of_papers else math.inf
        if not -shortest < self.travel_min_mm < 0 < self.travel_max_mm:
            raise CalibrationError(
                "joint limits",
                f"{self.travel_min_mm:g} … {self.travel_max_mm:g} mm",
                "travel_min_mm < 0 < travel_max_mm"
                + (", both shorter than the leg" if self.of_papers else ""),
            )
        if not self.travel_max_mm < shortest:
            raise CalibrationError(
                "travel_max_mm",
                f"{self.travel_max_mm:g}",
                f"less than the leg length {shortest:g} mm",
            )
        for name, direction in zip(LEG_NAMES, self.direction, strict=True):
            if abs(sum(part * part for part in direction) - 1.0) > UNIT:
                raise CalibrationError(
                    f"direction of drive {name}", str(direction), "a vector of length 1"
                )
        self._check_posture((0.0, 0.0, 0.0), "at Zero")
        self._check_workspace()

    def _check_workspace(self) -> None:
        """The corners of a box that the file names must be reached, and not be singular."""
        if self.workspace_mm is None:
            return
        low, high = self.workspace_mm
        if not all(a < b for a, b in zip(low, high, strict=True)):
            raise CalibrationError(
                "workspace_mm",
                f"{low} … {high} mm, which is empty",
                "the lowest corner first, then the highest",
            )
        for corner in product(*zip(low, high, strict=True)):
            self._check_posture(corner, f"with the tool at {corner} mm")
            travel = inverse(self, corner) - self.zero_mm
            for name, way in zip(LEG_NAMES, travel.tolist(), strict=True):
                if not self.travel_min_mm - UNIT <= way <= self.travel_max_mm + UNIT:
                    raise CalibrationError(
                        f"workspace_mm, corner {corner} mm",
                        f"carriage {name} at {way:+.3f} mm from Zero",
                        f"its joint limits {self.travel_min_mm:g} … {self.travel_max_mm:g} mm",
                        "glidecal workspace gives the largest cube that they allow.",
                    )

    def _check_posture(self, tool_mm: tuple[float, ...], where: str) -> None:
        tool = np.array(tool_mm)
        reach = self.reach_mm2(tool)
        for k, name in enumerate(LEG_NAMES):
            if not reach[k] > 0.0:
                raise CalibrationError(
                    f"bar {name}",
                    f"{self.leg_length_mm[k]:g} mm long, too short {where}",
                    f"more than {math.sqrt(self.leg_length_mm[k] ** 2 - reach[k]):.6g} mm, "
                    "the distance from the platform's joint to the line of the drive",
                    "Check the bar's length, the drive's origin and direction, and the platform.",
                )
        volume = abs(float(np.linalg.det(self.bars(tool))))
        slope = float((np.sqrt(reach) / self.lengths).min())
        if volume < LEAST_VOLUME or slope < LEAST_SLOPE:
            raise CalibrationError(
                "geometry of the machine",
                f"a singular posture {where}: the drives do not move the tool in every direction",
                "bars that do not lie in one plane, and none square to its drive",
                "Check origins, directions and the platform; two drives may be the same.",
            )

    def bars(self, tool_mm: FloatArray) -> FloatArray:
        """Each bar from its carriage to the platform over its length ``(..., 3 bars, 3)``.

        For tools ``(..., 3)`` that the bars reach, else NaN.
        """
        with np.errstate(invalid="ignore"):
            covered = np.sqrt(self.reach_mm2(tool_mm))
        ray = tool_mm[..., None, :] - self.anchors
        across = ray - (ray * self.directions).sum(axis=-1)[..., None] * self.directions
        return np.asarray((across - covered[..., None] * self.directions) / self.lengths[:, None])

    def stands(self, tool_mm: FloatArray) -> NDArray[np.bool_]:
        """Whether bars and joint limits allow these places of the tool ``(n, 3)``.

        On the same side of singular postures as Zero.
        """
        bars = self.bars(tool_mm)
        slope = -(bars * self.directions).sum(axis=-1)
        along = ((tool_mm[..., None, :] - self.anchors) * self.directions).sum(axis=-1)
        travel = along + slope * self.lengths - self.zero_mm
        limits = self.travel_min_mm - UNIT, self.travel_max_mm + UNIT
        within = ((travel >= limits[0]) & (travel <= limits[1]) & (slope >= LEAST_SLOPE)).all(
            axis=-1
        )
        sign_at_zero = float(np.sign(np.linalg.det(self.bars(np.zeros(3)))))
        volume = np.zeros(within.shape)
        volume[within] = sign_at_zero * np.linalg.det(bars[within])
        return np.asarray(within & (volume >= LEAST_VOLUME))

    def goes(self, leg: int, displacement_mm: float) -> bool:
        """Whether the tool stands at this displacement from the Zero of a leg."""
        at_mm = self.leg_zero_mm[leg] + displacement_mm * self.directions[leg]
        return bool(self.stands(at_mm[None])[0])

    @cached_property
    def of_papers(self) -> bool:
        """Whether the closed forms of papers/000 hold: an Orthoglide along the coordinates."""
        orthoglide = (self.origin_mm, self.direction, self.platform_mm)
        return orthoglide == (NOWHERE, COORDINATES, NOWHERE) and len(set(self.leg_length_mm)) == 1

    @cached_property
    def orthogonal(self) -> bool:
        """Whether the drives are square to each other."""
        product_of_two = self.directions @ self.directions.T
        return bool(np.abs(product_of_two - np.eye(3)).max() < UNIT)

    @cached_property
    def reads_legs(self) -> bool:
        """Whether each leg can be read: at its own Zero its bar lies along its drive.

        Moving along its drive the tool then takes the bar along without turning it.
        """
        return self.common_zero or bool(self.stands(self.leg_zero_mm).all())

    @cached_property
    def common_zero(self) -> bool:
        """Whether at Zero each bar lies along its drive, and the others lead across."""
        covered = np.sqrt(self.reach_mm2(np.zeros(3)))
        askew = np.sqrt(np.maximum(self.lengths**2 - covered**2, 0.0)) / self.lengths
        alike = np.abs(self.directions @ self.directions.T - np.eye(3))
        return bool(askew.max() < MOST_ASKEW and alike.max() < MOST_ALIKE)

    @property
    def parallel(self) -> bool:
        """Whether all drives point one way: none shows how the machine is turned about that."""
        return bool((self.directions @ self.directions.T).min() > MOST_ALIKE)

    @cached_property
    def leg_zero_mm(self) -> FloatArray:
        """Where the tool stands at the Zero of each leg, and of the tool ``(3 legs + 1, 3)``.

        There an indicator is set on the bar, and displacements of the leg count from it. Where bars
        lie along their drives at Zero it is that for all. Else the bar of a leg lies along its
        drive where the tool stands on that drive's line: the nearest such place.
        """
        along = (self.anchors * self.directions).sum(axis=-1)
        nearest = self.anchors - along[:, None] * self.directions
        return np.vstack([np.zeros((3, 3)) if self.common_zero else nearest, np.zeros(3)])

    @cached_property
    def read_along(self) -> FloatArray:
        """Unit vectors ``(3 legs, 3 axes, 3)`` along which an indicator at a leg reads.

        Across the leg's drive, towards that of the axis; with its own axis along the drive.
        """
        directions = [[self.towards(leg, axis) for axis in range(3)] for leg in range(3)]
        return np.array(directions)

    @cached_property
    def lengths(self) -> FloatArray:
        """Lengths of the bars ``(3,)``, mm."""
        return np.array(self.leg_length_mm)

    @cached_property
    def origins(self) -> FloatArray:
        """Origins of the drives ``(3 drives, 3)``, mm."""
        return np.array(self.origin_mm)

    @cached_property
    def directions(self) -> FloatArray:
        """Unit vectors of the drives ``(3 drives, 3)``."""
        return np.array(self.direction)

    @cached_property
    def platform(self) -> FloatArray:
        """Joints of the platform from the tool ``(3 bars, 3)``, mm."""
        return np.array(self.platform_mm)

    @cached_property
    def anchors(self) -> FloatArray:
        """Origins of the drives as the tool meets them, less the platform ``(3 drives, 3)``, mm."""
        return self.origins - self.platform

    @cached_property
    def meeting_mm(self) -> FloatArray:
        """Joint coordinates ``(3,)`` where each drive is nearest to the tool at Zero, mm.

        Where drives meet that do. 0 for joints that count from there.
        """
        return np.asarray(-dot(self.anchors, self.directions)) + 0.0

    @cached_property
    def zero_mm(self) -> FloatArray:
        """Joint coordinates ``(3,)`` of the Zero posture, mm."""
        return np.asarray(self.meeting_mm + np.sqrt(self.reach_mm2(np.zeros(3))))

    @cached_property
    def side(self) -> float:
        """On which side of the plane of the feet the tool is: that of Zero, +1.0 or -1.0."""
        feet = self.anchors + self.directions * self.zero_mm[:, None]
        normal = np.array(cross(feet[1] - feet[0], feet[2] - feet[0]))
        return -1.0 if float(normal @ feet[0]) > 0.0 else 1.0

    @cached_property
    def across(self) -> dict[str, FloatArray]:
        """Unit vectors across the drives by name, two for each.

        Where legs have one Zero ``"xy"`` is across drive x towards drive y. Else ``"xr"`` is
        radial, away from the tool at Zero, and ``"xt"`` tangential, so that r, t and the drive's
        direction are right-handed.
        """
        if self.common_zero:
            pairs = permutations(range(3), 2)
            return {LEG_NAMES[i] + LEG_NAMES[j]: self.read_along[i, j] for i, j in pairs}
        drives_across = {}
        for i, name in enumerate(LEG_NAMES):
            radial = self._across(i, *self._outwards(i))
            drives_across[name + "r"] = radial
            drives_across[name + "t"] = np.array(cross(self.directions[i], radial))
        return drives_across

    def towards(self, first: int, second: int) -> FloatArray:
        """Unit vector ``(3,)`` across one drive in which it leans towards another.

        That is the direction of the other, less what is along this one; for parallel drives the way
        from one line to the other; for a drive itself its own direction.
        """
        if first == second:
            return np.asarray(self.directions[first])
        between_origins = self.origins[second] - self.origins[first]
        return self._across(first, self.directions[second], between_origins, *self._outwards(first))

    def reach_mm2(self, tool_mm: FloatArray) -> FloatArray:
        """Squares ``(..., 3)`` of what each bar covers along its drive for tools ``(..., 3)``."""
        ray = tool_mm[..., None, :] - self.anchors
        along = dot(ray, self.directions)
        return np.asarray(self.lengths**2 - (dot(ray, ray) - along * along))

    def touched(
        self, leg: IntArray, station: FloatArray, displacement_mm: FloatArray
    ) -> FloatArray:
        """Fraction ``(n,)`` of each bar, from the tool end, under an indicator that stands still.

        ``station`` is that at Zero. Along its own drive the tool takes a bar along without turning
        it, so the bar slides past by the displacement: the fraction is linear in it, and between
        two postures lies between theirs. Joint offsets and bars that are off change it by their
        squares over those of the bar's length, and in the ratio of the lengths.
        """
        return np.asarray(station - displacement_mm / self.covered_mm[leg])

    def on_bar(
        self, leg: IntArray, station: FloatArray, displacement_mm: FloatArray
    ) -> NDArray[np.bool_]:
        """Whether the usable part of the bar is touched ``(n,)``; between two such postures it is.

        At Zero, displacement 0, the indicator is mounted (papers/000, section 4.1).
        """
        low, high = np.array(self.usable_bar)[leg].T
        point = self.touched(leg, station, displacement_mm)
        return np.asarray((point >= low - UNIT) & (point <= high + UNIT))

    def span_mm(self, leg: int, station: float) -> Pair:
        """Lowest and highest displacement where joint limits and the bar allow a set-up.

        They do not enclose 0 where the station itself is not on the usable part.
        """
        low, high = self.usable_bar[leg]
        lowest, highest = self.covered_mm[leg] * (station - np.array([high, low]))
        at = self.leg_zero_mm[leg]
        up = float((at - self.anchors[leg]) @ self.directions[leg])
        up += float(self.covered_mm[leg] - self.zero_mm[leg])
        limits = self.travel_min_mm - up, self.travel_max_mm - up
        return max(float(lowest), limits[0]), min(float(highest), limits[1])

    @cached_property
    def covered_mm(self) -> FloatArray:
        """What each bar covers along its drive at Zero of its leg, and along it ``(3,)``, mm."""
        return np.asarray(np.sqrt(self.reach_mm2(self.leg_zero_mm[:3]).diagonal()))

    def _outwards(self, drive: int) -> tuple[FloatArray, ...]:
        """Ways from the tool to a drive; if it goes through the tool, away from the others."""
        sum_of_others = self.directions.sum(axis=0) - self.directions[drive]
        return self.anchors[drive], -sum_of_others, *np.eye(3)

    def _across(self, drive: int, *ways: FloatArray) -> FloatArray:
        """Unit vector ``(3,)`` across a drive, along the first of these ways that leads across."""
        direction = self.directions[drive]
        for way in ways:
            across = way - (way @ direction) * direction
            size = float(np.linalg.norm(across))
            if size > UNIT:
                return np.asarray(across / size)
        raise AssertionError("no direction is parallel to all coordinates")


def inverse(geometry: Geometry, tool_mm: ArrayLike) -> FloatArray:
    """Carriage positions ``(..., 3)`` for tool positions ``(..., 3)``; papers/000 equation (3).

    One square root for each leg, the carriage ahead of the platform as at Zero. Subtract d_rho for
    joint coordinates. Raises UnreachablePosture where a leg is too short.
    """
    tool = np.asarray(tool_mm, dtype=np.float64)
    reach = geometry.reach_mm2(tool)
    if reach.size and not reach.min() >= 0.0:
        raise _unreachable(tool[(~(reach >= 0.0)).any(axis=-1)][0], "tool at")
    along = dot(tool[..., None, :] - geometry.anchors, geometry.directions)
    return np.asarray(along + np.sqrt(reach))


def direct(
    geometry: Geometry, carriage_mm: ArrayLike, length_error_mm: ArrayLike = 0.0
) -> FloatArray:
    """Tool position ``(..., 3)`` for carriage positions ``(..., 3)``; undoes `inverse`.

    ``length_error_mm`` ``(..., 3)`` is added to the nominal lengths. Raises UnreachablePosture
    where the bars cannot meet.
    """
    carriage = np.asarray(carriage_mm, dtype=np.float64)
    lengths = geometry.lengths + np.asarray(length_error_mm, dtype=np.float64)
    feet = geometry.origins + geometry.directions * carriage[..., :, None]
    return trilaterate(feet - geometry.platform, lengths, geometry.side)


def trilaterate(
    foot_mm: NDArray[Any], leg_length_mm: NDArray[Any], side: float, *, refuse: bool = True
) -> NDArray[Any]:
    """Tool position ``(..., 3)`` for feet anywhere in space ``(..., 3 legs, 3)``.

    Intersection of three spheres of radius ``leg_length_mm`` ``(..., 3)`` about the feet, each less
    its joint of the platform. There are two; ``side`` is that of the machine, `Geometry.side`.
    Accepts complex input for derivatives by the complex step. Where the spheres do not meet it
    raises UnreachablePosture, or gives NaN where it is not to ``refuse``.
    """
    # coordinate by coordinate: three together are too few for arrays to be quick
    origin, second, third = ([foot_mm[..., leg, k] for k in range(3)] for leg in range(3))
    to_second = [end - here for end, here in zip(second, origin, strict=True)]
    to_third = [end - here for end, here in zip(third, origin, strict=True)]
    square = leg_length_mm * leg_length_mm
    normal = cross(to_second, to_third)
    second_square, third_square, normal_square = (
        x * x + y * y + z * z for x, y, z in (to_second, to_third, normal)
    )
    along_second = (second_square + square[..., 0] - square[..., 1]) / 2
    along_third = (third_square + square[..., 0] - square[..., 2]) / 2
    in_plane = [
        (along_second * across + along_third * crossed) / normal_square
        for across, crossed in zip(cross(to_third, normal), cross(normal, to_second), strict=True)
    ]
    x, y, z = in_plane
    height_square = square[..., 0] - (x * x + y * y + z * z)
    if not refuse:
        height_square = np.where(height_square.real >= 0.0, height_square, np.nan)
    elif height_square.size and not height_square.real.min() >= 0.0:
        bad = np.unravel_index(int(np.argmin(height_square.real)), height_square.shape)
        feet = np.broadcast_to(foot_mm, (*height_square.shape, 3, 3))[bad]
        raise _unreachable(feet.real.ravel(), "feet at")
    height = side * np.sqrt(height_square / normal_square)
    coordinates = zip(origin, in_plane, normal, strict=True)
    return np.stack([start + flat + up * height for start, flat, up in coordinates], axis=-1)


def tool_jacobians(
    geometry: Geometry,
    tool_mm: ArrayLike,
    carriage_mm: ArrayLike,
    length_mm: NDArray[Any] | None = None,
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Derivatives of the tool position by joint offsets and by leg lengths; papers/000 (5).

    Shapes ``(..., 3)`` in, two arrays ``(..., 3, 3)`` out (row: coordinate, column: parameter),
    without unit (mm per mm). ``length_mm`` ``(..., 3)`` of the bars, None: the nominal ones.
    Complex numbers pass.
    """
    tool, carriage = np.asarray(tool_mm), np.asarray(carriage_mm)
    feet = geometry.anchors + geometry.directions * carriage[..., :, None]
    bars = tool[..., None, :] - feet
    index = np.arange(3)
    along = np.zeros_like(bars)
    along[..., index, index] = dot(bars, geometry.directions)
    stretch = np.zeros_like(bars)
    stretch[..., index, index] = geometry.lengths if length_mm is None else length_mm
    return np.linalg.solve(bars, along), np.linalg.solve(bars, stretch)


def dot(first: NDArray[Any], second: NDArray[Any]) -> NDArray[Any]:
    """Products ``(...)`` of vectors ``(..., 3)``, real or complex, none conjugated."""
    return np.asarray(np.einsum("...i,...i->...", first, second))


def cross(first: Coordinates, second: Coordinates) -> list[NDArray[Any]]:
    """Cross products, coordinate by coordinate."""
    (x, y, z), (u, v, w) = first, second
    return [y * w - z * v, z * u - x * w, x * v - y * u]


def _unreachable(position: NDArray[Any], subject: str) -> UnreachablePosture:
    position_words = ", ".join(f"{float(v):.3f}" for v in position)
    return UnreachablePosture(
        "unreachable posture",
        f"{subject} ({position_words}) mm",
        "positions for which the three legs can meet",
        "Check the displacement, the leg length and the joint limits of the machine file.",
    )
