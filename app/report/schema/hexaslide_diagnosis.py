"""What ``diagnose`` tells of a Hexa Slide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.report.schema.document import Report, Source, schema
from calib.diagnosis.hexaslide import CauseSize, HexaSlideClaim, HexaSlideDiagnosis


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


@dataclass(frozen=True)
class DiagnosedPostures:
    """A diagnosis with the name of its session."""

    name: str
    diagnosis: HexaSlideDiagnosis


class HexaSlideDiagnosisReport(Report):
    """``diagnose --json`` of a session of postures."""

    of = Source[DiagnosedPostures]()
    schema_id: Literal["glidecal.hexaslide-diagnosis/1"] = schema("glidecal.hexaslide-diagnosis/1")
    session: str = of(lambda r: r.name)
    verdict: Literal["agrees", "explained", "ambiguous", "unexplained", "cannot-tell"] = of(
        lambda r: r.diagnosis.verdict
    )
    named: tuple[MissingTogether, ...] = of(
        lambda r: tuple(map(MissingTogether.of, r.diagnosis.named))
    )
    claims: tuple[MissingTogether, ...] = of(
        lambda r: tuple(map(MissingTogether.of, r.diagnosis.claims)), "99 % of all weight"
    )
    sizes: tuple[CauseSize, ...] = of(lambda r: r.diagnosis.sizes)
    platform_rms_mm: float = of(
        lambda r: 1000.0 * r.diagnosis.platform_m, "that no parameter takes over"
    )
    mean_square_before: float = of(
        lambda r: r.diagnosis.gap_before, "in variances of the stated noise"
    )
    p_value_before: float = of(lambda r: r.diagnosis.p_before)
    mean_square_after: float = of(lambda r: r.diagnosis.gap_after)
    p_value_after: float = of(lambda r: r.diagnosis.p_after)
    spare_readings: int = of(lambda r: r.diagnosis.spare, "beyond what parameters take")
    lost_motions: tuple[str, ...] = of(lambda r: r.diagnosis.unidentifiable)
