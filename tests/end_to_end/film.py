"""README's walk in a real terminal, filmed: python -m tests.end_to_end.film 80x24 -o FOLDER.

tmux types what an operator types, and waits for the words that README promises. Of each station the
screen is kept as a text, and all of them together as ``film.cast``, which asciinema plays.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.conftest import ROOT, SAMPLES
from tests.end_to_end.test_terminal import Terminal

SIZES = ((80, 24), (100, 30), (120, 40))

COLOURS = re.compile(r"\x1b\[[0-9;:]*m|\x1b\(B|[\x0e\x0f]")

LAST_KEY = "f1 Help"
"""Where it can be read, the keys before it can."""

MOST_LINES = "2000"
"""Of what scrolled away above a command's last lines."""

INI = "[TRAJ]\nLINEAR_UNITS = mm\n" + "".join(
    f"[JOINT_{joint}]\nTYPE = LINEAR\nHOME_OFFSET = {joint}.5\n" for joint in range(3)
)


NOTHING_NAMED = ("AGREES. The model explains the readings", "CANNOT-TELL. These readings")
"""A sound machine; the scatter of the demonstration is another each time."""


@dataclass(frozen=True)
class Station:
    """What was typed, the ``words`` that README promises of it, and what the terminal showed."""

    name: str
    typed: str
    words: tuple[str, ...]
    text: str
    of_program: bool

    @property
    def missing(self) -> list[str]:
        """Promised words that are not there; a command's line may be broken anywhere."""
        text_shown = " ".join(self.text.split())
        return [words for words in self.words if " ".join(words.split()) not in text_shown]

    def cut(self, columns: int) -> list[str]:
        """Rows of the program's screens that go on beyond the edge."""
        rows = self.text.splitlines() if self.of_program else []
        rows = [row for row in rows if not row.endswith(LAST_KEY)]
        at_edge = (row for row in rows if len(row) >= columns and row[columns - 1].isalnum())
        return [*at_edge, *(row for row in rows if re.search(r"\w…\s*$", row))]


class Film(Terminal):
    """A shell with the program in a folder, and everything that it shows."""

    def __init__(self, folder: Path, columns: int, rows: int) -> None:
        super().__init__(folder, columns, rows)
        self.columns, self.rows = columns, rows
        self.stations: list[Station] = []
        self._began_s = time.monotonic()
        self._frames: list[tuple[float, str]] = []
        home = folder / ".home"
        (home / "bin").mkdir(parents=True)
        program = home / "bin" / "glidecal"
        program.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -m glidecal "$@"\n')
        program.chmod(0o755)
        environment = f"XDG_DATA_HOME={home} XDG_CACHE_HOME={home} TEXTUAL_ANIMATIONS=none"
        path = f"PATH={program.parent}:$PATH PYTHONUTF8=1 OPENBLAS_NUM_THREADS=1"
        self.run(f"cd '{folder}'; {environment} {path} PS1='$ ' exec sh -i")
        self.wait_for("$")

    def screen(self) -> str:
        """What is shown; another picture than before is filmed."""
        picture = self.call("capture-pane", "-p", "-e")
        if not self._frames or picture != self._frames[-1][1]:
            self._frames.append((time.monotonic() - self._began_s, picture))
        return "\n".join(row.rstrip() for row in COLOURS.sub("", picture).splitlines())

    def press_and_see(self, name: str, key: str, *words: str) -> None:
        """A key on a screen of the program, or none; words that come, the first when it is done."""
        self.press(*filter(None, [key]))
        text = self.wait_for(words[0])
        for later in words[1:]:
            text = self.wait_for(later)
        self.stations.append(Station(name, key, words, text, of_program=True))

    def type_and_see(self, name: str, command: str, *words: str) -> None:
        """A command in the shell, which then waits for the next one."""
        number = len(self.stations) + 1
        self.call("send-keys", "-l", f'clear; {command}; echo "[$?] {number}"')
        self.call("clear-history")
        self.press("Enter")
        self.wait_for(f"] {number}\n$")
        text = self.call("capture-pane", "-p", "-J", "-S", f"-{MOST_LINES}")
        self.stations.append(Station(name, command, (*words, "[0]"), text, of_program=False))

    def write(self, folder: Path) -> None:
        """A text of each station, and the film (asciicast, version 2)."""
        folder.mkdir(parents=True, exist_ok=True)
        for number, station in enumerate(self.stations, start=1):
            text = f"{station.typed}\n\n{station.text}"
            (folder / f"{number:02}_{station.name}.txt").write_text(text, encoding="utf-8")
        head = {"version": 2, "width": self.columns, "height": self.rows, "title": "README.md"}
        lines = [json.dumps(head)]
        for at_s, picture in self._frames:
            drawn = "\x1b[H\x1b[2J" + picture.rstrip("\n").replace("\n", "\r\n")
            lines.append(json.dumps([round(at_s, 3), "o", drawn]))
        (folder / "film.cast").write_text("\n".join(lines) + "\n", encoding="utf-8")


