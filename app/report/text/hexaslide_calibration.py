"""A calibrated Hexa Slide in words and tables."""

from __future__ import annotations

import math

from app.planning.hexaslide import CalibratedMachine
from app.report.schema.hexaslide import INNER_NAMES, CalibrationReport, Rms
from app.report.text.tables import new_table, signed, table_text, wrapped
from calib.hexaslide.geometry import unit_of
from calib.hexaslide.procedures import Kind
from protocols.hexaslide_postures import HexaSlideMeasurements

LACK_OF_FIT_LEVEL = 0.01
MOST_POSTURES = 5


def simulated_text(measured: HexaSlideMeasurements) -> str:
    """What was written."""
    return (
        f"{len(measured.postures)} simulated postures of {measured.machine.name}, "
        f"{measured.procedure.value}"
    )


def calibration_text(solved: CalibratedMachine) -> str:
    """The sentences that matter, parameters, what is left, then the checks."""
    said = CalibrationReport.of(solved=solved)  # words and JSON tell the same numbers
    parts = [
        wrapped(_heading(solved)),
        wrapped("\n".join([*_verdict(solved, said), *_warnings(solved), *_lost(solved)])),
        _parameters(solved),
        wrapped("\n".join(_figures(solved, said))),
        _left(solved, said),
        wrapped("\n".join([_held_out(solved, said), *_truth(said)])),
    ]
    return "\n\n".join(part for part in parts if part)


def _heading(solved: CalibratedMachine) -> str:
    source = solved.source
    measured = ", ".join(source.measured)
    read = f"sliders and {measured}" if measured else "sliders on the constraint link"
    return (
        f"{solved.name}: {source.machine.name} ({source.machine_file}), "
        f"{source.procedure.value}, {len(source.postures)} {source.origin} postures; read: {read}"
    )


def _verdict(solved: CalibratedMachine, said: CalibrationReport) -> list[str]:
    found = solved.found
    return [
        f"{found.rank} of {len(found.names)} combinations of the parameters identified from "
        f"{len(solved.numbers)} postures in {found.steps} steps.",
        f"{_what(solved)}, r.m.s.: "
        + "; ".join(_both(said.rms_before, said.rms_after, " → "))
        + ".",
    ]


def _what(solved: CalibratedMachine) -> str:
    kind = solved.source.procedure
    if kind is Kind.POSE_INVERSE:
        return "Sliders, read less predicted"
    return (
        "Length of the link less that predicted"
        if kind is Kind.CONSTRAINT_LINK
        else ("Measured less predicted")
    )


def _both(before: Rms, after: Rms, between: str) -> list[str]:
    """One phrase for lengths and one for angles, where there are any."""
    parts = []
    lengths, angles = (before.length_mm, after.length_mm), (before.angle_mrad, after.angle_mrad)
    for (first, second), unit in ((lengths, "mm"), (angles, "mrad")):
        if first is not None and second is not None:
            parts.append(f"{first:.4g}{between}{second:.4g} {unit}")
    return parts


def _warnings(solved: CalibratedMachine) -> list[str]:
    found = solved.found
    if solved.p_value is not None and solved.p_value < LACK_OF_FIT_LEVEL:
        ratio = math.sqrt(found.lack_of_fit or 0.0)
        return [
            f"WARNING: what is left is {ratio:.1f} times the stated noise: a wrong reading, a "
            "noise that is stated too small, or something that the model does not have. The "
            "uncertainties below do not count it."
        ]
    if found.covariance is None:
        return [
            "WARNING: no noise is stated and nothing is left over to tell it: no uncertainties. "
            "Measure more postures, or state the noise."
        ]
    return []


def _lost(solved: CalibratedMachine) -> list[str]:
    found = solved.found
    if not found.lost_count:
        return ["Nothing is lost: every parameter is known by itself."]
    lines = []
    if found.lost:
        lines.append(f"NOT SEEN, left as the machine file has it: {'; '.join(found.lost)}.")
    other = found.lost_count - len(found.lost)
    if other:
        lines.append(f"NOT SEEN: {other} more combinations, motions of no single frame.")
    if found.lost and not other:
        lines.append("These turn or shift whole frames; nothing that was measured depends on them.")
    return lines


