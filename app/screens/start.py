"""Open the terminal interface on the screen that was asked for."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from textual.screen import Screen

from app.measuring.recorded import check_session
from app.report.streams import need_terminal
from app.screens import Look
from app.screens.home import ReplayChoiceScreen, replay_screen
from app.screens.interface import Glidecal, screen_of
from app.screens.keys import settings_for_screens
from app.settings import settings_path

if TYPE_CHECKING:
    from app.measuring.plan import Plan


def open_interface(looks: Sequence[Look]) -> int:
    """Home. Returns the exit status."""
    need_terminal("terminal interface", "a verb: see glidecal --help")
    return open_screen(screen_of("home.HomeScreen"), looks)


def open_session(plan: Plan, looks: Sequence[Look]) -> int:
    """The instrument check of a planned or interrupted session, then measuring."""
    return open_screen(screen_of("check.CheckScreen", plan), looks)


def open_replay(paths: Sequence[Path], looks: Sequence[Look], *, served: bool = False) -> int:
    """A recorded session again, or a list of several. Raises RecordError for a bad file.

    ``served`` to others, folders may be among them, and nothing can be written or measured.
    """
    for path in () if served else paths:
        check_session(path)
    alone = len(paths) == 1 and not paths[0].is_dir()
    first = replay_screen(paths[0], looks) if alone else ReplayChoiceScreen(paths)
    return open_screen(first, looks, read_only=served)


def open_screen(first: Screen[None], looks: Sequence[Look], *, read_only: bool = False) -> int:
    """Any screen; ``looks`` are what home offers of machines. Returns the exit status."""
    settings = settings_for_screens(settings_path())
    interface = Glidecal(first, settings=settings, read_only=read_only, looks=looks)
    message = interface.run()
    if message:
        print(message, file=sys.stderr)
    return interface.return_code or 0
