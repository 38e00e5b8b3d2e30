"""What is missing in a Hexa Slide's model, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.table import Table

from app.evaluating.hexaslide_adoption import Adoption, DiagnosedPostures
from app.report.text.effect_entries import history_words, origin_lines, size_lines
from app.report.text.tables import new_table, paragraphs, result_table
from calib.hexaslide.causes import AdoptedEffect
from calib.hexaslide.diagnosis import CauseSize, HexaSlideDiagnosis, Names
from calib.hexaslide.platform import PlatformError
from calib.quantity import probability_words
from protocols.hexaslide_model import HexaSlideModel

if TYPE_CHECKING:  # sessions come with it, which not every result has
    from app.evaluating.hexaslide import PostureResult

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
    "other_frame": "{} measured in another frame than the machine's",
    "wrong_posture": "{} read or taken wrong",
}
VERDICTS = {
    "agrees": "The readings agree with the calibrated machine; nothing is missing.",
    "explained": "Something is missing, and these names explain it: {}.",
    "ambiguous": "The readings do not show which of these it is.",
    "unexplained": "More is left than noise, and no cause that is known explains it.",
    "cannot-tell": "Too few readings are left to show what is missing: {} beyond the parameters. "
    "Measure more different postures.",
}
MOST_CLAIMS = 8


def _title(causes: Names) -> str:
    return " and ".join(map(title_of, causes)) or "nothing"


def title_of(name: tuple[str, str]) -> str:
    """A cause at its place."""
    cause, where = name
    return TITLES.get(cause, f"{cause} of {{}}").format(where)


def diagnosis_text(diagnosed: DiagnosedPostures, adoption: Adoption | None = None) -> str:
    """The verdict, what may be true, sizes, what no reading shows, and what was adopted."""
    return paragraphs(
        f"{diagnosed.name}: {diagnosed.diagnosis.verdict}",
        beside_words(diagnosed.beside),
        *diagnosis_parts(diagnosed.diagnosis),
        "" if adoption is None else adoption_words(adoption),
    )


def beside_words(effects: Sequence[AdoptedEffect]) -> str:
    """Which effects of a model act; empty for none."""
    names = tuple((effect.id, effect.where) for effect in effects)
    return f"Beside the model's {_title(names)}." if effects else ""


def adoption_words(adoption: Adoption) -> str:
    """What follows if the adopted effects act."""
    names = tuple((effect.id, effect.where) for effect in adoption.effects)
    # the model's entry has the names of the values and their unit
    entries = [e for e in adoption.model.effects if (e.id, e.where) in names]
    platform_before, platform = adoption.platform_before, adoption.platform
    lines = [
        f"Adopted: {_title(names)}. Its size if it acts:",
        *(line for entry in entries for line in size_lines(entry)),
        f"If that acts, the platform is off by {1000.0 * platform.now.places_rms_m:.3g} mm r.m.s. "
        f"now, and {_bound(platform)} with the calibrated machine (95 %); when all models count,"
        f" {_bound(platform_before)}.",
        f"What is left, in variances of the noise: {adoption.gap_before:.3g} without it, "
        f"{adoption.gap_after:.3g} with it (p = {adoption.p_after:.2g}).",
    ]
    if adoption.left_out is not None:
        lines.append(
            "Postures that are left out, a fifth at a time, are missed by "
            f"{adoption.left_out.before:.2f} standard deviations of the noise without it, by "
            f"{adoption.left_out.after:.2f} with it (r.m.s.)."
        )
    return "\n".join(lines)


def _bound(platform: PlatformError) -> str:
    bound_m = platform.bound_m
    return "an unknown amount" if bound_m is None else f"at most {1000.0 * bound_m:.3g} mm"


def model_text(model: HexaSlideModel) -> str:
    """Effects with their sizes and where they are from, and how they came and went."""
    parts = []
    for entry in model.effects:
        title = f"{entry.id} ({entry.where}): {title_of((entry.id, entry.where))}"
        parts.append("\n".join([title, *size_lines(entry), *origin_lines(entry)]))
    return paragraphs(
        f"Model of {model.machine.name}", *(parts or ["No effects."]), history_words(model.history)
    )


def verdict_words(diagnosis: HexaSlideDiagnosis) -> str:
    """The verdict as a sentence, with what is named."""
    titles = "; ".join(_title(claim.causes) for claim in diagnosis.named)
    return VERDICTS[diagnosis.verdict].format(
        diagnosis.spare if diagnosis.verdict == "cannot-tell" else titles
    )


def verdict_line(result: PostureResult) -> str:
    """The verdict of a session before its sentence, or why there is none."""
    if result.diagnosis is None:
        return f"NOT DIAGNOSED. {result.not_diagnosed}"
    return f"{result.diagnosis.verdict.upper()}. {verdict_words(result.diagnosis)}"


def missing_parts(result: PostureResult) -> list[str | Table]:
    """What may be missing, or why there is no diagnosis."""
    return diagnosis_parts(result.diagnosis) if result.diagnosis else [result.not_diagnosed]


def diagnosis_parts(diagnosis: HexaSlideDiagnosis) -> list[str | Table]:
    """The diagnosis as sentences and tables, without the heading."""
    claims = new_table("what may be missing", "probability")
    for claim in diagnosis.claims[:MOST_CLAIMS]:
        claims.add_row(_title(claim.causes), probability_words(claim.weight))
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
    tables = [claims] if claims.rows else []
    sizes = size_tables(diagnosis.sizes)
    return [verdict_words(diagnosis), *tables, *sizes, "\n".join(lines)]


def size_tables(sizes: Sequence[CauseSize]) -> list[Table]:
    """Values of causes with their uncertainties; nothing for none."""
    return [result_table(CauseSize, sizes)] if sizes else []
