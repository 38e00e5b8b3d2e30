"""The whole job in one run: measure, identify, export, measure again, compare."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from protocols.record import read_record
from protocols.session import fold
from tests.app.cli import glidecal
from tests.conftest import LONG, first_quick


@LONG
@pytest.mark.parametrize("procedure", first_quick(["zero-max-min", "sweep"]))
def test_demo_headless(tmp_path: Path, procedure: str) -> None:
    run = glidecal("demo", "--headless", "--protocol", procedure, "--seed", "7", cwd=tmp_path)
    assert run.status == 0, run.err
    before, after = re.findall(r"went from ([\d.]+) to ([\d.]+) mm", run.out)[0]
    assert float(after) < 0.1 * float(before)
    sessions = sorted((tmp_path / "demo-sessions").glob("*.jsonl"))
    assert len(sessions) == 2
    assert [read_record(p).end for p in sessions] == ["closed", "closed"]
    first, second = (fold(read_record(p).events) for p in sessions)
    entered = second.opened.machine.entered_offsets_mm
    figures = re.findall(r"d_rho_\w +([+-][\d.]+)", run.out)[:3]
    assert [f"{value:+.4f}" for value in entered] == figures
    assert first.opened.machine.entered_offsets_mm == (0.0, 0.0, 0.0)
    assert all(re.fullmatch(r"01A[+-]\d+\.\d+", r.text) for r in first.readings)


def test_demo_without_a_terminal_falls_back_to_headless(tmp_path: Path) -> None:
    run = glidecal("demo", cwd=tmp_path)
    assert run.status == 0, run.err
    assert "Leg deviations went from" in run.out


@LONG
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_killed_in_the_middle_and_continued(tmp_path: Path) -> None:
    """Kill -9 while measuring; every acknowledged reading is there, none doubled."""
    session = tmp_path / "s.jsonl"
    slow = (
        "from app.cli import main; import app.measuring.session as g, sys, time\n"
        "take = g.GuidedSession.take\n"
        "def slowly(self):\n"
        "    taken = take(self)\n"
        "    if taken: print(taken.step.number, flush=True)\n"
        "    time.sleep(0.01)\n"
        "    return taken\n"
        "g.GuidedSession.take = slowly\n"
        f"sys.argv = ['glidecal', 'run', '--simulated', '--headless', '-o', {str(session)!r}]\n"
        "main()"
    )
    with subprocess.Popen([sys.executable, "-c", slow], stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        for line in run.stdout:
            if int(line) >= 9:
                break
        time.sleep(0.02)
        os.kill(run.pid, signal.SIGKILL)
        acknowledged = {int(line), *(int(n) for n in run.stdout.read().split())}
    steps = fold(read_record(session).events).done()
    assert acknowledged | set(range(1, 10)) <= steps
    again = glidecal("run", "--continue", session, "--headless")
    assert again.status == 0, again.err
    whole_session = fold(read_record(session).events)
    assert whole_session.done() == frozenset(range(1, 31))
    assert len(whole_session.readings) == 60
    assert glidecal("validate", session).status == 0
