"""What ``diagnose`` and ``compare`` tell of a Hexa Slide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from app.evaluating.hexaslide import ComparedSession, ComparedSessions
from app.evaluating.hexaslide_adoption import Adoption, DiagnosedPostures
from app.report.schema.document import Report, Source, maybe, schema
from app.report.schema.hexaslide import INNER_NAMES, PlatformReport
from calib.hexaslide.causes import AdoptedEffect
from calib.hexaslide.comparison import MachinesApart
from calib.hexaslide.diagnosis import CauseSize, HexaSlideClaim, LeftOutGap
from calib.quantity import Quantity


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
    values: tuple[float, ...] = of(lambda r: r.values)
    """as in the model file"""
    standard_uncertainties: tuple[float, ...] = of(lambda r: r.deviations)
    """none: held"""


class AdoptionReport(Report):
    """What follows if the adopted effects act."""

    of = Source[Adoption]()
    effects: tuple[AdoptedEntry, ...] = of(lambda r: tuple(map(AdoptedEntry.of, r.effects)))
    platform_before: PlatformReport = of(lambda r: PlatformReport.of(r.platform_before))
    """over all models"""
    platform: PlatformReport = of(lambda r: PlatformReport.of(r.platform))
    mean_square_before: float = of(lambda r: r.gap_before)
    """in variances of the stated noise"""
    mean_square_after: float = of(lambda r: r.gap_after)
    p_value_after: float = of(lambda r: r.p_after)
    left_out: LeftOutGap | None = of(lambda r: r.left_out)
    """a fifth of the postures left out at a time; null: too few"""


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
        lambda r, _: tuple(map(MissingTogether.of, r.diagnosis.claims))
    )
    """99 % of all weight"""
    sizes: tuple[CauseSize, ...] = of(lambda r, _: r.diagnosis.sizes)
    platform_rms_mm: float = of(lambda r, _: 1000.0 * r.diagnosis.platform_m)
    """that no parameter takes over"""
    mean_square_before: float = of(lambda r, _: r.diagnosis.gap_before)
    """in variances of the stated noise"""
    p_value_before: float = of(lambda r, _: r.diagnosis.p_before)
    mean_square_after: float = of(lambda r, _: r.diagnosis.gap_after)
    p_value_after: float = of(lambda r, _: r.diagnosis.p_after)
    spare_readings: int = of(lambda r, _: r.diagnosis.spare)
    """beyond what parameters take"""
    lost_motions: tuple[str, ...] = of(lambda r, _: r.diagnosis.unidentifiable)
    effects_of_model: tuple[AdoptedEntry, ...] | None = of(
        lambda r, _: tuple(map(AdoptedEntry.of, r.beside)) or None, asked=True
    )
    """with --model: what the readings were diagnosed beside"""
    adopted: AdoptionReport | None = of(
        lambda _, adoption: maybe(AdoptionReport.of, adoption), asked=True
    )
    """with --adopt"""


@dataclass(frozen=True)
class LengthOfBoth:
    """A length that no frame changes, mm; 0 within ``expanded_mm`` is expected."""

    before_mm: Annotated[float, Quantity("before", "mm", decimals=4)]
    after_mm: Annotated[float, Quantity("after", "mm", decimals=4)]
    difference_mm: Annotated[float, Quantity("difference", "mm", "signed", 4)]
    expanded_mm: Annotated[float | None, Quantity("± U (95 %)", decimals=4)]


def lengths_of(apart: MachinesApart) -> dict[str, LengthOfBoth]:
    """All 26 by their names."""
    first, second = (1000.0 * apart.lengths_m).tolist()
    expanded_mm = [None] * len(first)
    if apart.expanded_m is not None:
        expanded_mm = (1000.0 * apart.expanded_m).tolist()
    columns = zip(INNER_NAMES, first, second, expanded_mm, strict=True)
    return {
        name: LengthOfBoth(earlier_m, later_m, later_m - earlier_m, half)
        for name, earlier_m, later_m, half in columns
    }


class ComparedEntry(Report):
    """One of the sessions."""

    of = Source[ComparedSession]()
    session: str = of(lambda r: r.name)
    postures: int = of(lambda r: len(r.machine.calibration.after.postures))
    left_out: tuple[int, ...] = of(lambda r: r.left_out)
    """named as mistakes by the diagnosis"""
    verdict: str | None = of(lambda r: None if r.diagnosis is None else r.diagnosis.verdict)
    """of the diagnosis; null: no noise is stated"""
    named: tuple[MissingEntry, ...] = of(
        lambda r: tuple(
            MissingEntry(*cause)
            for claim in (r.diagnosis.named if r.diagnosis else ())
            for cause in claim.causes
        )
    )


class HexaSlideComparisonReport(Report):
    """``compare --json`` of two sessions of postures."""

    of = Source[ComparedSessions]()
    schema_id: Literal["glidecal.hexaslide-comparison/1"] = schema(
        "glidecal.hexaslide-comparison/1"
    )
    before: ComparedEntry = of(lambda r: ComparedEntry.of(r.before))
    after: ComparedEntry = of(lambda r: ComparedEntry.of(r.after))
    changed: bool | None = of(lambda r: r.apart.changed)
    """whether p_value is below 0.01; null: not known"""
    p_value: float | None = of(lambda r: r.apart.p_value)
    """chance of such differences if the machine is the same"""
    platform_rms_mm: float = of(lambda r: 1000.0 * r.apart.rms_m)
    """over the box, frames laid over, effects included"""
    platform_largest_mm: float = of(lambda r: 1000.0 * r.apart.largest_m)
    platform_chance_mm: float | None = of(
        lambda r: None if r.apart.chance_m is None else 1000.0 * r.apart.chance_m
    )
    """r.m.s. of one machine by noise alone, at most, 95 %; null: not known"""
    lengths: dict[str, LengthOfBoth] = of(lambda r: lengths_of(r.apart))
    """26 that no frame changes"""
    laid_over: tuple[str, ...] = of(lambda r: r.apart.free)
    """motions that no reading shows"""
