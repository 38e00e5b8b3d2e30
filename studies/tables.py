"""The tables of the page on the Hexa Slide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from app.planning.hexaslide import Request, hexaslide_planning
from app.report.text.hexaslide import lost_words
from calib.arrays import FloatArray
from calib.design.identifiability import classical_qr
from calib.design.refinement import ON_BOUND
from calib.hexaslide.planning import (
    PUBLISHED_SETS,
    HexaSlideSeen,
    conditions_at,
    differenced,
    look_at,
)
from calib.hexaslide.procedures import ProcedureKind

if TYPE_CHECKING:
    from studies.hexaslide import Studied

WIDTH = 98
SWINGS = "swing1,swing2,swing3,swing4,swing5,swing6"
SHOWN_SUBSETS = (
    ("pose-forward", "x,y,z"),
    ("pose-forward", "x,y,z,theta"),
    ("pose-forward", "x,y,z,phi"),
    ("pose-forward", "x,y,z,theta,psi,phi"),
    ("constraint-link", ""),
    ("constraint-link", "theta,psi"),
    ("constraint-link", "theta,psi,phi"),
    ("pose-forward", SWINGS),
    ("pose-forward", f"{SWINGS},theta,psi"),
    ("constraint-link", f"theta,psi,{SWINGS}"),
)
ROW_COUNT_SETS = {
    ProcedureKind.POSE_INVERSE: (8, 9, 100),
    ProcedureKind.POSITION: (15, 16, 17, 100),
    ProcedureKind.CONSTRAINT_LINK: (46, 47, 48, 55, 200),
}


def ranks(studies: Sequence[Studied]) -> str:
    """Table 1, corrected."""
    rows = []
    for entry in studies:
        sensitivity = entry.view.seen
        published = PUBLISHED_SETS[entry.kind]
        known_count = len(sensitivity.identifiability.individually_known)
        rows.append(
            [
                f"{published.case}, {entry.kind.value}",
                f"{len(sensitivity.identifiability.names)}",
                f"{sensitivity.examined.published_rank}",
                f"**{sensitivity.identifiability.rank}**",
                _short(lost_words(entry.view)),
                f"{known_count}",
                f"{entry.view.fewest}",
                f"{published.count}",
            ]
        )
    headings = "case, procedure|parameters|paper's rank|true rank|lost|known one by one|fewest "
    return table((headings + "postures|paper's postures").split("|"), rows)


def box(view: HexaSlideSeen) -> str:
    """Table 2."""
    rows = []
    for words, bounds in (("from", view.machine.box.lower), ("to", view.machine.box.upper)):
        places = [f"{value:g}" for value in bounds[:3]]
        rows.append([words, *places, *(f"{value:g}" for value in np.degrees(bounds[3:]))])
    return table(["", "x, m", "y, m", "z, m", "theta, °", "psi, °", "phi, °"], rows)


def row_counts(request: Request, kinds: Sequence[ProcedureKind]) -> str:
    """Rank and rows for several numbers of postures."""
    rows = []
    for kind, counts in ROW_COUNT_SETS.items():  # pose-forward as pose-inverse
        if kind not in kinds:
            continue
        texts = []
        for count in counts:
            view = look_at(
                hexaslide_planning(replace(request, procedure=kind.value, postures=count))
            )
            analysis = view.seen.identifiability
            texts.append(f"{count}: {analysis.row_count} rows, rank {analysis.rank}")
        rows.append([kind.value, "; ".join(texts)])
    return table(["procedure", "random postures: rows and rank"], rows)


def recipe(studies: Sequence[Studied], seed: int) -> str:
    """The paper's own recipe, differences and tolerance, at its number of postures and at many."""
    rows = []
    for entry in studies:
        if entry.kind is ProcedureKind.POSE_INVERSE:
            continue  # the paper has its derivatives in closed form
        paper = PUBLISHED_SETS[entry.kind].count
        generator = np.random.default_rng(seed)
        rank_by_count = {
            count: recipe_rank(entry.view, entry.view.machine.box.random(count, generator))
            for count in (paper, 4 * paper)
        }
        published_rank = f"{entry.view.seen.examined.published_rank}"
        rows.append(
            [
                entry.kind.value,
                published_rank,
                *(f"{count}: {r}" for count, r in rank_by_count.items()),
            ]
        )
        rows[-1] += [f"{entry.view.seen.identifiability.rank}", gap_words(entry.view)]
    headings = ["procedure", "paper", "recipe, paper's postures", "recipe, four times as many"]
    return table([*headings, "true", "gap with exact derivatives"], rows)


def gap_words(view: HexaSlideSeen) -> str:
    """The last singular value that is seen by the first that is not."""
    singular, rank = view.seen.identifiability.singular_values, view.seen.identifiability.rank
    if rank == len(singular):
        return "nothing is lost"
    return f"{singular[rank - 1] / singular[rank]:.0e}".replace("e+", "e")


