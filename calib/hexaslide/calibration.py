"""Identification of a Hexa Slide from measured postures; papers/001, equation (4).

Gauss and Newton with exact derivatives. Combinations of parameters that the readings do not see
(motions of whole frames) stay where the start has them: every step is the shortest one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import EXACT_BLIND, FloatArray, condition, named_inside, names_outside, svd_of_all
from calib.errors import CalibrationError, NotIdentifiable
from calib.hexaslide.geometry import (
    LAID_OVER,
    MOTIONS,
    OF_TRACKER,
    HexaSlide,
    forward_near,
    motions,
)
from calib.hexaslide.residuals import Readings, Residuals, postures_of, residuals, whitening
from calib.stats import coverage_factor, variance_ratio_p_value

MOST_STEPS = 12
MOST_HALVINGS = 12

SETTLED = 1e-5
"""A step that moves the prediction by less than this share of what is left is the last."""

NO_WORSE = 1e-9
"""Relative; sums of squares are not known better where little is left."""

ROUNDING_M = 1e-14
"""So small a movement of the prediction is arithmetic only."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What was identified from ``p`` postures with ``r`` values each.

    ``parameters`` ``(k,)`` in metres (components of rails without unit), named by ``names``;
    ``covariance`` ``(k, k)`` is that of what is seen, None where no noise is stated and no residual
    tells it. It holds for single parameters in ``known`` only, which have no share in what is
    unidentifiable: ``unidentifiable`` names the motions that no reading shows, the count is that of
    all such combinations, ``null`` ``(k, count)`` spans them. ``laid_over`` are the motions by
    which the platform is aligned before it is judged: those that no reading shows, and those of a
    tracker's frame. ``before`` and ``after`` are the residuals of start and result; ``square_sum``
    weighted, in units of the variance. ``degrees_of_freedom`` are those of the noise: infinite
    where it was stated.
    """

    machine: HexaSlide
    names: tuple[str, ...]
    parameters: FloatArray
    covariance: FloatArray | None
    known: tuple[str, ...]
    unidentifiable: tuple[str, ...]
    unidentifiable_count: int
    laid_over: tuple[str, ...]
    null: FloatArray
    rank: int
    condition_number: float
    before: Residuals
    after: Residuals
    noise_m: float | None
    degrees_of_freedom: float
    free_values: int
    square_sum: float | None
    steps: int

    @property
    def left_open(self) -> int:
        """Combinations that no reading shows and that are no motions of frames as wholes."""
        return self.unidentifiable_count - sum(name in MOTIONS for name in self.unidentifiable)

    @property
    def lack_of_fit(self) -> float | None:
        """Mean square of what is left in stated noise variances; None where there is none."""
        if self.square_sum is None or not self.free_values:
            return None
        return self.square_sum / self.free_values

    @property
    def p_value(self) -> float | None:
        """Chance of so much or more by noise alone."""
        ratio = self.lack_of_fit
        return None if ratio is None else variance_ratio_p_value(ratio, self.free_values, np.inf)

    @property
    def factor(self) -> float | None:
        """Coverage factor of 95 %; None without covariance."""
        return None if self.covariance is None else coverage_factor(self.degrees_of_freedom)


@dataclass(frozen=True, eq=False)
class _Point:
    """One set of parameters: whitened residuals ``(n,)`` and derivatives ``(n, k)``."""

    machine: HexaSlide
    residuals: Residuals
    residual: FloatArray
    design: FloatArray


@dataclass(frozen=True, eq=False)
class SeenDirections:
    """A design's singular values with what is below the rank cut off; ``null`` spans that."""

    left: FloatArray
    singular: FloatArray
    right: FloatArray
    null: FloatArray

    @staticmethod
    def of(design: FloatArray) -> SeenDirections:
        """Directions that derivatives ``(n, k)`` tell."""
        left_vectors, singular, right = svd_of_all(design)
        rank = int((singular > EXACT_BLIND * singular[0]).sum())
        return SeenDirections(left_vectors[:, :rank], singular[:rank], right[:rank], right[rank:].T)

    @property
    def inverse(self) -> FloatArray:
        """By how much parameters follow each direction of the readings ``(k, rank)``."""
        return np.asarray(self.right.T / self.singular)

    def step(self, residual: FloatArray) -> FloatArray:
        """The shortest change ``(k,)`` that takes out most of a residual ``(n,)``."""
        return np.asarray(self.inverse @ (self.left.T @ residual))


