"""What a cause of a stated size would explain of readings, and do at the platform.

About the calibrated machine all of it is linear in the size; parameters give way at every size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray, without
from calib.hexaslide.causes import HexaSlideCause
from calib.hexaslide.correction import moved_by, over_all
from calib.hexaslide.diagnosis import WeighedCauses
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.platform import Places
from calib.quantity import Sizes, round_step
from calib.stats import variance_ratio_p_value

FAR = 100.0
"""Unremarkable sizes, or four times what fits best: so far a size can be moved."""

DARK = 1e-6
"""Share of a cause that parameters leave, below which readings do not show it."""


@dataclass(frozen=True, eq=False)
class CauseAtSize:
    """A cause with ``values`` ``(r,)``: what is left of each posture, r.m.s. in standard deviations
    of the noise ``(p,)``; of all readings, with a p-value; metres r.m.s. over the box that the
    cause by itself does at the platform, and that it is off by where parameters without it are
    entered.
    """

    values: tuple[float, ...]
    by_posture: FloatArray
    times_noise: float
    p_value: float
    alone_m: float
    misled_m: float


@dataclass(frozen=True, eq=False)
class PostureTrial:
    """A cause whose sizes are moved. Per unit of each size ``columns`` ``(n, r)`` are what it does
    to the readings beside the parameters, ``alone`` and ``misled`` ``(q, r)`` to the platform.

    ``best`` ``(r,)`` fits best, give or take ``deviations`` ``(r,)``; both are empty where the
    readings do not show the cause.
    """

    cause: HexaSlideCause
    models: WeighedCauses
    columns: FloatArray
    alone: FloatArray
    misled: FloatArray
    best: tuple[float, ...]
    deviations: tuple[float, ...]

    @staticmethod
    def of(models: WeighedCauses, name: tuple[str, str], reference: HexaSlide) -> PostureTrial:
        """The trial of one cause, where a controller that holds ``reference`` sends the machine.

        Raises UnreachablePosture, CalibrationError.
        """
        names = [(cause.id, cause.where) for cause in models.causes]
        cause, index = models.causes[names.index(name)], models.selection.columns[names.index(name)]
        places = Places.of(reference, models.calibration.machine, models.calibration.laid_over)
        alone = over_all(models, places)[:, index]
        misled = moved_by(models, places) @ models.given_way[:, index] + alone
        columns = without(models.directions.left, cause.columns)
        best: tuple[float, ...] = ()
        deviations: tuple[float, ...] = ()
        inner = columns.T @ columns
        if (inner.diagonal() > DARK * (cause.columns**2).sum(axis=0)).all():
            covariance = np.linalg.inv(inner)
            sizes = covariance @ (columns.T @ models.whitened)
            best = tuple((cause.size * sizes).tolist())
            deviations = tuple((cause.size * np.sqrt(covariance.diagonal())).tolist())
        columns, alone, misled = (part / cause.size for part in (columns, alone, misled))
        return PostureTrial(cause, models, columns, alone, misled, best, deviations)

    @property
    def sizes(self) -> Sizes:
        """How they can be moved: by steps no larger than the standard uncertainty of each."""
        names, size, imitated = self.cause.names, self.cause.size, ""
        if not self.best:
            imitated = "The parameters can imitate it: the readings do not show its size."
        first = self.best or (0.0,) * len(names)
        far = tuple(max(FAR * size, 4.0 * abs(best)) for best in first)
        return Sizes(
            names=names,
            units=(self.cause.unit,) * len(names),
            first=first,
            steps=tuple(map(round_step, self.deviations or (0.1 * size,) * len(names))),
            least=tuple(-most for most in far),
            largest=far,
            best=self.best,
            deviations=self.deviations,
            why_not=imitated,
        )

    def at(self, values: Sequence[float]) -> CauseAtSize:
        """The cause with these sizes ``(r,)``, in its unit."""
        sizes = np.array(values)
        remainder = without(self.models.directions.left, self.models.whitened)
        remainder -= self.columns @ sizes
        remainder *= self.models.noise_times
        spare = max(self.models.spare, 1)
        ratio = float(remainder @ remainder) / spare
        by_posture = (remainder**2).reshape(len(self.models.readings.sliders), -1).mean(axis=1)
        count = len(self.alone) // 3
        alone, misled = (
            float(np.sqrt(((part @ sizes) ** 2).sum() / count))
            for part in (self.alone, self.misled)
        )
        p_value = variance_ratio_p_value(ratio, spare, np.inf)
        root = np.asarray(np.sqrt(by_posture))
        return CauseAtSize(tuple(values), root, ratio**0.5, p_value, alone, misled)
