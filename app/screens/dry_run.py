"""Every step of a procedure before it is measured; nothing is opened or written."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.screen import Screen
from textual.widgets import Footer, Static

from app.screens.fast_keys import Title


class DryRunScreen(Screen[None]):
    """A text to scroll through."""

    HELP = (
        "The steps in the order in which they are measured, each with the\n"
        "line to type at the controller. Nothing is opened or written."
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "app.pop_screen", "Back", id="dry-run.back"),
        Binding("f10", "app.quit", "Quit", id="dry-run.quit"),
    ]

    def __init__(self, text: str) -> None:
        super().__init__()
        self._text = text

    def compose(self) -> ComposeResult:
        yield Title()
        with VerticalScroll(id="dry-run"):
            yield Static(self._text, id="dry-run-text", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        self.query_one("#dry-run").focus()
