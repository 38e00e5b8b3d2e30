"""What a calibration means at the platform, over the whole box: off now, and off at most with it.

Parameters alone say little where combinations of them are lost. Both figures are of places of the
platform's origin; frames moved as wholes, which no reading shows, are laid over first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from calib.arrays import FloatArray, without
from calib.hexaslide.calibration import Calibration
from calib.hexaslide.checked import FramesApart, frame_motions, frames_apart
from calib.hexaslide.derivatives import jacobian
from calib.hexaslide.geometry import MOTIONS, HexaSlide, forward_near, rotation
from calib.hexaslide.procedures import Procedure, ProcedureKind, held_postures
from calib.stats import coverage_factor

PLACES = 200
"""So many random postures of the box stand for all of it: their r.m.s. varies by a few percent."""

SEED = 0
OUTSIDE = 0.05
"""One machine in twenty may be off by more than the bound."""


@dataclass(frozen=True, eq=False)
class PlatformError:
    """R.m.s. over the box, metres: ``now`` how far the platform is from where a controller that
    holds ``reference`` believes it, ``bound_m`` by how much it is off at most, in 95 of 100 cases,
    with the calibrated machine. The bound is None where no noise is known, or where readings leave
    more open than frames: ``left_open`` counts such combinations.
    """

    now: FramesApart
    bound_m: float | None
    left_open: int


def platform_error(reference: HexaSlide, calibrated: Calibration) -> PlatformError:
    """Of a controller that holds ``reference``. Raises UnreachablePosture, CalibrationError."""
    machine, free = calibrated.machine, calibrated.unidentifiable
    postures = held_postures(reference, PLACES, SEED)
    sliders = reference.sliders_at(postures)
    stands = np.asarray(forward_near(machine.geometry, sliders, postures))
    motions = [k for k, name in enumerate(MOTIONS) if name in free]
    left_open = calibrated.unidentifiable_count - len(motions)
    bound = None
    if calibrated.covariance is not None and left_open == 0:
        count = len(machine.geometry.names)
        covariance = calibrated.covariance[:count, :count]
        bound = _bound_m(machine, stands, covariance, motions)
        # one coverage factor counts that the noise itself is known from few degrees of freedom
        bound *= coverage_factor(calibrated.degrees_of_freedom) / coverage_factor(np.inf)
        if calibrated.lack_of_fit is not None:  # more is left than noise: at least so much is wrong
            bound *= max(1.0, calibrated.lack_of_fit) ** 0.5
    return PlatformError(frames_apart(postures, stands, free), bound, left_open)


def _bound_m(
    machine: HexaSlide, postures: FloatArray, covariance: FloatArray, motions: list[int]
) -> float:
    """The quantile of the r.m.s. of places that parameters of this covariance ``(k, k)`` move.

    The mean square is a sum of squares of normal values; its quantile is that of a multiple of chi
    square with the same mean and variance (Satterthwaite).
    """
    forward = Procedure.of(ProcedureKind.POSE_FORWARD).on(machine)
    moved = jacobian(forward, machine.geometry, postures)
    places = np.asarray(moved[:, :3]).reshape(-1, len(covariance))
    if motions:  # what frames take over is no error: both ways of moving are known by places alone
        frames = frame_motions(postures[:, :3], rotation(postures[:, 3:]))[:, :3]
        basis = frames.reshape(-1, frames.shape[-1])[:, motions]
        vectors, size, _ = np.linalg.svd(basis, full_matrices=False)
        vectors = vectors[:, size > 1e-9 * size[0]] if size[0] > 0.0 else vectors[:, :0]
        places = without(vectors, places)
    squares = covariance @ (places.T @ places) / len(postures)
    mean, spread = float(np.trace(squares)), float(np.trace(squares @ squares))
    if mean <= 0.0:
        return 0.0
    degrees = mean**2 / spread
    return float(np.sqrt(mean * chdtri(degrees, OUTSIDE) / degrees))
