"""Textual screens: they show and ask; every number comes from elsewhere."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # heavy: the command line knows the screens of machines without any of them
    from pathlib import Path

    from textual.screen import Screen

    from app.evaluating.posture_history import PostureEntry

    MakeScreen = Callable[[], Screen[None]]

# Read when Textual loads: a reading that just missed a picture waits half as long for the next.
# From a value shown to the terminal, p99: 20 ms, 33 with Textual's 60 (medians of three runs each).
os.environ.setdefault("TEXTUAL_FPS", "120")


@dataclass(frozen=True)
class Look:
    """A screen of a machine that needs no session, as the home screen offers it, and its sessions.

    ``choice`` is its line among the choices, ``words`` its lines in the help of them. ``reads``
    tells whether a file is a session of it, ``past`` what that says in a history, ``opened`` is its
    screen for what was chosen at home: result, replay, diagnose or export.
    """

    name: str
    choice: str
    words: str
    screen: MakeScreen
    reads: Callable[[Path], bool]
    past: Callable[[Path, bool], PostureEntry]
    opened: Callable[[Path, str], Screen[None]]


def look_of(path: Path, looks: Iterable[Look]) -> Look | None:
    """The look of the machine whose session a file is; None for one of indicators on legs."""
    return next((look for look in looks if look.reads(path)), None)
