"""From the noise of readings to the uncertainty of what is computed from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from calib.arrays import FloatArray, Observations, without_zeros
from calib.noise.reading import Noise


@dataclass(frozen=True, eq=False)
class Propagation:
    """Covariance ``(k, k)`` in mm² and the degrees of freedom ``(k,)`` of each variance.

    ``held_mm2`` ``(k, k)`` is the part of the covariance that is not noise of the readings but what
    the tolerances of a prior leave open; ``rounding_mm2`` ``(k, k)`` is the part that steps of the
    display give to all repeats of a posture.
    """

    covariance_mm2: FloatArray
    degrees_of_freedom: FloatArray
    held_mm2: FloatArray
    rounding_mm2: FloatArray

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
    ) -> Propagation:
        """The same with what tolerances ``(k,)`` leave open: the covariance of Bayes' estimate."""
        centred = without_zeros(observed, weight, design)
        seen = (centred.T * weight) @ centred
        posterior = np.linalg.inv(seen + np.diag(tolerance_mm**-2.0))
        share = self.covariance_mm2.diagonal() / posterior.diagonal()
        with np.errstate(divide="ignore"):
            degrees = np.asarray(self.degrees_of_freedom / share**2)
        held = np.asarray(posterior - self.covariance_mm2, dtype=np.float64)
        covariance = np.asarray(posterior, dtype=np.float64)
        return Propagation(covariance, degrees, held, self.rounding_mm2)


def propagate(estimator: FloatArray, observed: Observations, noise: Noise) -> Propagation:
    """Law of propagation (GUM 5.2) for a linear map ``(k, n_readings)`` of the readings.

    Each reading has a scatter of its own; rounding that is locked is common to the readings of a
    posture. Degrees of freedom after Welch and Satterthwaite (GUM G.4.1), one contribution for each
    indicator, one in all where they are pooled.
    """
    shown = noise.repeatability_mm2(observed)
    covariance = (estimator * shown) @ estimator.T
    together = np.asarray((_at_places(observed, noise).T @ estimator.T).T)
    shared = together @ together.T
    covariance = covariance + shared
    own = estimator**2 * shown
    degrees = _degrees_of_freedom(covariance.diagonal(), own, observed, noise)
    return Propagation(covariance, degrees, np.zeros_like(covariance), shared)


def uncertainties(combine: csr_array, observed: Observations, noise: Noise) -> FloatArray:
    """Standard uncertainties ``(k,)`` for a sparse map ``(k, n_readings)``, mm; no covariances."""
    own = combine.multiply(combine) @ noise.repeatability_mm2(observed)
    together = combine @ _at_places(observed, noise)
    shared = together.multiply(together).sum(axis=1)
    return np.sqrt(np.asarray(own, dtype=np.float64) + np.asarray(shared, dtype=np.float64))


def _at_places(observed: Observations, noise: Noise) -> csr_array:
    """What each reading shares with its posture ``(n_readings, n_places)``, mm."""
    place = observed.posture
    rows = np.arange(len(place))
    return csr_array(
        (np.sqrt(noise.quantisation_mm2(observed)), (rows, place)),
        shape=(len(place), int(place.max()) + 1),
    )


def _degrees_of_freedom(
    variance: FloatArray, own: FloatArray, observed: Observations, noise: Noise
) -> FloatArray:
    known = np.array([one.degrees_of_freedom for one in noise.indicators])
    group = noise.estimates[observed.indicator]
    spread = np.zeros_like(variance)
    for number in np.unique(group):
        contribution = own[:, group == number].sum(axis=1)
        spread += contribution**2 / known[number]
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(spread > 0.0, variance**2 / spread, np.inf))
