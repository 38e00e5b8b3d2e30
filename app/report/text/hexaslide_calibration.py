"""A calibrated Hexa Slide in words and tables."""

from __future__ import annotations

import math
from decimal import Decimal
from typing import TypeVar

from rich.table import Table

from app.evaluating.hexaslide_calibration import CalibratedMachine, VerifiedMachine
from app.report.schema.hexaslide import HexaSlideCalibrationReport, Rms
from app.report.text.hexaslide_diagnosis import beside_words, size_tables
from app.report.text.tables import new_table, paragraphs, signed
from calib.hexaslide.procedures import ProcedureKind
from calib.stats import UNLIKELY
from protocols.hexaslide import HexaSlideMeasurements

Number = TypeVar("Number", float, Decimal)

MOST_POSTURES = 5

MOST_DIGITS = 15
"""Of figures beside a tolerance."""

THOUSANDTHS = {"m": "mm", "m/m": "mm/m", "rad": "mrad"}

LEFT_WORDS = {
    ProcedureKind.POSE_INVERSE: "Sliders, read less predicted",
    ProcedureKind.POSE_FORWARD: "Measured less predicted",
    ProcedureKind.POSITION: "Measured less predicted",
    ProcedureKind.CONSTRAINT_LINK: "Length of the link, and what is measured, less predicted",
}


def simulated_text(measured: HexaSlideMeasurements) -> str:
    """What was written."""
    return (
        f"{len(measured.postures)} simulated postures of {measured.machine.name}, "
        f"{measured.procedure.value}"
    )


def calibration_text(result: CalibratedMachine) -> str:
    """The sentences that matter, parameters, what is left, then the checks."""
    document = HexaSlideCalibrationReport.of(result)  # words and JSON tell the same numbers
    linked = document.procedure is ProcedureKind.CONSTRAINT_LINK
    sliders = "sliders on the constraint link" if linked else "sliders"
    verdict = (
        f"{document.rank} of {document.parameter_count} combinations of the parameters identified "
        f"from {document.postures.fitted} postures in {document.steps} steps.",
        f"{LEFT_WORDS[document.procedure]}, r.m.s.: "
        f"{_both(document.rms_before, document.rms_after)}.",
    )
    return paragraphs(
        f"{document.measurements}: {document.machine} ({document.machine_file}), "
        f"{document.procedure.value}, {document.postures.count} {document.origin} postures; read: "
        f"{', '.join([sliders, *document.measured])}",
        beside_words(result.adopted),
        *size_tables(result.sizes),
        "\n".join([*verdict, platform_text(document), *caveats(document)]),
        *parameter_parts(document, result.fit.factor),
        *left_parts(document),
        "\n".join([check_words(document), *_truth(document)]),
    )


def check_words(document: HexaSlideCalibrationReport) -> str:
    """What postures that were kept out say of the result."""
    if document.held_out is None:
        return "No posture was kept out of the fit as a check."
    count, total = len(document.postures.held_out), document.postures.count
    both_words = _both(document.held_out.rms_before, document.held_out.rms_after)
    return (
        f"Check on {count} of {total} postures ({100.0 * count / total:.0f} %), kept out of "
        f"the fit: {both_words} r.m.s., noise of measuring included. Values and bound above are "
        "of these postures, too."
    )


def verification_text(verification: VerifiedMachine) -> str:
    """The decision, what it rests on, and what to do."""
    return paragraphs("\n".join(verification_lines(verification)))


def verification_lines(verification: VerifiedMachine) -> list[str]:
    """The decision, what the platform was off by before, then what to do."""
    was_mm = 1000.0 * verification.before.platform.now.places_rms_m
    decision, off = "NOT JUDGED", off_words(verification.after, verification.tolerance_mm)
    if verification.decision is not None:
        decision = verification.decision.upper()
    else:
        off += " There is no --tolerance, and no platform_tolerance_mm in the machine file."
    return [f"{decision}: {off}", f"Before: {was_mm:.3g} mm r.m.s.", *_next_lines(verification)]


