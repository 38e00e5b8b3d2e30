"""Whatever a stranger's file holds: a documented exit status, a paragraph, nothing else.

A few seeds always run; GLIDECAL_FUZZ=2000 sets another number of them.
"""

from __future__ import annotations

import os
import re
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from calib.printable import HIDDEN
from tests.app.cli import run_here
from tests.app.commands.hostile_files import KINDS, hostile_case
from tests.conftest import first_quick

SEEDS = int(os.environ.get("GLIDECAL_FUZZ", "0")) or 2 * len(KINDS)
AT_ONCE = 10
DOCUMENTED = {0, 2, 3, 4, 5, 6, 7, 130}
MOST_CPU_S = 60.0
"""A quiet computer needs a few; a busy one counts them several times."""
NOT_FINITE = re.compile(r"(?<![\w'\"])[+-]?(nan|inf|infinity)\b", re.IGNORECASE)


@dataclass
class Opened:
    """Files opened for writing while it is switched on."""

    paths: set[str] = field(default_factory=set)
    on: bool = False

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.on and event == "open" and isinstance(arguments[0], str):
            path, _, flags = arguments
            if flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                self.paths.add(os.path.realpath(path))


OPENED = Opened()
sys.addaudithook(OPENED)


def faults_of(seed: int, folder: Path, patch: pytest.MonkeyPatch) -> list[str]:
    """What the program did that it should not, for each run of this seed."""
    inside = folder / "chosen"
    inside.mkdir(parents=True)
    case = hostile_case(seed, inside)
    patch.chdir(inside)
    patch.setenv("GLIDECAL_EFFECTS", str(inside / "none"))
    for name, value in case.surroundings.items():
        patch.setenv(name, value)
    faults = []
    for arguments in case.runs:
        started = time.process_time()
        OPENED.paths.clear()
        OPENED.on = True
        try:
            status, out, err = run_here(*arguments)
        except Exception as problem:  # what would have been a traceback
            faults.append(f"{seed} {arguments}: {type(problem).__name__}: {problem!s:.300}")
            continue
        finally:
            OPENED.on = False
        spent_s = time.process_time() - started
        outside = {path for path in OPENED.paths if not path.startswith(os.path.realpath(inside))}
        raw = set(HIDDEN.findall(out + err)) - {"\n", "\t"}
        wrong = {
            "status": {status} - DOCUMENTED,
            "traceback": "Traceback" in out + err,
            "warning": "Warning" in err,
            "not finite": NOT_FINITE.findall(out),
            "raw": raw,
            "slow": spent_s if spent_s > MOST_CPU_S else None,
            "outside": outside - {os.devnull},
            "mute": bool(status) and not err,
            "long": len(err) if len(err) > 3000 else None,
        }
        faults += [f"{seed} {arguments}: {name} {v}" for name, v in wrong.items() if v]
    return faults


@pytest.mark.parametrize("first", first_quick(range(0, SEEDS, AT_ONCE)))
def test_strangers_files(first: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # of a module that a verb loads first
    faults = []
    for seed in range(first, min(first + AT_ONCE, SEEDS)):
        faults += faults_of(seed, tmp_path / str(seed), monkeypatch)
    assert not faults, "\n".join(faults)
