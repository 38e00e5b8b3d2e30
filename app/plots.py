"""What the plots show: series of points, computed apart from any screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.leg_table import leg_rows
from calib.solution import Solution
from protocols.procedure import Step
from protocols.session import Session


@dataclass(frozen=True)
class Series:
    """Points of one kind; ``names`` label the places of ``x`` where they are not lengths."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True)
class Chart:
    """One plot: series over one horizontal axis with the words beside it."""

    title: str
    x_words: str
    y_words: str
    series: tuple[Series, ...]
    x_names: tuple[str, ...] = ()


def readings_by_posture(session: Session, step: Step) -> Chart:
    """Readings of a leg minus the Zero of their cycle over the displacement, one series an axis."""
    series = []
    for axis in step.axes:
        rows = [row for row in leg_rows(session, step) if row.axis == axis]
        points = [point for row in rows for point in row.minus_zero_mm.items()]
        series.append(_series(f"along {axis.upper()}", points))
    title = f"leg {step.leg.upper()}: readings minus Zero"
    return Chart(title, "displacement, mm", "mm", tuple(s for s in series if s.x))


def measured_and_predicted(solution: Solution) -> Chart:
    """The differences as measured, and what the model leaves of them."""
    rows = list(solution.differences.published_rows)
    left = solution.differences.value_mm - solution.predicted_mm
    return Chart(
        "differences",
        "",
        "mm",
        (
            _numbered("measured", [float(solution.differences.value_mm[k]) for k in rows]),
            _numbered("left by the model", [float(left[k]) for k in rows]),
        ),
        tuple(solution.differences.names[k] for k in rows),
    )


def before_and_after(before: Solution, after: Solution) -> Chart:
    """The differences before and after the offsets were entered."""
    later = dict(zip(after.differences.names, after.differences.value_mm, strict=True))
    rows = [k for k in before.differences.published_rows if before.differences.names[k] in later]
    names = tuple(before.differences.names[k] for k in rows)
    return Chart(
        "before and after",
        "",
        "mm",
        (
            _numbered("before", [float(before.differences.value_mm[k]) for k in rows]),
            _numbered("after", [float(later[name]) for name in names]),
        ),
        names,
    )


def _series(name: str, points: Sequence[tuple[float, float]]) -> Series:
    return Series(name, tuple(x for x, _ in points), tuple(y for _, y in points))


def _numbered(name: str, values: Sequence[float]) -> Series:
    return Series(name, tuple(float(k) for k in range(1, len(values) + 1)), tuple(values))
