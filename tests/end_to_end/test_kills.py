"""Kill -9 at any byte of any write: what was acknowledged is there, once, and the session goes on.

What a power cut does to a disk that lies about its cache is beyond these tests.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from protocols.record import read_record
from protocols.session import fold
from tests.app.cli import glidecal
from tests.conftest import LONG

pytestmark = [LONG, pytest.mark.skipif(sys.platform == "win32", reason="needs fork and SIGKILL")]

STEPS = range(1, 9)
AXES_OF_A_STEP = 2
KILLS_OF_A_RUN = 100
Lines = list[dict[str, Any]]


def sessions(folder: Path, how: str, seed: str = "1", kills: int = 0) -> Lines:
    """Run the child program; what it tells of each session."""
    run = subprocess.run(
        [sys.executable, "-m", "tests.end_to_end.killed_session", folder, how, seed, str(kills)],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    assert run.returncode == 0, run.stderr
    return [json.loads(line) for line in run.stdout.splitlines()]


class Ledger:
    """The state of a record, found without the program's own reader."""

    def __init__(self, lines: Lines) -> None:
        self.step_of: dict[int, int] = {}
        self.superseded: set[int] = set()
        self.skipped: set[int] = set()
        for line in lines:
            if line["event"] == "reading":
                self.step_of[line["reading"]] = line["step"]
            elif line["event"] == "superseded":
                self.superseded |= set(line["readings"])
            elif line["event"] == "skipped":
                self.skipped |= set(line["steps"])
            elif line["event"] == "restored":
                self.superseded -= set(line.get("readings", ()))
                self.skipped -= set(line.get("steps", ()))

    @property
    def counting(self) -> set[int]:
        return set(self.step_of) - self.superseded

    def first_unfinished(self) -> int | None:
        axes = Counter(self.step_of[number] for number in self.counting)
        return next((n for n in STEPS if axes[n] < AXES_OF_A_STEP and n not in self.skipped), None)


def check_session(session: dict[str, Any]) -> Lines:
    """Everything that was told is in the record, and the record is whole. Returns its lines."""
    path = Path(session["path"])
    lines: Lines = [json.loads(line) for line in path.read_bytes().splitlines()]
    values = Counter(line["value_mm"] for line in lines if line["event"] == "reading")
    readings = {line["reading"]: line for line in lines if line["event"] == "reading"}
    for report in session["told"]:
        if report["did"] == "begin":
            assert Ledger(lines[: report["lines"]]).first_unfinished() == report["step"], report
        elif report["did"] == "correct":
            events = [
                e["event"] for e in lines if report["words"] in (e.get("text"), e.get("reason"))
            ]
            assert events, report
            assert len(set(events)) == len(events), report
        for number, axis, value_mm in report.get("readings", ()):
            reading = readings[number]
            assert (reading["step"], reading["axis"], reading["value_mm"]) == (
                report["step"],
                axis,
                value_mm,
            )
            assert values[value_mm] == 1
    check_end(path, lines)
    return lines


def check_end(path: Path, lines: Lines) -> None:
    """Closed, complete but for skipped steps, and read by the program as by the ledger."""
    ledger = Ledger(lines)
    record = read_record(path)
    folded = fold(record.events)
    assert record.end == "closed"
    assert ledger.first_unfinished() is None
    assert {r.reading for r in folded.readings} == ledger.counting
    assert Counter(ledger.step_of[number] for number in ledger.counting) == Counter(
        {n: AXES_OF_A_STEP for n in STEPS if n in folded.done()}
    )
    assert folded.done() | ledger.skipped == set(STEPS)


@pytest.mark.parametrize("seed", ["1", "2", "3"])
def test_a_hundred_random_kills(tmp_path: Path, seed: str) -> None:
    run = sessions(tmp_path, "random", seed, KILLS_OF_A_RUN)
    assert sum(session["kills"] for session in run) == KILLS_OF_A_RUN
    assert max(session["kills"] for session in run) >= 5
    for session in run:
        check_session(session)
    assert any(tmp_path.glob("*.torn"))


@pytest.mark.parametrize("how", ["boundary", "inside"])
def test_a_kill_at_every_line(tmp_path: Path, how: str) -> None:
    run = sessions(tmp_path, how, "5")
    kinds: set[str] = set()
    for session in run:
        kinds |= {line["event"] for line in check_session(session)}
    assert {"mounted", "superseded", "restored", "skipped", "noted", "faulted"} <= kinds
    assert {session["kills"] for session in run} == {0, 1, 2}
    torn = list(tmp_path.glob("*.torn"))
    if how == "inside":
        assert len(torn) > len(run) / 2
    else:
        assert all(of_the_fixed_kill(path) for path in torn)


def of_the_fixed_kill(torn: Path) -> bool:
    """At boundaries only the fixed kill of the first life tears a line; it may be kept twice."""
    return torn.name.startswith("1-") and len(set(torn.read_bytes().splitlines())) == 1


def test_a_real_run_is_killed_three_times_and_continued(tmp_path: Path) -> None:
    """Whole lines seen on the disk before a kill begin the finished record."""
    session = tmp_path / "s.jsonl"
    arguments = ["run", "--simulated", "--headless", "-o", str(session)]
    for line_count in (5, 25, 45):
        with subprocess.Popen([sys.executable, "-m", "app", *arguments]) as run:
            beginning = lines_when_there_are(session, line_count, run)
            os.kill(run.pid, signal.SIGKILL)
        assert run.returncode == -signal.SIGKILL, "the run ended before it was killed"
        on_disk = session.read_bytes()
        assert on_disk.startswith(beginning)
        arguments = ["run", "--headless", "--continue", str(session)]
    again = glidecal(*arguments)
    assert again.status == 0, again.err
    content = session.read_bytes()
    assert content.startswith(on_disk[: on_disk.rfind(b"\n") + 1])
    folded = fold(read_record(session).events)
    assert [e["event"] for e in map(json.loads, content.splitlines())].count("continued") == 3
    assert folded.done() == frozenset(range(1, 31))
    assert len(folded.readings) == 60
    assert glidecal("validate", session).status == 0


def lines_when_there_are(path: Path, line_count: int, run: subprocess.Popen[bytes]) -> bytes:
    """The whole lines of a growing file as soon as there are so many."""
    while run.poll() is None:
        content = path.read_bytes() if path.exists() else b""
        if content.count(b"\n") >= line_count:
            return content[: content.rfind(b"\n") + 1]
        time.sleep(0.001)
    pytest.fail(f"the run ended with status {run.returncode} and fewer than {line_count} lines")