def off_words(result: CalibratedMachine, tolerance_mm: float | None) -> str:
    """What the platform is off by as it was measured, beside the tolerance."""
    off_mm, bound_m = 1000.0 * result.platform.now.places_rms_m, result.platform.bound_m
    off, bound = f"{off_mm:.3g}", "an unknown amount"
    if bound_m is not None:
        off, bound_mm = deciding_figures(off_mm, 1000.0 * bound_m, tolerance_mm)
        bound = f"{bound_mm} mm"
    tolerance = f"; tolerance {tolerance_mm:.10g} mm" if tolerance_mm else ""
    return (
        f"the platform is off by {off} mm r.m.s. over the box, give or take {bound}"
        f" (95 %){tolerance}."
    )


def deciding_figures(off_mm: float, bound_mm: float, tolerance_mm: float | None) -> tuple[str, str]:
    """Both with so many digits that their sum and difference are on the side of the tolerance that
    was decided.
    """
    limit_mm = math.inf if tolerance_mm is None else tolerance_mm
    decided, limit = _sides(off_mm, bound_mm, limit_mm), Decimal(f"{limit_mm:.10g}")
    figures = f"{off_mm:.3g}", f"{bound_mm:.3g}"
    for digits in range(4, MOST_DIGITS + 1):
        off, bound = map(Decimal, figures)
        if _sides(off, bound, limit) == decided:  # as a reader adds them up
            break
        figures = f"{off_mm:.{digits}g}", f"{bound_mm:.{digits}g}"
    return figures


def _sides(off: Number, bound: Number, limit: Number) -> tuple[bool, bool]:
    """Whether that is surely within the limit, and surely not."""
    return off + bound <= limit, off - bound > limit


def _next_lines(verification: VerifiedMachine) -> list[str]:
    """What to do after a verification, and what it could not see."""
    lines = []
    if verification.same_machine:
        lines.append(
            "Both sessions were measured with one machine file: enter the calibrated machine "
            "(glidecal export --format model), and measure once more with it."
        )
    elif verification.tolerance_mm is None:
        lines.append("State --tolerance, or platform_tolerance_mm in the machine file.")
    elif verification.decision == "undecided" and not verification.after.fits:
        lines.append(
            "More is left of the readings than noise, so the machine does not pass: glidecal "
            "diagnose looks for what is missing."
        )
    elif verification.decision == "undecided":
        lines.append("Measure more postures, or with less noise.")
    elif verification.decision == "fail":
        lines.append("Calibrate once more from the second session.")
    if verification.after.platform.in_frame_of_tracker:
        lines.append(OF_TRACKER)
    if directions := verification.after.fit.unidentifiable:
        lines.append(f"Laid over, for no reading shows it: {'; '.join(directions)}.")
    return [*lines, *(f"Remark: {remark}" for remark in verification.remarks)]


OF_TRACKER = "A shift and a turn of the tracker's frame are taken out first."


def platform_text(document: HexaSlideCalibrationReport) -> str:
    """What the result means at the platform."""
    platform, frames = document.platform, ""
    if document.lost_motions:
        frames = " Frames that nothing shows are laid over."
    if platform.in_frame_of_tracker:
        frames += f" {OF_TRACKER}"
    if platform.bound_rms_mm is not None:
        largest = (
            f"by at most {platform.bound_rms_mm:.3g} mm r.m.s. with the calibrated machine (95 %)."
        )
    else:
        reason = "no noise is known"
        if platform.left_open:
            reason = f"{platform.left_open} combinations other than frames remain open"
        largest = f"by an unknown amount with the calibrated machine: {reason}."
    return (
        f"The platform, over the box: off by {platform.now_rms_mm:.3g} mm r.m.s. now (worst "
        f"{platform.now_worst_mm:.3g}), {largest}{frames}"
    )


