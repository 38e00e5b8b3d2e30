"""The report on a session of postures, in the frame of that on readings of legs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from app.evaluating.hexaslide_calibration import CalibratedMachine, VerifiedMachine
from app.evaluating.posture_history import Decision
from app.report.certificate import NOT_JUDGED, CertificateHead
from app.report.charts.hexaslide import drawn_machine, residual_charts
from app.report.hexaslide_certificate import CertifiedPostures, certified_postures
from app.report.pages.contents import CalibrationReport
from app.report.pages.figures import drawings_svg, svg_of
from app.report.pages.report import ReportSource
from app.report.pages.two_pages import (
    SIMULATED,
    Picture,
    Section,
    add_facts,
    celsius_words,
    ordered_rows,
    shortened,
    shortened_limits,
    traceability,
)
from app.report.schema.hexaslide import HexaSlideCalibrationReport
from app.report.text.hexaslide_calibration import (
    check_words,
    figure_lines,
    is_shown_better,
    left_parts,
    off_words,
    parameter_table,
    verification_lines,
)
from app.report.text.hexaslide_diagnosis import missing_parts, verdict_line
from app.report.text.hexaslide_session import readings_table, remark_lines
from app.report.text.tables import new_table, signed
from app.version import program
from calib.hexaslide.procedures import COMPONENTS
from protocols.dates import day_words
from protocols.hexaslide import Chain, HexaSlideMachine, machine_like
from protocols.hexaslide_session import PostureSession

if TYPE_CHECKING:  # of a digital certificate alone
    from app.report.dcc.document import CertificateContents

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
NOT_VERIFIED = (
    "No session after the calibrated machine was entered belongs to this document. The error of "
    "the platform with it is predicted from the readings, not measured."
)
LONGEST = 400
"""Letters of a sentence on the pages that are signed: seven motions of frames have room."""


def source_of_postures(
    path: Path,
    later_path: Path | None = None,
    tolerance_mm: float | None = None,
    head: CertificateHead | None = None,
) -> ReportSource:
    """The report of a session, with what a later one says of the machine that was entered.

    Raises as `certified_postures`.
    """
    return source_from(certified_postures(path, later_path, tolerance_mm, head))


def source_from(certified: CertifiedPostures) -> ReportSource:
    """The report of results that are there."""

    def certificate() -> CertificateContents:
        from app.report.dcc.hexaslide import contents_of

        return contents_of(certified)

    return ReportSource(
        certified.digests, certified.terms, lambda: report_page(certified), certificate
    )


def report_page(certified: CertifiedPostures) -> CalibrationReport:
    """The report of results that are there."""
    result, later, limits = certified.result, certified.later, certified.limits
    calibration = result.calibration
    document = HexaSlideCalibrationReport.of(calibration)
    calibrated = machine_like(calibration.source.machine, "", calibration.entered)
    enter = ENTER if is_shown_better(document) else KEEP
    entered = later is not None
    errors = _errors(document, entered=entered)
    simulated = any(session.opened.origin == "simulated" for session, _ in certified.sessions)
    return CalibrationReport(
        machine=calibration.source.machine.full_name,
        decision=_decision(certified),
        sentences=(_at_most(document, entered=entered), verdict_line(result)),
        first_page=[
            Section("", [_object(certified), SIMULATED if simulated else ""]),
            Section("Traceability", _traceability(certified)),
            Section("Result", [errors, RULE, enter, *_moved(calibration, calibrated)]),
        ],
        second_page=[
            Section("Entered and verified", _verified(later.verification if later else None)),
            Section("What is left at each posture", _charts(calibration)),
            Section("Limits of this result", shortened_limits(limits, LONGEST)),
        ],
        sections=[
            Section(
                "What was measured",
                [_machine(calibration.source.machine, certified.tolerance_mm), _drawn(calibration)],
            ),
            Section("What to enter in the controller", [enter, _values(calibration, calibrated)]),
            Section(
                "Parameters",
                [parameter_table(document), *figure_lines(document, calibration.fit.factor)],
            ),
            Section("What limits this result", limits),
            Section("What is missing from the model", missing_parts(result)),
            Section(
                "What the calibrated machine leaves",
                [
                    *left_parts(document),
                    check_words(HexaSlideCalibrationReport.of(result.checked)),
                ],
            ),
            *(_readings(session) for session, _ in certified.sessions),
        ],
        program=program(),
        identification=certified.identification,
        head=certified.head,
    )


def _readings(session: PostureSession) -> Section:
    heading = f"Readings of {session.name}"
    return Section(heading, [*remark_lines(session), readings_table(session)])


def _decision(certified: CertifiedPostures) -> str:
    """The decision that heads the report: after a verification that of the later session."""
    if certified.later is not None:
        verified, label = certified.later.verification, "measured again"
        return _judged(verified.decision, verified.after, verified.tolerance_mm, label)
    label = "as it was measured"
    return _judged(certified.decision, certified.calibration, certified.tolerance_mm, label)


def _judged(
    decision: Decision | None, result: CalibratedMachine, tolerance_mm: float | None, when: str
) -> str:
    if decision is None:
        return NOT_JUDGED.format("platform_tolerance_mm")
    return f"{decision.upper()}, {when}: {off_words(result, tolerance_mm)}"


def _at_most(document: HexaSlideCalibrationReport, *, entered: bool) -> str:
    """What the platform keeps with the calibrated machine; ``entered``: it was measured since."""
    bound_mm = document.platform.bound_rms_mm
    if bound_mm is None:
        return "What the platform is off by with the calibrated machine is not known."
    begin = "Predicted with the calibrated machine:" if entered else "With the calibrated machine"
    return f"{begin} the platform is off by at most {bound_mm:.3g} mm (95 %)."


def _object(certified: CertifiedPostures) -> Table:
    """The machine, the customer, and the sessions that were measured."""
    opened = [session.opened for session, _ in certified.sessions]
    counts = (f"{len(session.readings)}" for session, _ in certified.sessions)
    table = new_table("object", shortened(opened[0].machine.full_name), left_columns=2)
    rows: list[tuple[str, Iterable[str | None]]] = [
        *ordered_rows(certified.head, certified.serial_numbers),
        ("measured", dict.fromkeys(day_words(s.opened, s.readings) for s, _ in certified.sessions)),
        ("operator", dict.fromkeys(start.operator for start in opened)),
        ("temperature", dict.fromkeys(celsius_words(start.temperature_c) for start in opened)),
        ("procedure", dict.fromkeys(start.procedure.name for start in opened)),
        ("postures used", counts),
        ("origin", dict.fromkeys(start.origin for start in opened)),
        ("machine file", dict.fromkeys(start.machine_file for start in opened)),
        ("measured with", dict.fromkeys(start.program for start in opened)),
    ]
    add_facts(
        table, rows, [(session.name, record.digest) for session, record in certified.sessions]
    )
    return table


def _traceability(certified: CertifiedPostures) -> list[str | Table]:
    """Certificates of the instruments that the order names, and what was attached."""
    instruments = certified.head.order.instrument if certified.head else ()
    attached = certified.result.session.opened.procedure.attach
    return [
        *traceability(instruments, "instrument"),
        f"Attached: {shortened(attached, LONGEST) or 'not stated.'}",
    ]


def _errors(document: HexaSlideCalibrationReport, *, entered: bool) -> Table:
    """What the platform is off by, now, or before it was ``entered``, and calibrated."""
    platform = document.platform
    when = "before" if entered else "now"
    table = new_table("error of the platform over the box, mm", when, "calibrated, 95 % bound")
    bound = "not known" if platform.bound_rms_mm is None else f"{platform.bound_rms_mm:.3g}"
    table.add_row("r.m.s.", f"{platform.now_rms_mm:.3g}", bound)
    table.add_row("worst", f"{platform.now_worst_mm:.3g}", "")
    return table


def _moved(result: CalibratedMachine, calibrated: HexaSlideMachine) -> Iterator[str | Table]:
    """By how much each chain of the calibrated machine differs from its file."""
    table = new_table("chain", "start, mm", "joint, mm", "link, mm", "rail, mrad")
    for number, was, now in _chains(result, calibrated):
        mrad = f"{1000.0 * math.dist(was.rail, now.rail):.3f}" if was.rail and now.rail else ""
        table.add_row(
            number,
            f"{math.dist(was.start_mm, now.start_mm):.3f}",
            f"{math.dist(was.joint_mm, now.joint_mm):.3f}",
            signed(now.link_mm - was.link_mm),
            mrad,
        )
    yield "Distances between the values of the machine file and the calibrated ones:"
    yield table


def _chains(
    result: CalibratedMachine, calibrated: HexaSlideMachine
) -> Iterator[tuple[str, Chain, Chain]]:
    """Number, chain of the machine file and calibrated chain."""
    pairs = zip(result.source.machine.chain, calibrated.chain, strict=True)
    for number, (was, now) in enumerate(pairs, start=1):
        yield f"{number}", was, now


def _values(result: CalibratedMachine, calibrated: HexaSlideMachine) -> Table:
    """Every value of the machine file beside the calibrated one."""
    table = new_table("chain", "key", "machine file", "calibrated", "change", left_columns=2)

    def add(place: str, key: str, was: Sequence[float], now: Sequence[float], digits: int) -> None:
        axes = "xyz" if len(was) > 1 else ("",)
        for axis, first, second in zip(axes, was, now, strict=True):
            figures = (signed(value, digits) for value in (first, second, second - first))
            table.add_row(place, f"{key} {axis}".rstrip(), *figures)

    for number, was, now in _chains(result, calibrated):
        add(number, "start_mm", was.start_mm, now.start_mm, 4)
        add(number, "joint_mm", was.joint_mm, now.joint_mm, 4)
        if was.rail and now.rail:
            add(number, "rail", was.rail, now.rail, 7)
        add(number, "link_mm", (was.link_mm,), (now.link_mm,), 4)
    ends, ends_now = result.source.machine.constraint_link, calibrated.constraint_link
    if ends is not None and ends_now is not None and ends != ends_now:
        add("link", "platform_end_mm", ends.platform_end_mm, ends_now.platform_end_mm, 4)
        add("link", "base_end_mm", ends.base_end_mm, ends_now.base_end_mm, 4)
        add("link", "length_mm", (ends.length_mm,), (ends_now.length_mm,), 4)
    return table


def _verified(verification: VerifiedMachine | None) -> list[str]:
    """What a later session says of the machine that was entered."""
    if verification is None:
        return [NOT_VERIFIED]
    decision, sentence, *next_lines = verification_lines(verification)
    return [decision, f"{sentence} Session: {verification.after.name}.", *next_lines]


def _drawn(result: CalibratedMachine) -> Picture:
    machine = result.source.machine.whole()
    caption = "The machine at the middle of its box"
    if not machine.geometry.telescopic:
        caption += "; dotted: rails, as far as the sliders go there"
    return Picture(drawings_svg(drawn_machine(machine, machine.box.centre)), f"{caption}.")


def _charts(result: CalibratedMachine) -> list[Picture]:
    caption = "Measured less predicted with the calibrated machine, by posture."
    return [Picture(svg_of(chart), caption) for chart in residual_charts(result)]


def _machine(machine: HexaSlideMachine, tolerance_mm: float | None) -> Table:
    """What was known of it before; tolerances of parts are standard deviations."""
    table = new_table("machine", machine.name, left_columns=2)
    box = machine.box
    for axis in "xyz":
        low, high = getattr(box, f"{axis}_mm")
        table.add_row(f"box, {axis}", f"{low:g} … {high:g} mm")
    for angle in COMPONENTS[3:]:
        low, high = getattr(box, f"{angle}_deg")
        table.add_row(f"box, {angle}", f"{low:g} … {high:g}°")
    tolerances = machine.tolerances
    spread = f"{tolerances.start_mm:g}, {tolerances.joint_mm:g} and {tolerances.link_mm:g} mm"
    table.add_row("tolerance of starts, joints and links (standard deviation)", spread)
    platform = "not stated" if tolerance_mm is None else f"{tolerance_mm:g} mm r.m.s."
    table.add_row("tolerance of the platform", platform)
    return table
