"""Did entering the offsets do what was expected, and is the machine good enough now?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from app.evaluating.comparison import Comparison, compare_files
from calib.errors import UsageError
from calib.identify.accuracy import Decision, ToolError, decide

Entered = Literal["as expected", "not entered", "wrong sign", "something else"]


@dataclass(frozen=True)
class LeftOffset:
    """A joint offset before, and what is left; 0 within ``expanded_mm`` (95 %) is expected."""

    name: str
    before_mm: float
    found_mm: float
    expanded_mm: float

    @property
    def entered(self) -> Entered:
        """What must have happened to the value at the controller."""
        guesses: tuple[tuple[float, Entered], ...] = (
            (0.0, "as expected"),
            (self.before_mm, "not entered"),
            (2.0 * self.before_mm, "wrong sign"),
        )
        near = (word for value, word in guesses if abs(self.found_mm - value) <= self.expanded_mm)
        return next(near, "something else")


@dataclass(frozen=True, eq=False)
class Verification:
    """Two sessions, the second with the offsets of the first entered.

    ``decision`` is None where no tolerance is known.
    """

    compared: Comparison
    offsets: tuple[LeftOffset, ...]
    tolerance_mm: float | None
    decision: Decision | None

    @property
    def expected(self) -> ToolError:
        """What the first session promised of the tool with its offsets entered."""
        return self.compared.before.tool_after

    @property
    def found(self) -> ToolError:
        """What the second session says of the tool."""
        return self.compared.after.tool_before

    @property
    def something_missing(self) -> bool:
        """Whether the model leaves more than noise of the second session."""
        return self.compared.after.solution.lacks_fit


def verify_files(before: Path, after: Path, tolerance_mm: float | None = None) -> Verification:
    """Judge the second session by the first; the tolerance is that of its machine if not given.

    Raises as `compare_files`, and UsageError for a tolerance that is no positive length.
    """
    if tolerance_mm is not None and not tolerance_mm > 0.0:
        raise UsageError("--tolerance", f"{tolerance_mm:g} mm", "a positive length in mm")
    compared = compare_files(before, after)
    first, second = compared.before.solution, compared.after.solution
    tolerance = tolerance_mm or compared.after.sessions[0].opened.machine.tool_tolerance_mm
    spread = (first.enlarged_expanded_mm**2 + second.enlarged_expanded_mm**2) ** 0.5
    columns = zip(first.names, first.values_mm, second.values_mm, spread, strict=True)
    offsets = tuple(
        LeftOffset(name, float(was), float(now), float(half)) for name, was, now, half in columns
    )
    after_all = compared.after
    decision = (
        decide(after_all.tool_before, tolerance, after_all.tool_factor) if tolerance else None
    )
    return Verification(compared, offsets, tolerance, decision)
