"""A closed terminal and a polite kill: the session is paused and can go on."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from protocols.record import read_record
from tests.app.cli import glidecal
from tests.conftest import LONG, first_quick

if sys.platform == "win32":
    pytest.skip("Windows has neither pseudo-terminals nor SIGHUP", allow_module_level=True)

PATIENCE_S = 300.0


class Terminal:
    """A pseudo-terminal whose other end is ours to close."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self._ours, theirs = os.openpty()
        self.shown = b""
        self.process = subprocess.Popen(
            [sys.executable, "-m", "app", "--no-animations", *arguments],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            cwd=folder,
            start_new_session=True,
            env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"},
        )
        os.close(theirs)
        self._open = True

    def press(self, keys: bytes) -> None:
        os.write(self._ours, keys)

    def until(self, condition: Callable[[], bool]) -> None:
        """Read what is shown until the condition holds."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, self.shown[-2000:].decode(errors="replace")
            if self._open and select.select([self._ours], [], [], 0.1)[0]:
                try:
                    self.shown += os.read(self._ours, 65536)
                except OSError:  # nobody writes there any more
                    self.close()
            elif not self._open:
                select.select([], [], [], 0.1)

    def ended(self) -> bool:
        return self.process.poll() is not None

    def close(self) -> None:
        if self._open:
            os.close(self._ours)
            self._open = False


@pytest.fixture
def measuring(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    """A session with at least one reading, measured automatically."""
    monkeypatch.setenv("GLIDECAL_SETTINGS", str(tmp_path / "settings.toml"))
    terminal = Terminal(tmp_path, "run", "--simulated", "-o", "session.jsonl")
    record = tmp_path / "session.jsonl"
    terminal.until(lambda: b"Enter begins" in terminal.shown)
    terminal.press(b"\r")
    terminal.until(record.exists)
    terminal.until(lambda: b"automatic" in terminal.shown or pressed_a(terminal))
    terminal.until(lambda: b'"event":"reading"' in record.read_bytes())
    yield terminal
    if not terminal.ended():
        terminal.process.kill()
    terminal.process.wait()
    terminal.close()


def pressed_a(terminal: Terminal) -> bool:
    """Until the screen is there, a key goes nowhere."""
    if b"LEG X" in terminal.shown and b"pressed" not in terminal.shown:
        terminal.press(b"a")
        terminal.shown += b"pressed"
    return False


@pytest.mark.parametrize("closed", first_quick([False, True]), ids=["kill", "closed-terminal"])
def test_the_session_is_paused_and_goes_on(
    measuring: Terminal, tmp_path: Path, closed: bool
) -> None:
    record = tmp_path / "session.jsonl"
    if closed:
        measuring.close()
    os.kill(measuring.process.pid, signal.SIGHUP if closed else signal.SIGTERM)
    measuring.until(measuring.ended)
    assert measuring.process.returncode == 130
    assert b"Traceback" not in measuring.shown
    assert read_record(record).end == "open"
    assert [path.name for path in tmp_path.iterdir()] == ["session.jsonl"]
    run = glidecal("run", "--continue", record, "--headless")
    assert run.status == 0, run.err
    assert read_record(record).end == "closed"


@LONG
def test_wrong_settings_are_told_before_a_screen_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings_path = tmp_path / "settings.toml"
    settings_path.write_text('theme = "pink"\n', encoding="utf-8")
    monkeypatch.setenv("GLIDECAL_SETTINGS", str(settings_path))
    terminal = Terminal(tmp_path, "run", "--simulated", "-o", "session.jsonl")
    terminal.until(terminal.ended)
    terminal.until(lambda: b"'pink'" in terminal.shown)
    terminal.close()
    assert terminal.process.returncode == 3
    assert b"\x1b[?1049h" not in terminal.shown  # no screen was opened
    assert b"line 1, theme" in terminal.shown
    assert list(tmp_path.iterdir()) == [settings_path]
