"""What keys do to a machine that moves itself; nothing is loaded for a session without one."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from app.measuring.moving import Mover

HELD_KEY_S = 1.0
"""Presses of one key that follow this closely are one held key: terminals repeat it after up to a
second, then many times a second."""


class MotionKeys:
    """What the keys of a face do to a machine that moves itself, before they do anything else.

    While it may move every key stops it, whatever lies on top of the screen, and does nothing else.
    Only the view may be turned. The key that goes on counts once, however long it is held.
    """

    def __init__(self) -> None:
        self._go_s = -math.inf

    def ends_here(self, mover: Mover, *, goes: bool = False, views: bool = False) -> bool:
        """Whether a press has done all that it does: it stopped the machine, or was a repeat."""
        now_s = time.monotonic()
        repeats = goes and now_s - self._go_s < HELD_KEY_S
        if goes:
            self._go_s = now_s
        if repeats or views or not mover.line.may_move:
            return repeats
        mover.stop("stopped by the operator", by_operator=True)
        return True
