"""What ``diagnose`` tells of a Hexa Slide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from app.report.schema.document import Report, Thousandths, at, made, schema


@dataclass(frozen=True)
class MissingEntry:
    """A cause at its place."""

    id: str
    where: str


class MissingTogether(Report):
    """What may be missing together, nothing where it is empty, and the weight of that."""

    causes: Annotated[
        tuple[MissingEntry, ...],
        made(lambda causes: tuple(MissingEntry(*cause) for cause in causes)),
    ]
    weight: float


class CauseValue(Report):
    """A value of what is named, else of the heaviest claim."""

    name: str
    value: float
    standard_uncertainty: float = at("uncertainty")
    unit: str


class HexaSlideDiagnosisReport(Report):
    """``diagnose --json`` of a session of postures."""

    schema_id: Literal["glidecal.hexaslide-diagnosis/1"] = schema("glidecal.hexaslide-diagnosis/1")
    session: str = at("name")
    verdict: Literal["agrees", "explained", "ambiguous", "unexplained", "cannot-tell"] = at(
        "found.verdict"
    )
    named: tuple[MissingTogether, ...] = at("found.named")
    claims: tuple[MissingTogether, ...] = at("found.claims", "99 % of all weight")
    sizes: tuple[CauseValue, ...] = at("found.sizes")
    platform_rms_mm: Thousandths = at("found.platform_m", "that no parameter takes over")
    mean_square_before: float = at("found.gap_before", "in variances of the stated noise")
    p_value_before: float = at("found.p_before")
    mean_square_after: float = at("found.gap_after")
    p_value_after: float = at("found.p_after")
    spare_readings: int = at("found.spare", "beyond what parameters take")
    lost_motions: tuple[str, ...] = at("found.unidentifiable")
