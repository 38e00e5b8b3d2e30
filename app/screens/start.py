"""Open the terminal interface on the screen that was asked for."""

from __future__ import annotations

import sys
from pathlib import Path

from textual.screen import Screen

from app.commands.options import need_terminal
from app.opening import Plan
from app.screens.check import CheckScreen
from app.screens.home import HomeScreen
from app.screens.interface import Interface
from app.screens.result import ResultScreen
from app.solving import solve_files


def open_interface() -> int:
    """Home. Returns the exit status."""
    need_terminal("terminal interface", "a verb: see glidecal --help")
    return _run(HomeScreen())


def open_session(plan: Plan, *, continued: bool = False) -> int:
    """The instrument check of a planned or interrupted session, then measuring."""
    return _run(CheckScreen(plan, continued=continued))


def open_result(path: Path) -> int:
    """The result of a recorded session."""
    solved, _ = solve_files([path])
    return _run(ResultScreen(solved, None, path))


def _run(first: Screen[None]) -> int:
    interface = Interface(first)
    message = interface.run()
    if message:
        print(message, file=sys.stderr)
    return interface.return_code or 0
