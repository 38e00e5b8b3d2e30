"""What ``identifiability`` tells of any machine."""

from __future__ import annotations

from typing import Literal

from app.report.schema.document import Report, Source, finite, schema
from calib.design.identifiability import ClassicalQr, Combination, Examination, SeenBy


class PosturesSeen(Report):
    """How many steps, and where they come from."""

    of = Source[Examination]()
    count: int = of(lambda r: r.posture_count)
    source: str = of(lambda r: r.source)


of_seen = Source[SeenBy, object]()
"""What each machine has of it, and what one of them adds."""


class SeenReport(Report):
    """``identifiability --json``: what a procedure can and cannot see, of any machine."""

    schema_id: Literal["glidecal.identifiability/1"] = schema("glidecal.identifiability/1")
    machine: str = of_seen(lambda r, _: r.machine)
    procedure: str = of_seen(lambda r, _: r.examined.procedure)
    measured: tuple[str, ...] = of_seen(lambda r, _: r.examined.measured)
    """axis_leg, or what else is read"""
    postures: PosturesSeen = of_seen(lambda r, _: PosturesSeen.of(r.examined))
    parameters: tuple[str, ...] = of_seen(lambda r, _: r.identifiability.names)
    rank: int = of_seen(lambda r, _: r.identifiability.rank)
    parameter_count: int = of_seen(lambda r, _: len(r.identifiability.names))
    row_count: int = of_seen(lambda r, _: r.identifiability.row_count)
    """visits, or values"""
    independent_row_count: int = of_seen(lambda r, _: r.examined.independent_count)
    """different postures less zeros, or values"""
    limited_by: Literal["nothing", "too-few-postures"] = of_seen(lambda r, _: r.limited_by)
    fewest_postures: int | None = of_seen(lambda r, _: r.examined.fewest_postures)
    published_rank: int | None = of_seen(lambda r, _: r.examined.published_rank)
    """of papers/001; null where it has none"""
    remark: str = of_seen(lambda r, _: r.examined.remark)
    individually_identifiable: tuple[str, ...] = of_seen(
        lambda r, _: r.identifiability.individually_known
    )
    lost_directions: tuple[Combination, ...] = of_seen(lambda r, _: r.unidentifiable)
    weak_directions: tuple[Combination, ...] = of_seen(lambda r, _: r.weak)
    condition_number: float | None = of_seen(
        lambda r, _: finite(r.identifiability.condition_number)
    )
    """of the identifiable combinations"""
    units: str = of_seen(lambda r, _: r.examined.units)
    noise: str = of_seen(lambda r, _: r.examined.noise_words)
    classical_qr: ClassicalQr = of_seen(lambda r, _: r.qr)
