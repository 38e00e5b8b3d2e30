"""Run the program as a person would, with its streams and its exit status.

Most tests call it in their own process: there its libraries are loaded, and what one command worked
out of a session the next one finds. `as_process` is for what only a process shows: to start Python
and load scipy takes longer than most commands. `tests/end_to_end` starts Python, too.
"""

from __future__ import annotations

import gc
import io
import os
import subprocess
import sys
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from typer.main import get_command

from app.cli import main
from app.evaluating import correction
from tests.conftest import ROOT
from tests.posteriors import known_posterior

PATIENCE_S = 600.0


@dataclass(frozen=True)
class Run:
    """What a run of the program left behind."""

    status: int
    out: str
    err: str


def glidecal(*arguments: str | Path, cwd: Path | None = None) -> Run:
    """``glidecal`` with these arguments, in this process; no terminal, no input."""
    before, thresholds = dict(os.environ), gc.get_threshold()
    with TemporaryDirectory() as folder, ExitStack() as stack:
        out, err = Path(folder, "out"), Path(folder, "err")
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        stack.callback(gc.set_threshold, *thresholds)
        stack.callback(_restore_environment, before)
        streams = {"stdout": out, "stderr": err}
        for name, path in streams.items():
            stream = stack.enter_context(path.open("w", encoding="utf-8"))
            patch.setattr(sys, name, stream)
            patch.setattr(sys, f"__{name}__", stream)
        patch.setattr(sys, "stdin", stack.enter_context(Path(os.devnull).open(encoding="utf-8")))
        patch.setattr(sys, "argv", ["glidecal", *map(str, arguments)])
        patch.setattr(sys.modules["__main__"], "__package__", None)  # named by argv
        patch.setattr("typer.main.get_command", _command)
        patch.setattr(correction, "posterior", known_posterior)
        patch.setenv("COLUMNS", "80")
        if cwd is not None:
            patch.chdir(cwd)
        with pytest.raises(SystemExit) as exit_info:
            main()
        status = exit_info.value.code
        assert isinstance(status, int)
        sys.stdout.flush()
        sys.stderr.flush()
        return Run(status, *(p.read_text(encoding="utf-8") for p in (out, err)))


def _restore_environment(before: dict[str, str]) -> None:
    os.environ.clear()
    os.environ.update(before)


_command = cache(get_command)
"""Of the program, whose verbs and options are the same each time."""


def as_process(*arguments: str | Path, cwd: Path | None = None) -> Run:
    """As `glidecal`, in a process of its own."""
    run = subprocess.run(
        [sys.executable, "-m", "app", *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=False,
        timeout=PATIENCE_S,
        env={**os.environ, "COLUMNS": "80", "PYTHONPATH": str(ROOT)},
        cwd=cwd,
    )
    return Run(run.returncode, run.stdout.decode(), run.stderr.decode())


def refused(status: int, *arguments: str | Path, cwd: Path | None = None) -> str:
    """The one paragraph of an error with this exit status; never a traceback."""
    run = glidecal(*arguments, cwd=cwd)
    assert run.status == status, f"{run.status}: {run.err}"
    assert run.out == ""
    assert "Traceback" not in run.err
    last = run.err.strip().splitlines()[-1]
    assert last.startswith("glidecal: ")
    return last


def run_here(*arguments: str) -> tuple[int, str, str]:
    """The program in this process, for very many runs: status, standard output, standard error."""
    streams = io.BytesIO(), io.BytesIO()
    out, err = (io.TextIOWrapper(stream, encoding="utf-8") for stream in streams)
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["glidecal", *arguments])
        patch.setattr("typer.main.get_command", _command)
        with pytest.raises(SystemExit) as exit_info:
            main()
        sys.stderr.flush()
    status = exit_info.value.code
    assert isinstance(status, int)
    return status, streams[0].getvalue().decode(), streams[1].getvalue().decode()
