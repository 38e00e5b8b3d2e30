"""``python -m tests.blind.resolving``: does the proposed measurement resolve what stayed ambiguous?

Sessions with one hidden effect are drawn until enough of them are ambiguous. The procedure that the
program proposes is measured on the same hidden machine by the bench's own simulation, with new
mountings and new noise, and all sessions are diagnosed together: once, and again where it is still
ambiguous. Only the public document is read. Writes a page of Markdown.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, product
from pathlib import Path
from typing import Any

import numpy as np

from tests.blind.bench_files import write_session
from tests.blind.cases import PROCEDURES, USUAL_NOISES, Case
from tests.blind.effects import EFFECT_IDS, LETTERS
from tests.blind.generator import Again, Made, made_again, make
from tests.blind.resolving_page import page
from tests.blind.steps import Visit
from tests.blind.trials import Trial

Json = dict[str, Any]

STRENGTHS = (1.0, 2.0, 4.0)
ROUNDS = 2


def cases() -> Iterator[Case]:
    """Sessions with one effect: strengths, procedures and effects in turn, without end."""
    for n in count():
        for k, procedure, effect in product(STRENGTHS, PROCEDURES, EFFECT_IDS):
            key = f"resolving/{procedure}/{effect}/{k}/{n}"
            noise = USUAL_NOISES[n % len(USUAL_NOISES)]
            yield Case(key, "single", procedure, noise, (effect,), (k,))


@dataclass(frozen=True)
class Follower:
    """Measures what is proposed for one hidden machine, again and again."""

    case: Case
    made: Made
    folder: Path
    rng: np.random.Generator

    @classmethod
    def of(cls, case: Case, seed: int, folder: Path) -> Follower:
        session = make(case, seed)
        write_session(session, folder / f"{case.session}.jsonl")
        rng = np.random.default_rng([seed, int(case.session, 16)])
        return cls(case, session, folder, rng)

    def trial(self, rounds: int = ROUNDS) -> Trial:
        """Documents of the first session alone and of every proposal measured beside it."""
        paths = [self.folder / f"{self.case.session}.jsonl"]
        documents = [document_of(*paths)]
        while len(documents) <= rounds and proposed(documents[-1]):
            paths.append(self._measured(documents[-1]["next_measurement"], len(paths)))
            documents.append(document_of(*paths))
        return Trial(self.made.truth, tuple(documents))

    def _measured(self, request: Json, number: int) -> Path:
        again = Again(visits_of(request["protocol"]), tuple(request["entered_mm"]), request["load"])
        path = self.folder / f"{self.case.session}-{number}.jsonl"
        machine = path.with_suffix(".toml")
        machine.write_text(machine_text(again), encoding="utf-8")
        session = made_again(self.made, again, self.case.noise, self.rng)
        write_session(session, path, machine)
        return path


def proposed(document: Json) -> bool:
    """Whether a measurement that separates names is proposed."""
    return document["verdict"] == "ambiguous" and document["next_measurement"] is not None


def visits_of(procedure: str) -> list[Visit]:
    """The visits that a procedure file asks for, in its order, read without the program."""
    protocol = tomllib.loads(procedure)
    levels = [0.0 if level == "zero" else float(level) for level in protocol["levels"]]
    result = []
    for station, name in product(protocol["stations"], protocol["legs"]):
        leg = LETTERS.index(name)
        for cycle in range(1, protocol["cycles"] + 1):
            result += [Visit(leg, station, level, cycle) for level in levels]
        result.append(Visit(leg, station, 0.0, protocol["cycles"]))
    return result


def machine_text(again: Again) -> str:
    """The machine file that an operator writes for it."""
    return (
        'schema = "glidecal.machine/1"\n'
        f"entered_offsets_mm = {list(again.entered_mm)}\n"
        f"load = {again.load}\n"
    )


def document_of(*sessions: Path) -> Json:
    """The public document of these sessions, diagnosed together."""
    from app.evaluating.diagnosis import diagnose_files
    from app.report.schema.diagnosis import DiagnosisReport

    return DiagnosisReport.of(diagnose_files(sessions), None, None).model_dump(mode="json")


def trials(seed: int, target: int) -> tuple[list[Trial], int]:
    """So many sessions that are ambiguous at first, followed; and how many were drawn."""
    results: list[Trial] = []
    with tempfile.TemporaryDirectory() as name:
        for drawn, case in enumerate(cases(), start=1):
            trial = Follower.of(case, seed, Path(name)).trial()
            if trial.first["verdict"] == "ambiguous":
                results.append(trial)
                print(f"{len(results)} of {target}: {case.key}", file=sys.stderr)
            if len(results) == target:
                return results, drawn
    raise AssertionError("cases() has no end")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry of ``python -m tests.blind.resolving``."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind.resolving", description=__doc__)
    parser.add_argument("--seed", type=int, default=12)
    parser.add_argument("--count", type=int, default=216, help="ambiguous sessions")
    parser.add_argument("-o", "--output", type=Path, help="the page; else printed")
    options = parser.parse_args(arguments)
    text = page(*trials(options.seed, options.count), options.seed)
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
