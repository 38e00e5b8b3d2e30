"""A calibrated Hexa Slide in words and tables."""

from __future__ import annotations

import math

from rich.table import Table

from app.planning.hexaslide import LACK_OF_FIT_LEVEL, CalibratedMachine, VerifiedMachine
from app.report.schema.hexaslide import HexaSlideCalibrationReport, Rms
from app.report.text.tables import new_table, paragraphs, signed
from calib.hexaslide.procedures import ProcedureKind
from protocols.hexaslide import HexaSlideMeasurements

MOST_POSTURES = 5

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


def calibration_text(solved: CalibratedMachine) -> str:
    """The sentences that matter, parameters, what is left, then the checks."""
    said = HexaSlideCalibrationReport.of(solved=solved)  # words and JSON tell the same numbers
    linked = said.procedure is ProcedureKind.CONSTRAINT_LINK
    read = ", ".join(["sliders on the constraint link" if linked else "sliders", *said.measured])
    verdict = (
        f"{said.rank} of {said.parameter_count} combinations of the parameters identified from "
        f"{said.postures.fitted} postures in {said.steps} steps.",
        f"{LEFT_WORDS[said.procedure]}, r.m.s.: {_both(said.rms_before, said.rms_after)}.",
    )
    count, total = len(said.postures.held_out), said.postures.count
    check = "No posture was kept out of the fit as a check."
    if said.held_out is not None:
        both = _both(said.held_out.rms_before, said.held_out.rms_after)
        check = (
            f"Check on {count} of {total} postures ({100.0 * count / total:.0f} %), kept out of "
            f"the fit: {both} r.m.s., noise of measuring included."
        )
    return paragraphs(
        f"{said.measurements}: {said.machine} ({said.machine_file}), {said.procedure.value}, "
        f"{said.postures.count} {said.origin} postures; read: {read}",
        "\n".join([*verdict, platform_text(said), *caveats(said)]),
        _parameters(said),
        "\n".join(_figures(said, solved.factor)),
        *_left(said),
        "\n".join([check, *_truth(said)]),
    )


def verification_text(found: VerifiedMachine) -> str:
    """The decision, what it rests on, and what to do."""
    was, now = found.before.platform, found.after.platform
    off_mm, bound_m = 1000.0 * now.now.places_rms_m, now.bound_m
    bound = "an unknown amount" if bound_m is None else f"{1000.0 * bound_m:.3g} mm"
    lines = [
        f"{found.decision or 'undecided'}: "
        f"the platform is off by {off_mm:.3g} mm r.m.s. over the box, give or take {bound}"
        f" (95 %); tolerance {f'{found.tolerance_mm:g} mm' if found.tolerance_mm else 'none'}.",
        f"Before: {1000.0 * was.now.places_rms_m:.3g} mm r.m.s.",
    ]
    if found.same_machine:
        lines.append(
            "Both sessions were measured with one machine file: enter the calibrated machine "
            "(glidecal export --format model), and measure once more with it."
        )
    elif found.tolerance_mm is None:
        lines.append("State --tolerance, or platform_tolerance_mm in the machine file.")
    elif found.decision == "undecided":
        lines.append("Measure more postures, or with less noise.")
    elif found.decision == "fail":
        lines.append("Calibrate once more from the second session.")
    if lost := found.after.found.unidentifiable:
        lines.append(f"Laid over, for no reading shows it: {'; '.join(lost)}.")
    return paragraphs("\n".join(lines))


def platform_text(said: HexaSlideCalibrationReport) -> str:
    """What the result means at the platform."""
    platform, frames = said.platform, ""
    if said.lost_motions:
        frames = " Frames that nothing shows are laid over."
    most = (
        f"by at most {platform.bound_rms_mm:.3g} mm r.m.s. with the calibrated machine (95 %)."
        if platform.bound_rms_mm is not None
        else "by an unknown amount with the calibrated machine: no noise is known."
        if not platform.left_open
        else f"by an unknown amount with the calibrated machine: {platform.left_open} combinations "
        "that are no frames stay open."
    )
    return (
        f"The platform, over the box: off by {platform.now_rms_mm:.3g} mm r.m.s. now (worst "
        f"{platform.now_worst_mm:.3g}), {most}{frames}"
    )


def _both(before: Rms, after: Rms) -> str:
    """One phrase for lengths and one for angles, where there are any."""
    pairs = (
        (before.length_mm, after.length_mm, "mm"),
        (before.angle_mrad, after.angle_mrad, "mrad"),
    )
    return "; ".join(
        f"{first:.4g} → {second:.4g} {unit}"
        for first, second, unit in pairs
        if first is not None and second is not None
    )