def walk(film: Film, folder: Path) -> None:
    """README from its two commands to the history."""
    demonstration(film)
    shutil.copy(ROOT / "protocols" / "machines" / "orthoglide.toml", folder / "my-machine.toml")
    (folder / "my.ini").write_text(INI, encoding="utf-8")
    before, after = sorted((folder / "demo-sessions").glob("*.jsonl"))
    before.rename(folder / "before.jsonl")
    after.rename(folder / "after.jsonl")
    of_machine(film)
    of_result(film)
    of_history(film, folder)


def demonstration(film: Film) -> None:
    """`make demo` with its keys."""
    film.call("send-keys", "-l", "clear; glidecal demo")
    film.press_and_see("demo", "Enter", "Enter begins the session", "The machine is simulated")
    film.press_and_see(
        "measuring", "Enter", "LEG X   ZERO   cycle 1 of 3", "space Take", "= STABLE"
    )
    film.press_for("Space", "Taken and on the disk, step 1")
    film.press_and_see("taken", "a", "automatic", "Taken and on the disk, step")
    film.press_and_see(
        "result", "", "Next: E writes these values", "d_rho_x", "now ", "after ", "e Export"
    )
    film.press_and_see("exported", "e", "Written to", "offsets.json", "then V measures again")
    film.press_and_see("report", "r", "Report written beside the session", "print and sign it")
    film.press("d")
    film.press_and_see("diagnosis", "", film.wait_for_one_of(NOTHING_NAMED)[0], "l Result")
    film.press_and_see("back", "Escape", "Next: enter the values in the controller")
    film.press_and_see("verify", "v", "the exported offsets must now be in", "Enter begins")
    film.press_and_see("again", "Enter", "LEG X   ZERO   cycle 1 of 3")
    film.press_and_see("compared", "a", "Leg deviations went from", "Before/after", "f1 Help")
    film.press_and_see("left", "F10", "$")


def of_machine(film: Film) -> None:
    """Your own machine, as far as it goes without one."""
    film.type_and_see("ports", "glidecal ports", "port")
    film.type_and_see(
        "steps",
        "glidecal run --dry-run --machine my-machine.toml",
        "30 steps",
        "1 x ZERO 1",
        "30 z ZERO end",
    )


def of_result(film: Film) -> None:
    """The result, and the report."""
    film.type_and_see("solve", "glidecal solve before.jsonl", "d_rho_x", "± U (95 %)", "tool")
    film.type_and_see("diagnose", "glidecal diagnose before.jsonl", "missing.", "Tool over")
    film.type_and_see(
        "export",
        "glidecal export before.jsonl --format linuxcnc --ini my.ini -o offsets/",
        "written: offsets/calib_joint0.inc",
    )
    film.type_and_see(
        "verified", "glidecal verify before.jsonl after.jsonl --tolerance 0.05", "PASS"
    )
    film.type_and_see(
        "reported",
        "glidecal report before.jsonl --after after.jsonl -o report.html",
        "written: report.html",
    )


def of_history(film: Film, folder: Path) -> None:
    """Of these two sessions, and of the published ones on a screen."""
    film.type_and_see("history", "glidecal history .", "orthoglide, simulated: 2 sessions.")
    (folder / "published").mkdir()
    for path in (*SAMPLES.glob("experiment_?_*.jsonl"), SAMPLES / "simulated_sweep.jsonl"):
        shutil.copy(path, folder / "published")
    film.call("send-keys", "-l", "clear; glidecal history published --screen")
    film.press_and_see("machines", "Enter", "orthoglide, imported: ", "1 Machines")
    film.press_and_see("sessions", "Enter", "imported: 7 sessions. Last imported", "2 History")
    film.press_and_see("charts", "+", "joint y, change of the offset (2 of 3)")
    film.press_and_see("end", "F10", "$")


def filmed(columns: int, rows: int, folder: Path | None = None) -> list[Station]:
    """Every station of the walk; written to the ``folder``, also where it broke off."""
    with tempfile.TemporaryDirectory() as place:
        film = Film(Path(place), columns, rows)
        try:
            walk(film, Path(place))
        finally:
            film.stop()
            if folder:
                film.write(folder)
    return film.stations


def main() -> None:
    """Film at the sizes that are asked for, or at all three."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sizes", nargs="*", default=[f"{c}x{r}" for c, r in SIZES])
    parser.add_argument("-o", dest="folder", type=Path, default=Path("build/film"))
    asked = parser.parse_args()
    if shutil.which("tmux") is None:
        sys.exit("tmux is not installed: nothing is filmed")
    for size in asked.sizes:
        columns, rows = map(int, size.split("x"))
        stations = filmed(columns, rows, asked.folder / size)
        broken = [(s.name, s.missing, s.cut(columns)) for s in stations]
        for name, missing, cut in broken:
            if missing or cut:
                sys.exit(f"{size}, {name}: missing {missing}, cut {cut}")
        print(f"{size}: {len(stations)} stations in {asked.folder / size}")


if __name__ == "__main__":
    try:
        main()
    except pytest.fail.Exception as problem:
        sys.exit(str(problem))
