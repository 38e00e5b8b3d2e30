"""What ``align --json`` writes."""

from __future__ import annotations

from typing import Annotated, Literal

from app.measuring.aligning import Aligned
from app.report.schema.document import Report, at, made, schema
from calib.arrays import LEG_NAMES
from calib.tripod.effects.effect import AROUND, PAIRS


class FigureEntry(Report):
    """A figure of a pair of rails with its expanded uncertainty (95 %)."""

    axes: str
    value: float
    expanded: float


class MoveEntry(Report):
    """By what one end of a rail is to be moved, positive towards the positive axis, mm."""

    rail: str
    support_mm: float
    towards: str
    move_mm: float
    expanded_mm: float
    needed: bool


def _leans(found: Aligned) -> tuple[FigureEntry, ...]:
    values = zip(PAIRS, found.found.lean_mrad.tolist(), found.found.expanded[:3], strict=True)
    return tuple(FigureEntry(axes=a, value=v, expanded=float(u)) for a, v, u in values)


def _distances(found: Aligned) -> tuple[FigureEntry, ...]:
    values = zip(AROUND, found.found.distance_mm.tolist(), found.found.expanded[3:], strict=True)
    return tuple(FigureEntry(axes=a, value=v, expanded=float(u)) for a, v, u in values)


def _moves(found: Aligned) -> tuple[MoveEntry, ...]:
    return tuple(
        MoveEntry(
            rail=LEG_NAMES[one.rail],
            support_mm=one.support_mm,
            towards=LEG_NAMES[one.towards],
            move_mm=one.move_mm,
            expanded_mm=one.expanded_mm,
            needed=one.needed,
        )
        for one in found.shims
    )


class AlignmentReport(Report):
    """``align --json``: squareness, distances, and the moves of the two rails that do not stay."""

    schema_id: Literal["glidecal.alignment/1"] = schema("glidecal.alignment/1")
    session: str = at("name")
    reference: str = at("found.reference", "the rail that stays")
    squareness_mrad: Annotated[tuple[FigureEntry, ...], made(_leans)] = at(
        "found", "positive: less than a right angle"
    )
    distance_mm: Annotated[tuple[FigureEntry, ...], made(_distances)] = at(
        "found", "the first lies so much further along the third axis"
    )
    moves: Annotated[tuple[MoveEntry, ...], made(_moves)] = at("found")
    left_mm: float = at("found.found.left_mm", "r.m.s. that the fit leaves")
    noise_mm: float = at("found.found.noise_mm", "of a reading")
