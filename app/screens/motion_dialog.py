"""What happened to a machine that moves itself, and the operator's answer to it."""

from __future__ import annotations

import time
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.widgets import Static

from app.measuring.moving import Mover
from app.report.text import motion
from app.screens.interface import Dialog
from drivers.motion.line import DEAD_S
from drivers.motion.states import State

LOOK_S = 0.1


class MotionDialog(Dialog[None]):
    """Stands until the operator answers; no answer moves the machine.

    A key that comes within the dead time was meant for what was before. Escape leaves the machine
    as it is: the key that goes on asks again.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "answer", "I looked", id="motion.answer"),
        Binding("s", "vouch", "It does not move", id="motion.still"),
        Binding("h", "home", "Home it", id="motion.home"),
        Binding("escape", "dismiss(None)", "Leave it", id="motion.leave"),
    ]

    def __init__(self, mover: Mover) -> None:
        super().__init__()
        self._mover = mover
        self._opened_s = time.monotonic()
        self._event = Static("", id="event", markup=False)

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog alarm"):
            yield self._event

    def on_mount(self) -> None:
        self.app.bell()
        self._show()
        self.set_interval(LOOK_S, self._show)

    def _show(self) -> None:
        if self._mover.interrupted:
            self._event.update(self.app.keyed(motion.event_text(self._mover)))
        else:
            self.dismiss(None)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """No key at first; each only where it is an answer."""
        state, dead = self._mover.state, time.monotonic() - self._opened_s < DEAD_S
        fits = {
            "answer": state in (State.HELD, State.FAULT),
            "vouch": self._mover.line.not_stopped,
            "home": state is State.FAULT and self._mover.line.can_home,
        }
        return fits.get(action, True) and not dead

    def action_answer(self) -> None:
        """The operator looked: is all well again? What is still wrong is shown."""
        self._mover.answer()

    def action_vouch(self) -> None:
        self._mover.line.vouch()

    def action_home(self) -> None:
        """All carriages go to their switches; from here on every key stops them."""
        if self._mover.home() is not None:
            self.dismiss(None)
