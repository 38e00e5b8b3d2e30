"""``make processors``: one machine stands for many.

The kernels of OpenBLAS and numpy that other processors would take, as far as this one can run them:
golden texts, more texts that name the largest of something, and a part of the blind bench must
come out the same to the letter. Exit status 1 where anything differs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from difflib import unified_diff
from importlib import import_module
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_info  # type: ignore[import-untyped]  # it has no types

from tests.app.cli import glidecal
from tests.app.report.test_golden import GOLDEN, TEXTS
from tests.blind.bench_files import write_session
from tests.blind.cases import Case, plan
from tests.blind.documents import of_the_program, row_of
from tests.blind.generator import NotDrawn, make

Json = dict[str, Any]
NUMPY: Any = import_module(
    "numpy._core._multiarray_umath"
)  # untyped, its kernels are told here only
ROOT = Path(__file__).parents[1]
SEED, EVERY = 11, 8
SIMULATED = "sample_sessions/simulated_sweep.jsonl"
MORE_TEXTS: dict[str, tuple[str, ...]] = {
    "solve, joint offsets": ("solve", SIMULATED, "--subset", "joint-offsets"),
    "solve, leg lengths": ("solve", SIMULATED, "--method", "linear", "--subset", "leg-lengths"),
    "diagnose, no freedom": ("diagnose", "sample_sessions/experiment_1_six.jsonl"),
    "diagnose, published": ("diagnose", "sample_sessions/experiment_2_twelve.jsonl"),
    "diagnose, simulated": ("diagnose", "sample_sessions/simulated_zero-max-min.jsonl"),
    "plan, nothing": ("plan",),
    "plan, published": ("plan", "sample_sessions/experiment_3_twelve.jsonl"),
    "plan, simulated": ("plan", SIMULATED),
    "identifiability": ("identifiability", "orthoglide", "--procedure", "sweep"),
    "identifiability, noise": (
        *("identifiability", "orthoglide", "--procedure", "zero-max-min"),
        *("--noise", "0.002"),
    ),
    "aliases": ("diagnose", "--aliases", "--procedure", "zero-max-min"),
}


@dataclass(frozen=True)
class Kind:
    """A kind of processor: OpenBLAS's name, what numpy calls its instructions, threads.

    ``without`` are groups of instructions that numpy leaves alone.
    """

    core: str
    needs: str
    without: tuple[str, ...]
    threads: int

    @property
    def surroundings(self) -> dict[str, str]:
        """The environment in which a process computes like one."""
        features = NUMPY.__cpu_dispatch__
        return {
            **os.environ,
            "OPENBLAS_CORETYPE": self.core,
            "OPENBLAS_NUM_THREADS": str(self.threads),
            "NPY_DISABLE_CPU_FEATURES": " ".join(name for name in self.without if name in features),
        }


WIDE = (
    *("X86_V4", "AVX512F", "AVX512CD", "AVX512_SKX"),
    *("AVX512_CLX", "AVX512_CNL", "AVX512_ICL", "AVX512_SPR"),
)
AVX2 = ("X86_V3", "AVX2", "FMA3", "F16C", "AVX")
KINDS = (
    Kind("SkylakeX", "AVX512_SKX", (), 2),
    Kind("Haswell", "AVX2", WIDE, 2),
    Kind("Sandybridge", "AVX", (*WIDE, *AVX2), 1),
    Kind("Nehalem", "SSE42", (*WIDE, *AVX2), 2),
    Kind("Prescott", "SSE3", (*WIDE, *AVX2), 1),
)
SAME_AS = {"Katmai": "Prescott", "Zen": "Haswell", "Cooperlake": "SkylakeX"}


def cases() -> list[Case]:
    """A part of the quick blind bench, some of each cell."""
    return plan(0.04)[::EVERY]


def look(folder: Path) -> Json:
    """What this process computes with, every text, and what each diagnosis says."""
    features = NUMPY.__cpu_features__
    blas = [library for library in threadpool_info() if library["internal_api"] == "openblas"]
    texts = {}
    for name, arguments in {**TEXTS, **MORE_TEXTS}.items():
        run = glidecal(*arguments, cwd=ROOT)
        texts[name] = f"exit {run.status}\n{run.out}{run.err}"
    for case in cases():
        session = folder / f"{case.session}.jsonl"
        if not session.exists():
            continue
        row = row_of(of_the_program, session, case.without)
        names = [(e["id"], e["where"], sorted(e["also"])) for e in row["effects"]]
        rivals = [(c["id"], c["where"]) for c in row.get("candidates", ())]
        lines = [row["verdict"], *map(str, names), *map(str, rivals), str(row.get("error", ""))]
        texts[case.key] = "\n".join(lines)
    return {
        "cores": sorted(
            {SAME_AS.get(library["architecture"], library["architecture"]) for library in blas}
        ),
        "copies": len(blas),
        "threads": sorted({library["num_threads"] for library in blas}),
        "dispatched": [n for n in NUMPY.__cpu_dispatch__ if features[n]],
        "said": texts,
    }


def asked(kind: Kind, folder: Path) -> Json:
    """The same from a process of its own."""
    path = folder / f"{kind.core}.json"
    command = [sys.executable, "-m", "tests.processors", "--look", str(folder), "-o", str(path)]
    subprocess.run(command, cwd=ROOT, env=kind.surroundings, check=True)
    facts: Json = json.loads(path.read_text(encoding="utf-8"))
    return facts


def wrong(kind: Kind, facts: Json, reference: dict[str, str]) -> list[str]:
    """What differs from the first kind, and settings that took no effect."""
    problems = []
    threads = min(kind.threads, os.cpu_count() or 1)
    if facts["cores"] != [kind.core] or facts["threads"] != [threads]:
        problems.append(f"asked for {kind.core}, {threads} threads; in use: {facts['cores']}")
    if set(facts["dispatched"]) & set(kind.without):
        problems.append(f"numpy still uses {facts['dispatched']}")
    for name, text in reference.items():
        lines = unified_diff(text.splitlines(), facts["said"][name].splitlines(), lineterm="", n=0)
        problems += [f"{name}: {line}" for line in lines if line[:3] not in ("---", "+++")]
    return problems


def main() -> int:
    """Entry of ``python -m tests.processors``."""
    parser = argparse.ArgumentParser(prog="python -m tests.processors", description=__doc__)
    parser.add_argument("--look", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.look:
        options.output.write_text(json.dumps(look(options.look)), encoding="utf-8")
        return 0
    features = NUMPY.__cpu_features__
    kinds = [kind for kind in KINDS if features.get(kind.needs)]
    if len(kinds) < 2:
        print("processors: this one has a single kind of kernels; nothing compared")
        return 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case in cases():
            try:
                write_session(make(case, SEED), folder / f"{case.session}.jsonl")
            except NotDrawn as problem:
                print(f"could not be drawn and is left out: {problem}")
        # one after the other: threads of OpenBLAS wait by spinning, and two such programs on two
        # cores take ten times as long as one
        everything = [asked(kind, folder) for kind in kinds]
    reference = dict(everything[0]["said"])
    for name in TEXTS:
        golden = (GOLDEN / f"{name}.txt").read_text(encoding="utf-8")
        reference[name] = f"exit 0\n{golden}"
    failed = False
    for kind, facts in zip(kinds, everything, strict=True):
        problems = wrong(kind, facts, reference)
        using = " ".join(facts["dispatched"]) or "its baseline"
        print(
            f"{kind.core}: {facts['copies']} copies of OpenBLAS, {facts['threads']} threads, numpy"
            f" {using}: {len(reference)} texts and diagnoses, {len(problems)} lines wrong"
        )
        print("".join(f"    {line}\n" for line in problems), end="")
        failed = failed or bool(problems)
    left_out = [kind.core for kind in KINDS if kind not in kinds]
    if left_out:
        print(f"not run, this processor cannot: {', '.join(left_out)}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
