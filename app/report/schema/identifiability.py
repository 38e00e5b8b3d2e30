"""What ``identifiability`` tells of any machine."""

from __future__ import annotations

from typing import Literal, Protocol

from app.report.schema.document import Report, Source, finite, schema
from calib.design.identifiability import ClassicalQr, Combination, Examination, SeenBy


class PosturesSeen(Report):
    """How many steps, and where they come from."""

    of = Source[Examination]()
    count: int = of(lambda r: r.posture_count)
    source: str = of(lambda r: r.source)


class Seen(Protocol):
    """What a procedure sees of a machine, and perhaps more."""

    @property
    def seen(self) -> SeenBy:
        """What each machine has of it."""


of_seen = Source[Seen]()


class SeenReport(Report):
    """``identifiability --json``: what a procedure can and cannot see, of any machine."""

    schema_id: Literal["glidecal.identifiability/1"] = schema("glidecal.identifiability/1")
    machine: str = of_seen(lambda r: r.seen.machine)
    procedure: str = of_seen(lambda r: r.seen.examined.procedure)
    measured: tuple[str, ...] = of_seen(
        lambda r: r.seen.examined.measured, "axis_leg, or what else is read"
    )
    postures: PosturesSeen = of_seen(lambda r: PosturesSeen.of(r.seen.examined))
    parameters: tuple[str, ...] = of_seen(lambda r: r.seen.found.names)
    rank: int = of_seen(lambda r: r.seen.found.rank)
    parameter_count: int = of_seen(lambda r: len(r.seen.found.names))
    row_count: int = of_seen(lambda r: r.seen.found.row_count, "visits, or values")
    independent_row_count: int = of_seen(
        lambda r: r.seen.examined.independent_count, "different postures less zeros, or values"
    )
    limited_by: Literal["nothing", "too-few-postures"] = of_seen(lambda r: r.seen.limited_by)
    fewest_postures: int | None = of_seen(lambda r: r.seen.examined.fewest_postures)
    published_rank: int | None = of_seen(
        lambda r: r.seen.examined.published_rank, "of papers/001; null where it has none"
    )
    remark: str = of_seen(lambda r: r.seen.examined.remark)
    individually_identifiable: tuple[str, ...] = of_seen(lambda r: r.seen.found.individually_known)
    lost_directions: tuple[Combination, ...] = of_seen(lambda r: r.seen.unidentifiable)
    weak_directions: tuple[Combination, ...] = of_seen(lambda r: r.seen.weak)
    condition_number: float | None = of_seen(
        lambda r: finite(r.seen.found.condition_number), "of the identifiable combinations"
    )
    units: str = of_seen(lambda r: r.seen.examined.units)
    noise: str = of_seen(lambda r: r.seen.examined.noise_words)
    classical_qr: ClassicalQr = of_seen(lambda r: r.seen.qr)
