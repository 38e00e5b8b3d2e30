"""What ``diagnose`` tells of a Hexa Slide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.evaluating.hexaslide_adoption import Adoption, DiagnosedPostures
from app.report.schema.document import Report, Source, maybe, schema
from app.report.schema.hexaslide import PlatformReport
from calib.hexaslide.causes import AdoptedEffect
from calib.hexaslide.diagnosis import CauseSize, HexaSlideClaim
from calib.hexaslide.held_out import LeftOutGap


@dataclass(frozen=True)
class MissingEntry:
    """A cause at its place."""

    id: str
    where: str


class MissingTogether(Report):
    """What may be missing together, nothing where it is empty, and the weight of that."""

    of = Source[HexaSlideClaim]()
    causes: tuple[MissingEntry, ...] = of(
        lambda r: tuple(MissingEntry(*cause) for cause in r.causes)
    )
    weight: float = of(lambda r: r.weight)


class AdoptedEntry(Report):
    """An effect of a model with the sizes that fit best, in its order of values."""

    of = Source[AdoptedEffect]()
    id: str = of(lambda r: r.id)
    where: str = of(lambda r: r.where)
    values: tuple[float, ...] = of(lambda r: r.values, "as in the model file")
    standard_uncertainties: tuple[float, ...] = of(lambda r: r.deviations, "none: held")


class AdoptionReport(Report):
    """What follows if the adopted effects act."""

    of = Source[Adoption]()
    effects: tuple[AdoptedEntry, ...] = of(lambda r: tuple(map(AdoptedEntry.of, r.effects)))
    platform_before: PlatformReport = of(
        lambda r: PlatformReport.of(r.platform_before), "over all models"
    )
    platform: PlatformReport = of(lambda r: PlatformReport.of(r.platform))
    mean_square_before: float = of(lambda r: r.gap_before, "in variances of the stated noise")
    mean_square_after: float = of(lambda r: r.gap_after)
    p_value_after: float = of(lambda r: r.p_after)
    left_out: LeftOutGap | None = of(
        lambda r: r.left_out, "a fifth of the postures left out at a time; null: too few"
    )


class HexaSlideDiagnosisReport(Report):
    """``diagnose --json`` of a session of postures."""

    of = Source[DiagnosedPostures, Adoption | None]()
    schema_id: Literal["glidecal.hexaslide-diagnosis/1"] = schema("glidecal.hexaslide-diagnosis/1")
    session: str = of(lambda r, _: r.name)
    verdict: Literal["agrees", "explained", "ambiguous", "unexplained", "cannot-tell"] = of(
        lambda r, _: r.diagnosis.verdict
    )
    named: tuple[MissingTogether, ...] = of(
        lambda r, _: tuple(map(MissingTogether.of, r.diagnosis.named))
    )
    claims: tuple[MissingTogether, ...] = of(
        lambda r, _: tuple(map(MissingTogether.of, r.diagnosis.claims)), "99 % of all weight"
    )
    sizes: tuple[CauseSize, ...] = of(lambda r, _: r.diagnosis.sizes)
    platform_rms_mm: float = of(
        lambda r, _: 1000.0 * r.diagnosis.platform_m, "that no parameter takes over"
    )
    mean_square_before: float = of(
        lambda r, _: r.diagnosis.gap_before, "in variances of the stated noise"
    )
    p_value_before: float = of(lambda r, _: r.diagnosis.p_before)
    mean_square_after: float = of(lambda r, _: r.diagnosis.gap_after)
    p_value_after: float = of(lambda r, _: r.diagnosis.p_after)
    spare_readings: int = of(lambda r, _: r.diagnosis.spare, "beyond what parameters take")
    lost_motions: tuple[str, ...] = of(lambda r, _: r.diagnosis.unidentifiable)
    effects_of_model: tuple[AdoptedEntry, ...] | None = of(
        lambda r, _: tuple(map(AdoptedEntry.of, r.beside)) or None,
        "with --model: what the readings were diagnosed beside",
        asked=True,
    )
    adopted: AdoptionReport | None = of(
        lambda _, adoption: maybe(AdoptionReport.of, adoption), "with --adopt", asked=True
    )
