"""What the result screen of a session of postures says, and that of a cause of some size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from app.evaluating.hexaslide import PostureResult
from app.evaluating.hexaslide_calibration import decided
from app.report.charts.bars import now_and_after
from app.report.schema.hexaslide import HexaSlideCalibrationReport
from app.report.text.hexaslide_calibration import (
    caveats,
    check_words,
    is_shown_better,
    left_parts,
    off_words,
    parameter_parts,
)
from app.report.text.hexaslide_diagnosis import missing_parts, title_of, verdict_line
from app.report.text.hexaslide_session import readings_parts, remark_lines
from app.report.text.tables import new_table, paragraphs, table_text
from calib.errors import GlidecalError
from calib.hexaslide.what_if import CauseAtSize

LOOKING = "Working out the machine …"
NO_RESULT = "This session gives no machine."
WHICH_REPORT = "Write the report as"
ENDINGS = (".html", ".pdf")
REPORT_WRITTEN = "Report written: {}"


def heading_text(path: Path, result: PostureResult | None) -> str:
    """Which session this is."""
    if result is None:
        return path.name
    opened = result.session.opened
    return f"{path.name}   {opened.machine.full_name}, {opened.procedure.name}, {opened.origin}"


def problem_text(problem: GlidecalError) -> str:
    """Why there is no result."""
    return paragraphs(f"{NO_RESULT} {problem}")


def glance_text(result: PostureResult, columns: int, *, read_only: bool, folder: str = "") -> str:
    """The decision, the platform now and then, what is entered, what no reading shows, what next.

    ``folder`` is that with the calibrated machine, empty before.
    """
    calibration = result.calibration
    document = HexaSlideCalibrationReport.of(calibration)
    tolerance_mm = calibration.source.machine.platform_tolerance_mm
    decision = "NOT JUDGED" if tolerance_mm is None else decided(calibration, tolerance_mm).upper()
    platform, count = document.platform, len(document.individually_known)
    bound_text = "after is not known" if platform.bound_rms_mm is None else "after: at most (95 %)"
    bars = now_and_after(platform.now_rms_mm, platform.bound_rms_mm, tolerance_mm, columns)
    files = f"{folder} has" if folder else "{postures.export} writes"
    return paragraphs(
        f"{decision}: {off_words(calibration, tolerance_mm)}"
        f"{NO_TOLERANCE if tolerance_mm is None else ''}\n{verdict_line(result)}",
        [f"Platform error, r.m.s. over the box; {bound_text}:", *bars],
        f"{document.parameter_count} parameters are entered: {files} them as files, page Details "
        f"has the {count} that are known alone.",
        "\n".join(caveats(document)),
        "" if read_only else next_text(document, folder),
    )


NO_TOLERANCE = " State platform_tolerance_mm in the machine file, and it is judged."


def next_text(document: HexaSlideCalibrationReport, folder: str) -> str:
    """What to do next; nothing is entered that is not shown to be better."""
    if not is_shown_better(document):
        return "Next: change nothing in the controller; {postures.report} writes the report."
    if not folder:
        return (
            "Next: {postures.export} writes the calibrated machine, {postures.report} the report."
        )
    return (
        f"Next: enter the calibrated machine from {folder} in the controller, then measure "
        "postures again with its machine.toml; {postures.report} writes the report."
    )


def details_text(result: PostureResult) -> str:
    """Parameters, and what is known only together."""
    document = HexaSlideCalibrationReport.of(result.calibration)
    return paragraphs(*parameter_parts(document, result.calibration.fit.factor))


def left_text(result: PostureResult) -> str:
    """What the calibrated machine leaves, and the check on postures that were kept out."""
    parts = left_parts(HexaSlideCalibrationReport.of(result.calibration))
    return paragraphs(*parts, check_words(HexaSlideCalibrationReport.of(result.checked)))


def missing_text(result: PostureResult) -> str:
    """The diagnosis, or why there is none."""
    return paragraphs(*missing_parts(result))


def readings_text(result: PostureResult) -> str:
    """Every reading, those that do not count with the reason."""
    remarks = "\n".join(remark_lines(result.session))
    return paragraphs(result.record.unfinished, *readings_parts(result.session), remarks)


def exported_text(paths: Sequence[Path]) -> str:
    """Where the calibrated machine is."""
    return f"Written to {paths[0].parent}: {', '.join(path.name for path in paths)}."


WHICH_CAUSE = "Which cause?"


def cause_words(name: tuple[str, str], weight: float) -> str:
    """A line of the list of causes."""
    return f"{title_of(name)}, {100.0 * weight:.0f} %"


def what_if_heading(name: tuple[str, str], path: Path) -> str:
    """What is tried, on which readings."""
    return f"What if {title_of(name)}   {path.name}"


def what_if_text(nominal: CauseAtSize, now: CauseAtSize) -> str:
    """Residuals and platform, without the cause and with it."""
    table = new_table("", "without", "with it")
    pair = nominal, now
    table.add_row("readings left, times the noise", *(f"{entry.times_noise:.2f}" for entry in pair))
    table.add_row("chance of so much by noise", *(f"{entry.p_value:.2g}" for entry in pair))
    table.add_row("platform, cause not compensated, mm r.m.s.", "0", _mm(now.alone_m))
    table.add_row("platform, values without it entered, mm r.m.s.", "0", _mm(now.misled_m))
    return table_text(table)


def _mm(size_m: float) -> str:
    return f"{1000.0 * size_m:.4f}"
