"""What the next readings of a session should be, from the parts' tolerances and earlier readings.

A normal distribution over everything that makes a reading: parameters of the machine, play of its
carriages, what the model leaves out in a posture, zero and drift of a mounting, noise. Readings
taken narrow it (conditional normal distribution; kriging): wide on a raw machine, a few µm on a
posture that was read before from the same side.
"""

from __future__ import annotations

import numpy as np

from calib.arrays import Conditions, FloatArray, numbered
from calib.tripod.effects.drives import Backlash
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import PARAMETER_NAMES, Geometry
from calib.tripod.pipeline import Model, derivatives

ZERO_MM = 10.0
"""Standard deviation of the zero of a mounting about its first reading."""

DRIFT_MM_S = 0.001
"""The most that a mounting drifts, as two standard deviations."""

PLAY_MM = 0.05
"""Standard deviation of what a carriage stays back when it comes from above: twice as much has a
drive that is worn."""

LEFT_OUT = 0.05
"""What the model leaves out in a posture, of the tolerance of the joint offsets. The prototype of
papers/000 had offsets up to 1.7 mm and 0.14 mm r.m.s. left over after the fit."""


Predicted = tuple[FloatArray, FloatArray]
"""Mean and standard deviation ``(k,)`` of readings, mm."""


def predict(
    geometry: Geometry,
    tolerance_mm: FloatArray,
    taken: Conditions,
    value_mm: FloatArray,
    noise_mm: FloatArray,
    tilt_mrad: float = 0.0,
) -> tuple[Predicted, Predicted]:
    """The last k readings from the n before them: if the carriages may have play, and without.

    ``taken`` has n + k rows, in time; every mounting has one among the n. ``value_mm`` ``(n,)`` are
    what was read, ``tolerance_mm`` ``(6,)`` standard deviations of the parameters, ``noise_mm``
    ``(n + k,)`` of each reading, ``tilt_mrad`` the most that a reference plane leans. The first
    derivatives at the nominal machine serve as its model.
    """
    first = np.unique(taken.mount, return_index=True)[1][taken.mount]
    since_s = taken.time_s - taken.time_s[first]
    nominal = (0.0,) * len(PARAMETER_NAMES)
    by_tolerance = derivatives(geometry, nominal, taken) * tolerance_mm
    exact = Model(geometry).readings(taken)
    worn = [EffectInstance(Backlash(), carriage, (PLAY_MM,)) for carriage in "xyz"]
    by_play = np.array([Model(geometry, effects=(one,)).readings(taken) - exact for one in worn])
    one_mount = taken.mount[:, None] == taken.mount
    place = numbered(taken.leg, taken.axis, taken.station, taken.level, taken.over_plane)
    leaning_mm = 1e-3 * tilt_mrad / 2.0 * np.nan_to_num(taken.along_mm - taken.along_mm[first])
    drifted_mm = DRIFT_MM_S / 2.0 * since_s
    since_first = np.outer(drifted_mm, drifted_mm) + np.outer(leaning_mm, leaning_mm)
    covariance = (
        by_tolerance @ by_tolerance.T
        + one_mount * (ZERO_MM**2 + since_first)
        + (place[:, None] == place) * (LEFT_OUT * float(tolerance_mm[0])) ** 2
        + np.diag(noise_mm**2)
    )
    expected = value_mm[first] + exact
    known = value_mm, expected, noise_mm
    return _last(covariance + by_play.T @ by_play, *known), _last(covariance, *known)


def _last(
    covariance: FloatArray, value_mm: FloatArray, expected_mm: FloatArray, noise_mm: FloatArray
) -> Predicted:
    """The readings beyond those of ``value_mm``, of a normal distribution that those narrow."""
    n = len(value_mm)
    known, between = covariance[:n, :n], covariance[:n, n:]
    gain = np.linalg.solve(known, between)
    mean = expected_mm[n:] + gain.T @ (value_mm - expected_mm[:n])
    variance = np.diag(covariance[n:, n:] - between.T @ gain)
    return mean, np.sqrt(np.maximum(variance, noise_mm[n:] ** 2))
