"""The calibration report: what was measured, found, judged and limits it; its figures; its page."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import resources
from io import StringIO
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib as mpl
from jinja2 import Environment, StrictUndefined, Template
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import RenderableType
from rich.table import Table

from app.evaluating.comparison import Verification, verify_files
from app.evaluating.diagnosis import SessionDiagnosis, diagnose_files
from app.evaluating.solution import SessionSolution, judge, maps, solve_files
from app.report.charts.charts import (
    NOISE,
    Chart,
    Drawing,
    Series,
    StrokeStyle,
    before_and_after,
    measured_and_predicted,
    residuals_before_and_after,
    residuals_over_time,
)
from app.report.charts.tripod import drawn_set_up
from app.report.text.caveats import bound_made_of, caveats
from app.report.text.diagnosis import candidates_table, effects_text, gap_text
from app.report.text.result import (
    decided,
    difference_table,
    indicator_words,
    judged_text,
    noise_words,
    offsets_table,
    parameter_table,
    size_table,
    subset_table,
    verdict_words,
    what_to_do,
)
from app.report.text.tables import new_table, signed, uncertain
from app.version import program
from calib.errors import UsageError
from calib.printable import printable
from calib.tripod.workspace import PlaneMap
from protocols.files import check_targets, write_files
from protocols.procedure import Step
from protocols.record import read_record
from protocols.session import Reading, Session


@dataclass(frozen=True)
class Picture:
    """A picture as SVG, with the sentence below it."""

    svg: str
    caption: str


@dataclass(frozen=True)
class Section:
    """A heading with what stands below it, in this order."""

    heading: str
    sentences: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Picture] = ()


@dataclass(frozen=True)
class CalibrationReport:
    """``decision`` against the tolerance is empty where none is known."""

    machine: str
    decision: str
    sentences: Sequence[str]
    sections: Sequence[Section]
    program: str


def report_of(
    paths: Sequence[Path],
    *,
    model: Path | None = None,
    after: Path | None = None,
    tolerance_mm: float | None = None,
) -> CalibrationReport:
    """The report of sessions, with what a later one says of the offsets of the last.

    Raises as `solve_files`, `diagnose_files` and `verify_files`.
    """
    solved, warnings = solve_files(paths, model=model)
    diagnosed = diagnose_files(paths, model=model)
    verified = verify_files(paths[-1], after, tolerance_mm) if after else None
    machine = solved.sessions[0].opened.machine
    tolerance = tolerance_mm or machine.tool_tolerance_mm
    judged = " ".join(judged_text(judge(solved, tolerance)).split()) if tolerance else ""
    found = diagnosed.diagnosis
    everything = [solved, *([verified.compared.after] if verified else [])]
    names = [name for one in everything for name in one.names]
    sessions = [session for one in everything for session in one.sessions]
    remarks = [f"Remark: {remark}" for remark in found.remarks]
    sections = [
        Section(
            "What was measured",
            tables=[_sessions(names, sessions), _digests([*paths, *([after] if after else [])])],
            figures=_set_ups(solved.sessions[0]),
        ),
        _result(solved, judged),
        _budget(solved),
        *([_again(verified)] if verified else []),
        Section("What limits this result", [*warnings, *caveats(solved), *remarks]),
        _missing(diagnosed),
        _fit(solved),
    ]
    return CalibrationReport(
        machine=machine.name,
        decision=decided(verified) if verified else judged,
        sentences=(
            f"{verdict_words(solved)} {bound_made_of(solved)}",
            f"{found.verdict.upper()}. {found.sentence}",
        ),
        sections=[*sections, *map(_readings, names, sessions)],
        program=program(),
    )


def _sessions(names: Sequence[str], sessions: Sequence[Session]) -> Table:
    """Who measured what, when, how warm and with what."""
    table = new_table("", *names, left=1 + len(names))
    opened = [session.opened for session in sessions]
    rows: dict[str, list[str]] = {
        "machine": [one.machine.name for one in opened],
        "origin": [one.origin for one in opened],
        "began": [f"{one.at:%Y-%m-%d %H:%M %Z}" for one in opened],
        "operator": [one.operator for one in opened],
        "temperature": [
            "" if one.temperature_c is None else f"{one.temperature_c:g} °C" for one in opened
        ],
        "procedure": [one.procedure.name if one.procedure else "" for one in opened],
        "indicators": ["\n".join(map(indicator_words, one.instruments)) for one in opened],
        "measured with": [one.program for one in opened],
        "readings that count": [f"{len(one.readings)}" for one in sessions],
        "notes": ["\n".join((*one.opened.remarks, *one.notes)) for one in sessions],
    }
    for heading, values in rows.items():
        if any(values):
            table.add_row(heading, *(value or "not stated" for value in values))
    return table


def _digests(files: Sequence[Path]) -> Table:
    """As `glidecal validate` tells them."""
    table = new_table("file", "digest of its last line (SHA-256)", left=2)
    for path in files:
        table.add_row(path.name, read_record(path).digest)
    return table


def _result(solved: SessionSolution, judged: str) -> Section:
    solution = solved.solution
    tables = [parameter_table(solution), subset_table(solved)]
    if solution.sizes:
        tables.insert(1, size_table(solution))
    caption = (
        "Expected error of the tool with these values, µm r.m.s., on three planes through Zero."
    )
    return Section(
        "Result",
        [judged, DECISION_RULE if judged else "", noise_words(solution)],
        tables,
        [Picture(maps_svg(maps(solved)), caption)],
    )


def _budget(solved: SessionSolution) -> Section:
    """What the uncertainties are made of."""
    solution, bound = solved.solution, solved.bound_after
    parts = ("noise and steps", "noise and what is left", "noise and parts")
    of_values = new_table("± in mm (95 %)", *parts)
    columns = (
        solution.expanded_mm,
        solution.enlarged_expanded_mm,
        solution.expanded_with_tolerances_mm,
    )
    for name, *row in zip(solution.names, *(one.tolist() for one in columns), strict=True):
        of_values.add_row(name, *map(uncertain, row))
    of_tool = new_table("bound at the tool with these values, mm r.m.s.", "")
    of_tool.add_row("noise of the readings alone", uncertain(solved.bound_of_noise_mm))
    of_tool.add_row("and parts within tolerance", uncertain(bound.parameters_mm))
    for one in bound.names[:MOST_OPEN]:
        of_tool.add_row(f"and {one.title} ({one.id}, {one.where})", uncertain(one.bound_mm))
    return Section("Uncertainty budget", [BUDGET_WORDS], [of_values, of_tool])


def _set_ups(session: Session) -> list[Picture]:
    """The machine with the indicators at each leg, as the first step there was measured."""
    first: dict[str, Step] = {}
    for step in session.steps():
        first.setdefault(step.leg, step)
    drawn = [drawn_set_up(session, step, session.opened.instruments) for step in first.values()]
    shown = [one for one in drawn if one is not None]
    caption = "Where the indicators stood; + is where readings grow."
    return [Picture(drawings_svg(shown), caption)] if shown else []


def _again(verified: Verification) -> Section:
    """What the session after the offsets were entered says."""
    compared = verified.compared
    chart = before_and_after(compared.before.solution, compared.after.solution)
    return Section(
        "Measured again, with the offsets entered",
        [decided(verified), *what_to_do(verified), *compared.remarks],
        [offsets_table(verified)],
        [Picture(svg_of(chart), "Each difference before and after the offsets were entered.")],
    )


def _missing(diagnosed: SessionDiagnosis) -> Section:
    """The diagnosis: where readings and model disagree, and which effects explain it."""
    found = diagnosed.diagnosis
    caption = "Mean residual of each posture; grey: twice its noise."
    return Section(
        "What is missing from the model",
        [gap_text(found), effects_text(found.effects)],
        [candidates_table(found.candidates)] if found.candidates else [],
        [Picture(svg_of(residuals_before_and_after(found.residuals.cells)), caption)],
    )


def _fit(solved: SessionSolution) -> Section:
    """What the model makes of the readings."""
    figures = [
        Picture(
            svg_of(measured_and_predicted(solved.solution)),
            "Differences as measured, and what the model leaves of them.",
        )
    ]
    if (over_time := residuals_over_time(solved)).series:
        figures.append(Picture(svg_of(over_time), "Residuals over time: drift shows here."))
    return Section("Differences", tables=[difference_table(solved.solution)], figures=figures)


def _readings(name: str, session: Session) -> Section:
    """Every reading that was taken, those that do not count too."""
    table = new_table("no.", "mounting", "at", "value, mm", "min", "°C", "remark", left=3)
    for reading in session.all_readings:
        table.add_row(
            f"{reading.reading}",
            reading.mount,
            reading.place_words,
            signed(reading.value_mm, 4),
            "" if reading.time_s is None else f"{reading.time_s / 60.0:.1f}",
            "" if reading.temperature_c is None else f"{reading.temperature_c:g}",
            _state(session, reading),
        )
    return Section(f"Readings of {name}", tables=[table])


def _state(session: Session, reading: Reading) -> str:
    if reading.reading in session.superseded:
        return f"does not count: {session.superseded[reading.reading]}"
    if reading.reading in session.restored:
        return f"counts again: {session.restored[reading.reading]}"
    return ""


DECISION_RULE = (
    "Decision rule (ISO 14253-1): passed where the bound, which 95 of 100 such machines keep, is "
    "within the tolerance; failed where the error that is shown exceeds it by more than its "
    "expanded uncertainty (95 %); undecided in between."
)
BUDGET_WORDS = (
    "Noise holds the steps of the display. To it comes, each by itself, what the model leaves if "
    "that is taken for noise, and what parts within tolerance do. At the tool each effect stands "
    "by itself with noise and parts: the bound is the largest line."
)
MOST_OPEN = 8

STYLE: dict[Any, Any] = {
    "svg.hashsalt": "glidecal",  # names inside the file by its contents, not by chance
    "svg.fonttype": "path",  # looks alike where the fonts are others
    "text.parse_math": False,
    "font.size": 8.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.9",
}
COLOURS = ("#1b6ca8", "#c8501e", "#3a7d44", "#7a4fa0", "#8a6d1d", "#555555")
MARKERS = "osD^vP"
"""A series is told by its marker where a printer has no colours."""

WIDTH_IN, HEIGHT_IN = 6.6, 2.6
MARGINS = {"left": 0.09, "right": 0.99, "bottom": 0.18, "top": 0.87, "wspace": 0.3}
BAR = 0.22

DARKEST = 1.8
"""The colours end so far above the largest error: digits stay readable on all of them."""

WHOLE_UM = 20.0
"""From this size on tenths of a micrometre are not worth a digit."""


def svg_of(chart: Chart) -> str:
    """A chart of series; bars where the places have names and a series one value at each."""
    with _figure(WIDTH_IN, HEIGHT_IN) as ((axes,), out):
        shown = [series for series in chart.series if series.name != NOISE]
        for series in chart.series:
            if series.name == NOISE:
                _band(axes, series)
        barred = all(len(series.x) <= len(chart.x_names) for series in shown)
        for number, series in enumerate(shown):
            colour = COLOURS[number % len(COLOURS)]
            if barred:
                axes.bar(series.x, series.y, BAR, label=series.name, color=colour)
            else:
                marker = MARKERS[number % len(MARKERS)]
                axes.plot(series.x, series.y, marker, ms=3, label=series.name, color=colour)
        axes.axhline(0.0, color="0.4", lw=0.6)
        for mark in chart.marks:
            axes.axvline(mark, color="0.4", lw=0.6, ls="--")
        axes.set(xlabel=chart.x_words, ylabel=chart.y_words)
        if chart.x_names:
            axes.set_xticks(chart.x_ticks(), chart.x_names)
            axes.grid(visible=False, axis="x")
        axes.legend(frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return out.getvalue()


def _band(axes: Axes, series: Series) -> None:
    """Noise: a grey field at each place, as wide as its points."""
    points = sorted(zip(series.x, series.y, strict=True))
    for _, some in groupby(points, key=lambda point: round(point[0])):
        x, y = zip(*some, strict=True)
        axes.fill_between((min(x), max(x)), min(y), max(y), color="0.88", lw=0)


def maps_svg(maps: Sequence[PlaneMap]) -> str:
    """Planes of the workspace beside each other, the error of the tool in µm as colour and digits.

    All have one scale, from 0. A dash stands where the tool does not reach.
    """
    told = [v for one in maps for row in one.value.tolist() for v in row if math.isfinite(v)]
    most_um = 1000.0 * max(told)
    decimals = 0 if most_um >= WHOLE_UM else 1
    with _figure(WIDTH_IN, WIDTH_IN / len(maps), len(maps)) as (every, out):
        for axes, one in zip(every, maps, strict=True):
            grid = [[1000.0 * value for value in row] for row in one.value.tolist()]
            axes.pcolormesh(
                one.coordinate_mm, one.up_mm, grid, cmap="YlOrRd", vmin=0.0, vmax=DARKEST * most_um
            )
            for up_mm, row in zip(one.up_mm.tolist(), grid, strict=True):
                for across_mm, value in zip(one.coordinate_mm.tolist(), row, strict=True):
                    shown = f"{value:.{decimals}f}" if math.isfinite(value) else "–"
                    axes.text(across_mm, up_mm, shown, ha="center", va="center", size=6)
            axes.grid(visible=False)
            axes.set(xlabel=f"{one.across}, mm", ylabel=f"{one.up}, mm", aspect="equal")
    return out.getvalue()


STROKES: dict[StrokeStyle, dict[str, Any]] = {
    StrokeStyle.DOTTED: {"lw": 0.7, "ls": ":", "color": "0.4"},
    StrokeStyle.THIN: {"lw": 0.7, "color": "0.3"},
    StrokeStyle.THICK: {"lw": 2.2, "color": "0.1"},
    StrokeStyle.MARKED: {"lw": 0.7, "color": "0.1", "marker": "o", "ms": 2},
    StrokeStyle.BEADED: {"lw": 1.6, "color": COLOURS[1], "marker": "o", "ms": 2},
}


def drawings_svg(drawings: Sequence[Drawing]) -> str:
    """Pictures without scales beside each other."""
    with _figure(WIDTH_IN, WIDTH_IN / max(3, len(drawings)), len(drawings)) as (every, out):
        for axes, one in zip(every, drawings, strict=True):
            for stroke in one.strokes:
                axes.plot(*zip(*stroke.points, strict=True), **STROKES[stroke.style])
            for label in one.labels:
                ground = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
                axes.text(*label.at, label.words, ha="center", va="center", size=7, bbox=ground)
            axes.set_axis_off()
            axes.set_aspect("equal")
            axes.set_title(one.title, size=7)
    return out.getvalue()


@contextmanager
def _figure(
    width_in: float, height_in: float, columns: int = 1
) -> Iterator[tuple[list[Axes], StringIO]]:
    """Axes to draw on, beside each other; the SVG is there once they are done."""
    out = StringIO()
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width_in, height_in))
        figure.subplots_adjust(**MARGINS)  # a layout worked out would draw everything twice
        yield [figure.add_subplot(1, columns, 1 + k) for k in range(columns)], out
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})


PDF_NEEDS = (
    "the system's library Pango (Debian: libpangoft2-1.0-0); or write .html and print that "
    "from a browser"
)


def html_of(report: CalibrationReport) -> str:
    """One page without a script or anything from elsewhere; texts of strangers are inert."""
    return _template().render(report=report)


@cache
def _template() -> Template:
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, finalize=_shown, keep_trailing_newline=True
    )
    environment.filters |= {"svg": _drawing, "cells": _cells}
    text = resources.files("app.report.pages").joinpath("report.html").read_text(encoding="utf-8")
    return environment.from_string(text)


def _shown(value: object) -> object:
    """Hidden characters are shown, as everywhere."""
    return (
        printable(value, keep="\n")
        if isinstance(value, str) and not isinstance(value, Markup)
        else value
    )


def _cells(table: Table) -> list[tuple[RenderableType, ...]]:
    """Rows of a table."""
    return list(zip(*(column.cells for column in table.columns), strict=True))


def _drawing(svg: str) -> Markup:
    """The element alone; it is ours, and the texts in it are paths."""
    return Markup(svg[svg.index("<svg") :])


def pdf_of(html: str) -> bytes:
    """The page printed. Raises UsageError where the library cannot be loaded."""
    # fontTools writes the time into the fonts that it cuts down, unless this tells it one
    os.environ.setdefault("SOURCE_DATE_EPOCH", "0")
    try:
        from weasyprint import HTML
    except OSError as problem:  # not ImportError: it looks for the library as it is imported
        raise UsageError("a report as PDF", "no library to print it", PDF_NEEDS) from problem
    printed: bytes = HTML(string=html).write_pdf()
    return printed


def write_report(
    sessions: Sequence[Path],
    output: Path,
    model: Path | None = None,
    after: Path | None = None,
    *,
    tolerance_mm: float | None = None,
    replace: bool = False,
) -> Path:
    """Write the report of session files to a path that ends with ``.html`` or ``.pdf``.

    Raises UsageError for another ending, and as `report_of` and `write_files`.
    """
    if output.suffix not in (".html", ".pdf"):
        raise UsageError("--output", f"{output}", "a path that ends with .html or .pdf")
    check_targets([output], replace=replace)  # before long work
    html = html_of(report_of(sessions, model=model, after=after, tolerance_mm=tolerance_mm))
    written = pdf_of(html) if output.suffix == ".pdf" else html
    return write_files(output, {"": written}, replace=replace)[0]
