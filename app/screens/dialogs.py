"""Small dialogs over a screen. Each gives a value back; an empty one means: nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical, VerticalScroll
from textual.widgets import Input, OptionList, Static
from textual.widgets.option_list import Option

from app.screens.fast_keys import Dialog


class TextDialog(Dialog[str]):
    """One line of text: a note, a reason.

    ``without`` says what happens where there is none: then Enter gives nothing back by itself.
    """

    BINDINGS: ClassVar[list[BindingType]] = [("escape", "dismiss('')", "Cancel")]

    def __init__(self, question: str, hint: str, proposed: str = "", without: str = "") -> None:
        super().__init__()
        self._question = question
        self._hint = hint
        self._proposed = proposed
        self._without = without

    def compose(self) -> ComposeResult:
        ends = f"Escape: {self._without}" if self._without else "Enter keeps it, Escape leaves."
        with Vertical(classes="dialog"):
            yield Static(f"{self._question} {ends}", markup=False)
            yield Input(self._proposed, placeholder=self._hint)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        text = event.value.strip()
        if text or not self._without:
            self.dismiss(text)


class ChoiceDialog(Dialog[str]):
    """One of several answers, by arrow keys and Enter, by its number, or none by Escape.

    ``choices`` are pairs of an answer and the words that stand for it.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        ("escape", "dismiss('')", "Cancel"),
        *((str(number), f"pick({number})", "") for number in range(1, 10)),
    ]

    def __init__(
        self,
        question: str,
        choices: Sequence[tuple[str, str]],
        highlighted: int = 0,
        leaving: str = "Escape leaves.",
    ) -> None:
        super().__init__()
        self._leaving = leaving
        self._question = question
        self._choices = tuple(choices)
        self._highlighted = highlighted

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog"):
            yield Static(self._question, markup=False)
            yield OptionList(*(Option(words) for _, words in self._choices), markup=False)
            yield Static(f"Arrow keys and Enter, or the number. {self._leaving}", markup=False)

    def on_mount(self) -> None:
        options = self.query_one(OptionList)
        options.highlighted = self._highlighted if self._choices else None
        options.focus()

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        self.dismiss(self._choices[event.option_index][0])

    def action_pick(self, number: int) -> None:
        if number <= len(self._choices):
            self.dismiss(self._choices[number - 1][0])


class HelpDialog(Dialog[None]):
    """Words about the present screen and the panel that has the focus."""

    BINDINGS: ClassVar[list[BindingType]] = [
        ("escape", "dismiss(None)", "Close"),
        ("f1", "dismiss(None)", "Close"),
        ("enter", "dismiss(None)", "Close"),
    ]

    def __init__(self, text: str) -> None:
        super().__init__()
        self._text = text

    def compose(self) -> ComposeResult:
        with VerticalScroll(classes="dialog"):
            yield Static(self._text + "\n\nEscape closes.", markup=False)
