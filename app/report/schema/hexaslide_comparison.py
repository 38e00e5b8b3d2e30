"""What ``compare`` tells of two sessions of postures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.evaluating.hexaslide_comparison import ComparedSession, ComparedSessions
from app.report.schema.document import Report, Source, schema
from app.report.schema.hexaslide import INNER_NAMES
from app.report.schema.hexaslide_diagnosis import MissingEntry
from calib.hexaslide.comparison import MachinesApart


@dataclass(frozen=True)
class LengthOfBoth:
    """A length that no frame changes, mm; 0 within ``expanded_mm`` is expected."""

    before_mm: float
    after_mm: float
    difference_mm: float
    expanded_mm: float | None


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
    left_out: tuple[int, ...] = of(lambda r: r.left_out, "named as mistakes by the diagnosis")
    verdict: str | None = of(
        lambda r: None if r.diagnosis is None else r.diagnosis.verdict,
        "of the diagnosis; null: no noise is stated",
    )
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
    changed: bool | None = of(
        lambda r: r.apart.changed, "whether p_value is below 0.01; null: not known"
    )
    p_value: float | None = of(
        lambda r: r.apart.p_value, "chance of such differences if the machine is the same"
    )
    platform_rms_mm: float = of(
        lambda r: 1000.0 * r.apart.rms_m, "over the box, frames laid over, effects included"
    )
    platform_largest_mm: float = of(lambda r: 1000.0 * r.apart.largest_m)
    platform_chance_mm: float | None = of(
        lambda r: None if r.apart.chance_m is None else 1000.0 * r.apart.chance_m,
        "r.m.s. of one machine by noise alone, at most, 95 %; null: not known",
    )
    lengths: dict[str, LengthOfBoth] = of(lambda r: lengths_of(r.apart), "26 that no frame changes")
    laid_over: tuple[str, ...] = of(lambda r: r.apart.free, "motions that no reading shows")
