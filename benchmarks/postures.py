"""Choosing 12 of 1000 candidates with 6 parameters, beside other ways, as Markdown.

``python -m benchmarks.postures``. figaroh's determinant exchange runs on the same pools where this
Python has figaroh and picos, or where ``FIGAROH_PYTHON`` names the interpreter of an environment
of its own that has them: ``python -m venv E && E/bin/pip install figaroh picos``.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from calib.arrays import FloatArray
from calib.design.exchange import Candidates, choose

POOL, COUNT, PARAMETERS = 1000, 12, 6
POOLS = 7
STARTS = 64
RIDGE = 1e-9

FIGAROH = """
import contextlib, importlib.metadata, io, json, random, sys, time
import numpy as np, picos
from figaroh.optimal.base_optimal_calibration import Detmax
class Kept(Detmax):  # the class itself gives away no set, only its determinant
    def get_critD(self, members):
        self.members = list(members)
        return super().get_critD(members)

found = []
for number, rows in enumerate(np.load(sys.argv[1])):
    random.seed(number)
    pool = {k: picos.Constant(np.outer(row, row)) for k, row in enumerate(rows)}
    begin = time.perf_counter()
    search = Kept(pool, int(sys.argv[2]))
    with contextlib.redirect_stdout(io.StringIO()):
        search.main_algo()
    taken = time.perf_counter() - begin
    chosen = rows[search.members]
    found.append([float(np.linalg.slogdet(chosen.T @ chosen)[1]), taken, len(set(search.members))])
print(json.dumps([importlib.metadata.version("figaroh"), found]))
"""


def pools() -> FloatArray:
    """``(POOLS, POOL, PARAMETERS)``: normal rows of unequal sizes."""
    generator = np.random.default_rng(20)
    return generator.normal(size=(POOLS, POOL, PARAMETERS)) * generator.uniform(
        0.2, 1.0, (POOLS, POOL, 1)
    )


def log_determinant(rows: FloatArray) -> float:
    """Of the information of the chosen rows ``(m, k)``."""
    return float(np.linalg.slogdet(rows.T @ rows)[1])


def ours(rows: FloatArray, starts: int, *, repeats: bool = False) -> FloatArray:
    """`calib.design.exchange.choose`."""
    selection = choose(Candidates(rows[:, None]), COUNT, starts=starts, repeats=repeats)
    return np.asarray(rows[list(selection.chosen)])


def plain_fedorov(rows: FloatArray, seed: int = 0) -> FloatArray:
    """Fedorov's exchange as the idea is told: every swap tried, its determinant computed."""
    subset = np.random.default_rng(seed).choice(len(rows), COUNT, replace=False).tolist()
    best = log_determinant(rows[subset])
    while True:
        swap = None
        for place in range(COUNT):
            remaining = rows[subset[:place] + subset[place + 1 :]]
            fixed = remaining.T @ remaining + RIDGE * np.eye(PARAMETERS)
            all_swaps = np.linalg.slogdet(fixed + rows[:, :, None] * rows[:, None, :])[1]
            all_swaps[subset] = -np.inf
            k = int(all_swaps.argmax())
            if all_swaps[k] > best + 1e-9:
                best, swap = float(all_swaps[k]), (place, k)
        if swap is None:
            return np.asarray(rows[subset])
        subset[swap[0]] = swap[1]


def random_best(rows: FloatArray, budget_s: float) -> FloatArray:
    """The best of as many random sets as the time allows."""
    generator, best, best_rows = np.random.default_rng(0), -np.inf, rows[:COUNT]
    end = time.perf_counter() + budget_s
    while time.perf_counter() < end:
        index = generator.random((256, POOL)).argpartition(COUNT, axis=1)[:, :COUNT]
        sets = rows[index]
        logs = np.linalg.slogdet(np.swapaxes(sets, 1, 2) @ sets)[1]
        if logs.max() > best:
            best, best_rows = float(logs.max()), sets[int(logs.argmax())]
    return best_rows


def timed(work: Callable[[FloatArray], FloatArray]) -> tuple[list[float], list[float]]:
    """Logarithms of determinants and seconds over all pools."""
    logs, times = [], []
    for rows in pools():
        begin = time.perf_counter()
        subset = work(rows)
        times.append(time.perf_counter() - begin)
        logs.append(log_determinant(subset))
    return logs, times


@dataclass(frozen=True)
class Way:
    """Logarithms of determinants and seconds, one for each pool."""

    name: str
    logs: list[float]
    seconds: list[float]

    def row(self, best: FloatArray, beside: Way) -> str:
        """A line of the table."""
        middle, first = statistics.median(self.seconds), statistics.median(beside.seconds)
        off = np.array(self.logs) - best
        return (
            f"| {self.name} | {middle * 1e3:.1f} | {middle / first:.2f} | "
            f"{np.exp(np.median(off)):.3f} | {np.exp(off.min()):.3f} |"
        )


def figaroh_python() -> str | None:
    """The interpreter that has figaroh and picos, if there is one."""
    if all(importlib.util.find_spec(name) for name in ("figaroh", "picos")):
        return sys.executable
    program_name = os.environ.get("FIGAROH_PYTHON")
    program = shutil.which(program_name) if program_name else None
    if program_name and not program:
        print(f"FIGAROH_PYTHON: {program_name} is no program", file=sys.stderr)
    return program


def figaroh() -> Way | None:
    """Its Detmax class on plain matrices; the name tells how many different ones it takes."""
    python = figaroh_python()
    if python is None:
        return None
    with TemporaryDirectory() as folder:
        path = Path(folder) / "pools.npy"
        np.save(path, pools())
        process = subprocess.run(
            [python, "-c", FIGAROH, str(path), str(COUNT)],
            capture_output=True,
            text=True,
            check=False,
        )
    if process.returncode:
        print(f"figaroh: {process.stderr.strip().splitlines()[-1]}", file=sys.stderr)
        return None
    version, results = json.loads(process.stdout.splitlines()[-1])
    different = sorted(result[2] for result in results)
    name = (
        f"figaroh {version}, Detmax, one start, repeats ({different[0]} to {different[-1]} "
        "different ones)"
    )
    return Way(name, [result[0] for result in results], [result[1] for result in results])


def postures() -> list[str]:
    """The table: medians of time, ratio of determinants to the best of all ways."""
    first = Way(f"glidecal, {STARTS} starts", *timed(lambda rows: ours(rows, STARTS)))
    budget = statistics.median(first.seconds)
    ways = [
        first,
        Way("glidecal, 8 starts (default)", *timed(lambda rows: ours(rows, 8))),
        Way(
            f"glidecal, {STARTS} starts, repeats",
            *timed(lambda rows: ours(rows, STARTS, repeats=True)),
        ),
        Way("plain Fedorov exchange, one start", *timed(plain_fedorov)),
        Way("best of random sets, same time", *timed(lambda rows: random_best(rows, budget))),
    ]
    figaroh_way = figaroh()
    ways += [figaroh_way] if figaroh_way else []
    best = np.max([way.logs for way in ways], axis=0)
    return [
        f"| {COUNT} of {POOL} candidates, {PARAMETERS} parameters | ms | ratio "
        "| determinant / best, median | worst |",
        "|---|---|---|---|---|",
        *(way.row(best, first) for way in ways),
        *([] if figaroh_way else ["| figaroh, Detmax | not installed | | | |"]),
    ]


if __name__ == "__main__":
    print("\n".join(postures()))
