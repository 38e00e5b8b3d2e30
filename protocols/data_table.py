"""Tables to compute with: for pandas, and for files that other programs read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from calib.errors import UsageError

if TYPE_CHECKING:
    from pandas import DataFrame

Cell = str | float | None
"""A whole number is an int, a missing value None."""


@dataclass(frozen=True)
class DataTable:
    """Columns with names that carry their units, and rows ``(n, n_columns)`` in their order."""

    names: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def to_frame(self) -> DataFrame:
        """For pandas. Raises UsageError where that is not installed."""
        try:
            import pandas
        except ImportError as problem:
            raise UsageError(
                "to_frame()",
                "no package pandas",
                "an installation with the extra frames",
                'Install it with: pip install "glidecal[frames]"',
            ) from problem
        return pandas.DataFrame.from_records(list(self.rows), columns=list(self.names))
