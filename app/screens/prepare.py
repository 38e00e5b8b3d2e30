"""Before measuring: machine, procedure, operator, ports."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from functools import partial
from threading import Event
from typing import ClassVar

from textual import on, work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.content import Content
from textual.events import ScreenResume
from textual.screen import ScreenResultType
from textual.widget import Widget
from textual.widgets import Input, Label, Select, Static

from app.measuring.indicators import (
    DEFAULT_PROFILE,
    asked_of,
    indicator_of,
    serial_ports,
)
from app.measuring.preparation import (
    AXES,
    USUAL,
    Form,
    Preparation,
    best_fit,
    procedures_of,
    retyped,
)
from app.report.text import home as texts
from app.report.text.indicator import findings_text, trial_text
from app.report.text.preparing import indicator_lines, prepared_texts
from app.screens.check import CheckScreen, DryRunScreen
from app.screens.interface import MainScreen
from app.screens.pages import apart
from calib.errors import GlidecalError, IndicatorError
from drivers.doctor import Trials, findings_of, refused, try_profiles
from drivers.profile import Query, Unit
from drivers.profiles import PROFILES
from protocols.documents import MOST_LETTERS
from protocols.machine import Machine


class FormScreen(MainScreen[ScreenResultType]):
    """Fields one below the other, and below them a line on what they say."""

    def content(self) -> ComposeResult:
        with VerticalScroll(id="form"):
            yield from self.fields()
            yield Static("", id="summary", markup=False)

    @abstractmethod
    def fields(self) -> ComposeResult:
        """A row for each."""

    def typed(self) -> dict[str, str]:
        """What the fields say now: a key may come before the news of what was typed."""
        fields = {str(f.id): f.value for f in (*self.query(Input), *self.query(Select))}
        return {name: value.strip() for name, value in fields.items() if isinstance(value, str)}

    def summary(self, text: str) -> None:
        self.query_one("#summary", Static).update(self.app.keyed(text))

    def on_input_submitted(self) -> None:
        self.focus_next()


class IndicatorScreen(FormScreen[Form]):
    """A form that keeps what was typed however it is left; no port is opened unasked."""

    HELP = texts.INDICATOR_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f3", "try_profiles", "Try profiles on this port", id="indicator.try"),
        Binding("f5", "leave", "Done", id="indicator.done"),
        Binding("escape", "leave", "Back", id="indicator.back"),
    ]

    def __init__(self, which: str, form: Mapping[str, object], answered: dict[str, str]) -> None:
        super().__init__()
        self.heading, self._form = which, dict(form)
        self._answered = answered  # which profiles fit at a port, as long as the program runs
        self._stop: Event | None = None

    def fields(self) -> ComposeResult:
        values = USUAL | self._form
        along = dict.fromkeys([*AXES, str(values["axes"])])
        here = [(texts.port_label(*entry, self._answered), entry[0]) for entry in serial_ports()]
        profiles = texts.profile_rows(PROFILES.values())
        yield from row("Ports here", choice("here", here, prompt=texts.ports_here(len(here))))
        yield from self._input("port")
        chosen, prompt = values.get("profile"), self.app.keyed(texts.PROFILE_PROMPT)
        yield from row("Profile", choice("profile", profiles, chosen, prompt))
        rows = [(texts.axes_words(entry), entry) for entry in along]
        yield from row("Measures along", choice("axes", rows, values["axes"]))
        units = [(entry.value, entry.value) for entry in Unit]
        yield from row("Unit of the display", choice("unit", units, values["unit"]))
        for name in ("channel", "serial_number", "certificate", "certificate_date"):
            yield from self._input(name)

    def _input(self, name: str) -> ComposeResult:
        yield from entry(name, *texts.INDICATOR_FIELDS[name], str(self._form.get(name, "")))

    def on_mount(self) -> None:
        self.summary(texts.TRY_HINT)
        first = "#here" if serial_ports() and not self._form.get("port") else "#port"
        self.query_one(first).focus()

    def on_select_changed(self, event: Select.Changed) -> None:
        if event.select.id == "here" and isinstance(event.value, str):
            self.query_one("#port", Input).value = event.value
        self.on_input_changed()

    def on_input_changed(self) -> None:
        before = self._form
        if self._read() != before and self._stop is None:
            self.summary(texts.form_problem(self._form) or texts.TRY_HINT)

    def _read(self) -> Form:
        typed = self.typed()
        typed.pop("here", None)
        self._form = retyped(self._form, typed)
        return self._form

    def action_leave(self) -> None:
        """Stop trying, or go back with what stands here."""
        if self._stop is not None:
            self._stop.set()
        else:
            self.dismiss({name: value for name, value in self._read().items() if value != ""})

    def action_try_profiles(self) -> None:
        """Ask the port as each profile does: the operator says that an indicator is there."""
        if self._stop is not None:
            return
        with self.app.complaining():
            asking = {name: self._read().get(name) for name in ("port", "channel", "unit")}
            instrument = indicator_of({"profile": DEFAULT_PROFILE, **asking})  # any: not asked for
            self._stop = Event()
            self._try(instrument.port, asked_of(instrument), self._stop)

    @work
    async def _try(self, port: str, asked: Query, stop: Event) -> None:
        def tell(*trial: object) -> None:
            words = f"{texts.TRYING}\n{trial_text(*trial)}"  # type: ignore[arg-type]
            self.app.call_from_thread(self.summary, words)

        job = partial(try_profiles, PROFILES.values(), progress=tell, stopped=stop.is_set)
        try:
            trials = await apart(self, job, port, asked)
        except IndicatorError as problem:
            text = findings_text([refused(port, problem)])
        else:
            self._propose(port, trials)
            stopped = stop.is_set() and not trials.fits
            text = texts.STOPPED if stopped else findings_text(findings_of(trials))
        finally:  # the screen may be gone, and its worker with it
            stop.set()
        self._stop = None
        self.summary(text)

    def _propose(self, port: str, trials: Trials) -> None:
        """Put the profiles that fit first, and take one."""
        fitting = [fit.profile for fit in trials.fits]
        if not fitting:
            return
        self._answered[port] = ", ".join(profile.name for profile in fitting)
        other_profiles = [profile for profile in PROFILES.values() if profile not in fitting]
        profiles = self.query_one("#profile", Select)
        rows = [*texts.profile_rows(fitting, "fits: "), *texts.profile_rows(other_profiles)]
        profiles.set_options((Content(words), name) for words, name in rows)
        profiles.value = best_fit(fitting, self._form.get("profile"))
        self._read()


def row(label: str, widget: Widget) -> ComposeResult:
    """One line of a form."""
    with Horizontal(classes="field"):
        yield Label(label, markup=False)
        yield widget


def entry(name: str, label: str, hint: str, value: str = "") -> ComposeResult:
    """A line to type into; a value of a file may be longer than what can be typed."""
    typed = Input(value, hint, id=name, compact=True)
    typed.max_length = MOST_LETTERS
    yield from row(label, typed)


def choice(
    name: str, rows: Iterable[tuple[str, str]], value: object = None, prompt: str = ""
) -> Select[str]:
    """A list to choose from; without a value nothing is chosen."""
    options = [(Content(words), value_of_row) for words, value_of_row in rows]
    chosen = next((choosable for _, choosable in options if choosable == value), Select.NULL)
    blank = bool(prompt)
    return Select(options, prompt=prompt, allow_blank=blank, value=chosen, id=name, compact=True)


INDICATORS, IDENTITY = ("indicator1", "indicator2"), ("#serial", "#place")


class IndicatorField(Static, can_focus=True):
    """The line of one indicator; its form opens on Enter or a click."""

    def on_click(self) -> None:
        self.focus()
        if isinstance(self.screen, PrepareScreen):
            self.screen.action_choose()


class PrepareScreen(FormScreen[None]):
    """A form; F5 goes on to the instrument check. What was typed stays, however it is left."""

    HELP = texts.PREPARE_HELP
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
        self._answered: dict[str, str] = {}

    def fields(self) -> ComposeResult:
        for field in (texts.MACHINE, *texts.IDENTITY):
            yield from entry(*field)
        names = procedures_of(self._prepared.offered_for)
        yield from row("Procedure", choice("procedure", zip(names, names, strict=True)))
        for name, words in zip(INDICATORS, texts.WHICH_INDICATOR, strict=True):
            yield from row(words, IndicatorField(id=name, markup=False))
        for field in texts.FIELDS:
            yield from entry(*field)

    def on_mount(self) -> None:
        for name, words in texts.FIELD_HELP.items():
            self.query_one(f"#{name}").tooltip = Content(words)

    @on(Input.Changed)
    @on(Select.Changed)
    @on(ScreenResume)
    def summarise(self) -> None:
        """What the form says now; ports may have come or gone on, too."""
        try:
            machine = self._read().machine()
            self._offer(machine)
            self._propose(machine)
            text, lines = prepared_texts(self._read(), machine)
        except GlidecalError as problem:
            text, lines = str(problem), indicator_lines(self._prepared)
        self.query_one("#summary", Static).update(text)
        for name, words in zip(INDICATORS, lines, strict=True):
            self.query_one(f"#{name}", IndicatorField).update(self.app.keyed(words))

    def _read(self) -> Preparation:
        self._prepared.typed = self.typed()
        return self._prepared

    def _offer(self, machine: Machine) -> None:
        """What the machine can measure: as usual by hand or with a controller, or as chosen."""
        procedures, offered_for = self.query_one("#procedure", Select), self._prepared.offered_for
        names, chosen = self._prepared.offer(machine)
        if machine != offered_for:
            procedures.set_options((Content(name), name) for name in names)
        procedures.value = chosen

    def _propose(self, machine: Machine) -> None:
        """The indicators of the machine file, else those used last, until others are chosen."""
        if self._prepared.to_propose(machine):
            self._prepared.propose(machine)
            with self.app.complaining():
                for name, text in zip(IDENTITY, self._prepared.propose_last(machine), strict=True):
                    self.query_one(name, Input).value = text

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Enter and Delete are for the lines of the indicators."""
        return action not in ("choose", "clear") or isinstance(self.focused, IndicatorField)

    def action_choose(self) -> None:
        which = self._which()
        form = self._prepared.forms[which]
        screen = IndicatorScreen(texts.WHICH_INDICATOR[which], form, self._answered)
        self.app.push_screen(screen, lambda chosen: self._chosen(which, chosen or {}))

    def action_clear(self) -> None:
        self._chosen(self._which(), {})

    def _which(self) -> int:
        assert self.focused is not None, "offered on the line of an indicator alone"
        return INDICATORS.index(str(self.focused.id))

    def _chosen(self, which: int, form: Form) -> None:
        self._prepared.choose(which, form)
        self.summarise()

    def action_check(self) -> None:
        with self.app.complaining():
            self.app.push_screen(CheckScreen(self._read().plan(texts.CHOOSE_INDICATOR)))

    def action_dry_run(self) -> None:
        with self.app.complaining():
            self.app.push_screen(DryRunScreen(self._read().rehearsal()))