def _both(rms_before: Rms, rms_after: Rms) -> str:
    """One phrase for lengths and one for angles, where there are any."""
    pairs = (
        (rms_before.length_mm, rms_after.length_mm, "mm"),
        (rms_before.angle_mrad, rms_after.angle_mrad, "mrad"),
    )
    return "; ".join(
        f"{first:.4g} → {second:.4g} {unit}"
        for first, second, unit in pairs
        if first is not None and second is not None
    )


def is_shown_better(document: HexaSlideCalibrationReport) -> bool:
    """Whether the calibrated machine is better than its file, unless no bound tells it."""
    bound_mm = document.platform.bound_rms_mm
    return bound_mm is None or bound_mm < document.platform.now_rms_mm


def caveats(document: HexaSlideCalibrationReport) -> list[str]:
    """What stands against the result, and what it leaves out."""
    lines = []
    if wrong := document.postures.left_out:
        postures = f"posture{'s' if len(wrong) > 1 else ''} {', '.join(map(str, wrong))}"
        lines.append(
            f"LEFT OUT: {postures}. The diagnosis names a mistake there. The calibrated machine is "
            "from the other postures."
        )
    p_value = document.lack_of_fit.p_value
    if p_value is not None and p_value < UNLIKELY:
        ratio = math.sqrt(document.lack_of_fit.statistic or 0.0)
        lines.append(
            f"WARNING: what is left is {ratio:.1f} times the stated noise: a wrong reading, a "
            "noise that is stated too small, or something that the model does not have."
        )
    elif document.noise.length_mm is None:
        lines.append(
            "WARNING: no noise is stated and nothing is left over to show it: no uncertainties. "
            "Measure more postures, or state the noise."
        )
    platform = document.platform
    if not is_shown_better(document):
        lines.append(
            "WARNING: the readings do not show that the calibrated machine is better than the "
            f"machine file: its bound is {platform.bound_rms_mm:.3g} mm, the error now "
            f"{platform.now_rms_mm:.3g} mm. Keep the file, or measure more or better postures."
        )
    if not document.lost_count:
        return [*lines, "Every parameter is identifiable alone."]
    motions = document.lost_motions
    if motions:
        lines.append(f"NOT IDENTIFIABLE, left as the machine file has it: {'; '.join(motions)}.")
    other_count = document.lost_count - len(motions)
    if other_count:
        lines.append(
            f"NOT IDENTIFIABLE: {other_count} more combinations, not the motion of a single frame."
        )
    if motions and not other_count:
        lines.append("These turn or shift whole frames; nothing that was measured depends on them.")
    return lines


def parameter_parts(
    document: HexaSlideCalibrationReport, factor: float | None
) -> list[str | Table]:
    """Parameters that are known alone, whether they are lengths, and what is known together."""
    lines = "\n".join(figure_lines(document, factor))
    return [parameter_table(document), *entered_words(document), lines]


def parameter_table(document: HexaSlideCalibrationReport) -> str | Table:
    """Individually known parameters in thousandths of their units."""
    table = new_table("parameter", "value", "from nominal", "± U (95 %)", "unit")
    for name in document.individually_known:
        parameter = document.parameters[name]
        half = parameter.expanded_uncertainty
        table.add_row(
            name,
            f"{1000.0 * parameter.value:.4f}",
            signed(1000.0 * (parameter.value - parameter.nominal), 4),
            "unknown" if half is None else f"{1000.0 * half:.4f}",
            THOUSANDTHS[parameter.unit],
        )
    return table if document.individually_known else "No parameter is identifiable alone."


def entered_words(document: HexaSlideCalibrationReport) -> list[str]:
    """The sentence that lengths to enter are not those of the machine, where they compensate."""
    names = [
        name
        for name, length in document.inner_lengths.items()
        if name in document.individually_known
        and length.expanded_uncertainty_m is not None
        and abs(document.parameters[name].value - length.value_m) > length.expanded_uncertainty_m
    ]
    if not names:
        return []
    return [
        "The values are those to enter. They compensate for what has no parameter (glidecal "
        f"diagnose), so {', '.join(names)} are not lengths of the machine: --json has these as "
        "inner_lengths."
    ]