def calibrate(readings: Readings, start: HexaSlide, *, fewest: int = 1) -> Calibration:
    """Identify from ``start``, at most a dozen steps, each shortened until it is an improvement.

    ``fewest`` different postures are what the procedure needs, counted by
    `calib.hexaslide.planning.fewest_postures`. Raises NotIdentifiable for fewer, or where the steps
    do not settle, and UnreachablePosture for a posture that the machine at the start cannot take.
    """
    if readings.different < fewest:
        raise NotIdentifiable(
            f"different postures for {readings.procedure.kind.value}",
            f"{readings.different}",
            f"{fewest} or more",
            "Measure more postures.",
        )
    white = whitening(readings, start.geometry)
    first = point = _at(readings, start, white, None)
    for step_number in range(1, MOST_STEPS + 1):
        step = SeenDirections.of(point.design).step(point.residual)
        moved = _rms(point.design @ step)
        last = moved <= max(SETTLED * _rms(point.residual), ROUNDING_M)
        point, full = _improved(readings, white, point, step, final=last)
        if last and full:  # a shortened step is small without being the end
            return _result(readings, first, point, step_number)
    raise NotIdentifiable(
        "calibration",
        f"no rest after {MOST_STEPS} steps, {_rms(point.residual):.3g} m r.m.s. left",
        "readings that determine the parameters well enough for their noise",
        "Measure more or better postures (glidecal postures hexaslide), or look for a wrong one.",
    )


def _at(
    readings: Readings, machine: HexaSlide, white: FloatArray, guess: Residuals | None
) -> _Point:
    near = None if guess is None else guess.postures
    postures = postures_of(readings, machine, near)
    left_over, slopes = residuals(readings, machine, postures)
    residual = np.einsum("prs,ps->pr", white, left_over.values).ravel()
    design = np.einsum("prs,psk->prk", white, slopes)
    return _Point(machine, left_over, residual, design.reshape(residual.size, -1))


def _improved(
    readings: Readings, white: FloatArray, point: _Point, step: FloatArray, *, final: bool
) -> tuple[_Point, bool]:
    """The point after the longest half, quarter … of the step that is no worse, and if whole.

    The last step is within rounding of the best and need not improve.
    """
    names = readings.procedure.parameters
    begin = point.machine.parameters(names)
    here = _rms(point.residual)
    for halving in range(MOST_HALVINGS):
        try:
            machine = point.machine.with_parameters(names, begin + 0.5**halving * step)
            candidate = _at(readings, machine, white, point.residuals)
        except CalibrationError:
            continue
        if final or _rms(candidate.residual) <= here * (1.0 + NO_WORSE):
            return candidate, halving == 0
    raise NotIdentifiable(
        "calibration",
        f"no step that improves on {here:.3g} m r.m.s.",
        "readings that determine a machine near the nominal one",
        "Measure better postures, turned ones too (glidecal postures hexaslide), or look for a "
        "wrong reading, order of the sliders, or unit.",
    )


def _result(readings: Readings, first: _Point, point: _Point, steps: int) -> Calibration:
    names = readings.procedure.parameters
    parts_seen = SeenDirections.of(point.design)
    rank, count = len(parts_seen.singular), point.residual.size
    spare = count - rank
    square = float(point.residual @ point.residual)
    stated = readings.noise_m
    variance = stated**2 if stated else square / spare if spare else None
    inverse = parts_seen.inverse
    # papers/001 has the condition number of the bare derivatives, metres and radians
    bare = residuals(readings, point.machine, point.residuals.postures)[1]
    all_motions = motions(point.machine, names)
    unidentifiable = tuple(name for _, name in named_inside(parts_seen.null, all_motions)[0])
    free = {*unidentifiable, *(OF_TRACKER if readings.procedure.measures_places else ())}
    return Calibration(
        machine=point.machine,
        names=names,
        parameters=point.machine.parameters(names),
        covariance=None if variance is None else np.asarray(variance * (inverse @ inverse.T)),
        known=names_outside(parts_seen.null, names),
        unidentifiable=unidentifiable,
        unidentifiable_count=len(names) - rank,
        laid_over=tuple(name for name in LAID_OVER if name in free),
        null=parts_seen.null,
        rank=rank,
        condition_number=condition(bare.reshape(count, -1), rank),
        before=first.residuals,
        after=point.residuals,
        noise_m=None if variance is None else float(np.sqrt(variance)),
        degrees_of_freedom=np.inf if stated else float(spare),
        free_values=spare,
        square_sum=square / stated**2 if stated else None,
        steps=steps,
    )


def _rms(values_m: FloatArray) -> float:
    return float(np.sqrt((values_m * values_m).mean()))


def corrected(
    nominal: HexaSlide, calibrated: HexaSlide, postures: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How to reach postures ``(p, 6)`` on the calibrated machine: what to command ``(p, 6)`` a
    controller that keeps the nominal geometry, and where the sliders then are ``(p, 6)``.

    Raises as `HexaSlide.sliders_at`.
    """
    sliders = calibrated.sliders_at(postures, " on the calibrated machine")
    return np.asarray(forward_near(nominal.geometry, sliders, postures)), sliders
