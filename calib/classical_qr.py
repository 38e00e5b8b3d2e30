"""The test of papers/001, section 3, for parameters that cannot be identified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.observations import FloatArray


@dataclass(frozen=True)
class ClassicalQr:
    """Parameters whose diagonal entry of R is within the tolerance of zero.

    Which ones are flagged depends on the order of the columns, and neither noise nor size of the
    parameters has a say: `calib.identifiability` decides, this only compares.
    """

    tolerance: float
    flagged: tuple[str, ...]


def classical_qr(jacobian: FloatArray, names: Sequence[str]) -> ClassicalQr:
    """QR without pivoting of ``(m, k)``: ``|r_ii| <= k ε max|r_ii|`` is taken for zero.

    Parameters without a row of R of their own (fewer values than parameters) are flagged too.
    """
    diagonal = np.zeros(len(names))
    found = np.abs(np.linalg.qr(jacobian)[1].diagonal())
    diagonal[: len(found)] = found
    tolerance = len(names) * float(np.finfo(np.float64).eps) * float(diagonal.max(initial=0.0))
    flagged = tuple(name for name, r in zip(names, diagonal, strict=True) if r <= tolerance)
    return ClassicalQr(tolerance, flagged)
