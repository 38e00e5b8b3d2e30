"""Make docs/hexaslide.md whole: the tables of papers/001 beside what the program finds.

python docs/make_hexaslide.py          about five minutes on one core
python docs/make_hexaslide.py --quick  seconds: few random sets, one start, no page of record
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from hexaslide_page import (
    BOX,
    BOX_NOTE,
    CONDITIONS,
    INTRO,
    MORE,
    OWN,
    RANKS,
    RECIPE,
    ROW_COUNTS,
    SETS,
    SIMULATED,
    SIMULATED_NOTE,
    SUBSETS,
    THREADS,
    UNITS,
    code,
)
from hexaslide_simulated import simulated_table
from hexaslide_study import FULL, QUICK, SEED, Effort, kinds_of, study
from hexaslide_tables import (
    bounds_table,
    box_table,
    conditions_table,
    more_table,
    random_words,
    ranks_table,
    recipe_table,
    row_count_table,
    subsets_table,
    units_table,
)

from app.planning import Request
from app.wording.hexaslide_screen import postures_table
from calib.errors import GlidecalError
from calib.hexaslide.procedures import Kind

PAGE = Path(__file__).parent / "hexaslide.md"


def sections(asked: Request, effort: Effort) -> Iterator[str]:
    """The page piece by piece."""
    begin = time.perf_counter()
    studies = [study(replace(asked, procedure=kind.value), effort) for kind in kinds_of(asked)]
    yield INTRO
    yield ranks_table(studies)
    yield RANKS
    yield row_count_table(asked)
    yield ROW_COUNTS
    yield recipe_table(studies)
    yield RECIPE
    yield BOX
    yield box_table(studies[0].view)
    yield BOX_NOTE
    yield CONDITIONS.format(sets=effort.random_sets, starts=effort.starts, seed=SEED)
    yield conditions_table(studies)
    if studies[-1].kind is Kind.CONSTRAINT_LINK:
        yield random_words(studies[-1])
    yield bounds_table(studies)
    yield UNITS
    yield units_table(studies)
    yield MORE.format(starts=effort.more_starts)
    yield more_table(studies)
    yield SUBSETS
    yield subsets_table(asked)
    yield SETS
    for one in studies:
        yield f"{one.kind.value}, condition number {one.best.best.condition_number:.2f}:"
        yield code(postures_table(one.postures))
    yield SIMULATED
    yield simulated_table(kinds_of(asked), asked.machine_file)
    yield SIMULATED_NOTE
    yield OWN
    seconds = time.perf_counter() - begin
    yield f"Made by `docs/make_hexaslide.py` in {seconds:.0f} s with {THREADS} thread of BLAS."


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--starts", type=int)
    parser.add_argument("--machine-file", type=Path)
    parser.add_argument("--output", type=Path, default=PAGE)
    asked = parser.parse_args()
    effort = QUICK if asked.quick else FULL
    if asked.starts:
        effort = Effort(effort.random_sets, asked.starts, min(asked.starts, effort.more_starts))
    request = Request(Kind.POSE_INVERSE.value, asked.machine_file, seed=SEED)
    try:
        text = "\n\n".join(sections(request, effort))
    except GlidecalError as problem:
        parser.exit(1, f"make_hexaslide: {problem}\n")
    asked.output.write_text(f"{text}\n", encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