def _parameters(solved: CalibratedMachine) -> str:
    """Individually known parameters; lengths in mm, components of directions in mm/m."""
    found, u, factor = solved.found, solved.uncertainty, solved.factor
    if not found.known:
        return "No parameter is known by itself."
    table = new_table("parameter", "value", "from nominal", "± U (95 %)", "unit")
    for k, name in enumerate(found.names):
        if name in found.known:
            value, change = found.parameters[k], found.parameters[k] - solved.start[k]
            expanded = "unknown" if u is None else f"{1000.0 * u[k] * (factor or 0.0):.4f}"
            unit = "mm" if unit_of(name) == "m" else "mm/m"
            table.add_row(name, f"{1000.0 * value:.4f}", signed(1000.0 * change, 4), expanded, unit)
    return table_text(table)


def _figures(solved: CalibratedMachine, said: CalibrationReport) -> list[str]:
    lines = []
    others = [name for name in solved.found.names if name not in solved.found.known]
    if others:
        lines.append(
            f"{len(others)} parameters are known only together, up to what is not seen: "
            f"{', '.join(others)}."
        )
        lines += _inner(solved)
    lines += _noise(solved, said)
    lines.append(f"Condition number {said.condition_number:.4g} of what is seen ({said.units}).")
    return lines


def _noise(solved: CalibratedMachine, said: CalibrationReport) -> list[str]:
    noise, source = said.noise, solved.source
    if noise.length_mm is None:
        return []
    link = source.procedure is Kind.CONSTRAINT_LINK
    words = f"{'Play of the link' if link else 'Noise of a length'} {noise.length_mm:.4g} mm"
    if noise.angle_mrad is not None:
        words += f", of an angle {noise.angle_mrad:.4g} mrad"
    if noise.source == "stated":
        words += ", as stated"
    else:
        words += f", from what is left with {noise.degrees_of_freedom:g} degrees of freedom"
    return [f"{words}; coverage factor {solved.factor:.3f}."]


def _inner(solved: CalibratedMachine) -> list[str]:
    u, factor = solved.inner_uncertainty_m, solved.factor
    if u is None or factor is None:
        return []
    joints = [k for k, name in enumerate(INNER_NAMES) if name.startswith("B")]
    expanded = 1000.0 * factor * u[joints]
    return [
        f"Distances between platform joints do not depend on that: known to ±{expanded.min():.4f} "
        f"… ±{expanded.max():.4f} mm (95 %)."
    ]


def _left(solved: CalibratedMachine, said: CalibrationReport) -> str:
    left = said.residuals
    heading = "chain" if solved.source.procedure is Kind.POSE_INVERSE else "measured"
    table = new_table(heading, "left, r.m.s.", "unit", "share")
    for row in left.by_component:
        table.add_row(row.component, f"{row.rms:.4g}", row.unit, f"{100.0 * row.share:.0f} %")
    worst = sorted(left.by_posture, key=lambda one: -one.share)[:MOST_POSTURES]
    words = ", ".join(f"{one.posture} ({100.0 * one.share:.0f} %)" for one in worst)
    even = 100.0 / len(left.by_posture)
    return "\n".join(
        [
            table_text(table),
            "",
            wrapped(
                f"Postures with the largest shares: {words}; even would be {even:.0f} % each. "
                f"{left.remark}"
            ),
        ]
    )


def _held_out(solved: CalibratedMachine, said: CalibrationReport) -> str:
    held = said.held_out
    if solved.held_out is None or held is None:
        return "No posture was kept out of the fit as a check."
    count, total = len(solved.held_out.numbers), len(solved.source.postures)
    both = "; ".join(_both(held.rms_before, held.rms_after, " → "))
    return (
        f"Check on {count} of {total} postures ({100.0 * count / total:.0f} %), kept out of the "
        f"fit: {both} r.m.s., noise of measuring included."
    )


def _truth(document: CalibrationReport) -> list[str]:
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
