"""``make blind``: make the sessions, seal the truths, diagnose, score, write docs/blind.md.

Both cores work; a run that was stopped goes on where it was. Only the public command writes
sessions, and only the public document of a diagnosis is read.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import joblib

from calib.clusters import in_parallel
from tests.blind.baselines import named_by_all
from tests.blind.bench_files import (
    Folder,
    Json,
    append,
    lines,
    seal,
    sealed_truths,
    write_session,
)
from tests.blind.cases import Case, plan
from tests.blind.documents import of_the_program, row_of
from tests.blind.generator import NotDrawn, make
from tests.blind.table import Told, page

QUICK_SHARE = 0.04
BASELINE_CELLS = ("none", "single", "pair", "outside")
BASELINE_EVERY = 4
ROOT = Path(__file__).parents[2]
# Small matrices: a second thread in the library only takes the other process's core.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

Work = Callable[[Case], Json]


def generated(folder: Folder, seed: int, case: Case) -> Json:
    """Make one session; hands its truth back, which goes to the sealed file only."""
    try:
        session = make(case, seed)
    except NotDrawn as problem:
        return {"session": case.session, "not_drawn": str(problem)}
    write_session(session, folder.session(case.session))
    return {"session": case.session, "truth": session.truth}


def diagnosed(folder: Folder, case: Case) -> Json:
    """Diagnose one session from its file alone."""
    row = row_of(of_the_program, folder.session(case.session), case.without, case.also)
    strengths = list(case.strengths)
    public = {"cell": case.cell, "procedure": case.procedure, "noise": case.noise}
    return {"session": case.session, **public, "strengths": strengths, **row}


def compared(seed: int, case: Case) -> Json:
    """What the baselines name for the same session."""
    session = make(case, seed)
    return {"session": case.session, "named": named_by_all(session.rows, session.values_mm)}


def for_baselines(case: Case) -> bool:
    """A part of the sessions, drawn by the digest in their names."""
    return case.cell in BASELINE_CELLS and int(case.session, 16) % BASELINE_EVERY == 0


def do(work: Work, cases: Sequence[Case], path: Path, title: str) -> None:
    """Do what is not in the file yet; a line for each as soon as it is done."""
    done = {line["session"] for line in lines(path)}
    pending = [case for case in cases if case.session not in done]
    start = time.monotonic()
    for number, document in enumerate(in_parallel(work, pending), start=1):
        append(path, document)
        if number % 200 == 0 or number == len(pending):
            seconds = time.monotonic() - start
            print(f"{title}: {number} of {len(pending)}, {seconds:.0f} s", file=sys.stderr)


def run(cases: Sequence[Case], folder: Folder, seed: int, workers: int) -> Told:
    """Everything that is missing of a run, then what is known of it."""
    start = time.monotonic()
    with joblib.parallel_config("loky", n_jobs=workers, inner_max_num_threads=1):
        do(partial(generated, folder, seed), cases, folder.truths, "sessions")
        truths, _ = seal(folder, (case.session for case in cases))
        drawn = [case for case in cases if case.session in truths]
        do(partial(diagnosed, folder), drawn, folder.results, "diagnosed")
        compared_cases = [case for case in drawn if for_baselines(case)]
        do(partial(compared, seed), compared_cases, folder.baselines, "baselines")
    return told(cases, folder, seed, time.monotonic() - start)


def told(cases: Sequence[Case], folder: Folder, seed: int, seconds: float) -> Told:
    """Truths unsealed beside the results."""
    truths, digest = sealed_truths(folder)
    names = {case.session for case in cases}
    rows = [row for row in lines(folder.results) if row["session"] in names]
    baselines = [row for row in lines(folder.baselines) if row["session"] in names]
    truth_lines = [line for line in lines(folder.truths) if line["session"] in names]
    not_drawn = [line["not_drawn"] for line in truth_lines if "not_drawn" in line]
    return Told(truths, rows, baselines, seed, digest, seconds, not_drawn)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry of ``python -m tests.blind.run``."""
    options = _parser().parse_args(arguments)
    os.environ.update(ONE_THREAD)
    full_plan = plan()
    share = options.count / len(full_plan) if options.count else 1.0
    cases = plan(QUICK_SHARE if options.quick else share)
    place = options.folder / f"seed-{options.seed}"
    if options.fresh:
        shutil.rmtree(place, ignore_errors=True)
    folder = Folder(place)
    if options.again:
        folder.results.unlink(missing_ok=True)
    text = page(replace(run(cases, folder, options.seed, options.workers), note=options.note))
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    else:
        print(text)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.blind.run", description=__doc__)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--count", type=int, help="about so many sessions instead of all")
    parser.add_argument("--quick", action="store_true", help="one of each combination")
    parser.add_argument("--fresh", action="store_true", help="start from nothing")
    parser.add_argument("--again", action="store_true", help="same sessions, diagnose again")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "blind")
    parser.add_argument("--note", default="", help="how it was run, for the head of the page")
    parser.add_argument("-o", "--output", type=Path, help="the page; else printed")
    return parser


if __name__ == "__main__":
    sys.exit(main())
