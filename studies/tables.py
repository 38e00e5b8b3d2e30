"""The tables of the page on the Hexa Slide."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

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
SIMULATED_POSTURES = "80"
SHOWN_SUBSETS = (
    "x,y,z",
    "x,y,z,theta",
    "x,y,z,psi",
    "x,y,z,phi",
    "x,y,z,theta,psi",
    "x,y,z,theta,psi,phi",
    "x,y,theta,psi,phi",
    "z,theta,psi",
    "x,y",
    "z",
    "theta,psi",
    "theta,psi,phi",
)
BESIDE_THE_LINK = ("", "theta", "theta,psi", "phi", "theta,psi,phi", "x,y,z", "x,y,z,theta,psi,phi")
SWINGS = "swing1,swing2,swing3,swing4,swing5,swing6"
ENCODED = (
    ("pose-forward", "swing1"),
    ("pose-forward", SWINGS),
    ("pose-forward", f"{SWINGS},theta,psi"),
    ("pose-forward", "x,y,z,swing1,turn1"),
    ("constraint-link", "swing1"),
    ("constraint-link", "swing1,swing3,swing5"),
    ("constraint-link", SWINGS),
    ("constraint-link", f"theta,psi,{SWINGS}"),
)
ROW_COUNT_SETS = {
    ProcedureKind.POSE_INVERSE: (8, 9, 100),
    ProcedureKind.POSE_FORWARD: (8, 9, 100),
    ProcedureKind.POSITION: (15, 16, 17, 100),
    ProcedureKind.CONSTRAINT_LINK: (46, 47, 48, 55, 200),
}


def ranks(studies: Sequence[Studied]) -> str:
    """Table 1, corrected."""
    rows = []
    for one in studies:
        seen = one.view.seen
        published = PUBLISHED_SETS[one.kind]
        known = len(seen.found.individually_known)
        rows.append(
            [
                f"{published.case}, {one.kind.value}",
                f"{len(seen.found.names)}",
                f"{seen.examined.published_rank}",
                f"**{seen.found.rank}**",
                lost_words(one.view),
                f"{known}",
                f"{one.view.fewest}",
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


def row_counts(asked: Request, kinds: Sequence[ProcedureKind]) -> str:
    """Rank and rows for several numbers of postures."""
    rows = []
    for kind, counts in ROW_COUNT_SETS.items():
        if kind not in kinds:
            continue
        said = []
        for count in counts:
            view = look_at(hexaslide_planning(replace(asked, procedure=kind.value, postures=count)))
            found = view.seen.found
            said.append(f"{count}: {found.row_count} rows, rank {found.rank}")
        rows.append([kind.value, "; ".join(said)])
    return table(["procedure", "random postures: rows and rank"], rows)


def recipe(studies: Sequence[Studied], seed: int) -> str:
    """The paper's own recipe, differences and tolerance, at its number of postures and at many."""
    rows = []
    for one in studies:
        if one.kind is ProcedureKind.POSE_INVERSE:
            continue  # the paper has its derivatives in closed form
        paper = PUBLISHED_SETS[one.kind].count
        generator = np.random.default_rng(seed)
        found = {
            count: recipe_rank(one.view, one.view.machine.box.random(count, generator))
            for count in (paper, 4 * paper)
        }
        said = f"{one.view.seen.examined.published_rank}"
        rows.append([one.kind.value, said, *(f"{count}: {r}" for count, r in found.items())])
        rows[-1] += [f"{one.view.seen.found.rank}", gap_words(one.view)]
    headings = ["procedure", "paper", "recipe, paper's postures", "recipe, four times as many"]
    return table([*headings, "true", "gap with exact derivatives"], rows)


def gap_words(view: HexaSlideSeen) -> str:
    """The last singular value that is seen by the first that is not."""
    singular, rank = view.seen.found.singular_values, view.seen.found.rank
    if rank == len(singular):
        return "nothing is lost"
    return f"{singular[rank - 1] / singular[rank]:.0e}".replace("e+", "e")


