"""Choosing a session from a list."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.screen import Screen
from textual.widgets import Footer, OptionList, Static
from textual.widgets.option_list import Option

from app.measuring.recent import Recent, look_at
from app.report.text.home import ELSEWHERE, NO_SESSIONS, PICK_KEYS, session_label
from app.report.text.replay import REPLAY_QUESTION
from app.screens.dialogs import TextDialog
from app.screens.fast_keys import LeftOnce, Title
from app.screens.interface import Interface


class PickScreen(LeftOnce[Recent]):
    """Recent sessions with their state, or the path of another one; none by Escape."""

    app: Interface
    HELP = (
        "Each session stands with its readings and its state.\n"
        "An unreadable file tells its reason when it is chosen.\n"
        "The last line takes the path of a session in another folder."
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "Back", id="pick.back"),
        Binding("f10", "app.quit", "Quit", id="pick.quit"),
    ]

    def __init__(
        self, question: str, sessions: Sequence[Recent], proposed: Recent | None = None
    ) -> None:
        super().__init__()
        self._question = question
        self._sessions = tuple(sessions)
        self._proposed = proposed

    def compose(self) -> ComposeResult:
        yield Title()
        words = self._question if self._sessions else f"{self._question}\n{NO_SESSIONS}"
        yield Static(f"{words}\n{PICK_KEYS}", markup=False, id="question")
        labels = [Option(session_label(session)) for session in self._sessions]
        yield OptionList(*labels, Option(ELSEWHERE), id="choices", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        choices = self.query_one("#choices", OptionList)
        known = self._proposed in self._sessions
        choices.highlighted = self._sessions.index(self._proposed) if known else 0
        choices.focus()

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        if event.option_index < len(self._sessions):
            self._choose(self._sessions[event.option_index])
        else:
            self.app.push_screen(TextDialog("The path of a session file?", "path"), self._typed)

    def _typed(self, path: str | None) -> None:
        if path:
            self._choose(look_at(Path(path).expanduser()))

    def _choose(self, session: Recent) -> None:
        if session.problem:
            self.app.complain(session.problem)
        else:
            self.dismiss(session)


class ReplayChoiceScreen(Screen[None]):
    """The sessions that were named, and no other ones."""

    app: Interface
    HELP = "Arrow keys and Enter open a session; Escape comes back to this list."
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f10", "app.quit", "Quit", id="replay-choice.quit")
    ]

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__()
        self._paths = tuple(paths)

    def compose(self) -> ComposeResult:
        yield Title()
        yield Static(REPLAY_QUESTION, markup=False, id="question")
        labels = (Option(session_label(look_at(path))) for path in self._paths)
        yield OptionList(*labels, id="choices", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        choices = self.query_one("#choices", OptionList)
        choices.highlighted = 0
        choices.focus()

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        with self.app.complaining():
            self.app.push_screen(self.app.replay(self._paths[event.option_index]))
