"""What the calibration report says: what was measured, found and judged, and what limits it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from rich.table import Table

from app.evaluating.comparison import Verification
from app.evaluating.diagnosis import SessionDiagnosis
from app.evaluating.solution import SessionSolution
from app.report.certificate import CertifiedCalibration
from app.report.charts import results as charts
from app.report.charts.legs import LegFigure, leg_figures
from app.report.charts.tripod import drawn_set_up
from app.report.pages import figures
from app.report.pages.notebook import leg_rows
from app.report.pages.two_pages import (
    CalibrationReport,
    Picture,
    Section,
    calibration_report,
    celsius_words,
    machine_table,
    result_parts,
    second_page,
)
from app.report.text.caveats import taken_word
from app.report.text.correction import FRAME_WORDS, before_or_now, shown_value, value_parts
from app.report.text.diagnosis import diagnosis_parts, headline, shown_candidates
from app.report.text.model import effect_words
from app.report.text.result import (
    DECISION_RULE,
    bound_sentence,
    indicator_words,
    left_out_words,
    verification_parts,
    view_parts,
)
from app.report.text.tables import LEAST_MM, new_table, signed, uncertain
from calib.arrays import LEG_NAMES
from calib.diagnosis.vectors import vector_maps
from calib.identify.solution import Solution
from calib.printable import printable
from protocols.machine import Machine
from protocols.procedure import Step
from protocols.session import Reading, Session

VIEW = "Parameters as the papers identify them"


def report_from(calibration: CertifiedCalibration) -> CalibrationReport:
    """The report of results that are there."""
    result, verified = calibration.result, calibration.verification
    diagnosis = calibration.diagnosed.diagnosis
    has_view = result.view_solution is not None
    legs = leg_figures(result) if has_view else ()
    sections = [
        Section(
            "What was measured",
            [
                _machine(calibration),
                *_sessions(calibration.sessions, calibration.counted),
                *_set_ups(result.sessions[0]),
            ],
        ),
        _controller(calibration),
        _view(result),
        *([_budget(result)] if has_view else []),
        *([_again(verified)] if verified else []),
        Section("What limits this result", calibration.limits),
        _missing(calibration.diagnosed, entered=calibration.verification is not None),
        *([_fit(result), _legs(legs)] if has_view else []),
        _doubted(result, calibration.sessions),
        *map(_readings, calibration.sessions),
    ]
    return calibration_report(
        calibration,
        calibration.machine.name,
        decision=calibration.decision,
        sentences=(
            bound_sentence(
                result.entered, result.frame, calibration.tolerance_mm, entered=verified is not None
            ),
            headline(diagnosis),
        ),
        facts=[(f"{taken_word(result)}s that count", [f"{sum(calibration.counted.values())}"])],
        result=result_parts(calibration),
        second_page=second_page(calibration, legs),
        annex=sections,
    )


def _machine(calibration: CertifiedCalibration) -> Table:
    machine = calibration.machine
    lengths = dict.fromkeys(f"{mm:g}" for mm in machine.geometry().leg_length_mm)
    spread = f"{machine.offset_tolerance_mm:g} and {machine.length_tolerance_mm:g} mm"
    facts = {
        "length of the bars": f"{', '.join(lengths)} mm",
        "travel from Zero": f"{machine.travel_min_mm:+g} … {machine.travel_max_mm:+g} mm",
        "tolerance of joint offsets and lengths (standard deviation)": spread,
    }
    if machine.adjusted:
        facts["mechanical state"] = machine.adjusted
    return machine_table(calibration, facts)


def _sessions(sessions: Sequence[Session], counted: Mapping[str, int]) -> list[Table]:
    """Who measured what, when, how warm and with what; some sessions beside each other."""
    if len(sessions) > BESIDE:
        parts = sessions[:BESIDE], sessions[BESIDE:]
        return [table for part in parts for table in _sessions(part, counted)]
    table = new_table(
        "session", *(record.name for record in sessions), left_columns=1 + len(sessions)
    )
    opened = [session.opened for session in sessions]
    contacts = all(session.of_contacts for session in sessions)
    rows: dict[str, Iterable[str]] = {
        "origin": (record.origin for record in opened),
        "began": (record.measured_words("%Y-%m-%d %H:%M %Z") for record in opened),
        "operator": (record.operator for record in opened),
        "temperature": (celsius_words(record.temperature_c) for record in opened),
        "procedure": (record.procedure.name if record.procedure else "" for record in opened),
        "probe" if contacts else "indicators": (
            "\n".join(map(indicator_words, record.instruments)) for record in opened
        ),
        "measured with": (record.program for record in opened),
        "contacts that count" if contacts else "readings that count": (
            f"{counted[record.digest]} of {len(record.all_readings)}" for record in sessions
        ),
    }
    if any(record.distances for record in sessions):
        rows["distances between marks"] = (f"{len(record.distances)}" for record in sessions)
    rows["SHA-256 of the last line"] = (record.digest for record in sessions)
    for heading, values in rows.items():
        table.add_row(heading, *(value or "not stated" for value in values))
    notes = ["\n".join((*record.opened.remarks, *record.notes)) for record in sessions]
    if any(notes):
        table.add_row("notes", *notes)
    return [table]


def _set_ups(session: Session) -> list[Picture]:
    """The machine with the indicators at each leg, as the first step there was measured."""
    first: dict[str, Step] = {}
    for step in session.steps():
        first.setdefault(step.leg, step)
    pictures = [drawn_set_up(session, step, session.opened.instruments) for step in first.values()]
    drawings = [drawing for drawing in pictures if drawing is not None]
    caption = "Places of the indicators; + is the direction in which readings grow."
    return [Picture(figures.drawings_svg(drawings), caption)] if drawings else []


def _controller(calibration: CertifiedCalibration) -> Section:
    """What is to be entered and what the tool keeps then, with remedies of a model.

    The decision before heads it where the values were entered since.
    """
    result, entered = calibration.result, calibration.verification is not None
    machine, change = calibration.machine, result.printer_change
    sentence = (
        "True position of a joint = believed position + offset. These are the values that glidecal "
        "export writes for a controller with joint offsets, in addition to those entered when it "
        f"was measured. They leave the smallest tool error, {FRAME_WORDS[result.frame]}."
    )
    return Section(
        f"What to enter in the {'firmware' if change else 'controller'}",
        [
            calibration.judged_words if entered else "",
            DECISION_RULE,
            "" if change else sentence,
            *value_parts(result, _offsets(result, machine), entered=entered),
            *([] if change else [_vectors(result, before_or_now(entered))]),
            *(effect_words(effect, machine) for effect in calibration.effects),
        ],
    )


def _offsets(result: SessionSolution, machine: Machine) -> Table:
    """Joint offsets beside those that were entered when it was measured."""
    table = new_table("joint", "entered when measured, mm", "add, mm", "± U (95 %)", "together, mm")
    wide_mm = result.corrections.uncertainties_mm()[1].tolist()
    columns = (
        machine.entered_offsets_mm,
        result.joint_offsets_mm,
        wide_mm,
    )
    for name, now_mm, added, wide in zip(LEG_NAMES, *columns, strict=True):
        now, add, total = map(shown_value, (now_mm, added, now_mm + added))
        table.add_row(name, now, add, uncertain(wide, 4), total)
    return table


def _vectors(result: SessionSolution, when: str) -> Picture:
    """Which way the tool is off without the values entered, ``when`` that is, and with them."""
    correction = result.correction
    states = ((when, correction.off_now), ("with these values entered", correction.off))
    maps = [(label, vector_maps(off, correction.frame)) for label, off in states]
    caption = (
        f"Expected error of the tool, {FRAME_WORDS[correction.frame]}, on three planes through "
        "Zero. All arrows have one scale; colour is the length in space. What may be off in any "
        "direction has no arrow: it is in the bound above."
    )
    return Picture(figures.vectors_svg(maps), caption)


def _view(result: SessionSolution) -> Section:
    """One set of parameters as the papers identify it, with pictures where there is one."""
    if (solution := result.view_solution) is None:
        return Section(VIEW, view_parts(result))
    caption = (
        f"Expected error of the tool with the values of this view, {FRAME_WORDS[result.frame]}, µm "
        "r.m.s., on three planes through Zero."
    )
    maps = Picture(figures.maps_svg(result.tool_maps), caption)
    return Section(VIEW, [*view_parts(result), *_correlations(solution), maps])


def _correlations(solution: Solution) -> Iterator[Picture]:
    """How much one parameter could stand for another, where there are two."""
    if solution.correlation is not None and len(solution.names) > 1:
        caption = (
            "Correlations of the parameters. Near 1 or −1 the readings show only the difference "
            "or the sum of the two."
        )
        yield Picture(figures.correlations_svg(solution.names, solution.correlation), caption)


def _budget(result: SessionSolution) -> Section:
    """What the uncertainties of the view are made of."""
    solution = result.solution
    sources = solution.budget_mm
    together, inflated = solution.expanded_with_tolerances_mm, solution.inflated_expanded_mm
    of_values = new_table("± in mm (95 %)", *sources, "± U together", "if what is left is noise")
    columns = (*sources.values(), together, inflated)
    for name, *row in zip(solution.names, *(column.tolist() for column in columns), strict=True):
        of_values.add_row(name, *(uncertain(mm, 4) if mm > LEAST_MM else "0" for mm in row))
    sentence = (
        "The sources are independent; U is the root of the sum of their squares. The last column "
        "is for the case that what the parameters leave is noise. The bound at the tool is not "
        "made of these: it is over everything that may be true of the machine."
    )
    shares = Picture(
        figures.pareto_svg(result.budget),
        "Sources of the uncertainty of these parameters, the largest first. The line is their "
        "share of the square of U so far. U of the values to enter is another one.",
    )
    return Section("Uncertainty budget of these parameters", [sentence, of_values, shares])


def _again(verification: Verification) -> Section:
    """What the session after the offsets were entered says."""
    compared = verification.compared
    chart = charts.before_and_after(compared.before.solution, compared.after.solution)
    caption = f"Each difference before and after the offsets were entered{WHISKER_WORDS}"
    return Section(
        "Measured again, with the offsets entered",
        [*verification_parts(verification), Picture(figures.bars_svg(chart), caption)],
    )


def _missing(diagnosed: SessionDiagnosis, *, entered: bool) -> Section:
    """The diagnosis, with pictures of what each candidate and what the names leave.

    Values may be ``entered`` since.
    """
    diagnosis = diagnosed.diagnosis
    pictures = [
        Picture(
            figures.svg_of(charts.residuals_before_and_after(diagnosis.residuals.cells)),
            "Mean residual of each posture; grey: twice its noise.",
        )
    ]
    if bars := [
        (printable(f"{c.id} ({c.where})"), 1000.0 * c.gap_rms_after_mm, not c.reason_rejected)
        for c in shown_candidates(diagnosis)
    ]:
        caption = (
            "Evidence: what each candidate leaves of the gap. The shorter its bar, the more the "
            "readings speak for it; it is named where nothing else explains them as well."
        )
        gap_um = 1000.0 * diagnosis.gap_before.rms_mm
        pictures.insert(0, Picture(figures.evidence_svg(bars, gap_um), caption))
    parts = diagnosis_parts(diagnosed, entered=entered)
    return Section("What is missing from the model", [*parts, *pictures])


def _fit(result: SessionSolution) -> Section:
    """What the model makes of the readings."""
    caption = f"Differences as measured, and what the model leaves of them{WHISKER_WORDS}"
    bars = Picture(figures.bars_svg(charts.measured_and_predicted(result.solution)), caption)
    parts = [bars]
    if (over_time := charts.residuals_over_time(result)).series:
        parts.append(Picture(figures.svg_of(over_time), "Residuals over time: drift shows here."))
    caption = (
        "Residuals in the order of their size. On the line they are normal with the noise of the "
        "readings; steeper is more than noise; a point far from the others is an outlier."
    )
    parts.append(Picture(figures.svg_of(charts.residuals_over_normal(result)), caption))
    return Section("Differences", parts)


def _legs(legs: tuple[LegFigure, ...]) -> Section:
    """Each leg and axis over its travel."""
    sentence = (
        "Readings over the displacement, the fit of offsets and lengths as a line, and below, "
        "enlarged, what it leaves. A thin line joins the readings in time. All have the same "
        "scales. Play is a split between the directions, a tilt a slope, a screw a wave, a bow a "
        "parabola."
    )
    rows = leg_rows(legs)
    pictures = [Picture(figures.legs_svg(row), "; ".join(leg.title for leg in row)) for row in rows]
    return Section("Each leg over its travel", [sentence, *pictures])


def _doubted(result: SessionSolution, sessions: Sequence[Session]) -> Section:
    """Readings that were questioned, superseded or do not fit their repeats; steps left out."""
    suspects = {
        (suspect.session, suspect.reading.reading): suspect.studentised
        for suspect in result.suspects
    }
    table = new_table("session", "no.", "at", "value, mm", "", left_columns=3)
    lines = []
    for session in sessions:
        for reading in session.all_readings:
            why = [_state(session, reading)]
            if (off := suspects.get((session.name, reading.reading))) is not None:
                why.append(f"{signed(off, 1)} standard deviations from its repeats")
            if reasons := "; ".join(filter(None, why)):
                of = (session.name, f"{reading.reading}", reading.place_words)
                table.add_row(*of, signed(reading.value_mm, 4), reasons)
        lines += [f"{session.name}: {reasons}" for reasons in left_out_words(session)]
    fallback = "No reading was questioned or superseded, and all fit their repeats."
    return Section(
        "Questioned and superseded readings", [*lines, table if table.rows else fallback]
    )


def _readings(session: Session) -> Section:
    """Every reading that was taken, those that do not count too; those of one posture in a row."""
    readings = session.all_readings
    axes = sorted({reading.axis for reading in readings})
    values = [f"{axis}, mm" for axis in axes]
    table = new_table(
        "no.", "mounting", "at", "station", *values, "time, min", "°C", "", left_columns=3
    )
    several = len({reading.station for reading in readings}) > 1
    rows: list[tuple[tuple[str, ...], dict[str, Reading]]] = []
    for reading in readings:
        state = (
            reading.place_words,
            f"{reading.station:g}" if several else "",
            f"{reading.cycle}",
            "" if reading.time_s is None else f"{reading.time_s / 60.0:.1f}",
            "" if reading.temperature_c is None else f"{reading.temperature_c:g}",
            _state(session, reading),
        )
        if not rows or rows[-1][0] != state or reading.axis in rows[-1][1]:
            rows.append((state, {}))
        rows[-1][1][reading.axis] = reading
    for (place, station, _, *more_places), by_axis in rows:
        numbers = ", ".join(f"{reading.reading}" for reading in by_axis.values())
        mounts = ", ".join(dict.fromkeys(reading.mount for reading in by_axis.values()))
        texts = [signed(by_axis[axis].value_mm, 4) if axis in by_axis else "" for axis in axes]
        table.add_row(numbers, mounts, place, station, *texts, *more_places)
    return Section(
        f"{'Contacts' if session.of_contacts else 'Readings'} of {session.name}", [table]
    )


def _state(session: Session, reading: Reading) -> str:
    if reading.reading in session.superseded:
        return f"not used: {session.superseded[reading.reading]}"
    if reading.reading in session.restored:
        return f"used again: {session.restored[reading.reading]}"
    return ""


BESIDE = 3
"""So many sessions stand beside each other in a table."""

WHISKER_WORDS = "; below, on a scale of its own. Whiskers: twice the standard uncertainty."