def caveats(said: HexaSlideCalibrationReport) -> list[str]:
    """What stands against the result, and what it leaves out."""
    lines = []
    p_value = said.lack_of_fit.p_value
    if p_value is not None and p_value < LACK_OF_FIT_LEVEL:
        ratio = math.sqrt(said.lack_of_fit.statistic or 0.0)
        lines.append(
            f"WARNING: what is left is {ratio:.1f} times the stated noise: a wrong reading, a "
            "noise that is stated too small, or something that the model does not have. The "
            "uncertainties below do not count it."
        )
    elif said.noise.length_mm is None:
        lines.append(
            "WARNING: no noise is stated and nothing is left over to tell it: no uncertainties. "
            "Measure more postures, or state the noise."
        )
    if not said.lost_count:
        return [*lines, "Every parameter is known by itself."]
    motions = said.lost_motions
    if motions:
        lines.append(f"NOT IDENTIFIABLE, left as the machine file has it: {'; '.join(motions)}.")
    other = said.lost_count - len(motions)
    if other:
        lines.append(
            f"NOT IDENTIFIABLE: {other} more combinations, not the motion of a single frame."
        )
    if motions and not other:
        lines.append("These turn or shift whole frames; nothing that was measured depends on them.")
    return lines


def _parameters(said: HexaSlideCalibrationReport) -> str | Table:
    """Individually known parameters in thousandths of their units."""
    table = new_table("parameter", "value", "from nominal", "± U (95 %)", "unit")
    for name in said.individually_known:
        one = said.parameters[name]
        half = one.expanded_uncertainty
        table.add_row(
            name,
            f"{1000.0 * one.value:.4f}",
            signed(1000.0 * (one.value - one.nominal), 4),
            "unknown" if half is None else f"{1000.0 * half:.4f}",
            THOUSANDTHS[one.unit],
        )
    return table if said.individually_known else "No parameter is known by itself."


def _figures(said: HexaSlideCalibrationReport, factor: float | None) -> list[str]:
    lines = []
    others = [name for name, one in said.parameters.items() if not one.individually_known]
    if others:
        lines.append(f"{len(others)} parameters are known only together: {', '.join(others)}.")
        lines += _inner(said, factor)
    lines += _noise(said, factor)
    lines.append(
        f"Condition number {said.condition_number:.4g} of the identifiable combinations "
        f"({said.units})."
    )
    return lines


def _noise(said: HexaSlideCalibrationReport, factor: float | None) -> list[str]:
    noise, link = said.noise, said.procedure is ProcedureKind.CONSTRAINT_LINK
    if noise.length_mm is None:
        return []
    words = f"{'Play of the link' if link else 'Noise of a length'} {noise.length_mm:.4g} mm"
    if noise.angle_mrad is not None:
        words += f", of an angle {noise.angle_mrad:.4g} mrad"
    if noise.source == "stated":
        words += ", as stated"
    else:
        words += f", from what is left with {noise.degrees_of_freedom:g} degrees of freedom"
    return [f"{words}; coverage factor {factor:.3f}."]


def _inner(said: HexaSlideCalibrationReport, factor: float | None) -> list[str]:
    known = {name: one.standard_uncertainty_m for name, one in said.inner_lengths.items()}
    joints = [u for name, u in known.items() if name.startswith("B") and u is not None]
    if not joints or factor is None:
        return []
    least, most = (1000.0 * factor * end(joints) for end in (min, max))
    return [
        f"Distances between platform joints do not depend on that: known to ±{least:.4f} "
        f"… ±{most:.4f} mm (95 %)."
    ]


def _left(said: HexaSlideCalibrationReport) -> tuple[Table, str]:
    residuals = said.residuals
    heading = "chain" if said.procedure is ProcedureKind.POSE_INVERSE else "measured"
    table = new_table(heading, "residual r.m.s.", "unit", "share")
    for row in residuals.by_component:
        table.add_row(row.component, f"{row.rms:.4g}", row.unit, f"{100.0 * row.share:.0f} %")
    worst = sorted(residuals.by_posture, key=lambda one: -one.share)[:MOST_POSTURES]
    words = ", ".join(f"{one.posture} ({100.0 * one.share:.0f} %)" for one in worst)
    even = 100.0 / len(residuals.by_posture)
    return table, (
        f"Postures with the largest shares: {words}; even would be {even:.0f} % each. "
        f"{residuals.remark}"
    )


def _truth(document: HexaSlideCalibrationReport) -> list[str]:
    said = document.truth
    if said is None:
        return []
    before, after = said.before, said.after
    where = "the postures kept out" if said.postures == "held out" else "all postures"
    moved = [
        f"{name} {size:.3g} {unit}"
        for name, size, unit in (
            ("platform frame turned by", after.platform_frame_turned_mrad, "mrad"),
            ("platform frame shifted by", after.platform_frame_shifted_mm, "mm"),
            ("base turned by", after.base_turned_mrad, "mrad"),
        )
        if size > 0.0
    ]
    lines = [
        f"Against the truth at {where}: position {before.position_rms_mm:.4g} → "
        f"{after.position_rms_mm:.4g} mm r.m.s. (worst {after.position_worst_mm:.4g}), "
        f"angle {before.angle_rms_mrad:.4g} → {after.angle_rms_mrad:.4g} mrad."
    ]
    if moved:
        lines.append(f"Apart from constant motions that nothing shows: {', '.join(moved)}.")
    if said.individually_known_within_95_percent is not None:
        lines.append(
            f"{said.individually_known_within_95_percent} of "
            f"{said.individually_known_count} individually known parameters lie within their "
            "95 % interval."
        )
    return lines
