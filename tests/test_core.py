"""Measure, solve, diagnose, export of tripods work without what not everybody needs.

The core of the program; the other rooms lean on it, and never the other way round.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import LONG, ROOT, SAMPLES, first_quick

MOTION = "drivers.motion"
"""Measuring steps through a session by hand or by machine in one place, and imports it."""

BESIDE_THE_CORE = (
    "app.report.dcc",
    "app.report.pages",
    "app.screens.hexaslide",
    "app.serving",
    "calib.hexaslide",
    MOTION,
    "protocols.hexaslide",
    "protocols.hexaslide_session",
    "protocols.hexaslide_table",
    "protocols.printers",
)
"""Hexa Slide, machines that move themselves, printers, reports, and what serves a browser."""

WITHOUT = """
import sys

REMOVED = {removed}

class Removed:
    def find_spec(self, name, path=None, target=None):
        if any(name == removed or name.startswith(removed + ".") for removed in REMOVED):
            raise ModuleNotFoundError(name + " is removed")

sys.meta_path.insert(0, Removed())
from glidecal.__main__ import main
main()
"""
SESSION = str(SAMPLES / "simulated_zero-max-min.jsonl")


@pytest.mark.parametrize(
    "arguments",
    first_quick(
        [
            ("run", "--simulated", "--headless", "-o", "s.jsonl"),
            ("validate", SESSION),
            ("solve", SESSION),
            ("diagnose", SESSION),
            ("export", SESSION, "--format", "json", "-o", "offsets.json"),
        ]
    ),
    ids=lambda arguments: arguments[0],
)
def test_the_core_works_alone(arguments: tuple[str, ...], tmp_path: Path) -> None:
    removed = [name for name in BESIDE_THE_CORE if name != MOTION or arguments[0] != "run"]
    works(removed, arguments, tmp_path)


@LONG
def test_keys_are_listed_without_the_extra_that_serves_a_browser(tmp_path: Path) -> None:
    works(["aiohttp", "textual_serve"], ("settings",), tmp_path)


def works(removed: list[str], arguments: tuple[str, ...], folder: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-c", WITHOUT.format(removed=removed), *arguments],
        cwd=folder,
        env={"PYTHONPATH": str(ROOT), "HOME": str(folder)},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