def recipe_rank(view: HexaSlideSeen, postures: FloatArray) -> int:
    """Differences of 1e-7 and the tolerance of papers/001, QR without pivoting."""
    names = view.seen.found.names
    rows = differenced(view.procedure, view.machine, postures)
    return len(names) - len(classical_qr(rows.reshape(-1, len(names)), names).flagged)


def conditions(studies: Sequence[Studied]) -> str:
    """Tables 3 to 6."""
    rows = []
    for one in studies:
        published, best = PUBLISHED_SETS[one.kind], one.best
        low, middle, high = np.percentile(one.random["m, rad"], [5.0, 50.0, 95.0])
        rows.append(
            [
                f"{published.table}",
                one.kind.value,
                f"{published.count}: {published.random:g} → {published.best:g}",
                f"{one.view.fewest}: {number(middle)} ({number(low)} … {number(high)})",
                f"**{best.condition_number:.1f}**",
                f"{np.median(best.values):.1f} ({min(best.values):.1f} … {max(best.values):.1f})",
                f"{middle / best.condition_number:.0f}",
            ]
        )
    headings = "table|procedure|paper: random → optimum|random here, median (5 … 95 %)|best here|"
    return table((headings + "all starts, median|random by best").split("|"), rows)


def bounds(studies: Sequence[Studied]) -> str:
    """Where the optimum postures stand."""
    rows = []
    for one in studies:
        box = one.view.machine.box
        share = (one.postures - box.lower) / (box.upper - box.lower)
        on_bound = (share < ON_BOUND) | (share > 1.0 - ON_BOUND)
        rows.append(
            [
                one.kind.value,
                f"{on_bound.mean():.0%}",
                f"{on_bound.any(axis=1).mean():.0%}",
                f"{on_bound.all(axis=1).mean():.0%}",
            ]
        )
    headings = "procedure|coordinates on a bound|postures with one at least|postures in a corner"
    return table(headings.split("|"), rows)


def units(studies: Sequence[Studied]) -> str:
    """The same sets in other units."""
    rows = []
    for one in studies:
        best = conditions_at(one.view, one.postures)
        rows.append(
            [
                one.kind.value,
                *(
                    f"{number(float(np.median(one.random[units])))} → {number(best[units])}"
                    for units in best
                ),
            ]
        )
    return table(["procedure, random median → best", *studies[0].random], rows)


def more(studies: Sequence[Studied]) -> str:
    """What more postures give."""
    rows = []
    for one in studies:
        found = {one.view.fewest: one.best.condition_number, **one.more}
        said = "; ".join(f"{count}: {value:.1f}" for count, value in found.items())
        rows.append([one.kind.value, said])
    return table(["procedure", "postures: best condition number"], rows)


def subsets(asked: Request, kinds: Sequence[ProcedureKind]) -> dict[str, str]:
    """Ranks for any measured components, beside a link, and with encoders."""
    linked = ProcedureKind.CONSTRAINT_LINK in kinds
    link = [("constraint-link", names) for names in BESIDE_THE_LINK if linked]
    encoded = [(kind, names) for kind, names in ENCODED if kind in kinds]
    return {
        "subsets": _subsets(asked, [("pose-forward", names) for names in SHOWN_SUBSETS]),
        "beside_link": _subsets(asked, link) if linked else "",
        "encoders": _subsets(asked, encoded),
    }


def _subsets(asked: Request, shown: Sequence[tuple[str, str]]) -> str:
    rows = []
    for kind, names in shown:
        measured = tuple(names.split(",")) if names else ()
        view = look_at(hexaslide_planning(replace(asked, procedure=kind, measured=measured)))
        found = view.seen.found
        rows.append(
            [
                ", ".join(view.procedure.read).replace(SWINGS.replace(",", ", "), "swing1 … 6"),
                f"{found.rank} of {len(found.names)}",
                lost_words(view),
                f"{view.fewest}",
                number(view.conditions["m, rad"]),
            ]
        )
    headings = "measured|rank|lost|fewest postures|condition number, random postures"
    return table(headings.split("|"), rows)


