"""The report on a session of postures, in the frame of that on readings of legs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from rich.table import Table

from app.evaluating.hexaslide import PostureResult
from app.report.certificate import NOT_JUDGED, CertificateHead
from app.report.charts.hexaslide import drawn_machine, residual_charts
from app.report.dcc.hexaslide import results_of
from app.report.hexaslide_certificate import CertifiedPostures, certified_postures, machine_numbers
from app.report.pages.figures import drawings_svg, svg_of
from app.report.pages.report import ReportSource
from app.report.pages.two_pages import (
    LONGEST_OF_POSTURES,
    CalibrationReport,
    Fact,
    Picture,
    Section,
    calibration_report,
    machine_table,
    not_verified_words,
    shortened_limits,
)
from app.report.schema.hexaslide import HexaSlideCalibrationReport
from app.report.text.hexaslide_calibration import (
    check_words,
    is_shown_better,
    left_parts,
    off_words,
    parameter_parts,
    verification_lines,
)
from app.report.text.hexaslide_diagnosis import missing_parts, verdict_line
from app.report.text.hexaslide_session import readings_table, remark_lines
from app.report.text.tables import new_table, signed
from calib.hexaslide.procedures import COMPONENTS
from protocols.hexaslide import HexaSlideMachine
from protocols.hexaslide_session import PostureSession

RULE = (
    "Pass: the error of the platform and its 95 % bound together are within the tolerance, and no "
    "more is left of the readings than noise. Fail: the error less its bound exceeds the "
    "tolerance. Otherwise undecided."
)
ENTER = (
    "Enter the calibrated machine: the file that glidecal export --format model writes, or with "
    "--format linuxcnc-kins what LinuxCNC takes. All its values are in the annex."
)
KEEP = (
    "Change nothing in the controller: the readings do not show that the calibrated machine is "
    "better than the machine file."
)


def source_of_postures(
    path: Path,
    later_path: Path | None = None,
    tolerance_mm: float | None = None,
    head: CertificateHead | None = None,
    result: PostureResult | None = None,
) -> ReportSource:
    """The report of a session, with what a later one says of the machine that was entered.

    The ``result`` of the session may be there already. Raises as `certified_postures`.
    """
    certified = certified_postures(path, later_path, tolerance_mm, head, result)
    return ReportSource(certified, partial(report_page, certified), partial(results_of, certified))


def report_page(certified: CertifiedPostures) -> CalibrationReport:
    """The report of results that are there."""
    result, document, machine = certified.result, certified.document, certified.machine
    calibration, limits = result.calibration, certified.limits
    opened = [session.opened for session in certified.sessions]
    enter = ENTER if is_shown_better(document) else KEEP
    entered = certified.verification is not None
    caption = "Measured less predicted with the calibrated machine, by posture."
    pictures = [Picture(svg_of(chart), caption) for chart in residual_charts(calibration)]
    facts: list[Fact] = [
        ("postures used", (f"{len(session.readings)}" for session in certified.sessions)),
        ("origin", dict.fromkeys(start.origin for start in opened)),
        ("machine file", dict.fromkeys(start.machine_file for start in opened)),
        ("measured with", dict.fromkeys(start.program for start in opened)),
    ]
    return calibration_report(
        certified,
        machine.full_name,
        decision=_decision(certified),
        sentences=(_at_most(document, entered=entered), verdict_line(result)),
        facts=facts,
        result=[_errors(document, entered=entered), RULE, enter, *_moved(certified)],
        second_page=[
            Section("Entered and verified", _verified(certified)),
            Section("What is left at each posture", pictures),
            Section("Limits of this result", shortened_limits(limits, LONGEST_OF_POSTURES)),
        ],
        annex=[
            Section("What was measured", [_machine(certified), _drawn(machine)]),
            Section("What to enter in the controller", [enter, _values(certified)]),
            Section("Parameters", parameter_parts(document, calibration.fit.factor)),
            Section("What limits this result", limits),
            Section("What is missing from the model", missing_parts(result)),
            Section(
                "What the calibrated machine leaves",
                [*left_parts(document), check_words(HexaSlideCalibrationReport.of(result.checked))],
            ),
            *map(_readings, certified.sessions),
        ],
    )


def _readings(session: PostureSession) -> Section:
    heading = f"Readings of {session.name}"
    return Section(heading, [*remark_lines(session), readings_table(session)])


def _decision(certified: CertifiedPostures) -> str:
    """The decision that heads the report: after a verification that of the later session."""
    verified = certified.verification
    decision, result, when = certified.decision, certified.result.calibration, "as it was measured"
    if verified:
        decision, result, when = verified.decision, verified.after, "measured again"
    if decision is None:
        return NOT_JUDGED.format("platform_tolerance_mm")
    return f"{decision.upper()}, {when}: {off_words(result, certified.tolerance_mm)}"


def _at_most(document: HexaSlideCalibrationReport, *, entered: bool) -> str:
    """What the platform keeps with the calibrated machine; ``entered``: it was measured since."""
    bound_mm = document.platform.bound_rms_mm
    if bound_mm is None:
        return "What the platform is off by with the calibrated machine is not known."
    begin = "Predicted with the calibrated machine:" if entered else "With the calibrated machine"
    return f"{begin} the platform is off by at most {bound_mm:.3g} mm (95 %)."


def _errors(document: HexaSlideCalibrationReport, *, entered: bool) -> Table:
    """What the platform is off by, now, or before it was ``entered``, and calibrated."""
    platform = document.platform
    when = "before" if entered else "now"
    table = new_table("error of the platform over the box, mm", when, "calibrated, 95 % bound")
    bound = "not known" if platform.bound_rms_mm is None else f"{platform.bound_rms_mm:.3g}"
    table.add_row("r.m.s.", f"{platform.now_rms_mm:.3g}", bound)
    table.add_row("worst", f"{platform.now_worst_mm:.3g}", "")
    return table


def _moved(certified: CertifiedPostures) -> Iterator[str | Table]:
    """By how much each chain of the calibrated machine differs from its file."""
    table = new_table("chain", "start, mm", "joint, mm", "link, mm", "rail, mrad")
    chains = certified.machine.chain, certified.calibrated.chain
    for number, (was, now) in enumerate(zip(*chains, strict=True), start=1):
        mrad = f"{1000.0 * math.dist(was.rail, now.rail):.3f}" if was.rail and now.rail else ""
        table.add_row(
            f"{number}",
            f"{math.dist(was.start_mm, now.start_mm):.3f}",
            f"{math.dist(was.joint_mm, now.joint_mm):.3f}",
            signed(now.link_mm - was.link_mm),
            mrad,
        )
    yield "Distances between the values of the machine file and the calibrated ones:"
    yield table


def _values(certified: CertifiedPostures) -> Table:
    """Every value of the machine file beside the calibrated one."""
    machine, calibrated = certified.machine, certified.calibrated
    linked = machine.constraint_link != calibrated.constraint_link
    table = new_table("part", "key", "machine file", "calibrated", "change", left_columns=2)
    pairs = zip(machine_numbers(machine), machine_numbers(calibrated), strict=True)
    for (part, key, was), (_, _, now) in pairs:
        digits = 7 if key.startswith("rail") else 4
        if part.startswith("chain") or linked:
            table.add_row(part, key, *(signed(value, digits) for value in (was, now, now - was)))
    return table


def _verified(certified: CertifiedPostures) -> list[str]:
    """What a later session says of the machine that was entered."""
    if (verification := certified.verification) is None:
        return [not_verified_words(certified)]
    decision, sentence, *next_lines = verification_lines(verification)
    return [decision, f"{sentence} Session: {verification.after.name}.", *next_lines]


def _drawn(machine_file: HexaSlideMachine) -> Picture:
    machine = machine_file.whole()
    caption = "The machine at the middle of its box"
    if not machine.geometry.telescopic:
        caption += "; dotted: rails, as far as the sliders go there"
    return Picture(drawings_svg(drawn_machine(machine, machine.box.centre)), f"{caption}.")


def _machine(certified: CertifiedPostures) -> Table:
    box, tolerances = certified.machine.box, certified.machine.tolerances
    facts = {}
    for axis in "xyz":
        low, high = getattr(box, f"{axis}_mm")
        facts[f"box, {axis}"] = f"{low:g} … {high:g} mm"
    for angle in COMPONENTS[3:]:
        low, high = getattr(box, f"{angle}_deg")
        facts[f"box, {angle}"] = f"{low:g} … {high:g}°"
    facts["tolerance of starts, joints and links (standard deviation)"] = (
        f"{tolerances.start_mm:g}, {tolerances.joint_mm:g} and {tolerances.link_mm:g} mm"
    )
    return machine_table(certified, facts)
