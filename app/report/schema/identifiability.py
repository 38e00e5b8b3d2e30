"""What ``identifiability`` tells of any machine."""

from __future__ import annotations

from typing import Literal, Protocol

from app.report.schema.document import Report, Source, finite, maybe, schema
from calib.design.identifiability import (
    AddedMeasurement,
    ClassicalQr,
    Combination,
    Examination,
    SeenBy,
)


class Addition(Report):
    """The added posture that helps most, and the uncertainty then."""

    of = Source[AddedMeasurement]()
    posture: str = of(lambda added: added.where)
    standard_uncertainty_mm: float = of(lambda added: added.standard_uncertainty)


class DirectionEntry(Report):
    """A combination of parameters that is lost or weak."""

    of = Source[Combination]()
    name: str = of(lambda combination: combination.name)
    combination: dict[str, float] = of(
        lambda combination: combination.shares, "shares of the parameters"
    )
    standard_uncertainty_mm: float | None = of(
        lambda combination: combination.standard_uncertainty, "null where lost"
    )
    tool_mm: float | None = of(lambda combination: combination.tool_mm, "null where lost")
    cure: Addition | None = of(lambda combination: maybe(Addition.of, combination.added))


class PosturesSeen(Report):
    """How many steps, and where they come from."""

    of = Source[Examination]()
    count: int = of(lambda examined: examined.posture_count)
    source: str = of(lambda examined: examined.source)


class Seen(Protocol):
    """What a procedure sees of a machine, and perhaps more."""

    @property
    def seen(self) -> SeenBy:
        """What each machine has of it."""


of_seen = Source[Seen]()


class SeenReport(Report):
    """``identifiability --json``: what a procedure can and cannot see, of any machine."""

    schema_id: Literal["glidecal.identifiability/1"] = schema("glidecal.identifiability/1")
    machine: str = of_seen(lambda result: result.seen.machine)
    procedure: str = of_seen(lambda result: result.seen.examined.procedure)
    measured: tuple[str, ...] = of_seen(
        lambda result: result.seen.examined.measured, "axis_leg, or what else is read"
    )
    postures: PosturesSeen = of_seen(lambda result: PosturesSeen.of(result.seen.examined))
    parameters: tuple[str, ...] = of_seen(lambda result: result.seen.found.names)
    rank: int = of_seen(lambda result: result.seen.found.rank)
    parameter_count: int = of_seen(lambda result: len(result.seen.found.names))
    row_count: int = of_seen(lambda result: result.seen.found.row_count, "visits, or values")
    independent_row_count: int = of_seen(
        lambda result: result.seen.examined.independent_count,
        "different postures less zeros, or values",
    )
    limited_by: Literal["nothing", "too-few-postures"] = of_seen(lambda seen: seen.seen.limited_by)
    fewest_postures: int | None = of_seen(lambda result: result.seen.examined.fewest_postures)
    published_rank: int | None = of_seen(
        lambda result: result.seen.examined.published_rank,
        "of papers/001; null where it has none",
    )
    remark: str = of_seen(lambda result: result.seen.examined.remark)
    individually_identifiable: tuple[str, ...] = of_seen(
        lambda result: result.seen.found.individually_known
    )
    lost_directions: tuple[DirectionEntry, ...] = of_seen(
        lambda result: tuple(map(DirectionEntry.of, result.seen.unidentifiable))
    )
    weak_directions: tuple[DirectionEntry, ...] = of_seen(
        lambda result: tuple(map(DirectionEntry.of, result.seen.weak))
    )
    condition_number: float | None = of_seen(
        lambda result: finite(result.seen.found.condition_number),
        "of the identifiable combinations",
    )
    units: str = of_seen(lambda result: result.seen.examined.units)
    noise: str = of_seen(lambda result: result.seen.examined.noise_words)
    classical_qr: ClassicalQr = of_seen(lambda result: result.seen.qr)
