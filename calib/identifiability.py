"""What the readings can and cannot see of the base parameters."""

from __future__ import annotations

import math

import numpy as np

from calib.errors import NotIdentifiable
from calib.noise import Noise
from calib.observations import LEG_NAMES, FloatArray
from calib.orthoglide.geometry import PARAMETER_NAMES
from calib.solution import Direction, Subset

UNSEEN_MM = 5.0
"""A direction known no better than this is not seen: no machine is assembled so badly."""

WEAK_RATIO = 10.0
"""A direction is weak when it is known so many times worse than the best known one."""

RANK_TOLERANCE = 1e-7
"""Relative singular value below which nothing is seen at all, whatever the noise."""


def refuse_unseen(
    information: FloatArray, noise: Noise | None, free: tuple[int, ...], subset: Subset
) -> None:
    """Raise NotIdentifiable where some combination of the parameters is not seen.

    ``information`` is ``(k, k)`` for unit noise. Without a noise only exact blindness counts.
    """
    values, vectors = np.linalg.eigh(information)
    singular = np.sqrt(np.clip(values, 0.0, None))
    spread = noise.standard_deviation_mm if noise else 0.0
    unseen = (singular <= RANK_TOLERANCE * singular[-1]) | (spread > UNSEEN_MM * singular)
    if not unseen.any():
        return
    names = [PARAMETER_NAMES[k] for k in free]
    blind = "; ".join(_short_combination(vectors[:, k], names) for k in np.flatnonzero(unseen))
    raise NotIdentifiable(
        f"the set '{subset}' is not determined by these readings",
        f"{int(unseen.sum())} of {len(free)} combinations not seen: {blind}",
        f"every combination known to better than {UNSEEN_MM:g} mm",
        "Choose a smaller set with --subset, or measure Zero, Max and Min on all three legs.",
    )


def weak_directions(covariance_mm2: FloatArray, free: tuple[int, ...]) -> tuple[Direction, ...]:
    """Sums and differences of offset and length of one leg that are weakly known.

    The standard uncertainty is that of the combination as written (not of unit length).
    """
    if len(free) < len(PARAMETER_NAMES):
        return ()
    best = math.sqrt(max(float(np.linalg.eigvalsh(covariance_mm2)[0]), 0.0))
    weak = []
    for leg, name in enumerate(LEG_NAMES):
        for sign, word in ((1.0, "+"), (-1.0, "-")):
            combination = np.zeros(len(free))
            combination[[leg, 3 + leg]] = 1.0, sign
            uncertainty = math.sqrt(float(combination @ covariance_mm2 @ combination))
            if uncertainty > WEAK_RATIO * best * math.sqrt(2.0) and uncertainty > 0.0:
                weak.append(Direction(f"d_rho_{name} {word} d_L_{name}", uncertainty))
    return tuple(weak)


def _short_combination(vector: FloatArray, names: list[str]) -> str:
    """The direction in words, entries below a quarter of the largest left out."""
    largest = np.abs(vector).max()
    scaled = vector / vector[np.argmax(np.abs(vector))]
    parts = [
        f"{'+' if value > 0 else '-'} {'' if abs(value) > 0.95 else f'{abs(value):.1f} '}{name}"
        for value, name in zip(scaled, names, strict=True)
        if abs(value) * largest > 0.25 * largest
    ]
    return " ".join(parts).removeprefix("+ ")
