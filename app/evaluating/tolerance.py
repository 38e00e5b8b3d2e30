"""What a tolerance may be, for every kind of machine."""

from __future__ import annotations

from calib.errors import UsageError


def check_tolerance(tolerance_mm: float | None) -> None:
    """Raises UsageError for one that is stated and no positive length."""
    if tolerance_mm is not None and not tolerance_mm > 0.0:
        raise UsageError("--tolerance", f"{tolerance_mm:g} mm", "a positive length in mm")
