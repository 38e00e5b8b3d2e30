"""Optimum postures of a Hexa Slide beside plain SLSQP from the same starts, as Markdown.

``OPENBLAS_NUM_THREADS=1 python -m benchmarks.hexaslide [STARTS [PEER_STARTS [PEER_SECONDS]]]``. The
peer does what papers/001 did with fmincon: the condition number itself, gradients by differences;
and, as a better peer, its logarithm. It is given our quick rows. Times are process time.
"""

from __future__ import annotations

import contextlib
import math
import os
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from calib.arrays import FloatArray
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.planning import rows_seen
from calib.hexaslide.procedures import Procedure, ProcedureKind
from calib.hexaslide.search import Search, best_postures
from protocols.hexaslide import load_hexaslide

COUNTS = {
    ProcedureKind.POSE_INVERSE: 9,
    ProcedureKind.POSE_FORWARD: 9,
    ProcedureKind.POSITION: 16,
    ProcedureKind.CONSTRAINT_LINK: 48,
}
"""The fewest postures of each procedure."""

STARTS, PEER_STARTS, PEER_SECONDS = 20, 4, 10.0
SEED = 0


@dataclass(frozen=True)
class Found:
    """What starts came to, and the mean process time of one."""

    name: str
    values: tuple[float, ...]
    seconds: float

    @property
    def middle(self) -> float:
        """The median."""
        return statistics.median(self.values)

    def row(self, problem: str) -> str:
        """A line of the table."""
        figures = (min(self.values), self.middle, max(self.values))
        cells = " | ".join(f"{value:.5g}" for value in figures)
        return f"| {problem} | {self.name} | {len(self.values)} | {cells} | {self.seconds:.2f} |"


class _Over(Exception):
    """The time of the peer is used up."""


class ConditionNumber:
    """That of what is seen, or its logarithm, as the peer minimises it until its time is up."""

    def __init__(
        self, procedure: Procedure, machine: HexaSlide, seconds: float, *, logarithm: bool
    ) -> None:
        self.logarithm = logarithm
        self.rows = rows_seen(procedure, machine)
        self.box = machine.box
        self.end = time.process_time() + seconds
        self.least = np.inf

    def __call__(self, unit: FloatArray) -> float:
        """Of coordinates as shares of the box."""
        if time.process_time() > self.end:
            raise _Over
        width = self.box.upper - self.box.lower
        jacobian = self.rows(self.box.lower + unit.reshape(-1, 6) * width)[0]
        value = float(np.linalg.cond(jacobian.reshape(-1, jacobian.shape[-1])))
        self.least = min(self.least, value)
        return math.log(value) if self.logarithm else value


def ours(procedure: Procedure, machine: HexaSlide, starts: int, seed: int = SEED) -> Found:
    """`calib.hexaslide.search.best_postures`."""
    begin = time.process_time()
    count = COUNTS[procedure.kind]
    best = best_postures(procedure, machine, count, Search(seed=seed, starts=starts, space="box"))
    return Found("glidecal", best.values, (time.process_time() - begin) / starts)


def peer(
    procedure: Procedure,
    machine: HexaSlide,
    starts: int,
    seconds: float,
    *,
    logarithm: bool,
    seed: int = SEED,
) -> Found:
    """SLSQP with differences on the condition number; the least value that it met counts."""
    generator, values, times = np.random.default_rng(seed), [], []
    for _ in range(starts):
        start = machine.box.random(COUNTS[procedure.kind], generator)
        begin = time.process_time()
        cost = ConditionNumber(procedure, machine, seconds, logarithm=logarithm)
        unit = ((start - machine.box.lower) / (machine.box.upper - machine.box.lower)).ravel()
        with contextlib.suppress(_Over):
            minimize(
                cost,
                unit,
                method="SLSQP",
                bounds=[(0.0, 1.0)] * len(unit),
                options={"maxiter": 1000, "ftol": 1e-9},
            )
        values.append(cost.least)
        times.append(time.process_time() - begin)
    name = f"SLSQP{' (logarithm)' * logarithm}"
    return Found(name, tuple(values), statistics.mean(times))


def postures_of_procedures(
    starts: int = STARTS, peer_starts: int = PEER_STARTS, peer_seconds: float = PEER_SECONDS
) -> list[str]:
    """The table: condition numbers on H60, the less the better."""
    example = load_hexaslide()
    machine = example.whole()
    lines = [
        "| H60, fewest postures, condition number | by | starts | best | median | worst "
        "| s a start |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind, count in COUNTS.items():
        procedure = Procedure.of(kind)
        result = ours(procedure, machine, starts)
        rivals = [
            peer(procedure, machine, peer_starts, peer_seconds, logarithm=logarithm)
            for logarithm in (False, True)
        ]
        lines += [search.row(f"{kind.value}, {count}") for search in (result, *rivals)]
    return lines


def hexaslide() -> list[str]:
    """The same from a process of its own, in which linear algebra has one thread."""
    process = subprocess.run(
        [sys.executable, "-m", "benchmarks.hexaslide"],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parent.parent,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    return process.stdout.splitlines()


if __name__ == "__main__":
    counts = [int(text) for text in sys.argv[1:]]
    print("\n".join(postures_of_procedures(*counts)))
