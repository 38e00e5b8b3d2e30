"""What ``align --json`` writes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from app.report.schema.document import Report, at, made, schema
from calib.arrays import LEG_NAMES
from calib.tripod.alignment import Alignment
from calib.tripod.effects.effect import AROUND, PAIRS

LegName = Annotated[str, made(LEG_NAMES.__getitem__)]


@dataclass(frozen=True)
class FigureEntry:
    """A figure of a pair of rails with its expanded uncertainty (95 %)."""

    axes: str
    value: float
    expanded: float


class MoveEntry(Report):
    """By what one end of a rail is to be moved, positive towards the positive axis, mm."""

    rail: LegName
    support_mm: float
    towards: LegName
    move_mm: float
    expanded_mm: float
    needed: bool


def _leans(alignment: Alignment) -> tuple[FigureEntry, ...]:
    return tuple(
        map(FigureEntry, PAIRS, alignment.lean_mrad.tolist(), alignment.expanded[:3].tolist())
    )


def _distances(alignment: Alignment) -> tuple[FigureEntry, ...]:
    return tuple(
        map(FigureEntry, AROUND, alignment.distance_mm.tolist(), alignment.expanded[3:].tolist())
    )


class AlignmentReport(Report):
    """``align --json``: squareness, distances, and the moves of the two rails that do not stay."""

    schema_id: Literal["glidecal.alignment/1"] = schema("glidecal.alignment/1")
    session: str = at("name")
    reference: str = at("found.reference", "the rail that stays")
    squareness_mrad: Annotated[tuple[FigureEntry, ...], made(_leans)] = at(
        "found.found", "positive: less than a right angle"
    )
    distance_mm: Annotated[tuple[FigureEntry, ...], made(_distances)] = at(
        "found.found", "the first lies so much further along the third axis"
    )
    moves: tuple[MoveEntry, ...] = at("found.shims")
    left_mm: float = at("found.found.left_mm", "r.m.s. that the fit leaves")
    noise_mm: float = at("found.found.noise_mm", "of a reading")