def figure_lines(document: HexaSlideCalibrationReport, factor: float | None) -> list[str]:
    """What is known only together, noise, and the condition number."""
    lines = []
    unknown = [
        name for name, parameter in document.parameters.items() if not parameter.individually_known
    ]
    if unknown:
        lines.append(f"{len(unknown)} parameters are known only together: {', '.join(unknown)}.")
        lines += _inner(document)
    lines += _noise(document, factor)
    lines.append(
        f"Condition number {document.condition_number:.4g} of the identifiable combinations "
        f"({document.units})."
    )
    return lines


def _noise(document: HexaSlideCalibrationReport, factor: float | None) -> list[str]:
    noise, link = document.noise, document.procedure is ProcedureKind.CONSTRAINT_LINK
    if noise.length_mm is None:
        return []
    text = f"{'Play of the link' if link else 'Noise of a length'} {noise.length_mm:.4g} mm"
    if noise.angle_mrad is not None:
        text += f", of an angle {noise.angle_mrad:.4g} mrad"
    if noise.source == "stated":
        text += ", as stated"
    else:
        text += f", from what is left with {noise.degrees_of_freedom:g} degrees of freedom"
    return [f"{text}; coverage factor {factor:.3f}."]


def _inner(document: HexaSlideCalibrationReport) -> list[str]:
    halves = {name: joint.expanded_uncertainty_m for name, joint in document.inner_lengths.items()}
    joints = [half for name, half in halves.items() if name.startswith("B") and half is not None]
    if not joints:
        return []
    least, longest = (1000.0 * end(joints) for end in (min, max))
    return [
        f"Distances between platform joints do not depend on that: known to ±{least:.4f} "
        f"… ±{longest:.4f} mm (95 %)."
    ]


def left_parts(document: HexaSlideCalibrationReport) -> tuple[Table, str]:
    """What is left, by component and by posture."""
    residuals = document.residuals
    heading = "chain" if document.procedure is ProcedureKind.POSE_INVERSE else "measured"
    table = new_table(heading, "residual r.m.s.", "unit", "share")
    for row in residuals.by_component:
        table.add_row(row.component, f"{row.rms:.4g}", row.unit, f"{100.0 * row.share:.0f} %")
    worst = sorted(residuals.by_posture, key=lambda posture: -posture.share)[:MOST_POSTURES]
    text = ", ".join(f"{posture.posture} ({100.0 * posture.share:.0f} %)" for posture in worst)
    even = 100.0 / len(residuals.by_posture)
    return table, (
        f"Postures with the largest shares: {text}; even would be {even:.0f} % each. "
        f"{residuals.remark}"
    )


def _truth(document: HexaSlideCalibrationReport) -> list[str]:
    truth = document.truth
    if truth is None:
        return []
    apart_before, apart_after = truth.before, truth.after
    where = "the postures kept out" if truth.postures == "held out" else "all postures"
    moved = [
        f"{name} {size:.3g} {unit}"
        for name, size, unit in (
            ("platform frame turned by", apart_after.platform_frame_turned_mrad, "mrad"),
            ("platform frame shifted by", apart_after.platform_frame_shifted_mm, "mm"),
            ("base turned by", apart_after.base_turned_mrad, "mrad"),
        )
        if size > 0.0
    ]
    lines = [
        f"Against the truth at {where}: position {apart_before.position_rms_mm:.4g} → "
        f"{apart_after.position_rms_mm:.4g} mm r.m.s. (worst {apart_after.position_worst_mm:.4g}), "
        f"angle {apart_before.angle_rms_mrad:.4g} → {apart_after.angle_rms_mrad:.4g} mrad."
    ]
    if moved:
        lines.append(f"Apart from constant motions that nothing shows: {', '.join(moved)}.")
    if truth.individually_known_within_95_percent is not None:
        lines.append(
            f"{truth.individually_known_within_95_percent} of "
            f"{truth.individually_known_count} individually known parameters lie within their "
            "95 % interval."
        )
    return lines
