"""A session whose process is killed at chosen bytes: the program that `test_kills` runs.

One thread only, so that forking is safe. Each child is one life of the session: it goes on with the
record, acknowledges over a pipe what it did, and sends itself SIGKILL when its time has come.
"""

from __future__ import annotations

import itertools
import json
import os
import random
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

from app.measuring.gauges import Gauge
from app.measuring.indicators import simulated_indicators
from app.measuring.opening import begin
from app.measuring.plan import Plan
from app.measuring.session import GuidedSession, Indicators
from drivers.line import IndicatorLine
from drivers.profile import Fault, FaultKind, IndicatorReading, Outcome, Query
from drivers.profiles import PROFILES
from protocols.machine import Machine
from protocols.procedure import Procedure
from tests.end_to_end.fates import Fate, LineFate, RandomFate, Spared, die, doomed

PROFILE = PROFILES["mitutoyo-01a"]
Told = dict[str, Any]


class InstantLine(IndicatorLine):
    """Answers at once with a value that no other reading of the session has, rarely a fault."""

    def __init__(self, first_mm: float, chance: random.Random) -> None:
        super().__init__(PROFILE, "")
        self._next_mm = first_mm
        self._chance = chance

    def ask(self) -> Future[Outcome]:
        answer: Future[Outcome] = Future()
        self._next_mm += 0.002
        value_mm = round(self._next_mm, 3)
        outcome: Outcome = IndicatorReading(f"01A{value_mm:+.3f}", value_mm, 0.001, True)
        if self._chance.random() < 0.04:
            outcome = Fault(FaultKind.DEVICE_FAULT, "err", "the device says so")
        answer.set_result(outcome)
        return answer


class InstantGauge(Gauge):
    """A gauge without a port."""

    def __init__(self, line: InstantLine) -> None:
        super().__init__(PROFILE, "", Query(), window_s=0.1, tolerance_mm=0.004)
        self._line = line


def plan(path: Path) -> Plan:
    """Eight steps on two legs."""
    return Plan(
        path=path,
        machine=Machine(),
        procedure=Procedure(
            schema="glidecal.procedure/1",
            name="short",
            title="short",
            legs=("x", "z"),
            cycles=1,
            levels=("zero", "max", "min"),
        ),
        instruments=simulated_indicators([PROFILE.name]),
    )


class Life:
    """One child: does things at random and acknowledges each one when it is done."""

    def __init__(self, path: Path, number: int, seed: str, pipe: int, fate: Fate) -> None:
        self._path = path
        self._pipe = pipe
        self._fate = fate
        self._name = f"life {number}"
        self._chance = random.Random(f"{seed}/{number}")
        self._acts = 0
        lines = [InstantLine(number + k / 1000, self._chance) for k in range(2)]
        gauges = tuple(InstantGauge(line) for line in lines)
        self._indicators = Indicators(gauges, lambda _: None)

    def live(self) -> None:
        """Go on with the session until it is closed, or until the end."""
        with doomed(self._fate):
            continuation = replace(plan(self._path), continued=self._path.exists())
            guided = begin(continuation, self._indicators)
            lines = self._path.read_bytes().count(b"\n")
            step = guided.step()
            self._tell({"did": "begin", "lines": lines, "step": step.number if step else None})
            while guided.step() is not None:
                self._act(guided)
            guided.finish()
            self._tell({"did": "finish"})

    def _tell(self, report: Told) -> None:
        if self._fate.pause():
            die()
        os.write(self._pipe, json.dumps(report).encode() + b"\n")

    def _act(self, guided: GuidedSession) -> None:
        self._acts += 1
        words = f"{self._name}, act {self._acts}"
        if self._chance.random() < 0.6:
            self._take(guided)
        elif self._correct(guided, words):
            self._tell({"did": "correct", "words": words})

    def _take(self, guided: GuidedSession) -> None:
        taken_step = guided.take()
        if taken_step is not None:
            values = [[r.reading, r.axis, r.value_mm] for r in taken_step.readings]
            self._tell({"did": "take", "step": taken_step.step.number, "readings": values})

    def _correct(self, guided: GuidedSession, words: str) -> bool:
        """One of the operator's corrections; whether the record has these words now."""
        session = guided.session
        step = guided.step()
        steps = sorted(session.done())
        act = self._chance.choice(["note", "undo", "repeat", "restore", "skip", "remount"])
        if act == "note":
            guided.note(words)
        elif act == "undo" and steps:
            guided.undo(words)
        elif act == "repeat" and steps:
            guided.repeat(self._chance.choice([*steps, *session.skipped]), words)
        elif act == "restore":
            return guided.restore(self._chance.randint(1, len(guided.steps)), words)
        elif act == "skip" and step is not None and self._chance.random() < 0.6:
            guided.skip([step.number], words)
        else:
            guided.remount()
            return False
        return True


