"""Before measuring: machine, procedure, operator, ports."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.screen import Screen
from textual.widgets import Footer, Header, Input, Label, Select, Static

from app.indicators import check_indicators, parse_indicator
from app.opening import Plan, session_name
from app.screens.check import CheckScreen
from app.screens.interface import Interface
from app.wording.session import procedure_sentence
from calib.errors import GlidecalError
from protocols.errors import UsageError
from protocols.machine import load_machine
from protocols.procedure import load_procedure, procedure_names
from protocols.table import NUMBER

FIELDS = (
    (
        "indicator1",
        "First indicator",
        "mitutoyo-01a:COM5, sylvac:/dev/ttyUSB0@yx",
    ),
    ("indicator2", "Second indicator", "empty: one indicator, each leg is measured twice"),
    ("machine", "Machine file", "empty: the prototype of the papers"),
    ("operator", "Operator", ""),
    ("temperature", "Temperature, °C", ""),
)


class PrepareScreen(Screen[None]):
    """A form; F5 goes on to the instrument check."""

    app: Interface
    BINDINGS: ClassVar[list[BindingType]] = [
        ("f5", "check", "Check the indicators"),
        ("escape", "app.pop_screen", "Back"),
        ("f10", "app.quit", "Quit"),
    ]

    def compose(self) -> ComposeResult:
        yield Header()
        with VerticalScroll(id="form"):
            with Horizontal(classes="field"):
                yield Label("Procedure", markup=False)
                names = [(name, name) for name in procedure_names()]
                yield Select(names, value="zero-max-min", allow_blank=False, id="procedure")
            for name, label, hint in FIELDS:
                with Horizontal(classes="field"):
                    yield Label(label, markup=False)
                    yield Input(placeholder=hint, id=name, compact=True)
            yield Static("", id="summary", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        self.query_one("#indicator1", Input).focus()
        self._summarise()

    def on_select_changed(self) -> None:
        self._summarise()

    def on_input_changed(self) -> None:
        self._summarise()

    def on_input_submitted(self) -> None:
        self.focus_next()

    def _summarise(self) -> None:
        try:
            plan = self._plan()
            text = procedure_sentence(plan.procedure, plan.machine.geometry(), plan.axes)
        except GlidecalError as problem:
            text = str(problem)
        self.query_one("#summary", Static).update(text)

    def action_check(self) -> None:
        """On to the live readings."""
        try:
            plan = self._plan()
        except GlidecalError as problem:
            self.app.complain(problem)
        else:
            self.app.push_screen(CheckScreen(plan))

    def _plan(self) -> Plan:
        text = {name: self.query_one(f"#{name}", Input).value.strip() for name, _, _ in FIELDS}
        name = str(self.query_one("#procedure", Select).value)
        named = [value for value in (text["indicator1"], text["indicator2"]) if value]
        machine = load_machine(Path(text["machine"]) if text["machine"] else None)
        instruments = tuple(map(parse_indicator, named)) or machine.indicator
        if not instruments:
            raise UsageError(
                "indicators", "none", "PROFILE:PORT", "Without any, choose the demonstration"
            )
        check_indicators(instruments)
        return Plan(
            path=session_name(Path(), name),
            machine=machine,
            procedure=load_procedure(name, machine.geometry()),
            instruments=instruments,
            operator=text["operator"],
            temperature_c=_temperature(text["temperature"]),
        )


def _temperature(text: str) -> float | None:
    if not text:
        return None
    if not NUMBER.fullmatch(text) or not -50.0 <= float(text) <= 100.0:
        raise UsageError("temperature", repr(text), "−50 … 100 °C with a decimal point, or nothing")
    return float(text)
