"""What a tolerance may be, for every kind of machine."""

from __future__ import annotations

from calib.errors import check_number

LEAST_MM, LARGEST_MM = 1e-9, 100.0
"""As in a machine file."""

ALLOWED = f"a positive length in mm, up to {LARGEST_MM:g}"


def check_tolerance(tolerance_mm: float | None) -> None:
    """Raises UsageError for one that is stated and no positive length."""
    if tolerance_mm is not None:
        check_number("--tolerance", tolerance_mm, LEAST_MM, LARGEST_MM, "mm", ALLOWED)
