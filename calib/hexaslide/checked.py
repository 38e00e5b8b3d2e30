"""A calibration with its checks: postures kept out of the fit, and the truth where it is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.hexaslide.calibration import Calibration, calibrate, left_of
from calib.hexaslide.frames import FramesApart, frames_apart, inner_lengths, inner_slopes
from calib.hexaslide.geometry import NAMES, HexaSlide
from calib.hexaslide.kinematics import forward
from calib.hexaslide.planning import fewest_postures
from calib.hexaslide.residuals import Left, Readings, shares
from calib.observations import FloatArray
from calib.stats import coverage_factor, variance_ratio_p_value

SPARE = 1.5
"""A fit keeps so many times the fewest postures before any is kept out of it."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Postures kept out of the fit, by their numbers, and what each machine leaves of them."""

    numbers: tuple[int, ...]
    before: Left
    after: Left


@dataclass(frozen=True, eq=False)
class AgainstTruth:
    """Nominal and identified machine against the true one, at the same sliders.

    ``kept_out`` tells whether at postures kept out of the fit, else at all. ``misses`` ``(k,)``
    are the errors of the individually known parameters, ``held`` counts those within their 95 %
    interval, None without uncertainties. ``inner_m`` ``(26,)`` are errors of lengths that no frame
    changes.
    """

    kept_out: bool
    before: FramesApart
    after: FramesApart
    misses: FloatArray
    held: int | None
    inner_m: FloatArray


@dataclass(frozen=True, eq=False)
class Checked:
    """A calibration with its checks. ``factor`` is the coverage factor of 95 %; ``p_value`` None
    where no noise is stated. ``by_column`` and ``by_posture`` share what is left; ``numbers`` are
    the fitted postures.
    """

    start: FloatArray
    found: Calibration
    fewest: int
    numbers: tuple[int, ...]
    by_column: FloatArray
    by_posture: FloatArray
    factor: float | None
    p_value: float | None
    held_out: HeldOut | None
    truth: AgainstTruth | None

    @property
    def uncertainty(self) -> FloatArray | None:
        """Standard uncertainty ``(k,)``; it means something for the individually known only."""
        if self.found.covariance is None:
            return None
        return np.asarray(np.sqrt(self.found.covariance.diagonal()))

    @property
    def inner_uncertainty_m(self) -> FloatArray | None:
        """Standard uncertainty ``(26,)`` of lengths that no frame changes."""
        if self.found.covariance is None:
            return None
        slopes = inner_slopes(self.found.machine.geometry)
        own = self.found.covariance[: len(NAMES), : len(NAMES)]
        return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", slopes, own, slopes)))


def checked_calibration(
    readings: Readings, nominal: HexaSlide, true: HexaSlide | None, share: float
) -> Checked:
    """Identify from readings, about ``share`` of their postures kept out.

    Raises CalibrationError where the postures give no result.
    """
    fewest = fewest_postures(readings.procedure, nominal)
    out = _kept_out(len(readings.sliders), fewest, share)
    fitted = readings.take(~out)
    found = calibrate(fitted, nominal, fewest=fewest)
    by_column, by_posture = shares(fitted, found.machine.geometry, found.after)
    checked = readings.take(out) if out.any() else None
    result = Checked(
        start=nominal.parameters(found.names),
        found=found,
        fewest=fewest,
        numbers=fitted.numbers,
        by_column=by_column,
        by_posture=by_posture,
        factor=None if found.covariance is None else coverage_factor(found.degrees_of_freedom),
        p_value=_p_value(found),
        held_out=None if checked is None else _held_out(checked, nominal, found),
        truth=None,
    )
    if true is None:
        return result
    against = _against(result, checked or readings, nominal, true, kept_out=checked is not None)
    return replace(result, truth=against)


def _kept_out(count: int, fewest: int, share: float) -> NDArray[np.bool_]:
    """Which postures ``(p,)`` stay out of the fit: evenly spread, none where all are needed."""
    most = max(count - int(np.ceil(SPARE * fewest)), 0)
    chosen = min(int(share * count), most)
    out = np.zeros(count, dtype=np.bool_)
    out[[int((k + 0.5) * count / chosen) for k in range(chosen)]] = True
    return out


def _p_value(found: Calibration) -> float | None:
    if found.square_sum is None or not found.free_values:
        return None
    return variance_ratio_p_value(found.square_sum / found.free_values, found.free_values, np.inf)


def _held_out(readings: Readings, nominal: HexaSlide, found: Calibration) -> HeldOut:
    return HeldOut(readings.numbers, left_of(readings, nominal), left_of(readings, found.machine))


def _against(
    result: Checked, readings: Readings, nominal: HexaSlide, true: HexaSlide, *, kept_out: bool
) -> AgainstTruth:
    """Everything that is known better than the measurements tell."""
    found, sliders = result.found, readings.sliders
    stand = [
        np.asarray(forward(machine.geometry, sliders, machine.box))
        for machine in (nominal, found.machine, true)
    ]
    known = [found.names.index(name) for name in found.known]
    misses = (found.parameters - true.parameters(found.names))[known]
    held = None
    if result.uncertainty is not None and result.factor is not None:
        held = int((np.abs(misses) <= result.factor * result.uncertainty[known]).sum())
    lengths = inner_lengths(found.machine.geometry) - inner_lengths(true.geometry)
    return AgainstTruth(
        kept_out=kept_out,
        before=frames_apart(stand[0], stand[2], found.lost),
        after=frames_apart(stand[1], stand[2], found.lost),
        misses=misses,
        held=held,
        inner_m=np.asarray(lengths),
    )
