"""What a field of a result is to its reader, stated once at the field, and numbers as text.

A field is ``value: Annotated[float, Quantity(label="measured", unit="mm", ...)]``. Its JSON Schema,
the table on a terminal and on a page, and the columns of a spreadsheet and of pandas come from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Literal, TypeVar, get_type_hints

from calib.arrays import FloatArray

R = TypeVar("R")

LEAST_MM = 1e-6
"""What is less than a millionth of a millimetre is arithmetic."""


@dataclass(frozen=True)
class Quantity:
    """``words`` go into the JSON Schema; without a ``label`` there is no column for a reader.

    ``decimals`` are for a ``signed`` number, at least so many for an ``uncertainty`` and for what
    is ``measured``: that has as many as its uncertainty in the same row. ``two-digit`` numbers
    have their own, a ``tolerance`` three at most. A ``probability`` is
    no certainty. ``missing`` stands in place of None.
    """

    label: str | None = None
    unit: str = ""
    kind: Literal[
        "plain", "signed", "measured", "uncertainty", "two-digit", "tolerance", "probability"
    ] = "plain"
    decimals: int | None = None
    words: str = ""
    missing: str = ""

    @property
    def heading(self) -> str:
        """Heading of its column."""
        return ", ".join(filter(None, (self.label, self.unit)))

    def column(self, key: str) -> str:
        """The name of its column for programs, which has the unit once."""
        return key if not self.unit or key.endswith(f"_{self.unit}") else f"{key}_{self.unit}"

    def shown(self, value: object, uncertainty: float | None = None) -> str:
        """The value for a reader, beside the least uncertainty of its row."""
        if not isinstance(value, float):
            return self.missing if value is None else f"{value}"
        least = self.decimals or 0
        if self.kind == "uncertainty":
            return uncertain(value, least)
        if self.kind in ("signed", "measured"):
            apart = self.kind == "measured" and uncertainty is not None
            return signed(value, decimals_for(uncertainty or 0.0, least) if apart else least)
        if words := {"two-digit": figures, "probability": probability_words}.get(self.kind):
            return words(value)
        if self.kind == "tolerance":
            return f"{value:.3g}"
        return f"{value:g}" if self.decimals is None else f"{value:.{least}f}"

    def __get_pydantic_json_schema__(
        self, schema: object, handler: Callable[[object], dict[str, object]]
    ) -> dict[str, object]:
        """The schema of the field with these words."""
        description = {"description": self.words} if self.words else {}
        return handler(schema) | description


INTERNAL = {"exclude": True}
"""Metadata of a field that stays in the program; its type is ``Annotated[…, Internal()]``."""


class Internal:
    """A value that no document has: its type need not be one of JSON."""

    def __get_pydantic_core_schema__(
        self, source: object, handler: Callable[[object], object]
    ) -> dict[str, str]:
        """Anything."""
        return {"type": "any"}


def quantities(kind: type) -> dict[str, Quantity]:
    """Quantities of a data class by field, in order; one that states nothing is a plain value."""
    hints = get_type_hints(kind, include_extras=True)
    extras = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    return {
        field.name: next((e for e in extras[field.name] if isinstance(e, Quantity)), Quantity())
        for field in fields(kind)
    }


def rows(kind: Callable[..., R], names: Iterable[str], *columns: FloatArray) -> dict[str, R]:
    """A row for each name out of columns ``(n,)``."""
    lists = (column.tolist() for column in columns)
    return {name: kind(*row) for name, *row in zip(names, *lists, strict=True)}


def decimals(size: float) -> int:
    """Decimals that show two digits of a size (GUM 7.2.6); of nothing, four."""
    return max(0, 1 - int(f"{size:.1e}".partition("e")[2])) if size > 0.0 else 4


def known_to(value: float, half: float) -> str:
    """A number with its sign, to the second digit of its expanded uncertainty."""
    if half > 0.0:
        value = round(value, 1 - int(f"{half:.1e}".partition("e")[2]))
    return signed(value, decimals(half))


def figures(size: float) -> str:
    """A size to two digits, without an exponent."""
    rounded = float(f"{size:.1e}")
    return f"{rounded:.{decimals(rounded)}f}"


def decimals_for(uncertainty_mm: float, least: int = 3) -> int:
    """Decimals for an uncertainty in mm, at least so many."""
    return max(least, decimals(max(uncertainty_mm, LEAST_MM)))


def uncertain(value_mm: float, least: int = 3) -> str:
    """How sure something is: never rounded to a bare zero, two digits at least."""
    size = max(value_mm, LEAST_MM)
    return f"{size:.{decimals_for(size, least)}f}"


def beside(value_mm: float, limit_mm: float | None) -> str:
    """A value as of `uncertain`, with the decimals that show on which side of a limit it is."""
    text = uncertain(value_mm)
    while limit_mm is not None and (float(text) <= limit_mm) != (value_mm <= limit_mm):
        text = f"{value_mm:.{len(text.partition('.')[2]) + 1}f}"
    return text


def probability_words(probability: float) -> str:
    """A probability: two figures, and no certainty."""
    if probability < 0.005:
        return "< 0.01"
    return f"{probability:.2f}" if probability < 0.995 else "> 0.99"


def signed(value: float, decimals: int = 3) -> str:
    """A number with its sign; zero is never shown as minus zero."""
    return f"{round(value, decimals) + 0.0:+.{decimals}f}"


def round_step(size: float) -> float:
    """1, 2 or 5 of a power of ten, the nearest one below."""
    decade = 10.0 ** math.floor(math.log10(size) + 1e-9)
    factor = max(
        factor_of_decade
        for factor_of_decade in (1.0, 2.0, 5.0)
        if factor_of_decade * decade <= size * (1.0 + 1e-9)
    )
    return float(f"{factor * decade:.6g}")


@dataclass(frozen=True)
class Sizes:
    """Sizes of something missing that can be moved by round ``steps``, at first the ``first`` ones.

    The ``best`` fit the readings, give or take ``deviations``. Both are empty where readings do not
    tell them, and ``why_not`` says why.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    first: tuple[float, ...]
    steps: tuple[float, ...]
    least: tuple[float, ...]
    largest: tuple[float, ...]
    best: tuple[float, ...]
    deviations: tuple[float, ...]
    why_not: str

    def moved(self, values: Sequence[float], number: int, steps: int) -> tuple[float, ...]:
        """The sizes with one moved by so many of its steps, onto a multiple of them, in bounds."""
        step = self.steps[number]
        at = values[number] / step
        near = round(at)
        if not math.isclose(at, near, abs_tol=1e-6):  # between two steps: onto the next one first
            near = math.floor(at) if steps > 0 else math.ceil(at)
        value = min(max((near + steps) * step, self.least[number]), self.largest[number])
        return (*values[:number], float(f"{value:.10g}"), *values[number + 1 :])
