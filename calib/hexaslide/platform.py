"""What a calibration means at the platform, over the whole box: off now, and off at most with it.

Parameters alone say little where combinations of them are lost. Both figures are of places of the
platform's origin. Frames are laid over first: those that no reading shows, and that of a tracker,
which is known no better than somebody set it up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray, without
from calib.errors import UnreachablePosture
from calib.hexaslide.calibration import Calibration
from calib.hexaslide.checked import FramesApart, frame_motions, frames_apart
from calib.hexaslide.derivatives import jacobian
from calib.hexaslide.geometry import (
    LAID_OVER,
    OF_TRACKER,
    HexaSlide,
    forward_near,
    inverse,
    rotation,
)
from calib.hexaslide.procedures import (
    WELL_HELD,
    Procedure,
    ProcedureKind,
    held_postures,
    looseness,
)
from calib.stats import COVERAGE, coverage_factor, root_quantile

PLACES = 200
"""So many random postures of the box stand for all of it where what is off there is small: their
r.m.s. varies by a few percent."""

EVEN = 4000
"""So many even ones tell by how much it is off now: their r.m.s. varies by a thousandth, which is
less than the bound beside it."""

GOLDEN = 1.1127756842787055
"""The golden ratio of six dimensions, x^7 = x + 1: M. Roberts, The unreasonable effectiveness of
quasirandom sequences, 2018."""

SEED = 0
FRAMES = 1e-9
"""Singular values, by the largest, of frames that move places."""


@dataclass(frozen=True, eq=False)
class PlatformError:
    """R.m.s. over the box, metres: ``now`` how far the platform is from where a controller that
    holds ``reference`` believes it, ``bound_m`` by how much it is off at most, in 95 of 100 cases,
    with the calibrated machine; both once it is aligned by the motions ``laid_over``. The bound is
    None where no noise is known, or where readings leave more open than frames: ``left_open``
    counts such combinations.
    """

    now: FramesApart
    bound_m: float | None
    left_open: int
    laid_over: tuple[str, ...]

    @property
    def in_frame_of_tracker(self) -> bool:
        """Whether what was measured has a frame of its own, which is laid over."""
        return {*OF_TRACKER} <= {*self.laid_over}


@dataclass(frozen=True, eq=False)
class Places:
    """Random postures for all of the box: ``sliders`` ``(p, 6)`` of a controller that holds the
    ``reference``, the machine's ``postures`` ``(p, 6)`` there, and by how much parameters of its
    geometry move the platform's origin, ``moved`` ``(3 p, k)``. The columns of ``frames`` span what
    frames that are laid over do there; it is taken out.
    """

    reference: HexaSlide
    sliders: FloatArray
    postures: FloatArray
    moved: FloatArray
    frames: FloatArray

    @staticmethod
    def of(
        reference: HexaSlide,
        machine: HexaSlide,
        free: tuple[str, ...],
        count: int = PLACES,
        seed: int = SEED,
    ) -> Places:
        """Where a controller that holds ``reference`` sends a ``machine``; ``free`` of `LAID_OVER`.

        Raises UnreachablePosture, CalibrationError.
        """
        aims = held_postures(reference, count, seed)
        sliders = reference.sliders_at(aims)
        stands = np.asarray(forward_near(machine.geometry, sliders, aims))
        motions = [k for k, name in enumerate(LAID_OVER) if name in free]
        frames = frame_motions(stands[:, :3], rotation(stands[:, 3:]))[:, :3]
        vectors, size, _ = np.linalg.svd(
            frames.reshape(-1, frames.shape[-1])[:, motions], full_matrices=False
        )
        vectors = vectors[:, size > FRAMES * size.max(initial=0.0)]
        forward = Procedure.of(ProcedureKind.POSE_FORWARD).on(machine)
        moved = np.asarray(jacobian(forward, machine.geometry, stands)[:, :3])
        moved = without(vectors, moved.reshape(3 * len(stands), -1))
        return Places(reference, sliders, stands, moved, vectors)

    @property
    def count(self) -> int:
        """How many postures there are."""
        return len(self.postures)

    def error(
        self, calibration: Calibration, machine: HexaSlide, bound_m: float | None
    ) -> PlatformError:
        """How far the ``machine`` is from where its controller believes it, evenly over the box,
        and the bound with it entered. Where it does not reach all of that, the random postures
        stand for it.
        """
        aims = even_postures(self.reference)
        try:
            stands = forward_near(machine.geometry, self.reference.sliders_at(aims), aims)
        except UnreachablePosture:
            aims = held_postures(self.reference, self.count, SEED)
            stands = forward_near(machine.geometry, self.reference.sliders_at(aims), aims)
        now = frames_apart(aims, np.asarray(stands), calibration.laid_over)
        return PlatformError(now, bound_m, calibration.left_open, calibration.laid_over)

    def bound_m(self, spread: FloatArray) -> float:
        """The r.m.s. that 95 of 100 cases keep, normal along ``spread`` ``(3 p, r)``, metres."""
        inner = spread.T @ spread
        mean, variance = np.trace(inner), 2.0 * (inner**2).sum()
        square, its_variance = np.array([[mean], [variance / self.count]]) / self.count
        return root_quantile(np.ones(1), square, its_variance, COVERAGE)

    def without_frames(self, moved: FloatArray) -> FloatArray:
        """Movements ``(3 p, c)`` less what frames take over: that is no error."""
        return without(self.frames, moved)


def root_of(covariance: FloatArray) -> FloatArray:
    """A root ``(c, c)`` of a covariance that need not be definite."""
    square, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(square, 0.0)))


def even_postures(machine: HexaSlide) -> FloatArray:
    """Postures ``(p, 6)`` that fill the reached part of the box more evenly than random ones, those
    left out that are next to singular ones; where few remain, those of `held_postures`.

    An additive recurrence by powers of `GOLDEN`: scipy has others in scipy.stats, which no solve
    loads for its time. Raises as `held_postures`.
    """
    steps = np.outer(np.arange(1, EVEN + 1), GOLDEN ** -np.arange(1.0, 7.0))
    postures = machine.box.lower + (0.5 + steps) % 1.0 * (machine.box.upper - machine.box.lower)
    postures = postures[machine.within(inverse(machine.geometry, postures)).all(axis=1)]
    postures = postures[looseness(machine.geometry, postures) < WELL_HELD]
    return postures if len(postures) >= PLACES else held_postures(machine, PLACES, SEED)


def platform_error(reference: HexaSlide, calibration: Calibration) -> PlatformError:
    """The platform's error where a controller holds ``reference``. Raises UnreachablePosture,
    CalibrationError.
    """
    places = Places.of(reference, calibration.machine, calibration.laid_over)
    bound = None
    if calibration.covariance is not None and not calibration.left_open:
        count = places.moved.shape[1]
        root = root_of(calibration.covariance[:count, :count])
        bound = places.bound_m(places.moved @ root)
        # one coverage factor counts that the noise itself is known from few degrees of freedom
        bound *= coverage_factor(calibration.degrees_of_freedom) / coverage_factor(np.inf)
        if (
            calibration.lack_of_fit is not None
        ):  # more is left than noise: at least so much is wrong
            bound *= max(1.0, calibration.lack_of_fit) ** 0.5
    return places.error(calibration, calibration.machine, bound)
