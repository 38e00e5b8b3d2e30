"""docs/hexaslide.md: the tables of papers/001 beside what the program finds.

python -m studies.hexaslide          some minutes on one core
python -m studies.hexaslide --quick  seconds: few random sets, one start, no page of record
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import jinja2
import numpy as np

from app.planning.hexaslide import Request, hexaslide_planning, posture_table
from calib.arrays import FloatArray
from calib.errors import GlidecalError
from calib.hexaslide.planning import (
    PUBLISHED_SETS,
    HexaSlideSeen,
    Scale,
    conditions_by_units,
    look_at,
    sensitivity,
)
from calib.hexaslide.procedures import ProcedureKind
from calib.hexaslide.search import BestPostures, Search, SearchSpace, best_postures
from protocols.hexaslide import load_hexaslide
from studies import THREADS, tables

PAGE = Path(__file__).parents[1] / "docs" / "hexaslide.md"
SETS = "posture_sets"
"""The folder beside the page with a table of the best postures for each procedure."""

TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent),
    undefined=jinja2.StrictUndefined,
    autoescape=False,  # the page is Markdown
    trim_blocks=True,
    keep_trailing_newline=True,
)
SEED = 0


@dataclass(frozen=True)
class Effort:
    """How much is computed."""

    random_sets: int
    starts: int
    few_starts: int
    joint_starts: int


FULL = Effort(random_sets=400, starts=20, few_starts=2, joint_starts=2)
QUICK = Effort(random_sets=8, starts=1, few_starts=1, joint_starts=0)


@dataclass(frozen=True, eq=False)
class Studied:
    """One procedure: what it sees, condition numbers of random sets ``(n,)``, the best set."""

    view: HexaSlideSeen
    random: FloatArray
    random_of_paper: FloatArray
    best: BestPostures
    few: BestPostures | None
    in_box: BestPostures
    in_joints: BestPostures | None

    @property
    def kind(self) -> ProcedureKind:
        """Which procedure."""
        return self.view.procedure.kind

    @property
    def postures(self) -> FloatArray:
        """The best postures ``(p, 6)``."""
        return self.best.coordinates


def kinds_of(request: Request) -> tuple[ProcedureKind, ...]:
    """The procedures that this machine allows: without a link none that uses it."""
    linked = load_hexaslide(request.machine_file).constraint_link is not None
    return tuple(
        kind for kind in ProcedureKind if linked or kind is not ProcedureKind.CONSTRAINT_LINK
    )


def study(request: Request, effort: Effort) -> Studied:
    """Everything that the page tells of a procedure."""
    view = look_at(hexaslide_planning(request))
    kind = view.procedure.kind
    random = random_conditions(view, view.fewest, effort.random_sets)
    paper = PUBLISHED_SETS[kind].count
    few_random = (
        random if paper == view.fewest else random_conditions(view, paper, effort.random_sets)
    )
    best = searched(view, view.fewest, effort.starts)
    few = None
    if paper < view.fewest:
        few = searched(view, paper, effort.few_starts, few=True)
    # a link has the most postures and the slowest search
    starts = effort.joint_starts if kind is not ProcedureKind.CONSTRAINT_LINK else 0
    in_box = searched(view, view.fewest, starts) if starts else best
    in_joints = searched(view, view.fewest, starts, space="joints") if starts else None
    return Studied(view, random, few_random, best, few, in_box, in_joints)


def searched(
    view: HexaSlideSeen, count: int, starts: int, *, few: bool = False, space: SearchSpace = "box"
) -> BestPostures:
    """As ``glidecal postures hexaslide --criterion condition``."""
    search = Search(seed=SEED, starts=starts, few=few, space=space)
    return best_postures(view.procedure, view.machine, count, search)


def random_conditions(view: HexaSlideSeen, count: int, sets: int) -> FloatArray:
    """Condition numbers ``(sets,)``, metres and radians, of what so many random postures see."""
    generator, scale = np.random.default_rng(SEED), Scale.of(view.procedure, view.machine)
    conditions = []
    for _ in range(sets):
        postures = view.machine.box.random(count, generator)
        rows = sensitivity(view.procedure, view.machine, postures).jacobian
        rank = min(view.seen.identifiability.rank, len(rows))
        conditions.append(conditions_by_units(view.procedure, rows, rank, scale)["m, rad"])
    return np.array(conditions)


def page(request: Request, effort: Effort) -> tuple[str, dict[str, str]]:
    """The page, every table in its sentences, and the table of the best postures by procedure."""
    begin = time.perf_counter()
    kinds = kinds_of(request)
    studies = [study(replace(request, procedure=kind.value), effort) for kind in kinds]
    linked = studies[-1] if studies[-1].kind is ProcedureKind.CONSTRAINT_LINK else None
    parts = {
        "ranks": tables.ranks(studies),
        "row_counts": tables.row_counts(request, kinds),
        "recipe": tables.recipe(studies, SEED),
        "box": tables.box(studies[0].view),
        "conditions": tables.conditions(studies),
        "of_link": tables.random_words(linked) if linked else "",
        "subsets": tables.subsets(request, kinds),
        "in_units": tables.in_units(studies[0]),
        "joints": tables.joints(studies),
    }
    text = TEMPLATES.get_template("hexaslide.md.jinja").render(
        **parts,
        effort=effort,
        seed=SEED,
        threads=THREADS,
        seconds=round(time.perf_counter() - begin),
    )
    return text, {entry.kind.value: posture_table(entry.postures) for entry in studies}


def main() -> None:
    """Write the page, and the sets of postures beside it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--starts", type=int)
    parser.add_argument("--machine-file", type=Path)
    parser.add_argument("--output", type=Path, default=PAGE)
    options = parser.parse_args()
    effort = QUICK if options.quick else FULL
    if options.starts:
        few, joint = (min(options.starts, n) for n in (effort.few_starts, effort.joint_starts))
        effort = Effort(effort.random_sets, options.starts, few, joint)
    request = Request(ProcedureKind.POSE_INVERSE.value, options.machine_file, seed=SEED)
    try:
        text, posture_sets = page(request, effort)
    except GlidecalError as problem:
        parser.exit(1, f"studies.hexaslide: {problem}\n")
    options.output.write_text(text, encoding="utf-8", newline="\n")
    folder = options.output.parent / SETS
    folder.mkdir(exist_ok=True)
    for kind, postures in posture_sets.items():
        path = folder / f"hexaslide-{kind}.csv"
        path.write_text(postures, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
