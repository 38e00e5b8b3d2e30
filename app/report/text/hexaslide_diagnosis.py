"""What is missing in a Hexa Slide's model, in words."""

from __future__ import annotations

from rich.table import Table

from app.report.text.tables import new_table, paragraphs, result_table
from calib.diagnosis.hexaslide import CauseSize, HexaSlideDiagnosis, Names
from protocols.data_table import DataTable

TITLES = {
    "rail_scale": "scale of {}",
    "rail_wave": "wave of {}",
    "leg_scale": "scale of {}",
    "leg_wave": "wave of {}",
    "leg_backlash": "play in {}",
    "backlash": "play of the carriage on {}",
    "joint_offset": "axes of the universal joint on {} that do not meet",
    "straightness": "{} that is bowed",
    "thermal_growth": "growth of {} with time",
    "wrong_posture": "{} read or taken wrong",
}
VERDICTS = {
    "agrees": "The readings agree with the calibrated machine; nothing is missing.",
    "explained": "Something is missing, and these names explain it: {}.",
    "ambiguous": "The readings do not tell which of these it is.",
    "unexplained": "More is left than noise, and no cause that is known explains it.",
    "cannot-tell": "Too few readings are over to tell what is missing: {} beyond the parameters. "
    "Measure more postures.",
}
MOST_CLAIMS = 8


def _title(causes: Names) -> str:
    return " and ".join(TITLES[cause].format(where) for cause, where in causes) or "nothing"


def diagnosis_text(name: str, diagnosis: HexaSlideDiagnosis) -> str:
    """The verdict, what may be true, sizes, and what no reading shows."""
    return paragraphs(f"{name}: {diagnosis.verdict}", *diagnosis_parts(diagnosis))


def verdict_words(diagnosis: HexaSlideDiagnosis) -> str:
    """The verdict as a sentence, with what is named."""
    named = "; ".join(_title(claim.causes) for claim in diagnosis.named)
    return VERDICTS[diagnosis.verdict].format(
        diagnosis.spare if diagnosis.verdict == "cannot-tell" else named
    )


def diagnosis_parts(diagnosis: HexaSlideDiagnosis) -> list[str | Table]:
    """The same as sentences and tables, without the heading."""
    claims = new_table("what may be missing", "probability")
    for claim in diagnosis.claims[:MOST_CLAIMS]:
        claims.add_row(_title(claim.causes), f"{100.0 * claim.weight:.0f} %")
    sizes = result_table(DataTable.of(CauseSize, diagnosis.sizes))
    lines = [
        f"What is left, in variances of the noise: {diagnosis.gap_before:.3g} before (p = "
        f"{diagnosis.p_before:.2g}), {diagnosis.gap_after:.3g} after (p = {diagnosis.p_after:.2g})."
    ]
    if diagnosis.sizes:
        lines.append(
            f"At the platform it does {1000.0 * diagnosis.platform_m:.3g} mm r.m.s. in these "
            "postures that no parameter takes over."
        )
    if diagnosis.unidentifiable:
        lines.append(f"The readings do not show: {'; '.join(diagnosis.unidentifiable)}.")
    parts: list[str | Table] = [verdict_words(diagnosis)]
    parts += [claims] if diagnosis.claims else []
    parts += [sizes] if diagnosis.sizes else []
    return [*parts, "\n".join(lines)]
