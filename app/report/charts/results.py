"""What the plots of results show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from app.evaluating.solution import SessionSolution
from app.measuring.leg_review import leg_rows
from app.report.charts.charts import NOISE, Chart, Point, Series, Stroke, StrokeStyle, series_of
from app.report.charts.legs import left_by
from app.report.text.tables import difference_words
from calib.arrays import FloatArray
from calib.diagnosis.results import SEEN, Cell
from calib.identify.solution import Solution
from calib.printable import with_capital
from protocols.procedure import Step
from protocols.session import Session

ASIDE = 0.12
"""Two series over the same names stand so far to the left and right of each name."""


def readings_by_posture(session: Session, step: Step) -> Chart:
    """Readings of a leg minus the Zero of their cycle over the displacement, one series an axis.

    Those of the tool over the number of the position.
    """
    series = []
    for axis in step.axes:
        rows = [row for row in leg_rows(session, step) if row.axis == axis]
        points = [point for row in rows for point in row.minus_zero_mm.items()]
        series.append(series_of(f"along {axis.upper()}", points))
    quantity = "far end minus near end" if step.over_plane else "readings minus Zero"
    title = f"{with_capital(step.touched)}: {quantity}"
    x_words = "number of the position" if step.leg == "tool" else "displacement, mm"
    return Chart(title, x_words, "mm", tuple(s for s in series if s.x))


def measured_and_predicted(solution: Solution) -> Chart:
    """The differences as measured, and what the model leaves of them."""
    rows, names = _published(solution)
    measured_mm, u_mm = solution.differences.value_mm, solution.difference_uncertainty_mm[rows]
    left_mm = solution.left_mm[rows]
    return _differences(names, ("measured", measured_mm[rows], u_mm), ("residual", left_mm, u_mm))


def predictions_with(without: Solution, now: Solution) -> Chart:
    """The differences as measured, and as predicted without an effect and with it."""
    rows, names = _published(now)
    values = (now.differences.value_mm, without.predicted_mm, now.predicted_mm)
    series = zip(("measured", "without", "with it"), values, strict=True)
    return _differences(names, *((name, column[rows]) for name, column in series))


def residuals_with(without: Solution, now: Solution) -> Chart:
    """What is left of the differences without an effect and with it, µm.

    The scale has room for as much with the other sign: that is left at twice the size that fits.
    """
    rows, names = _published(now)
    before_um, now_um = (1000.0 * solution.left_mm[rows] for solution in (without, now))
    chart = _differences(names, ("without", before_um), ("with it", now_um))
    room = tuple((-before_um).tolist())
    return replace(chart, title="Left of the differences", y_words="µm", room=room)


def before_and_after(earlier: Solution, later: Solution) -> Chart:
    """The differences before and after the offsets were entered."""
    differences, differences_after = earlier.differences, later.differences
    row_after = {name: k for k, name in enumerate(differences_after.names)}
    rows = [k for k in differences.published_rows if differences.names[k] in row_after]
    names = [differences.names[k] for k in rows]
    partners = [row_after[name] for name in names]
    return _differences(
        names,
        ("before", differences.value_mm[rows], earlier.difference_uncertainty_mm[rows]),
        ("after", differences_after.value_mm[partners], later.difference_uncertainty_mm[partners]),
    )


def _published(solution: Solution) -> tuple[list[int], list[str]]:
    """Rows and names of the (up to) twelve differences."""
    rows = list(solution.differences.published_rows)
    return rows, [solution.differences.names[k] for k in rows]


def _differences(
    names: Sequence[str],
    *named_columns: tuple[str, FloatArray] | tuple[str, FloatArray, FloatArray],
) -> Chart:
    """Two or three series over the same names, beside each other so that none hides another.

    Each with its values and their standard uncertainties, none where nobody shows them.
    """
    series = []
    for k, (name, *columns) in enumerate(named_columns):
        aside = (2 * k + 1 - len(named_columns)) * ASIDE
        x = tuple(place + aside for place in range(1, len(names) + 1))
        series.append(Series(name, x, *(tuple(column.tolist()) for column in columns)))
    labels = tuple(map(difference_words, names))
    if labels == tuple(names):
        return Chart("Differences", "", "mm", tuple(series), labels)
    legs = tuple(name.partition(",")[0] for name in labels)
    return Chart("Differences: leg along axis", "", "mm", tuple(series), labels, x_groups=legs)


HALF = 0.36
"""The displacements of one mounting stand so far to the left and right of its name."""

EDGE = 0.45
"""Where the noise of a mounting is marked, clear of its displacements."""

BESIDE = 0.03


def residuals_before_and_after(cells: Sequence[Cell]) -> Chart:
    """Mean residuals in µm of each mounting, its displacements from left to right, and the noise.

    The noise is drawn at two standard deviations of a mean, on both sides of zero.
    """
    set_ups = sorted({_set_up(cell) for cell in cells})
    several = len({station for _, _, station in set_ups}) > 1
    names = tuple(
        f"{leg}{axis}{100.0 * station:.0f}" if several else f"{leg.upper()} along {axis.upper()}"
        for leg, axis, station in set_ups
    )
    places = {set_up: float(k) for k, set_up in enumerate(set_ups, start=1)}
    noise: list[Point] = []
    for set_up, place in places.items():
        floor = SEEN * 1000.0 * max(cell.noise_mm for cell in cells if _set_up(cell) == set_up)
        noise += [(place + side, y) for side in (-EDGE, EDGE) for y in (-floor, floor)]
    adopted = any(cell.after_mm is not None for cell in cells)
    aside = BESIDE if adopted else 0.0
    points_before: list[Point] = []
    points_after: list[Point] = []
    for cell, part in zip(cells, _parts(cells), strict=True):
        x = places[_set_up(cell)] + HALF * part
        points_before.append((x - aside, 1000.0 * cell.before_mm))
        if cell.after_mm is not None:
            points_after.append((x + aside, 1000.0 * cell.after_mm))
    series = [series_of(NOISE, noise), series_of("before", points_before)]
    if adopted:
        series.append(series_of("after adopting", points_after))
    of_tool = any(cell.position_mm for cell in cells)
    label = f"{'positions' if of_tool else 'displacement'} from left to right"
    return Chart("Mean residual", label, "µm", tuple(series), names)


def _set_up(cell: Cell) -> tuple[str, str, float]:
    return cell.leg, cell.axis, cell.station


def _parts(cells: Sequence[Cell]) -> list[float]:
    """How far each stands from the middle of its mounting, as a share."""
    reach = max(abs(cell.displacement_mm) for cell in cells) or 1.0
    positions = sorted({cell.position_mm for cell in cells if cell.position_mm})
    middle = (len(positions) - 1) / 2.0
    return [
        (positions.index(cell.position_mm) - middle) / middle
        if cell.position_mm and middle
        else cell.displacement_mm / reach
        for cell in cells
    ]


def residuals_over_time(result: SessionSolution) -> Chart:
    """What the model leaves of each reading over the time of its session: drift shows here."""
    several = len(result.sessions) > 1
    points: dict[str, list[Point]] = {}
    for session, reading, residual_mm in result.residuals:
        if reading.time_s is not None:
            leg = reading.leg if reading.leg == "tool" else f"leg {reading.leg.upper()}"
            name = f"{leg} along {reading.axis.upper()}"
            if several:
                name = f"session {1 + result.names.index(session)}"
            points.setdefault(name, []).append((reading.time_s / 60.0, 1000.0 * residual_mm))
    series = tuple(series_of(name, points_of_name) for name, points_of_name in points.items())
    return Chart("Residuals", "minutes", "residual, µm", series)


def residuals_over_normal(result: SessionSolution) -> Chart:
    """Residuals in the order of their size against those of a normal distribution.

    On the line, in µm, lie normal ones with the noise of the readings.
    """
    left_mm, scores = (values.tolist() for values in result.left_over_normal)
    left_um = tuple(1000.0 * mm for mm in left_mm)
    noise_um = 1000.0 * result.noise.standard_deviation_mm
    line = tuple((score, noise_um * score) for score in (min(scores), max(scores)))
    residuals = Series(left_by(result), tuple(scores), left_um)
    return Chart(
        "Residuals against the normal distribution",
        "standard deviations of a normal distribution",
        "residual, µm",
        (residuals,),
        strokes=(Stroke(StrokeStyle.THIN, line),),
    )
