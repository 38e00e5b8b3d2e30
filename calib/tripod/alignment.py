"""Mechanical alignment of three drives to be square: from readings of legs to shims under rails.

Leg readings see, of six leans and six shifts of the rails, how far each pair is from square and how
far each pair misses the other: six figures. The rest turns or moves the machine as a whole. One
rail is the reference and stays; the next one (x, y, z, x …) is turned square to it and moved to
meet it, the third does the same to both. Drives that are not meant to be square are turned and
moved to where the machine file has them. Readings are those of the lines themselves, however far
they lean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import compress, permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import (
    LEG_NAMES,
    FloatArray,
    Observations,
    conditions,
    incidence,
    tilts,
    without_zeros,
)
from calib.errors import NotIdentifiable, UsageError
from calib.noise.reading import IndicatorFigures, reading_noise, reading_weights, visit_means
from calib.stats import UNLIKELY, coverage_factor, variance_ratio_p_value
from calib.tripod.effects.effect import (
    AROUND,
    PAIRS,
    PER_THOUSAND,
    from_meeting_mm,
    moved_foot,
    numbers,
)
from calib.tripod.geometry import Geometry, Three
from calib.tripod.movements import with_first_movements
from calib.tripod.pipeline import Flow, Model, Stage, command, derivatives

LEAN_TOLERANCE_MRAD = 5.0
DISTANCE_TOLERANCE_MM = 5.0
"""A raw machine is no further off than some of these; they only keep a poor session solvable."""

DESIGNED_MRAD = 10.0
"""Nobody designs drives that are nearer to square and are not: such a file states how they lie."""

FINE_MRAD, FINE_MM = 0.05, 0.025
"""Half of what is aimed at: what lies nearer is left alone, for a fitter's hand adds more."""

ROUNDS = 6
STEP = 1e-3
"""Of a lean (mrad) and a distance (mm), for derivatives: readings are straight over much more."""

