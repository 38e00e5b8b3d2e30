"""Run the program as a person would: as a process, with its streams and its exit status."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Run:
    """What a run of the program left behind."""

    status: int
    out: str
    err: str


def glidecal(*arguments: str | Path, cwd: Path | None = None) -> Run:
    """``glidecal`` with these arguments; no terminal, no input."""
    done = subprocess.run(
        [sys.executable, "-m", "app", *map(str, arguments)],
        capture_output=True,
        text=True,
        encoding="utf-8",
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        timeout=90,
        check=False,
        env={**os.environ, "COLUMNS": "80", "PYTHONUTF8": "1"},
    )
    return Run(done.returncode, done.stdout, done.stderr)


def refused(status: int, *arguments: str | Path, cwd: Path | None = None) -> str:
    """The one paragraph of an error with this exit status; never a traceback."""
    run = glidecal(*arguments, cwd=cwd)
    assert run.status == status, f"{run.status}: {run.err}"
    assert run.out == ""
    assert "Traceback" not in run.err
    last = run.err.strip().splitlines()[-1]
    assert last.startswith("glidecal: ")
    return last
