"""Residuals before and after adopting as a chart."""

from __future__ import annotations

from collections.abc import Sequence

from app.diagnosis_residuals import SEEN, Cell
from app.plots import Chart, Series

HALF = 0.36
"""The displacements of one mounting stand so far to the left and right of its name."""

EDGE = 0.45
"""Where the noise of a mounting is marked, clear of its displacements."""

BESIDE = 0.03


def residuals_before_and_after(cells: Sequence[Cell]) -> Chart:
    """Mean residuals in µm of each mounting, its displacements from left to right, and the noise.

    The noise is drawn at two standard deviations of a mean, on both sides of zero.
    """
    stations = {cell.station for cell in cells}
    mounts = sorted({_mount(cell) for cell in cells})
    places = {mount: float(k) for k, mount in enumerate(mounts, start=1)}
    names = tuple(mount_name(*mount, stations=len(stations)) for mount in mounts)
    adopted = any(cell.after_mm is not None for cell in cells)
    aside = BESIDE if adopted else 0.0
    series = [_noise(cells, places), _residuals("before", cells, places, -aside)]
    if adopted:
        series.append(_residuals("after adopting", cells, places, aside, after=True))
    words = "displacement from left to right"
    return Chart("Mean residual", words, "µm", tuple(series), names)


def mount_name(leg: str, axis: str, station: float, *, stations: int) -> str:
    """A mounting in a few letters; the station, in percent, only where there are several."""
    if stations > 1:
        return f"{leg}{axis}{100.0 * station:.0f}"
    return f"{leg.upper()} along {axis.upper()}"


def _mount(cell: Cell) -> tuple[str, str, float]:
    return cell.leg, cell.axis, cell.station


def _residuals(
    name: str,
    cells: Sequence[Cell],
    places: dict[tuple[str, str, float], float],
    aside: float,
    *,
    after: bool = False,
) -> Series:
    reach = max(abs(cell.displacement_mm) for cell in cells) or 1.0
    x, y = [], []
    for cell in cells:
        value_mm = cell.after_mm if after else cell.before_mm
        if value_mm is not None:
            x.append(places[_mount(cell)] + HALF * cell.displacement_mm / reach + aside)
            y.append(1000.0 * value_mm)
    return Series(name, tuple(x), tuple(y))


def _noise(cells: Sequence[Cell], places: dict[tuple[str, str, float], float]) -> Series:
    x: list[float] = []
    y: list[float] = []
    for mount, place in places.items():
        floor = SEEN * 1000.0 * max(cell.noise_mm for cell in cells if _mount(cell) == mount)
        for side in (-EDGE, EDGE):
            x += [place + side, place + side]
            y += [-floor, floor]
    return Series("noise", tuple(x), tuple(y))
