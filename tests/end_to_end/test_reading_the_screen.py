"""A whole session at 80 × 24 by somebody who reads only the screen, and types only keys.

Two simulated indicators listen on real ports; their machine stands in a second terminal. The ports
are named in the wrong order, and once the machine is not moved: the screen must tell both.
"""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from protocols.record import read_record
from protocols.session import fold
from tests.conftest import LONG
from tests.end_to_end.test_terminal import Terminal

pytestmark = [
    LONG,
    pytest.mark.skipif(shutil.which("tmux") is None, reason="tmux is not installed"),
]

PROCEDURE = """\
schema = "glidecal.procedure/1"
name = "short"
title = "Zero, Max, Min once on each leg"
cycles = 1
levels = ["zero", "max", "min"]
window_s = 0.5
"""
BOX = "│█▊▎╭╮╰╯─▔▁ "
PATIENCE_S = 300.0


class Person:
    """Knows the machine and where each spindle stands; of the program only what is shown."""

    def __init__(self, screen: Terminal, machine: Terminal) -> None:
        self.screen, self.machine = screen, machine
        self.at_step = 1
        self.forgets_to_move = True
        self.met: list[str] = []

    def read(self) -> str:
        """The screen as one text, without frames."""
        return " ".join(line.strip(BOX) for line in self.screen.screen().splitlines())

    def key_for(self, words: str) -> str:
        """The key that the last line of the screen names for this."""
        self.screen.wait_for(f" {words}")
        match = re.search(rf"(\S+) {words}\b", self.screen.screen().strip().splitlines()[-1])
        assert match, f"no key for {words}:\n{self.screen.screen()}"
        return {"⏎": "Enter", "space": "Space", "esc": "Escape"}.get(
            match[1], match[1].replace("f1", "F1")
        )

    def do(
        self, act: Callable[[], object], *, until_gone: str, again_s: float = PATIENCE_S
    ) -> None:
        """Act, then wait until this is no longer to be read; act again after so long."""
        self.met.append(until_gone)
        due = time.monotonic()
        end = due + PATIENCE_S
        while until_gone in self.read():
            now = time.monotonic()
            assert now < end, f"{until_gone!r} stays:\n{self.screen.screen()}"
            if now >= due:
                act()
                due = now + again_s
            time.sleep(0.1)

    def push(self, axis: str) -> None:
        """Push in the spindle that stands along an axis of leg X."""
        self.machine.press({"Y": "p1", "Z": "p2"}[axis], "Enter")

    def look(self) -> bool:
        """Read the screen and do what it asks for. Returns whether the session has its result."""
        text = self.read()
        if moved := re.search(r"Was it the one along ([YZ])\? Then (\S) exchanges", text):
            self.do(lambda: self.screen.press(moved[2].lower()), until_gone=moved[0])
        elif request := re.search(r"[Pp]ush in the spindle along ([YZ]) of leg X", text):
            words = text[text.index(request[0]) :][:90]
            self.do(lambda: self.push(request[1]), until_gone=words, again_s=10.0)
        elif "found at its place. Enter begins" in text:
            self.do(lambda: self.screen.press("Enter"), until_gone="Enter begins")
        elif answer := re.search(r"did the machine move\?.*?(\d)  No\.", text):
            self.do(lambda: self.screen.press(answer[1]), until_gone="did the machine move?")
        elif "Space continues" in text:
            self.do(lambda: self.screen.press("Space"), until_gone="Space continues")
        elif present := re.search(r">\s+(\d+) [XYZ] (ZERO|MAX|MIN)", text):
            self.measure(int(present[1]), text)
        return "With these values entered" in text

    def measure(self, step: int, text: str) -> None:
        """Move the machine there, wait until all stand still, take."""
        forgotten = step == 2 and self.forgets_to_move
        if step != self.at_step and not forgotten:
            self.machine.press(str(step), "Enter")
            self.machine.wait_for(f"step {step}:")
            self.at_step = step
            time.sleep(1.5)  # the machine goes there, and is heard to
        elif text.count("= STABLE") == 2:
            self.screen.press(self.key_for("Take"))
            self.forgets_to_move &= not forgotten
            time.sleep(1.0)


@pytest.fixture
def terminals(tmp_path: Path) -> Iterator[tuple[Terminal, Terminal]]:
    folders = tmp_path / "here", tmp_path / "machine"
    for folder in folders:
        folder.mkdir()
        (folder / "short.toml").write_text(PROCEDURE, encoding="utf-8")
    pair = Terminal(folders[0]), Terminal(folders[1])
    yield pair
    for terminal in pair:
        terminal.stop()


def test_a_whole_session_by_who_reads_only_the_screen(
    terminals: tuple[Terminal, Terminal], tmp_path: Path
) -> None:
    screen, machine = terminals
    machine.start("simulate-indicator", "mitutoyo-01a", "--protocol", "short.toml")
    output = machine.wait_for("Ctrl-C ends").replace("\n", "")
    first, second = dict.fromkeys(re.findall(r"/dev/[a-z]+/?\d+", output))
    wrong = [f"--indicator mitutoyo-01a:{port}" for port in (second, first)]
    screen.start("run", "--protocol", "short.toml", "-o", "mine.jsonl", *wrong)
    person = Person(screen, machine)
    text, since = "", time.monotonic()
    while not person.look():
        if (now := person.read()) != text:
            text, since = now, time.monotonic()
        assert time.monotonic() - since < PATIENCE_S, f"nothing goes on:\n{screen.screen()}"
        time.sleep(0.2)
    screen.press(person.key_for("Export"))
    screen.wait_for("Written to")
    screen.press(person.key_for("Quit"))
    screen.wait_for("STATUS 0")

    record = read_record(tmp_path / "here" / "mine.jsonl")
    session = fold(record.events)
    assert record.end == "closed"
    assert session.complete
    assert [instrument.port for instrument in session.opened.instruments] == [first, second]
    assert [instrument.pushed_in for instrument in session.opened.instruments] == [
        "larger",
        "larger",
    ]
    assert "ports exchanged" in session.notes[0]
    assert list(session.superseded.values()) == ["questioned: unchanged"] * 2
    assert "did the machine move?" in person.met
    assert len(session.readings) == 2 * 12
