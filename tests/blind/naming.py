"""Names of the posterior beside today's, on the same sessions, and whether its probabilities hold.

``python -m tests.blind.naming --seed 41 --count 1000`` makes the sessions, asks both, and prints
the table. Gross errors of the readings are not among the sessions.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import joblib
import numpy as np

from tests.blind.bench_files import Folder, Json, lines, seal
from tests.blind.cases import Case, plan
from tests.blind.documents import ANSWERERS
from tests.blind.effects import BESIDE
from tests.blind.run import ONE_THREAD, ROOT, diagnosed, do, generated
from tests.blind.scoring import (
    NEARLY_INSIDE,
    Scored,
    called_explained,
    detectable,
    exact,
    false_machine_name,
    false_name,
    joined,
    placed_in_set,
    rate,
    separable,
    single_name,
    truth_in_set,
    wrong_confident,
    wrong_name_or_place,
)
from tests.blind.table import shown

CELLS = (
    *("none", "bars", "single", "pair", "look-alike", "beside-named", "left-out", "outside"),
    *("plane-none", "plane", "plane-alone-none", "plane-alone"),
)
UNKNOWN = ("left-out", "outside")
EDGES = (0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
DRIFTS = {"thermal_drift", "stand_drift"}


def cases(count: int) -> list[Case]:
    """About so many sessions of these cells."""
    whole = [case for case in plan() if case.cell in CELLS]
    chosen = [case for case in plan(count / len(whole)) if case.cell in CELLS]
    return sorted(chosen, key=lambda case: case.session)  # a run that was stopped has some of all


def with_every_rival(case: Case) -> Case:
    """What stands beside the catalogue counts as a rival of what is hidden."""
    return replace(case, also=tuple(BESIDE))


Choice = Callable[[Scored], bool]
Line = tuple[str, Choice, Choice]


def _in(*cells: str) -> Choice:
    return lambda one: one.cell in cells


def _both(*choices: Choice) -> Choice:
    return lambda one: all(choice(one) for choice in choices)


def _foreign(one: Scored) -> bool:
    return one.cell in UNKNOWN and all(h["rival_share"] < NEARLY_INSIDE for h in one.hidden)


def _near(one: Scored) -> bool:
    return one.cell in UNKNOWN and not _foreign(one)


def _large(one: Scored) -> bool:
    return bool(min(one.truth["strengths"]) >= 2.0)


def _wanders(one: Scored) -> bool:
    return bool(one.truth["noise"] == "wander")


def _still(one: Scored) -> bool:
    return not _wanders(one)


def _sound(one: Scored) -> bool:
    return one.cell in ("none", "plane-none", "plane-alone-none")


def _known(one: Scored) -> bool:
    return _sound(one) or one.cell in ("single", "pair", "look-alike", "plane", "plane-alone")


def _named_beside_drift(one: Scored) -> bool:
    return bool(one.named_ids - DRIFTS)


LINES: tuple[Line, ...] = (
    ("truth in the set, one effect", _both(_in("single"), detectable), truth_in_set),
    ("the same, with its place", _both(_in("single"), detectable), placed_in_set),
    ("truth in the set, look-alikes", _in("look-alike"), truth_in_set),
    ("truth in the set, over a plane", _both(_in("plane"), detectable), truth_in_set),
    ("truth in the set, two effects", _both(_in("pair"), detectable), truth_in_set),
    ("the same, with their places", _both(_in("pair"), detectable), placed_in_set),
    ("truth in the set, beside the catalogue", _in("beside-named"), truth_in_set),
    ("wrong confident name", _known, wrong_confident),
    ("wrong confident name or place", _known, wrong_name_or_place),
    ("wrong confident name, beside the catalogue", _in("beside-named"), wrong_confident),
    ("name on nothing", _both(_sound, _still), false_name),
    ("name on nothing, noise that wanders", _both(_sound, _wanders), _named_beside_drift),
    ("name on nothing, bars off by 1 or 3 tolerances", _in("bars"), false_machine_name),
    ("outside called explained", _foreign, called_explained),
    ("the same, nearly imitated by a known law", _near, called_explained),
    ("name and place, separable", _both(_in("single"), _large, separable), single_name),
    ("the same over a plane", _both(_in("plane"), separable), single_name),
    ("name and place, separable or not", _both(_in("single"), _large), single_name),
    ("one effect exact", _both(_in("single"), _large), exact),
    ("two effects exact", _both(_in("pair"), detectable), exact),
    ("two effects exact, separable", _both(_in("pair"), detectable, separable), exact),
)


@dataclass(frozen=True)
class Bin:
    """Names of probabilities in a range: how many, their mean, and the share that is right."""

    least: float
    most: float
    count: int
    mean: float
    right: float


def probabilities_and_truth(one: Scored) -> list[tuple[float, bool]]:
    """Every probability of a name beside whether it is true; drifts of wandering noise are open."""
    open_names = DRIFTS if _wanders(one) else set()
    return [(p, i in one.true_ids) for i, p in one.row["probabilities"] if i not in open_names]


def reliability(chosen: Iterable[Scored]) -> list[Bin]:
    """Bins of all probabilities of these sessions from 1 % on."""
    pairs = [pair for one in chosen for pair in probabilities_and_truth(one)]
    stated, right = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
    found = []
    for least, most in pairwise(EDGES):
        inside = (stated >= least) & ((stated < most) | (most == EDGES[-1]))
        if inside.any():
            means = float(stated[inside].mean()), float(right[inside].mean())
            found.append(Bin(least, most, int(inside.sum()), *means))
    return found


def brier(chosen: Sequence[Scored]) -> float:
    """Mean over sessions of the summed squares of probability less truth, names unsaid at 0."""
    total = 0.0
    for one in chosen:
        pairs = dict(one.row["probabilities"])
        missed = one.true_ids - set(pairs)
        total += sum((p - right) ** 2 for p, right in probabilities_and_truth(one)) + len(missed)
    return total / len(chosen) if chosen else float("nan")


def page(truths: dict[str, Json], rows: dict[str, list[Json]]) -> str:
    """Both side by side, then the reliability of the posterior's probabilities."""
    common = set.intersection(*({row["session"] for row in some} for some in rows.values()))
    truths = {session: truth for session, truth in truths.items() if session in common}
    scored = {name: joined(truths, some) for name, some in rows.items()}
    head = ["| what | " + " | ".join(scored) + " |", "|---" * (1 + len(scored)) + "|"]
    for what, counts, hit in LINES:
        rates = [rate(filter(counts, some), hit) for some in scored.values()]
        head.append(f"| {what} | " + " | ".join(shown(one) for one in rates) + " |")
    sure = [one for one in scored.get("posterior", ()) if "probabilities" in one.row]
    for title, counts in (("known to the library", _known), ("outside", _foreign)):
        chosen = [one for one in sure if counts(one)]
        if not chosen:
            continue
        head += ["", f"Probabilities of names, hidden laws {title}: {len(chosen)} sessions,"]
        head += [f"Brier score {brier(chosen):.3f} a session.", ""]
        head += ["| range | mean | right | names |", "|---|---|---|---|"]
        head += [
            f"| {one.least:.2f} … {one.most:.2f} | {one.mean:.3f} | {one.right:.3f} | {one.count} |"
            for one in reliability(chosen)
        ]
    times = [one.row["cpu_s"] for one in sure] or [float("nan")]
    head += ["", f"Processor time of the posterior: median {np.median(times):.2f} s,"]
    head += [f"95th percentile {np.percentile(times, 95):.2f} s, reading the file included."]
    return "\n".join(head) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry of ``python -m tests.blind.naming``."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind.naming", description=__doc__)
    parser.add_argument("--seed", type=int, default=41)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--answerer", choices=tuple(ANSWERERS), action="append")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "naming")
    parser.add_argument("-o", "--output", type=Path, help="the page; else printed")
    options = parser.parse_args(arguments)
    os.environ.update(ONE_THREAD)
    folder, chosen = Folder(options.folder / f"seed-{options.seed}"), cases(options.count)
    rows = {}
    with joblib.parallel_config("loky", n_jobs=options.workers, inner_max_num_threads=1):
        every = [with_every_rival(case) for case in chosen]
        do(partial(generated, folder, options.seed), every, folder.truths, "sessions")
        truths, _ = seal(folder, (case.session for case in chosen))
        drawn = [case for case in chosen if case.session in truths]
        for name in options.answerer or ANSWERERS:
            work = partial(diagnosed, folder, answerer=name)
            do(work, drawn, folder.results_of(name), name)
            rows[name] = lines(folder.results_of(name))
    text = page(truths, rows)
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
