"""Pictures of legs as a notebook shows them, as text, or on axes of matplotlib."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from app.evaluating.solution import SessionSolution
from app.report.charts.characters import legs_text
from app.report.charts.legs import LegFigure, leg_figures
from calib.errors import check_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BESIDE = 2
"""So many pictures stand in a row."""


def leg_rows(legs: tuple[LegFigure, ...]) -> Iterator[tuple[LegFigure, ...]]:
    """The pictures as they stand beside each other."""
    return (legs[k : k + BESIDE] for k in range(0, len(legs), BESIDE))


@dataclass(frozen=True)
class SessionFigures:
    """A picture for each leg and axis: ``str`` gives characters, a notebook shows SVG."""

    legs: tuple[LegFigure, ...]

    @classmethod
    def of(cls, result: SessionSolution) -> SessionFigures:
        """Figures of a solution."""
        return cls(leg_figures(result))

    def __str__(self) -> str:
        return legs_text(self.legs)

    def _repr_html_(self) -> str:
        """Inline SVG, as Jupyter asks for it. Needs matplotlib."""
        from app.report.pages.figures import legs_svg

        pictures = (legs_svg(row) for row in leg_rows(self.legs))
        return "\n".join(f"<div>{svg[svg.index('<svg') :]}</div>" for svg in pictures)

    def draw(self, number: int, above: Axes, below: Axes) -> None:
        """One of the pictures on two axes: readings, and what is left of them.

        They are numbered from 0; raises UsageError for another number.
        """
        check_number("number of a picture", number, 0, len(self.legs) - 1)
        from app.report.pages.figures import draw_leg

        draw_leg(self.legs[number], above, below)