def joints(studies: Sequence[Studied]) -> str:
    """The same searches between the ends of the rails."""
    rows = []
    for one in studies:
        if one.in_joints is None:
            continue
        found, box = one.in_joints, one.in_box
        angles = np.degrees(np.abs(found.coordinates[:, 3:])).max()
        rows.append(
            [
                f"{one.kind.value}, {len(found.coordinates)}",
                f"{box.condition_number:.1f}",
                f"{found.condition_number:.1f}",
                f"{box.condition_number / found.condition_number:.1f}",
                f"{found.refined.on_bound / found.coordinates.size:.0%}",
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
        "With the 46 postures of Table 6 the constraint link shows 46 of its 48 combinations. Over "
        f"those, random sets of 46 have the median {middle} ({low} … {high}), and a search with "
        f"--few finds {link.few.condition_number:.1f}; the paper has 601200 and 145230. Without "
        "--few the search refuses so few: two combinations, others for each set, stay unknown, so "
        "no calibration comes of them and the smaller number is no better one."
    )


def simulated(kinds: Sequence[ProcedureKind], machine_file: Path | None) -> str:
    """Simulate and solve once for each procedure."""
    own = () if machine_file is None else ("--machine-file", str(machine_file.absolute()))
    headings = [
        "procedure",
        "combinations",
        "residual, mm",
        "position at postures kept out, mm",
        "angle there, mrad",
        "constant motion left",
    ]
    with tempfile.TemporaryDirectory() as folder:
        return table(headings, [_row(kind, Path(folder), own) for kind in kinds])


def _row(kind: ProcedureKind, folder: Path, own: Sequence[str]) -> list[str]:
    measured, true = f"{kind.value}.json", f"{kind.value}-true.json"
    wanted = (
        "--procedure",
        kind.value,
        "--postures",
        SIMULATED_POSTURES,
        "--truth",
        true,
        "--seed",
        "1",
    )
    _glidecal(folder, "simulate", "-o", measured, "--machine", "hexaslide", *wanted, *own)
    found = json.loads(_glidecal(folder, "solve", measured, "--truth", true, "--json"))
    before, after = found["truth"]["before"], found["truth"]["after"]
    residuals = (found[when]["length_mm"] for when in ("rms_before", "rms_after"))
    return [
        kind.value,
        f"{found['rank']} of {found['parameter_count']}",
        " → ".join(_figure(value) for value in residuals),
        f"{before['position_rms_mm']:.3f} → {after['position_rms_mm']:.4f}",
        f"{before['angle_rms_mrad']:.3f} → {after['angle_rms_mrad']:.4f}",
        _motions(after) if found["lost_count"] else "none",
    ]


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _motions(apart: dict[str, Any]) -> str:
    said = (
        ("platform turned {:.2f} mrad", apart["platform_frame_turned_mrad"]),
        ("shifted {:.2f} mm", apart["platform_frame_shifted_mm"]),
        ("base turned {:.2f} mrad", apart["base_turned_mrad"]),
    )
    return ", ".join(words.format(size) for words, size in said if size > 0.0)


def _glidecal(folder: Path, *arguments: str) -> str:
    """Raises RuntimeError with its own words where the program refuses."""
    done = subprocess.run(
        [sys.executable, "-m", "app", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
        timeout=120,
    )
    if done.returncode:
        raise RuntimeError(done.stderr)
    return done.stdout


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def filled(text: str) -> str:
    """One paragraph in lines."""
    return fill(text, WIDTH, break_on_hyphens=False, break_long_words=False)


def number(value: float) -> str:
    """About four digits."""
    if value < 1000.0:
        return f"{value:.1f}"
    return f"{value:.0f}" if value < 10_000.0 else f"{value:.3e}".replace("e+0", "e")