FINE_ENOUGH = 3.0
"""A figure that is known to no better than a third of what is aimed at is no figure to shim by."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """How the rails lie to each other, with joint offsets and lengths fitted beside it.

    ``lean_mrad`` ``(3,)`` of the pairs xy, yz, xz: positive, less than 90° between them.
    ``distance_mm`` ``(3,)`` of xy, yz, zx: along the third axis the first lies so much further.
    ``covariance`` ``(6, 6)`` of both; ``noise_mm`` of a reading, ``left_mm`` r.m.s. that is left,
    which noise exceeds with the probability ``chance``.
    """

    model: Model
    lean_mrad: FloatArray
    distance_mm: FloatArray
    covariance: FloatArray
    noise_mm: float
    left_mm: float
    chance: float

    @property
    def to_square(self) -> bool:
        """Whether the drives are to be square and to meet; else as the machine file has them."""
        return bool(np.abs(figures_of(self.model.geometry)[0]).max() < DESIGNED_MRAD)

    @property
    def off(self) -> FloatArray:
        """Leans and distances ``(6,)``, mrad and mm, from what they are to be."""
        figures = np.concatenate([self.lean_mrad, self.distance_mm])
        if self.to_square:
            return figures
        return np.asarray(figures - np.concatenate(figures_of(self.model.geometry)))

    @property
    def lacks_something(self) -> bool:
        """Whether readings show what rails, offsets and bars do not; the intervals leave it out."""
        return self.chance < UNLIKELY

    @property
    def expanded(self) -> FloatArray:
        """Half widths of 95 % intervals ``(6,)``, mrad and mm."""
        return np.asarray(coverage_factor(math.inf) * np.sqrt(self.covariance.diagonal()))


def check_common_zero(geometry: Geometry) -> None:
    """Raises UsageError for a machine of which no rail can be aligned by its legs."""
    if not geometry.common_zero:
        raise UsageError(
            "alignment",
            "bars that are not along their drives at one Zero",
            "a machine whose legs are read at one, such as an Orthoglide",
        )


def alignment(
    geometry: Geometry,
    observations: Observations,
    tolerance_mm: FloatArray,
    indicator: IndicatorFigures,
    reference: int = 0,
) -> Alignment:
    """Fit leans and distances beside the base parameters, these held by ``tolerance_mm`` ``(6,)``.

    The model that is given back has the ``reference`` drive in its place. Raises UsageError
    for a machine whose legs cannot be read and NotIdentifiable without noise or readings that tell
    all six.
    """
    check_common_zero(geometry)
    visits = with_first_movements(geometry, visit_means(observations))
    noise = reading_noise(visits, indicator)
    if noise is None:
        raise NotIdentifiable(
            "alignment",
            "no scatter of repeats and no stated noise",
            "repeats, as procedures with cycles have",
        )
    root = np.sqrt(reading_weights(visits, noise))
    limits = [LEAN_TOLERANCE_MRAD] * 3 + [DISTANCE_TOLERANCE_MM] * 3
    hold = np.diag(1.0 / np.concatenate([tolerance_mm, limits]) ** 2)
    nominal = np.concatenate([np.zeros(6), *figures_of(geometry)])
    x = np.zeros(12)

    def readings(x: FloatArray) -> FloatArray:
        return _model(geometry, nominal + x, reference).readings(visits)

    for _ in range(ROUNDS):
        drives = _model(geometry, nominal + x, reference).effects
        base = derivatives(geometry, x[:6], visits, drives)
        steps = STEP * np.eye(12)[6:]
        columns = [(readings(x + step) - readings(x - step)) / (2.0 * STEP) for step in steps]
        design = np.column_stack([base, *columns])
        rows = without_zeros(visits, root**2, design) * root[:, None]
        off = without_zeros(visits, root**2, visits.value_mm - readings(x)) * root
        covariance = np.linalg.inv(rows.T @ rows + hold)
        x = x + covariance @ (rows.T @ off - hold @ x)
    seen_figures = np.sqrt(covariance.diagonal())[6:] < np.array(limits) / FINE_ENOUGH
    if not seen_figures.all():
        names = [f"squareness {p}" for p in PAIRS] + [f"distance {p}" for p in AROUND]
        unseen = compress(names, ~seen_figures)
        raise NotIdentifiable(
            "alignment",
            f"readings that do not show {', '.join(unseen)}",
            "all three legs along both axes at Zero, Max, Min, and over a plane: procedure align",
        )
    model = _model(geometry, nominal + x, reference)
    residual_mm = without_zeros(visits, root**2, visits.value_mm - model.readings(visits))
    noise_mm = float(np.sqrt(np.mean(root**-2.0)))
    left_mm = float(np.sqrt(np.mean(residual_mm**2)))
    spread = np.asarray(covariance[6:, 6:], dtype=np.float64)
    zeros = np.linalg.matrix_rank(np.hstack([incidence(visits.mount), tilts(visits)]))
    free = max(len(visits) - int(zeros) - len(x), 1)
    square = float(((residual_mm * root) ** 2).sum()) / free
    chance = variance_ratio_p_value(square, free, noise.degrees_of_freedom)
    lean_mrad, distance_mm = np.split((nominal + x)[6:], 2)
    return Alignment(model, lean_mrad, distance_mm, spread, noise_mm, left_mm, chance)


def figures_of(geometry: Geometry) -> tuple[FloatArray, FloatArray]:
    """Leans ``(3,)``, mrad, and distances ``(3,)``, mm, of nominal drives, as `Alignment` has them.

    The distance is along what is across both drives.
    """
    drives, anchors = geometry.directions, geometry.anchors
    leans = [math.asin(float(drives[i] @ drives[j])) / PER_THOUSAND for i, j in map(numbers, PAIRS)]
    apart = []
    for i, j in map(numbers, AROUND):
        across = np.cross(drives[i], drives[j])
        apart.append(float((anchors[i] - anchors[j]) @ across / np.linalg.norm(across)))
    return np.array(leans), np.array(apart)


@dataclass(frozen=True, eq=False)
class DrivesThatLie:
    """Feet on the lines of other drives than those that the controller reckons with."""

    lines: Geometry
    id: str = "drives_that_lie"
    stage: Stage = Stage.FOOT

    def change(self, _stage_input: NDArray[Any], flow: Flow) -> NDArray[Any]:
        """Each carriage at its coordinate along the line."""
        along = flow.carriage_mm[..., :, None] * self.lines.directions
        return np.asarray(self.lines.origins + along)


def _model(geometry: Geometry, x: FloatArray, reference: int) -> Model:
    lean_mrad, distance_mm = np.split(x[6:], 2)
    lines = aligned_geometry(geometry, lean_mrad, distance_mm, reference)
    return Model(geometry, tuple(x[:6].tolist()), (DrivesThatLie(lines),))


def aligned_geometry(
    geometry: Geometry, lean_mrad: FloatArray, distance_mm: FloatArray, reference: int
) -> Geometry:
    """The machine with its drives as they lie, for a controller that is told of them.

    Leans and distances ``(3,)`` are those of `Alignment`. The reference drive stays, the next one
    stays in the plane of both, as `shims` have it; each joint counts from where it did. Raises
    CalibrationError for drives that no machine has.
    """
    order = [(reference + k) % 3 for k in range(3)]
    lean = np.zeros((3, 3))
    for (i, j), value in zip(map(numbers, PAIRS), lean_mrad.tolist(), strict=True):
        lean[i, j] = lean[j, i] = math.sin(PER_THOUSAND * value)
    cosines = (lean + np.eye(3))[np.ix_(order, order)]
    try:
        ways = np.linalg.cholesky(cosines)
    except np.linalg.LinAlgError as problem:
        raise NotIdentifiable(
            "alignment",
            f"leans of {', '.join(f'{mrad:.0f}' for mrad in lean_mrad)} mrad of {', '.join(PAIRS)}",
            "leans that three drives can have together",
            "Are the readings in millimetres?",
        ) from problem
    axes = geometry.directions[reference], geometry.read_along[reference, order[1]]
    handed = np.sign(np.linalg.det(geometry.directions[order]))  # drives may be numbered either way
    frame = np.array([*axes, handed * np.cross(*axes)])
    directions = np.zeros((3, 3))
    directions[order] = ways @ frame
    anchors = np.zeros((3, 3))
    anchors[reference] = geometry.anchors[reference]
    distance = dict(zip(AROUND, distance_mm.tolist(), strict=True))
    for k, drive in enumerate(order[1:], start=1):
        rows = [directions[drive]]
        far = [-float(geometry.meeting_mm[drive])]
        for earlier in order[:k]:
            cyclic = (drive - earlier) % 3 == 1  # the pair is named from the other one
            first, second = (earlier, drive) if cyclic else (drive, earlier)
            across = np.cross(directions[first], directions[second])
            across = across / np.linalg.norm(across)
            name = LEG_NAMES[first] + LEG_NAMES[second]
            rows.append(across)
            far.append(
                float(anchors[earlier] @ across) + (-1.0 if cyclic else 1.0) * distance[name]
            )
        anchors[drive] = np.linalg.lstsq(np.array(rows), np.array(far))[0]
    origins = anchors + geometry.platform
    return replace(geometry, origin_mm=_triples(origins), direction=_triples(directions))


def _triples(rows: FloatArray) -> Three:
    first, second, third = ((x, y, z) for x, y, z in rows.tolist())
    return first, second, third


@dataclass(frozen=True)
class Shim:
    """What one end of a rail is to be moved by: ``move_mm`` ± ``expanded_mm`` (95 %).

    ``rail`` and ``towards``, the axis across it, are 0, 1, 2; the end rests at ``support_mm`` along
    the rail from where the axes meet, the other end at ``other_mm``. Not ``needed``: as near
    already as a turn would make it.
    """

    rail: int
    towards: int
    support_mm: float
    other_mm: float
    move_mm: float
    expanded_mm: float
    needed: bool = True

    def shown(self, geometry: Geometry, station: float) -> float:
        """What an indicator on this leg at Zero reads along ``towards`` for each mm of the move.

        The carriage moves by its share between both ends, the touched point by the station of that.
        """
        at_zero_mm = geometry.zero_mm[self.rail] - geometry.meeting_mm[self.rail]
        share = (self.other_mm - at_zero_mm) / (self.other_mm - self.support_mm)
        return float(station * share)


def shims(
    alignment_result: Alignment, reference: int, supports_mm: tuple[float, float]
) -> list[Shim]:
    """Moves of both ends of the two other rails, in every direction that is told; see the module.

    ``supports_mm`` are the two places along every rail where it rests.
    """
    off = alignment_result.off
    second, third = (reference + 1) % 3, (reference + 2) % 3
    turned = [
        (second, reference, _lean(second, reference), np.zeros(6)),
        (second, third, np.zeros(6), _distance(reference, second)),
        (third, reference, _lean(third, reference), _distance(second, third)),
        (third, second, _lean(third, second), -_distance(third, reference)),
    ]
    moves = []
    for rail, towards, lean, shift in turned:
        fine = abs(float(lean @ off)) < FINE_MRAD and abs(float(shift @ off)) < FINE_MM
        for support, opposite in (supports_mm, supports_mm[::-1]):
            row = shift - PER_THOUSAND * support * lean
            half = coverage_factor(math.inf) * math.sqrt(
                float(row @ alignment_result.covariance @ row)
            )
            move = float(row @ off)
            moves.append(Shim(rail, towards, support, opposite, move, half, not fine))
    return moves


def _lean(first: int, second: int) -> FloatArray:
    pair = {LEG_NAMES[first], LEG_NAMES[second]}
    return np.array([*(float(pair == {*name}) for name in PAIRS), 0.0, 0.0, 0.0])


def _distance(first: int, second: int) -> FloatArray:
    name = LEG_NAMES[first] + LEG_NAMES[second]
    return np.array([0.0, 0.0, 0.0, *(float(pair == name) for pair in AROUND)])


def slope_at_zero_mm(model: Model, leg: int, towards: int) -> float:
    """How much further along an axis the foot of a leg is than its tool end, at Zero."""
    geometry, at_zero = model.geometry, conditions([leg], [towards], [0.0])
    joint_mm = command(geometry, at_zero)
    flow = Flow(geometry, model.parameters_mm, at_zero, joint_mm, model.effects)
    end, foot = flow.bar_mm
    return float((foot - end)[0] @ geometry.read_along[leg, towards])


@dataclass(frozen=True)
class RailMoved:
    """A rail that lies elsewhere, for a simulated machine: moved by shims under its ends."""

    rail: int
    towards: int
    shift_mm: float
    lean: float
    id: str = "rail_moved"
    stage: Stage = Stage.FOOT

    def change(self, stage_input: NDArray[Any], flow: Flow) -> NDArray[Any]:
        """The foot is sideways by a constant and in proportion to its way from the others."""
        way = self.shift_mm + self.lean * from_meeting_mm(flow, self.rail)
        across = flow.geometry.read_along[self.rail, self.towards]
        return np.asarray(stage_input + moved_foot(self.rail, across, way))

    @classmethod
    def by_shim(cls, shim: Shim, moved_mm: float) -> RailMoved:
        """What moving one end does, the other stays."""
        lean = moved_mm / (shim.support_mm - shim.other_mm)
        return cls(shim.rail, shim.towards, -lean * shim.other_mm, lean)


def misaligned(geometry: Geometry, seed: int) -> tuple[RailMoved, ...]:
    """Rails of a simulated machine: each off by up to 1 mm and 2 mrad, both ways across."""
    generator = np.random.default_rng([seed, 6])
    off = generator.uniform(-1.0, 1.0, (3, 3, 2)) * (1.0, 2e-3)
    return tuple(
        RailMoved(rail, towards, *off[rail, towards].tolist())
        for rail, towards in permutations(range(3), 2)
        if geometry.common_zero
    )
