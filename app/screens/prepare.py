"""Before measuring: machine, procedure, operator, ports."""

from __future__ import annotations

import re
from pathlib import Path
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.content import Content
from textual.screen import Screen
from textual.widgets import Footer, Input, Label, Select, Static

from app.measuring.indicators import (
    DEFAULT_PROFILE,
    check_indicators,
    from_file,
    parse_indicator,
    some_indicators,
)
from app.measuring.opening import Plan, session_name
from app.report.text.home import FIELD_HELP, PREPARE_HELP
from app.report.text.session import dry_run_text, procedure_sentence
from app.screens.fast_keys import Title
from app.screens.interface import Interface
from calib.errors import GlidecalError, UsageError
from protocols.machine import Instrument, Machine, load_machine
from protocols.procedure import Procedure, leg_procedure_names, load_procedure, shuffled
from protocols.table import NUMBER

FIELDS = (
    ("indicator1", "First indicator", "mitutoyo-01a:COM5, sylvac:/dev/ttyUSB0@yx"),
    ("indicator2", "Second indicator", "empty: one indicator, each leg is measured twice"),
    ("machine", "Machine file", "empty: the prototype of the papers"),
    ("operator", "Operator", ""),
    ("temperature", "Temperature, °C", ""),
    ("random", "Random order seed", "empty: the order as written"),
)
SEED = re.compile(r"\d{1,9}", re.ASCII)


class PrepareScreen(Screen[None]):
    """A form; F5 goes on to the instrument check."""

    app: Interface
    HELP = PREPARE_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f5", "check", "Check the indicators", id="prepare.check"),
        Binding("f2", "dry_run", "Dry run", id="prepare.dry-run"),
        Binding("escape", "app.pop_screen", "Back", id="prepare.back"),
        Binding("f10", "app.quit", "Quit", id="prepare.quit"),
    ]

    def compose(self) -> ComposeResult:
        yield Title()
        with VerticalScroll(id="form"):
            with Horizontal(classes="field"):
                yield Label("Procedure", markup=False)
                names = [(name, name) for name in leg_procedure_names()]
                yield Select(
                    names, value="zero-max-min", allow_blank=False, id="procedure", compact=True
                )
            for name, label, hint in FIELDS:
                with Horizontal(classes="field"):
                    yield Label(label, markup=False)
                    yield Input(placeholder=hint, id=name, compact=True)
            yield Static("", id="summary", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        for name, words in FIELD_HELP.items():
            self.query_one(f"#{name}").tooltip = Content(words)
        self.query_one("#indicator1", Input).focus()
        self._summarise()

    def on_select_changed(self) -> None:
        self._summarise()

    def on_input_changed(self) -> None:
        self._summarise()

    def on_input_submitted(self) -> None:
        self.focus_next()

    def _summarise(self) -> None:
        said = []
        try:
            machine = self._machine()
            axes = [instrument.axes for instrument in self._some(machine)]
            said.append(procedure_sentence(self._procedure(machine), machine.geometry(), axes))
            self._plan()
        except GlidecalError as problem:
            said.append(str(problem))
        self.query_one("#summary", Static).update("\n".join(said))

    def action_check(self) -> None:
        with self.app.complaining():
            self.app.push_screen(self.app.check(self._plan()))

    def action_dry_run(self) -> None:
        """Every step, before anything is opened."""
        with self.app.complaining():
            machine = self._machine()
            text = dry_run_text(self._procedure(machine), machine, self._some(machine))
            self.app.push_screen(DryRunScreen(text))

    def _value(self, name: str) -> str:
        return self.query_one(f"#{name}", Input).value.strip()

    def _machine(self) -> Machine:
        path = self._value("machine")
        return load_machine(Path(path).expanduser() if path else None)

    def _procedure(self, machine: Machine) -> Procedure:
        name = str(self.query_one("#procedure", Select).value)
        procedure = load_procedure(name, machine.geometry())
        seed = _seed(self._value("random"))
        return procedure if seed is None else shuffled(procedure, seed)

    def _instruments(self, machine: Machine) -> tuple[Instrument, ...]:
        named = [value for value in map(self._value, ("indicator1", "indicator2")) if value]
        instruments = tuple(map(parse_indicator, named))
        instruments = instruments or from_file(machine.indicator, "the machine file")
        if instruments:
            check_indicators(instruments)
        return instruments

    def _some(self, machine: Machine) -> tuple[Instrument, ...]:
        """The indicators; without any, two."""
        return self._instruments(machine) or some_indicators(DEFAULT_PROFILE, needed=False)

    def _plan(self) -> Plan:
        machine = self._machine()
        procedure = self._procedure(machine)
        instruments = self._instruments(machine)
        if not instruments:
            raise UsageError(
                "indicators", "none", "PROFILE:PORT", "Without any, choose the demonstration"
            )
        return Plan(
            path=session_name(Path(), procedure.name),
            machine=machine,
            procedure=procedure,
            instruments=instruments,
            operator=self._value("operator"),
            temperature_c=_temperature(self._value("temperature")),
        )


class DryRunScreen(Screen[None]):
    """Every step of a procedure, to scroll through."""

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


def _temperature(text: str) -> float | None:
    if not text:
        return None
    if not NUMBER.fullmatch(text) or not -50.0 <= float(text) <= 100.0:
        raise UsageError("temperature", repr(text), "−50 … 100 °C with a decimal point, or nothing")
    return float(text)


def _seed(text: str) -> int | None:
    if not text:
        return None
    if not SEED.fullmatch(text):
        raise UsageError("random order seed", repr(text), "a whole number from 0, or nothing")
    return int(text)
