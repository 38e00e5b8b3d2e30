"""Before measuring: machine, procedure, operator, ports."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from functools import partial
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.content import Content
from textual.events import ScreenResume
from textual.screen import ScreenResultType
from textual.widget import Widget
from textual.widgets import Input, Label, Select, Static

from app.measuring.indicators import serial_ports
from app.measuring.preparation import Form, Preparation, ProfileTrial, retyped
from app.report.text import home as texts
from app.report.text.help import help_of, help_of_field
from app.report.text.indicator import findings_text, trial_text
from app.report.text.preparing import indicator_fields, prepared_texts
from app.screens.check import CheckScreen, DryRunScreen
from app.screens.interface import MainScreen, once
from app.screens.pages import apart
from protocols.documents import MOST_LETTERS


class FormScreen(MainScreen[ScreenResultType]):
    """Fields one below the other, and below them a line on what they say."""

    def content(self) -> ComposeResult:
        with VerticalScroll(id="form"):
            for field in self.fields():
                label = Label(field.label, markup=False)
                yield Horizontal(label, self.box(field), classes="field")
            yield Static("", id="summary", markup=False)

    @abstractmethod
    def fields(self) -> Iterable[texts.FormField]:
        """Fields from top to bottom."""

    def box(self, field: texts.FormField) -> Widget:
        """What is typed into or chosen from; a list without a hint has always a choice."""
        if field.rows is None:
            line = Input(field.value, field.hint, id=field.name, compact=True)
            line.max_length = MOST_LETTERS  # a value of a file may be longer
            return line
        options = [(Content(label), value) for label, value in field.rows]
        selection = field.value if field.value in [value for _, value in options] else Select.NULL
        prompt, blank = self.app.keyed(field.hint), bool(field.hint)
        return Select(
            options, prompt=prompt, allow_blank=blank, value=selection, id=field.name, compact=True
        )

    def boxes(self) -> dict[str, Input | Select[str]]:
        return {str(box.id): box for box in (*self.query(Input), *self.query(Select))}

    def typed(self) -> dict[str, str]:
        """What the fields say now: a key may come before the news of what was typed."""
        values = {name: box.value for name, box in self.boxes().items()}
        return {name: value.strip() for name, value in values.items() if isinstance(value, str)}

    def summary(self, text: str) -> None:
        self.query_one("#summary", Static).update(self.app.keyed(text))

    def on_input_submitted(self) -> None:
        self.focus_next()


class IndicatorScreen(FormScreen[Form]):
    """A form that keeps what was typed however it is left; no port is opened unasked."""

    HELP = help_of("indicator")
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f3", "try_profiles", "Try profiles on this port", id="indicator.try"),
        Binding("f5", "leave", "Done", id="indicator.done"),
        Binding("escape", "leave", "Back", id="indicator.back"),
    ]

    def __init__(self, title: str, form: Mapping[str, object], answers: dict[str, str]) -> None:
        super().__init__()
        self.heading, self._form, self._answers = title, dict(form), answers
        self._trial: ProfileTrial | None = None

    def fields(self) -> Iterable[texts.FormField]:
        return indicator_fields(self._form, self._answers)

    def on_mount(self) -> None:
        self.summary(texts.TRY_HINT)
        first = "#here" if serial_ports() and not self._form.get("port") else "#port"
        self.query_one(first).focus()

    def on_select_changed(self, event: Select.Changed) -> None:
        if event.select.id == "here" and isinstance(event.value, str):
            self.query_one("#port", Input).value = event.value
        self.on_input_changed()

    def on_input_changed(self) -> None:
        form_before = self._form
        if self._read() != form_before and self._trial is None:
            self.summary(texts.form_problem(self._form) or texts.TRY_HINT)

    def _read(self) -> Form:
        self._form = retyped(self._form, self.typed())
        return self._form

    def action_leave(self) -> None:
        """Stop trying, or go back with what stands here."""
        if self._trial is not None:
            self._trial.stop()
        else:
            self.dismiss({name: value for name, value in self._read().items() if value != ""})

    @once("try")
    async def action_try_profiles(self) -> None:
        """Ask the port as each profile does: the operator says that an indicator is there."""
        trial = self._trial = ProfileTrial(self._read())

        def tell(*progress: object) -> None:
            text = f"{texts.TRYING}\n{trial_text(*progress)}"  # type: ignore[arg-type]
            self.app.call_from_thread(self.summary, text)

        try:
            findings = await apart(self, trial.run, tell)
        finally:  # the screen may be gone, and its worker with it
            trial.stop()
        if trial.fitting:  # they stand first, and one of them is taken
            self._answers[trial.instrument.port] = ", ".join(fit.name for fit in trial.fitting)
            profiles, rows = self.query_one("#profile", Select), texts.profile_rows(trial.fitting)
            profiles.set_options((Content(label), name) for label, name in rows)
            profiles.value = trial.best(self._form.get("profile"))
            self._read()
        self._trial = None
        self.summary(findings_text(findings) or texts.STOPPED)


class IndicatorField(Static, can_focus=True):
    """The line of one indicator; its form opens on Enter or a click."""

    async def on_click(self) -> None:
        await self.run_action("screen.choose")


class PrepareScreen(FormScreen[None]):
    """A form; F5 goes on to the instrument check. What was typed stays, however it is left."""

    HELP = help_of("prepare")
    heading = "New session"
    AUTO_FOCUS = "#indicator1"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "choose", "Choose", id="prepare.choose"),
        Binding("delete", "clear", "Clear", id="prepare.clear"),
        Binding("f5", "check", "Check the indicators", id="prepare.check"),
        Binding("f2", "dry_run", "Dry run", id="prepare.dry-run"),
        Binding("escape", "app.pop_screen", "Back", id="prepare.back"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._prepared = Preparation()

    def fields(self) -> Iterable[texts.FormField]:
        rows = [(name, name) for name in self._prepared.procedures]
        procedure = texts.FormField("procedure", "Procedure", rows=rows)
        return (*texts.WHICH_MACHINE, procedure, *texts.WHICH_INDICATOR, *texts.FIELDS)

    def box(self, field: texts.FormField) -> Widget:
        of_indicator = field in texts.WHICH_INDICATOR
        box = IndicatorField(id=field.name, markup=False) if of_indicator else super().box(field)
        if help_text := help_of_field(field.name):
            box.tooltip = Content(help_text)
        return box

    @on(Input.Changed)
    @on(Select.Changed)
    @on(ScreenResume)
    def summarise(self) -> None:
        """What the form says now; ports may have come or gone on, too."""
        procedures = self.query_one("#procedure", Select)  # first: a screen that goes has none
        prepared, boxes = self._prepared, self.boxes()
        machine_before = prepared.offered_for
        prepared.retype(self.typed())
        if prepared.offered_for != machine_before:
            procedures.set_options((Content(name), name) for name in prepared.procedures)
        for name, value in prepared.fields.items():
            boxes[name].value = value
        if prepared.forgotten:
            self.app.complain(prepared.forgotten)
        text, lines = prepared_texts(prepared)
        self.query_one("#summary", Static).update(text)
        for line, label in zip(self.query(IndicatorField), lines, strict=True):
            line.update(self.app.keyed(label))

    def _read(self) -> Preparation:
        self._prepared.typed = self.typed()
        return self._prepared

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Enter and Delete are for the lines of the indicators."""
        return action not in ("choose", "clear") or isinstance(self.focused, IndicatorField)

    def action_choose(self) -> None:
        number = self._which()
        form, answers = self._prepared.forms[number], self._prepared.answers
        screen = IndicatorScreen(texts.WHICH_INDICATOR[number].label, form, answers)
        self.app.push_screen(screen, partial(self._chosen, number))

    def action_clear(self) -> None:
        self._chosen(self._which(), None)

    def _which(self) -> int:
        return [line is self.focused for line in self.query(IndicatorField)].index(True)

    def _chosen(self, number: int, form: Form | None) -> None:
        self._prepared.choose(number, form or {})
        self.summarise()

    def action_check(self) -> None:
        with self.app.complaining():
            self.app.push_screen(CheckScreen(self._read().plan(texts.CHOOSE_INDICATOR)))

    def action_dry_run(self) -> None:
        with self.app.complaining():
            self.app.push_screen(DryRunScreen(self._read().rehearsal()))
