"""Textual screens: they show and ask; every number comes from elsewhere."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # heavy: the command line knows the screens of machines without any of them
    from textual.screen import Screen

    MakeScreen = Callable[[], Screen[None]]

# Read when Textual loads: a reading that just missed a picture waits half as long for the next.
# From a value shown to the terminal, p99: 20 ms, 33 with Textual's 60 (medians of three runs each).
os.environ.setdefault("TEXTUAL_FPS", "120")


@dataclass(frozen=True)
class Look:
    """A screen of a machine that needs no session, as the home screen offers it.

    ``choice`` is its line among the choices, ``words`` its lines in the help of them.
    """

    name: str
    choice: str
    words: str
    screen: MakeScreen
