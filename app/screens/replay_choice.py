"""Which of several sessions to replay."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.screen import Screen
from textual.widgets import Footer, OptionList, Static
from textual.widgets.option_list import Option

from app.measuring.recent import look_at
from app.report.text.home import session_label
from app.report.text.replay import REPLAY_QUESTION
from app.screens.fast_keys import Title
from app.screens.interface import Interface
from calib.errors import GlidecalError


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
        try:
            self.app.push_screen(self.app.replay(self._paths[event.option_index]))
        except GlidecalError as problem:
            self.app.complain(problem)
