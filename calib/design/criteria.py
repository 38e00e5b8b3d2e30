"""How good a set of measurements is, as one number. Knows no machine.

Measurements are rows: derivatives by the parameters, divided by the noise. Their information
matrix is ``M = Σ rowᵀ row``; of nuisance parameters (zeros of mountings) only the Schur complement
``S`` of the wanted ones remains, and ``S⁻¹`` is the covariance of the wanted parameters. With the
singular values ``σ_1 ≥ … ≥ σ_L`` of the wanted part, ``σ² `` being the eigenvalues of ``S``, the
criteria are those of papers/001, section 4, and two of statistics:

==========================  ==========================  ========================================
determinant (D)             ``(σ_1 ⋯ σ_L)^(1/L)``       largest is best; papers/001, 1st and 2nd
average-variance (A)        ``tr(S⁻¹) / L``             smallest
smallest-singular-value (E) ``σ_L``                     largest; papers/001, 4th
condition                   ``σ_1 / σ_L``               smallest; inverse of papers/001, 3rd
noise-amplification         ``σ_L² / σ_1``              largest; papers/001, 5th
tool-variance               ``tr(metric S⁻¹)``          smallest
==========================  ==========================  ========================================

The first two of papers/001, ``det(JᵀJ)`` and the geometric mean by ``√m``, order sets of equal size
alike; the geometric mean does not overflow. Only D does not depend on the units of the parameters.
`Observability` holds all five as the paper writes them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from calib.arrays import BLIND, BLIND_IN_SQUARES, FloatArray
from calib.errors import CalibrationError, NotIdentifiable

RIDGE = 1e-9
"""Information, relative to the best single candidate, that stands in where there is none."""


class Criterion(StrEnum):
    """What is to be made best."""

    DETERMINANT = "determinant"
    AVERAGE_VARIANCE = "average-variance"
    SMALLEST_SINGULAR_VALUE = "smallest-singular-value"
    CONDITION = "condition"
    NOISE_AMPLIFICATION = "noise-amplification"
    TOOL_VARIANCE = "tool-variance"

    @property
    def larger_is_better(self) -> bool:
        """Whether the value is to be maximised."""
        return self in (
            Criterion.DETERMINANT,
            Criterion.SMALLEST_SINGULAR_VALUE,
            Criterion.NOISE_AMPLIFICATION,
        )

    def better(self, value: float, than: float) -> bool:
        """Whether a value is better than another one."""
        return value > than if self.larger_is_better else value < than


@dataclass(frozen=True, eq=False)
class Aim:
    """What a set is judged by: the criterion, and which of the ``k`` parameters count.

    ``wanted`` holds their indices, the others are nuisance; None stands for all. ``metric``
    ``(k_wanted, k_wanted)`` is needed for the tool variance only.
    """

    criterion: Criterion = Criterion.DETERMINANT
    wanted: tuple[int, ...] | None = None
    metric: FloatArray | None = None

    def parts(self, count: int) -> tuple[list[int], list[int]]:
        """Indices of the wanted parameters, and of the nuisance.

        Raises CalibrationError where they, or the metric of them, do not fit.
        """
        keep = list(range(count)) if self.wanted is None else list(self.wanted)
        if not keep or len(set(keep)) < len(keep) or not set(keep) <= set(range(count)):
            raise CalibrationError(
                "wanted parameters", str(self.wanted), f"different numbers from 0 to {count - 1}"
            )
        size, shape = len(keep), None if self.metric is None else self.metric.shape
        if self.criterion is Criterion.TOOL_VARIANCE and shape != (size, size):
            raise CalibrationError(
                "metric of the tool variance", f"shape {shape}", f"shape ({size}, {size})"
            )
        return keep, sorted(set(range(count)) - set(keep))


@dataclass(frozen=True)
class Observability:
    """The five criteria of papers/001, section 4, of one set; the larger the better.

    The determinant as its decimal logarithm; the geometric mean is divided by the root of the
    number of postures.
    """

    log10_determinant: float
    geometric_mean: float
    inverse_condition: float
    smallest_singular_value: float
    noise_amplification: float

    @property
    def condition_number(self) -> float:
        """Largest by smallest singular value."""
        return 1.0 / self.inverse_condition


def observability(singular: FloatArray, postures: int) -> Observability:
    """The criteria from the singular values ``(k,)`` of a Jacobian, largest first, none zero."""
    logs = np.log(singular)
    largest, least = float(singular[0]), float(singular[-1])
    return Observability(
        log10_determinant=float(2.0 * logs.sum() / math.log(10.0)),
        geometric_mean=float(np.exp(logs.mean()) / math.sqrt(postures)),
        inverse_condition=least / largest,
        smallest_singular_value=least,
        noise_amplification=least**2 / largest,
    )


def nuisance_fitted(information: FloatArray, aim: Aim) -> FloatArray:
    """The wanted parameters, each with the best nuisance beside it ``(k, k_wanted)``.

    ``information`` is ``(k, k)``; a nuisance parameter that no measurement touches stays at 0.
    """
    keep, drop = aim.parts(len(information))
    lift = np.zeros((len(information), len(keep)))
    lift[keep, np.arange(len(keep))] = 1.0
    if drop:
        result = np.linalg.pinv(information[np.ix_(drop, drop)], rcond=BLIND**2, hermitian=True)
        lift[drop] = -result @ information[np.ix_(drop, keep)]
    return lift


def wanted_information(information: FloatArray, aim: Aim) -> FloatArray:
    """Schur complement ``(k_wanted, k_wanted)`` of ``(k, k)``: nuisance fitted too."""
    lift = nuisance_fitted(information, aim)
    return np.asarray(lift.T @ information @ lift)


def value_of(information: FloatArray, aim: Aim) -> float:
    """The criterion of one information matrix ``(k, k)``.

    Raises NotIdentifiable where a wanted combination is not seen.
    """
    remaining = wanted_information(information, aim)
    count = len(remaining)
    # in units in which every parameter alone is known alike: theirs decide nothing
    size = np.sqrt(np.clip(remaining.diagonal(), 0.0, None))
    scale = np.where(size > 0.0, size, 1.0)
    singular = np.sqrt(np.clip(np.linalg.eigvalsh(remaining / scale / scale[:, None]), 0.0, None))
    visible = int((singular > BLIND_IN_SQUARES * max(float(singular[-1]), 1.0)).sum())
    if visible < count:
        raise NotIdentifiable(
            "a set of measurements",
            f"{visible} of {count} combinations of the parameters identifiable",
            "all of them",
            "Measure more postures, or others.",
        )
    return float(values_of(inverse(remaining)[None], aim)[0])


def inverse(matrix: FloatArray) -> FloatArray:
    """The inverse of a regular matrix."""
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def value_or_none(information: FloatArray, aim: Aim) -> float | None:
    """`value_of`, None where a wanted combination is not seen."""
    try:
        return value_of(information, aim)
    except NotIdentifiable:
        return None


def values_of(covariance: FloatArray, aim: Aim) -> FloatArray:
    """The criterion ``(b,)`` of covariances ``(b, k_wanted, k_wanted)``."""
    kind = aim.criterion
    if kind is Criterion.AVERAGE_VARIANCE:
        return np.asarray(np.trace(covariance, axis1=1, axis2=2) / covariance.shape[-1])
    if kind is Criterion.TOOL_VARIANCE and aim.metric is not None:
        return np.asarray(np.einsum("ij,bji->b", aim.metric, covariance))
    if kind is Criterion.DETERMINANT:
        sign, log = np.linalg.slogdet(covariance)
        mean = np.where(sign > 0.0, -0.5 * log / covariance.shape[-1], -math.inf)
        return np.asarray(np.exp(mean))
    variance = np.linalg.eigvalsh(covariance)  # ascending
    usable = variance[:, 0] > 0.0
    least = 1.0 / np.sqrt(np.where(usable, variance[:, -1], 1.0))
    largest = 1.0 / np.sqrt(np.where(usable, variance[:, 0], 1.0))
    if kind is Criterion.CONDITION:
        return np.where(usable, largest / least, math.inf)
    value = least if kind is Criterion.SMALLEST_SINGULAR_VALUE else least**2 / largest
    return np.where(usable, value, 0.0)


def scores(values: FloatArray, criterion: Criterion) -> FloatArray:
    """Logarithms of the values, turned so that larger is better."""
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(np.where(values >= 0.0, values, np.nan))
    turned = logs if criterion.larger_is_better else -logs
    return np.where(np.isnan(turned), -math.inf, turned)


def covariances_after(
    covariance: FloatArray, rows: FloatArray, signs: FloatArray, keep: list[int]
) -> FloatArray:
    """Covariances ``(b, k_wanted, k_wanted)`` after each of ``b`` changes by ``r`` rows.

    ``covariance`` ``(k, k)`` is that before, ``rows`` ``(b, r, k)``; ``signs`` ``(r,)`` is +1 for
    a row that is added and -1 for one that is taken away (Woodbury's identity).
    """
    moved = rows @ covariance
    inner = moved @ np.swapaxes(rows, 1, 2) + np.diag(signs)
    visible = moved[:, :, keep]
    shift = np.swapaxes(visible, 1, 2) @ np.linalg.solve(inner, visible)
    return np.asarray(covariance[np.ix_(keep, keep)] - shift)
