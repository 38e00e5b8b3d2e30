"""What the next readings of a session should be, from the parts' tolerances and earlier readings.

A normal distribution over everything that makes a reading: parameters of the machine, play of its
carriages, what the model leaves out in a posture, zero and drift of a mounting, noise. Readings
taken narrow it (conditional normal distribution; kriging): wide on a raw machine, a few µm on a
posture that was read before from the same side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.arrays import Conditions, FloatArray, IntArray, numbered
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

CLEAR = 6.9
"""Of two readings that may be wrong one is named alone where it is a thousand times as likely:
the logarithm of that."""

Predicted = tuple[FloatArray, FloatArray]
"""Mean and standard deviation ``(k,)`` of readings, mm."""


@dataclass(frozen=True, eq=False)
class CorrelatedReadings:
    """Readings of one session and how they hang together.

    ``value_mm`` ``(n,)`` are the first n of all m readings in time, ``expected_mm`` ``(m,)`` what
    the nominal machine shows. The covariances ``(m, m)`` are without noise: ``worn_mm2`` where the
    carriages may have play, ``sure_mm2`` where they have none.
    """

    value_mm: FloatArray
    expected_mm: FloatArray
    worn_mm2: FloatArray
    sure_mm2: FloatArray

    @classmethod
    def of(
        cls,
        geometry: Geometry,
        tolerance_mm: FloatArray,
        conditions: Conditions,
        value_mm: FloatArray,
        tilt_mrad: float = 0.0,
    ) -> CorrelatedReadings:
        """How readings taken like this hang together on a machine of these tolerances.

        ``conditions`` has m rows, in time; every mounting has one among the first n. ``value_mm``
        ``(n,)`` are what was read, ``tolerance_mm`` ``(6,)`` standard deviations of the parameters,
        ``tilt_mrad`` the most that a reference plane leans. The first derivatives at the nominal
        machine serve as its model.
        """
        first = np.unique(conditions.mount, return_index=True)[1][conditions.mount]
        since_s = conditions.time_s - conditions.time_s[first]
        nominal = (0.0,) * len(PARAMETER_NAMES)
        by_tolerance = derivatives(geometry, nominal, conditions) * tolerance_mm
        exact = Model(geometry).readings(conditions)
        worn = [EffectInstance(Backlash(), carriage, (PLAY_MM,)) for carriage in "xyz"]
        by_play = np.array(
            [Model(geometry, effects=(play,)).readings(conditions) - exact for play in worn]
        )
        one_mount = conditions.mount[:, None] == conditions.mount
        place = numbered(
            conditions.leg,
            conditions.axis,
            conditions.station,
            conditions.level,
            conditions.over_plane,
        )
        leaning_mm = (
            1e-3 * tilt_mrad / 2.0 * np.nan_to_num(conditions.along_mm - conditions.along_mm[first])
        )
        drifted_mm = DRIFT_MM_S / 2.0 * since_s
        since_first = np.outer(drifted_mm, drifted_mm) + np.outer(leaning_mm, leaning_mm)
        sure = (
            by_tolerance @ by_tolerance.T
            + one_mount * (ZERO_MM**2 + since_first)
            + (place[:, None] == place) * (LEFT_OUT * float(tolerance_mm[0])) ** 2
        )
        return cls(value_mm, value_mm[first] + exact, sure + by_play.T @ by_play, sure)

    def predict(self, noise_mm: FloatArray, *, worn: bool) -> Predicted:
        """The last m - n readings, from a normal distribution that those of ``value_mm`` narrow.

        ``noise_mm`` ``(m,)`` is the standard deviation of each reading by itself; ``worn``: the
        carriages may have play.
        """
        n = len(self.value_mm)
        covariance = (self.worn_mm2 if worn else self.sure_mm2) + np.diag(noise_mm**2)
        of_taken, between = covariance[:n, :n], covariance[:n, n:]
        gain = np.linalg.solve(of_taken, between)
        mean = self.expected_mm[n:] + gain.T @ (self.value_mm - self.expected_mm[:n])
        variance = np.diag(covariance[n:, n:] - between.T @ gain)
        return mean, np.sqrt(np.maximum(variance, noise_mm[n:] ** 2))

    def contradicted(
        self, group: IntArray, noise_mm: float, limit_mm: float, reach: float
    ) -> list[list[int]]:
        """Groups of the n readings that the others contradict, the clearest contradiction first.

        ``group`` ``(n,)`` numbers what is wrong together, as both readings of a step. One is
        contradicted where a reading of it is further than ``limit_mm`` and than ``reach`` standard
        deviations from what all others predict. The one without which the others are most likely
        is wrong; with it stand those for which that is within `CLEAR` as likely: of two that
        contradict each other both. Then the same of what is left.
        """
        n = len(self.value_mm)
        off_mm = self.value_mm - self.expected_mm[:n]
        noise_mm2 = np.full(n, noise_mm**2)
        together: list[list[int]] = []
        while True:
            precision = np.linalg.inv(self.worn_mm2[:n, :n] + np.diag(noise_mm2))
            weighed = precision @ off_mm
            likely = {}
            diagonal = np.diag(
                precision
            )  # of a row by itself: quick, and near to that of its group
            far = np.abs(weighed) / diagonal > 0.5 * np.maximum(limit_mm, reach / np.sqrt(diagonal))
            for candidate in np.unique(group[far & (noise_mm2 < ZERO_MM**2)]).tolist():
                rows = np.flatnonzero(group == candidate)
                alone_mm2 = np.linalg.inv(precision[np.ix_(rows, rows)])
                away_mm = alone_mm2 @ weighed[rows]
                deviation_mm = np.sqrt(np.diag(alone_mm2))
                if (np.abs(away_mm) <= np.maximum(limit_mm, reach * deviation_mm)).all():
                    continue
                spread = math.log(float(np.linalg.det(alone_mm2 / ZERO_MM**2)))
                likely[candidate] = 0.5 * (float(away_mm @ weighed[rows]) + spread)
            if not likely:
                return together
            best = max(likely.values())
            order = sorted(likely, key=lambda candidate: -likely[candidate])
            together.append([c for c in order if likely[c] >= best - CLEAR])
            noise_mm2[np.isin(group, together[-1])] = ZERO_MM**2
