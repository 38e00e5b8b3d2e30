"""A real terminal: tmux types the keys and reads the screen."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(shutil.which("tmux") is None, reason="tmux is not installed")

PATIENCE_S = 300.0


class Terminal:
    """A terminal of its own server, with so many columns and rows."""

    def __init__(self, folder: Path, columns: int = 80, rows: int = 24) -> None:
        self._folder, self._started = folder, 0
        self._size = ["-x", str(columns), "-y", str(rows)]

    @property
    def _tmux(self) -> list[str]:
        """Another socket for each start: the server before may not have ended yet."""
        return ["tmux", "-S", str(self._folder / f"tmux{self._started}"), "-f", "/dev/null"]

    def start(self, *arguments: str) -> None:
        self._started += 1
        command = " ".join([sys.executable, "-m", "app", *arguments])
        # Ctrl-C is for the program alone: the shell must live to tell its status
        self.run(f"trap : INT; cd '{self._folder}' && {command}; echo STATUS $?; sleep 60")

    def run(self, script: str) -> None:
        """What is on the screen ends with the script."""
        self.call("new-session", "-d", *self._size, script)

    def press(self, *keys: str) -> None:
        self.call("send-keys", *keys)

    def screen(self) -> str:
        return self.call("capture-pane", "-p")

    def wait_for(self, text: str, patience_s: float = PATIENCE_S) -> str:
        """What is shown once this is; a line may be broken anywhere."""
        return self.wait_for_one_of((text,), patience_s)[1]

    def wait_for_one_of(
        self, texts: Sequence[str], patience_s: float = PATIENCE_S
    ) -> tuple[str, str]:
        """The first of these that is shown, and all that is."""
        deadline = time.monotonic() + patience_s
        while time.monotonic() < deadline:
            output = self.screen()
            text_shown = " ".join(output.split())
            for text in texts:
                if " ".join(text.split()) in text_shown:
                    return text, output
            time.sleep(0.1)
        pytest.fail(f"none of {texts} appeared:\n{self.screen()}")

    def press_for(self, key: str, text: str) -> str:
        """As an operator does: once more where the press came while the readings moved."""
        for _ in range(5):
            self.press(key)
            with suppress(pytest.fail.Exception):
                return self.wait_for(text, 5.0)
        return self.wait_for(text)

    def stop(self) -> None:
        subprocess.run([*self._tmux, "kill-server"], capture_output=True, check=False)

    def call(self, *arguments: str) -> str:
        """What tmux answers."""
        process = subprocess.run(
            [*self._tmux, *arguments], capture_output=True, text=True, check=True, timeout=300
        )
        return process.stdout


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    opened = Terminal(tmp_path)
    yield opened
    opened.stop()


def test_demo_is_driven_by_keys_and_paused_with_ctrl_c(terminal: Terminal, tmp_path: Path) -> None:
    terminal.start("demo")
    terminal.wait_for("Enter begins the session")
    terminal.press("Enter")
    terminal.wait_for("LEG X   ZERO   cycle 1 of 3")
    terminal.wait_for("= STABLE")
    output = terminal.press_for("Space", "Taken and on the disk, step 1")
    assert "G53 G0 X60.000" in output
    assert "f10 Leave" in output
    terminal.press("a")
    terminal.wait_for("Taken and on the disk, step 3")
    terminal.press("C-c")
    output = terminal.wait_for("STATUS")
    assert "STATUS 130" in output
    joined = output.replace("\n", "")
    assert "glidecal run --continue" in joined
    (session,) = (tmp_path / "demo-sessions").glob("*.jsonl")
    terminal.start("run", "--continue", str(session))
    terminal.wait_for("Enter continues the session")
    terminal.press("F10")
    terminal.wait_for("STATUS 0")


def test_a_person_is_asked_before_a_file_is_replaced(
    terminal: Terminal, tmp_path: Path, samples: Path
) -> None:
    own_file = tmp_path / "out.json"
    own_file.write_text("mine", encoding="utf-8")
    session = str(samples / "simulated_sweep.jsonl")
    for answer, status in (("n", 130), ("y", 0)):
        terminal.start("export", session, "--format", "json", "-o", own_file.name)
        terminal.wait_for("out.json is there already. Replace? [y/N]:")
        assert own_file.read_text(encoding="utf-8") == "mine"
        terminal.press(answer, "Enter")
        terminal.wait_for(f"STATUS {status}")
        assert (own_file.read_text(encoding="utf-8") == "mine") == (answer == "n")
        terminal.stop()


def test_long_work_tells_that_it_is_under_way_and_stops(terminal: Terminal) -> None:
    terminal.start(*["postures", "hexaslide", "--procedure", "pose-forward", "--count", "30"])
    terminal.wait_for("Looking for postures, Ctrl-C stops")
    terminal.press("C-c")
    terminal.wait_for("STATUS 130")
    assert "Traceback" not in terminal.screen()


def test_home(terminal: Terminal) -> None:
    terminal.start()
    output = terminal.wait_for("Demonstration on a simulated machine")
    assert "New session on real indicators" in output
    terminal.press("Enter")
    terminal.wait_for("First indicator")
    terminal.press("F10")
    terminal.wait_for("STATUS 0")