def recipe_rank(view: HexaSlideSeen, postures: FloatArray) -> int:
    """Differences of 1e-7 and the tolerance of papers/001, QR without pivoting."""
    names = view.seen.identifiability.names
    rows = differenced(view.procedure, view.machine, postures)
    return len(names) - len(classical_qr(rows.reshape(-1, len(names)), names).flagged)


def conditions(studies: Sequence[Studied]) -> str:
    """Tables 3 to 6, and the share of the best postures on a bound and in a corner of the box."""
    rows = []
    for entry in studies:
        published, best = PUBLISHED_SETS[entry.kind], entry.best
        low, middle, high = np.percentile(entry.random, [5.0, 50.0, 95.0])
        on_bound = _on_bound(entry)
        rows.append(
            [
                f"{published.table}",
                entry.kind.value,
                f"{published.count}: {published.random:g} → {published.best:g}",
                f"{entry.view.fewest}: {number(middle)} ({number(low)} … {number(high)})",
                f"**{best.condition_number:.1f}**",
                f"{middle / best.condition_number:.0f}",
                f"{on_bound.any(axis=1).mean():.0%}",
                f"{on_bound.all(axis=1).mean():.0%}",
            ]
        )
    headings = "table|procedure|paper: random → optimum|random here, median (5 … 95 %)|best here|"
    return table((headings + "random by best|on a bound|in a corner").split("|"), rows)


def _on_bound(entry: Studied) -> NDArray[np.bool_]:
    """Which coordinates ``(p, 6)`` of the best postures are at an end of the box."""
    box = entry.view.machine.box
    share = (entry.postures - box.lower) / (box.upper - box.lower)
    return (share < ON_BOUND) | (share > 1.0 - ON_BOUND)


def in_units(entry: Studied) -> str:
    """Condition numbers of the best set, metres and millimetres."""
    best = conditions_at(entry.view, entry.postures)
    metres, millimetres = (number(best[units]) for units in ("m, rad", "mm, rad"))
    return (
        f"the best set of {entry.kind.value} has {metres} in metres, {millimetres} in millimetres"
    )


def subsets(request: Request, kinds: Sequence[ProcedureKind]) -> str:
    """Ranks for any measured components, beside a link, and with encoders."""
    rows = []
    for kind, names in SHOWN_SUBSETS:
        if kind not in kinds:
            continue
        measured = tuple(names.split(",")) if names else ()
        view = look_at(hexaslide_planning(replace(request, procedure=kind, measured=measured)))
        analysis = view.seen.identifiability
        rows.append(
            [
                f"`{','.join(view.procedure.read)}`".replace(SWINGS, "swing1…6"),
                f"{analysis.rank} of {len(analysis.names)}",
                _short(lost_words(view)),
                f"{view.fewest}",
                number(view.conditions["m, rad"]),
            ]
        )
    return table(["measured", "rank", "lost", "fewest postures", "condition"], rows)


def _short(motions: str) -> str:
    """``turns XYZ, shifts XYZ`` of the platform's frame, ``base X`` for a turn of the base."""
    for words, word in (
        ("platform frame turned about its", "turns"),
        ("platform frame shifted along its", "shifts"),
        ("base turned about", "base"),
    ):
        motions = motions.replace(words, word)
    return motions.replace("X, Y, Z", "XYZ").replace(";", ",")


def joints(studies: Sequence[Studied]) -> str:
    """The same searches between the ends of the rails."""
    rows = []
    for entry in studies:
        if entry.in_joints is None:
            continue
        design, box = entry.in_joints, entry.in_box
        angles = np.degrees(np.abs(design.coordinates[:, 3:])).max()
        rows.append(
            [
                f"{entry.kind.value}, {len(design.coordinates)}",
                f"{box.condition_number:.1f}",
                f"{design.condition_number:.1f}",
                f"{box.condition_number / design.condition_number:.1f}",
                f"{design.refined.on_bound / design.coordinates.size:.0%}",
                f"{angles:.0f}",
            ]
        )
    headings = "procedure, postures|box|rails|gain|sliders at an end|largest angle, °"
    return table(headings.split("|"), rows)


def random_words(link: Studied) -> str:
    """The paper's own number of postures for the constraint link."""
    low, middle, high = (number(q) for q in np.percentile(link.random_of_paper, [5, 50, 95]))
    assert link.few is not None
    return filled(
        "The 46 postures of Table 6 show 46 of the 48 combinations, and other ones in each set. "
        f"Over those, random sets of 46 have the median {middle} ({low} … {high}), and a search "
        f"in the box with --few finds {link.few.condition_number:.1f}."
    )


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    first, *body = (f"| {' | '.join(line)} |" for line in (headings, *rows))
    return "\n".join([first, "|---" * len(headings) + "|", *body])


def filled(text: str) -> str:
    """One paragraph in lines."""
    return fill(text, WIDTH, break_on_hyphens=False, break_long_words=False)


def number(value: float) -> str:
    """About four digits."""
    if value < 1000.0:
        return f"{value:.1f}"
    return f"{value:.0f}" if value < 10_000.0 else f"{value:.3e}".replace("e+0", "e")
