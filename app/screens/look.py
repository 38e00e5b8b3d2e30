"""A screen of a machine that needs no session, as the home screen offers it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # heavy: the command line knows the screens of machines without any of them
    from textual.screen import Screen

    MakeScreen = Callable[[], Screen[None]]


@dataclass(frozen=True)
class Look:
    """``choice`` is its line among the choices, ``words`` its lines in the help of them."""

    name: str
    choice: str
    words: str
    screen: MakeScreen
