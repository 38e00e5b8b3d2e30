"""Whether a tool is within its tolerance."""

from __future__ import annotations

from typing import Literal

Decision = Literal["pass", "fail", "undecided"]


def decide(least_mm: float, bound_mm: float, tolerance_mm: float) -> Decision:
    """Pass where the 95 % bound is within the tolerance, fail where the least error exceeds it.

    ``least_mm`` is what is expected less its expanded uncertainty: the guard band of ISO 14253-1.
    """
    if bound_mm <= tolerance_mm:
        return "pass"
    return "fail" if least_mm > tolerance_mm else "undecided"
