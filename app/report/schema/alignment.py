"""What ``align --json`` writes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from app.measuring.aligning import RailAlignment
from app.report.schema.document import Report, Source, schema
from calib.arrays import LEG_NAMES, FloatArray
from calib.tripod.alignment import Shim
from calib.tripod.effects.effect import AROUND, PAIRS


@dataclass(frozen=True)
class FigureEntry:
    """A figure of a pair of rails with its expanded uncertainty (95 %)."""

    axes: str
    value: float
    expanded: float


class MoveEntry(Report):
    """Move of one end of a rail, positive towards the positive axis, mm."""

    of = Source[Shim]()
    rail: str = of(lambda r: LEG_NAMES[r.rail])
    support_mm: float = of(lambda r: r.support_mm)
    towards: str = of(lambda r: LEG_NAMES[r.towards])
    move_mm: float = of(lambda r: r.move_mm)
    expanded_mm: float = of(lambda r: r.expanded_mm)
    needed: bool = of(lambda r: r.needed)


def _figures(
    pairs: Iterable[str], values: FloatArray, expanded: FloatArray
) -> tuple[FigureEntry, ...]:
    return tuple(map(FigureEntry, pairs, values.tolist(), expanded.tolist()))


class AlignmentReport(Report):
    """``align --json``: squareness, distances, and the moves of the two rails that do not stay."""

    of = Source[str, RailAlignment]()
    schema_id: Literal["glidecal.alignment/1"] = schema("glidecal.alignment/1")
    session: str = of(lambda session, _: session)
    reference: str = of(lambda _, r: r.reference)
    """the rail that stays"""
    squareness_mrad: tuple[FigureEntry, ...] = of(
        lambda _, r: _figures(PAIRS, r.alignment.lean_mrad, r.alignment.expanded[:3])
    )
    """positive: less than a right angle"""
    distance_mm: tuple[FigureEntry, ...] = of(
        lambda _, r: _figures(AROUND, r.alignment.distance_mm, r.alignment.expanded[3:])
    )
    """the first lies so much further along the third axis"""
    moves: tuple[MoveEntry, ...] = of(lambda _, r: tuple(map(MoveEntry.of, r.shims)))
    """to square, or to where the machine file has drives that are not meant to be"""
    left_mm: float = of(lambda _, r: r.alignment.left_mm)
    """r.m.s. that the fit leaves"""
    noise_mm: float = of(lambda _, r: r.alignment.noise_mm)
    """of a reading"""
    chance: float = of(lambda _, r: r.alignment.chance)
    """probability that noise alone leaves so much; below 0.001 something else acts, and the
    uncertainties leave it out
    """
