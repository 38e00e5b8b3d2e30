"""What to enter for a machine in which something may be missing: least error of its platform.

A controller holds parameters alone. Where a model has a cause, the parameters are those beside it
and, on top, what of its effect over the box parameters can imitate: the best name is not the best
correction. Models count with their weights, in the entered values and in the bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.hexaslide.causes import causes_of_machine
from calib.hexaslide.checked import KnownValues, inner_lengths, length_slopes, lengths_alone
from calib.hexaslide.diagnosis import WeighedCauses
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.platform import Places, PlatformError
from calib.hexaslide.procedures import Procedure, ProcedureKind
from calib.hexaslide.residuals import Readings
from calib.stats import COVERAGE, mixture_uncertainties, root_quantile

IMITATED_AT = 400
"""So many places, of the seed of this number, show what parameters can imitate."""

IMITATED = 1e-6
"""Singular values, by the largest, of parameters over the box that imitate an effect."""


@dataclass(frozen=True, eq=False)
class HexaSlideCorrection:
    """The machine to enter, and what the platform is off by now and then at most.

    ``parameters`` ``(k,)`` are those to enter, with what the true ones may differ by; ``lengths_m``
    ``(26,)`` the lengths that no frame changes.
    """

    machine: HexaSlide
    platform: PlatformError
    parameters: KnownValues
    lengths_m: KnownValues


def correction_of(models: WeighedCauses, reference: HexaSlide) -> HexaSlideCorrection | None:
    """The correction for a controller that holds ``reference`` now; None where no model could be
    weighed.

    Raises UnreachablePosture, CalibrationError.
    """
    if not models.entries:
        return None
    calibrated = models.calibration
    machine, names, free = calibrated.machine, calibrated.names, calibrated.laid_over
    along = models.directions.right.T
    # parameters beside an effect give way; those that are entered imitate it over the box
    given_way = models.given_way
    # in the frame as it was measured: what is laid over is not moved for nothing
    sample = Places.of(reference, machine, calibrated.unidentifiable, IMITATED_AT, IMITATED_AT)
    imitated = np.linalg.pinv(moved_by(models, sample) @ along, rcond=IMITATED)
    # a place is come to from either side, so that no parameter imitates play
    still = np.zeros((sample.count, 1))
    entered = given_way + along @ (imitated @ over_all(models, sample, still))
    # judged at other places than those where it is imitated
    places = Places.of(reference, machine, free)
    ways = np.resize([[1.0], [-1.0]], (places.count, 1))
    shift, over_box = moved_by(models, places), over_all(models, places, ways)
    by_noise = shift @ models.directions.inverse
    stands, adopted = shift @ given_way + over_box, over_box @ models.stated

    values = [models.values(entry) for entry in models.entries]
    index = [models.index(entry) for entry in models.entries]
    change = (entered - given_way) @ models.stated
    for weight, (mean, _), of_entry in zip(models.weights, values, index, strict=True):
        change += weight * (entered[:, of_entry] @ mean)
    squares = []
    for (mean, covariance), of_entry in zip(values, index, strict=True):
        off = adopted + stands[:, of_entry] @ mean - shift @ change
        spread = stands[:, of_entry] @ np.linalg.cholesky(covariance)
        squares.append(_square(off, np.hstack([by_noise, spread]), places.count))
    bound_m = None
    if not calibrated.left_open:
        square, variance = np.array(squares).T
        bound_m = root_quantile(models.weights, square, variance, COVERAGE)
        bound_m *= models.excess**0.5
    parameters = calibrated.parameters + models.tolerances * change
    entered_machine = machine.with_parameters(names, parameters)
    return HexaSlideCorrection(
        entered_machine,
        places.error(calibrated, entered_machine, bound_m),
        known_of(models, np.eye(len(names)), calibrated.parameters, parameters),
        lengths_of(models),
    )


def known_of(
    models: WeighedCauses, slopes: FloatArray, at: FloatArray, stated: FloatArray | None = None
) -> KnownValues:
    """Values ``(m,)`` that are ``at`` for the calibrated machine and have these ``slopes``
    ``(m, k)`` by its parameters: as they are expected over all models, or as they are ``stated``.
    """
    scaled = slopes * models.tolerances
    square = models.excess
    by_noise = ((scaled @ models.directions.inverse) ** 2).sum(axis=1)
    given_way = scaled @ models.given_way
    means, variances = [], []
    for entry in models.entries:
        of_causes = given_way[:, models.index(entry)]
        mean, covariance = models.values(entry)
        means.append(at + of_causes @ mean)
        variances.append(square * (by_noise + ((of_causes @ covariance) * of_causes).sum(axis=1)))
    mean_values = np.array(means)
    values = models.weights @ mean_values if stated is None else stated
    off = mean_values - values
    return KnownValues(values, *mixture_uncertainties(models.weights, off, np.array(variances)))


def lengths_of(models: WeighedCauses) -> KnownValues:
    """`inner_lengths` ``(26,)``, m; what is known of them as `lengths_alone` has it."""
    calibrated = models.calibration
    if calibrated.left_open:
        return lengths_alone(calibrated)
    geometry = calibrated.machine.geometry
    slopes = length_slopes(geometry, calibrated.names)
    return known_of(models, slopes, np.asarray(inner_lengths(geometry)))


def moved_by(models: WeighedCauses, places: Places) -> FloatArray:
    """By how much parameters in their tolerances move the platform ``(q, k)``; those of a link do
    not.
    """
    count = len(models.calibration.names) - places.moved.shape[1]
    shift = np.hstack([places.moved, np.zeros((len(places.moved), count))])
    return np.asarray(shift * models.tolerances)


def over_all(models: WeighedCauses, places: Places, ways: FloatArray | None = None) -> FloatArray:
    """What all causes do to the platform ``(q, c)``, frames taken out: mistakes do nothing.

    ``ways`` are as `causes_of_machine` takes them.
    """
    machine, readings = models.calibration.machine, models.readings
    forward = Procedure.of(ProcedureKind.POSE_FORWARD).on(machine)
    noise = readings.length_noise_m, readings.angle_noise_rad or 1.0
    box = Readings(forward, places.sliders, places.postures, *noise)
    causes = causes_of_machine(box, machine, places.postures, models.lead_m, models.middle, ways)
    shift = np.hstack([cause.places for cause in causes])
    mistakes = sum(cause.columns.shape[1] for cause in models.causes) - shift.shape[1]
    return places.without_frames(np.hstack([shift, np.zeros((len(shift), mistakes))]))


def _square(off: FloatArray, spread: FloatArray, count: int) -> tuple[float, float]:
    """Mean and variance of the mean square of ``count`` places that are ``off`` ``(q,)``, give or
    take normal values along ``spread`` ``(q, r)``; other places of the box vary, too.
    """
    inner, along = spread.T @ spread, spread.T @ off
    of_places = (off.reshape(count, -1) ** 2).sum(axis=1) + (
        spread.reshape(count, -1, spread.shape[1]) ** 2
    ).sum(axis=(1, 2))
    mean = float(off @ off + np.trace(inner)) / count
    variance = float(2.0 * (inner**2).sum() + 4.0 * (along @ along)) / count**2
    return mean, variance + float(of_places.var()) / count
