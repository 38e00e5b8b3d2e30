"""From the noise of readings to the uncertainty of what is computed from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from calib.fit import without_zeros
from calib.noise import Noise, same_place
from calib.observations import FloatArray, Observations


@dataclass(frozen=True, eq=False)
class Propagated:
    """Covariance ``(k, k)`` in mm² and the degrees of freedom ``(k,)`` of each variance."""

    covariance_mm2: FloatArray
    degrees_of_freedom: FloatArray

    @property
    def uncertainty_mm(self) -> FloatArray:
        """Standard uncertainties ``(k,)``, mm."""
        return np.sqrt(self.covariance_mm2.diagonal())

    def with_prior(
        self,
        observed: Observations,
        weight: FloatArray,
        design: FloatArray,
        tolerance_mm: FloatArray,
    ) -> Propagated:
        """The same with what tolerances ``(k,)`` leave open: the covariance of Bayes' estimate."""
        centred = without_zeros(observed, weight, design)
        seen = (centred.T * weight) @ centred
        posterior = np.linalg.inv(seen + np.diag(tolerance_mm**-2.0))
        share = self.covariance_mm2.diagonal() / posterior.diagonal()
        with np.errstate(divide="ignore"):
            degrees = np.asarray(self.degrees_of_freedom / share**2)
        return Propagated(np.asarray(posterior, dtype=np.float64), degrees)


def propagate(
    estimator: FloatArray | csr_array, observed: Observations, noise: Noise
) -> Propagated:
    """Law of propagation (GUM 5.2) for a linear map ``(k, n_readings)`` of the readings.

    Each reading has a scatter of its own; rounding that is locked is common to the readings of a
    posture. Degrees of freedom after Welch and Satterthwaite (GUM G.4.1), one contribution for each
    indicator, one in all where they are pooled.
    """
    dense: NDArray[np.float64] = (
        estimator.toarray() if isinstance(estimator, csr_array) else np.asarray(estimator)
    )
    own = dense**2 * noise.shown_mm2(observed)
    shown = (dense * noise.shown_mm2(observed)) @ dense.T
    covariance = shown + _locked(dense, observed, noise)
    return Propagated(covariance, _degrees_of_freedom(covariance.diagonal(), own, observed, noise))


def _locked(dense: FloatArray, observed: Observations, noise: Noise) -> FloatArray:
    place = same_place(observed)
    locked = noise.locked_mm2(observed)
    if not locked.any():
        return np.zeros((len(dense), len(dense)))
    together = np.zeros((int(place.max()) + 1, len(dense)))
    np.add.at(together, place, (dense * np.sqrt(locked)).T)
    return np.asarray(together.T @ together)


def _degrees_of_freedom(
    variance: FloatArray, own: FloatArray, observed: Observations, noise: Noise
) -> FloatArray:
    known = np.array([one.degrees_of_freedom for one in noise.indicators])
    group = np.zeros_like(observed.indicator) if noise.pooled else observed.indicator
    spread = np.zeros_like(variance)
    for number in np.unique(group):
        contribution = own[:, group == number].sum(axis=1)
        spread += contribution**2 / known[number]
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(spread > 0.0, variance**2 / spread, np.inf))