def run_life(path: Path, number: int, seed: str, fate: Fate) -> tuple[list[Told], bool]:
    """What a child acknowledged, and whether it was killed."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        try:
            Life(path, number, seed, writing, fate).live()
        except BaseException as problem:
            os.write(2, f"{path.name}, life {number}: {problem!r}\n".encode())
            os._exit(1)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        reports = [json.loads(line) for line in pipe]
    _, status = os.waitpid(child, 0)
    killed = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL
    if not killed and os.WEXITSTATUS(status):
        sys.exit("a life ended by an error")
    return reports, killed


def is_closed(path: Path) -> bool:
    *lines, _ = path.read_bytes().split(b"\n")
    return bool(lines) and json.loads(lines[-1])["event"] == "closed"


def run_session(path: Path, seed: str, fates: Iterator[Fate]) -> Told:
    """Lives until the record is closed. A file without a first line is begun again."""
    reports: list[Told] = []
    kills = number = 0
    while not (path.exists() and is_closed(path)):
        if path.exists() and b"\n" not in path.read_bytes():
            path.unlink()
        number += 1
        life_reports, killed = run_life(path, number, seed, next(fates))
        reports += life_reports
        kills += killed
    return {"path": str(path), "kills": kills, "told": reports}


def random_fates(chance: random.Random, count: int) -> Iterator[Fate]:
    """So many kills, some of them while the record is being opened again; then peace."""
    for _ in range(count):
        yield RandomFate(chance.randint(0, 900 if chance.random() < 0.3 else 6000))
    yield from itertools.repeat(Spared())


def killed_at_random(folder: Path, seed: str, kills: int) -> Iterator[Told]:
    """Sessions with several kills each until there were so many."""
    chance = random.Random(seed)
    number = 0
    while kills > 0:
        number += 1
        fates = random_fates(chance, min(kills, chance.randint(1, 12)))
        session = run_session(folder / f"{number}.jsonl", f"{seed}/{number}", fates)
        kills -= session["kills"]
        yield session


def killed_at_every_line(folder: Path, seed: str, *, inside: bool) -> Iterator[Told]:
    """The same two lives again and again, killed one line later each time.

    The first life is killed at each of its lines, then the second, which begins with line 10.
    """
    chance = random.Random(seed)
    for kills_before in (0, 1):
        for line in itertools.count(1):
            first = [LineFate(9, 0.5)] * kills_before
            fate = LineFate(line, chance.random() if inside else None)
            fates: Iterator[Fate] = itertools.chain([*first, fate], itertools.repeat(Spared()))
            path = folder / f"{kills_before}-{line}.jsonl"
            session = run_session(path, seed, fates)
            yield session
            if session["kills"] == kills_before:  # it was over before that line
                break


def main(folder: str, how: str, seed: str, kills: str) -> None:
    """Print one JSON document for each session."""
    if how == "random":
        sessions = killed_at_random(Path(folder), seed, int(kills))
    else:
        sessions = killed_at_every_line(Path(folder), seed, inside=how == "inside")
    for session in sessions:
        print(json.dumps(session))


if __name__ == "__main__":
    main(*sys.argv[1:])
