"""Measure in LinuxCNC, export, home again, measure: the loop as tests and figures go round it."""

from __future__ import annotations

import re
from pathlib import Path

from app.exports.linuxcnc import pins
from calib.tripod.pipeline import Model
from tests.app.cli import glidecal
from tests.controller.machine import Controlled, Machine, homing, old_home_offset_mm
from tests.controller.running import need_linuxcnc

OFFSETS = (0.8, -1.3, 0.45)


class Loop:
    """One machine with its controller, measured uncorrected.

    ``ini`` is the controller's file, ``session`` what was measured, ``model`` where to adopt what
    is found.
    """

    def __init__(self, machine: Machine, folder: Path, *, zero_set: bool = False) -> None:
        need_linuxcnc()
        self.machine, self.folder, self.zero_set = machine, folder, zero_set
        self.entries = [homing(old_home_offset_mm(machine, k, 1.0)) for k in range(3)]
        before = Controlled(machine, self.entries, pins(Model()), zero_set=zero_set)
        table, self.before_mm = before.measured(folder / "before")
        self.ini = folder / "before" / "config" / "machine.ini"
        self.session, self.model = folder / "before.jsonl", folder / "found.json"
        (folder / "before.csv").write_text(table)
        self.do("import", folder / "before.csv", "-o", self.session, "--resolution", "0.001")

    def do(self, *words: str | Path) -> str:
        run = glidecal(*words)
        assert run.status == 0, run.err
        return run.out

    def after_mm(self, name: str, *words: str | Path, sign: float = 1.0) -> float:
        """The tool's error with what this export writes; -1 turns what HOME_OFFSET grows by."""
        out = self.folder / f"export-{name}"
        self.do("export", *words, "--ini", self.ini, "-o", out)
        files = {path.name: path.read_text() for path in out.iterdir()}
        for k in range(3):
            old = float(self.entries[k]["HOME_OFFSET"])
            include = files[f"calib_joint{k}.inc"]
            new = float(re.findall(r"^HOME_OFFSET = (.*)$", include, re.M)[0])
            turned = f"HOME_OFFSET = {old + sign * (new - old):.6f}"
            files[f"calib_joint{k}.inc"] = re.sub(r"(?m)^HOME_OFFSET = .*$", turned, include)
        includes = [f"#INCLUDE calib_joint{k}.inc\n" for k in range(3)]
        hal = files.pop("calib.hal", pins(Model()))
        state = self.machine, self.entries, hal, files, includes, self.zero_set
        return Controlled(*state).checked_mm(self.folder / name)
