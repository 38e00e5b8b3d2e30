"""The calibration report: what was measured, found, judged, and what limits it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from app.evaluating.comparison import Verification, verify_files
from app.evaluating.diagnosis import SessionDiagnosis, diagnose_files
from app.evaluating.solution import SessionSolution, judge, maps, solve_files
from app.report.charts.charts import (
    before_and_after,
    measured_and_predicted,
    residuals_before_and_after,
    residuals_over_time,
)
from app.report.pages.figures import maps_svg, svg_of
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
from app.report.text.tables import new_table, signed
from app.version import program
from protocols.record import read_record
from protocols.session import Reading, Session


@dataclass(frozen=True)
class Figure:
    """A picture as SVG, with the sentence below it."""

    svg: str
    caption: str


@dataclass(frozen=True)
class Section:
    """A heading with what stands below it, in this order."""

    heading: str
    sentences: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()


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
    judged = judged_text(judge(solved, tolerance)) if tolerance else ""
    found = diagnosed.diagnosis
    everything = [solved, *([verified.compared.after] if verified else [])]
    names = [name for one in everything for name in one.names]
    sessions = [session for one in everything for session in one.sessions]
    remarks = [f"Remark: {remark}" for remark in found.remarks]
    sections = [
        Section(
            "What was measured",
            tables=[_sessions(names, sessions), _digests([*paths, *([after] if after else [])])],
        ),
        _result(solved, judged),
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
        "Result", [judged, noise_words(solution)], tables, [Figure(maps_svg(maps(solved)), caption)]
    )


def _again(verified: Verification) -> Section:
    """What the session after the offsets were entered says."""
    compared = verified.compared
    chart = before_and_after(compared.before.solution, compared.after.solution)
    return Section(
        "Measured again, with the offsets entered",
        [decided(verified), *what_to_do(verified), *compared.remarks],
        [offsets_table(verified)],
        [Figure(svg_of(chart), "Each difference before and after the offsets were entered.")],
    )


def _missing(diagnosed: SessionDiagnosis) -> Section:
    """The diagnosis: where readings and model disagree, and which effects explain it."""
    found = diagnosed.diagnosis
    caption = "Mean residual of each posture; grey: twice its noise."
    return Section(
        "What is missing from the model",
        [gap_text(found), effects_text(found.effects)],
        [candidates_table(found.candidates)] if found.candidates else [],
        [Figure(svg_of(residuals_before_and_after(found.residuals.cells)), caption)],
    )


def _fit(solved: SessionSolution) -> Section:
    """What the model makes of the readings."""
    figures = [
        Figure(
            svg_of(measured_and_predicted(solved.solution)),
            "Differences as measured, and what the model leaves of them.",
        )
    ]
    if (over_time := residuals_over_time(solved)).series:
        figures.append(Figure(svg_of(over_time), "Residuals over time: drift shows here."))
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
