"""Before measuring: the dry run, and the check whether the indicators answer, each in its place."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.widgets import Static

from app.exit_codes import exit_code
from app.measuring.gauges import PushResult, SpindleCheck
from app.measuring.indicators import (
    adapter_before,
    indicator_words,
    moved_adapters,
    port_is_gone,
)
from app.measuring.opening import begin, first_step, open_indicators
from app.measuring.plan import Plan
from app.measuring.session import Indicators
from app.report.text import motion, preparing
from app.report.text.home import CHECK_HELP, DRY_RUN_HELP
from app.screens.interface import MainScreen
from app.screens.paged import Page, PagedScreen
from app.screens.pages import apart, is_left, once
from app.screens.session_view import Gauges, port_dialog
from calib.errors import GlidecalError
from protocols.procedure import Step

REFRESH_S = 0.1
OPENING = "Opening the indicators …"


class CheckScreen(MainScreen[None]):
    """Live readings before the record begins."""

    HELP = CHECK_HELP
    heading = "Check of the indicators"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "begin", "Begin", id="check.begin"),
        Binding("f5", "begin", "Begin", show=False, id="check.begin-too"),
        Binding("x", "exchange", "Exchange the ports", id="check.exchange"),
        Binding("r", "retry", "Try again", id="check.retry"),
        Binding("o", "port", "Other port", id="check.port"),
        Binding("escape", "back", "Back", id="check.back"),
    ]

    def __init__(self, plan: Plan) -> None:
        super().__init__()
        self._plan = plan
        self._problem: GlidecalError | None = None
        self._gone: list[int] = []  # indicators whose ports are not here
        self._trial: SpindleCheck | None = None
        self._first: Step | None = None

    def content(self) -> ComposeResult:
        words = Static(OPENING, id="words", markup=False)
        if self._plan.motion or self._plan.by_itself:  # every posture, to scroll through
            with VerticalScroll(id="moves"):
                yield words
        else:
            yield words
        yield Static("", id="trial", markup=False)
        yield Gauges(self._plan.instruments)

    def on_mount(self) -> None:
        self._open()

    @work(thread=True)
    def _open(self) -> None:
        """To its end, be this screen left meanwhile: ports that are open then are closed again."""
        interface = self.app  # a screen that is gone has none
        try:
            indicators = open_indicators(self._plan)
        except GlidecalError as problem:
            interface.call_from_thread(self._refused, problem)
        else:
            interface.call_from_thread(self._opened, indicators)

    def _refused(self, problem: GlidecalError) -> None:
        if is_left(self):
            return
        self._problem, instruments = problem, self._plan.instruments
        self._gone = [k for k, each in enumerate(instruments) if port_is_gone(each.port)]
        words = preparing.refused_text(
            problem, instruments, self._gone, moved_adapters(self._plan.instruments)
        )
        self.query_one("#words", Static).update(self.app.keyed(words))
        self.refresh_bindings()

    def _opened(self, indicators: Indicators) -> None:
        if is_left(self):
            indicators.close()
            return
        self.app.indicators = indicators
        self.refresh_bindings()
        mover, moved = indicators.mover, moved_adapters(self._plan.instruments)
        warnings = [
            f"WARNING: {line}" for line in preparing.adapter_lines(self._plan.instruments, moved)
        ]
        of_machine = motion.check_text(self._plan, mover) if mover is not None else ""
        words = filter(None, [of_machine, "\n".join(warnings), preparing.check_text(self._plan)])
        self.query_one("#words", Static).update(self.app.keyed("\n\n".join(words)))
        if not self._plan.simulated:  # no hand can push those spindles
            with self.app.complaining():
                self._first = first_step(self._plan)
                self._trial = SpindleCheck(self._plan.instruments)
        self.set_interval(REFRESH_S, self._show_live)

    def _show_live(self) -> None:
        if self.app.indicators is None:
            return
        states = [gauge.live() for gauge in self.app.indicators.gauges]
        self.query_one(Gauges).show(states)
        if (trial := self._trial) and self._first:
            unready = not trial.ready
            if ended := trial.look(states):
                self.app.bell()
            if ended or (unready and trial.ready):
                self._show_trial(preparing.trial_text(trial, self._first))
                self.refresh_bindings()

    def _show_trial(self, text: str) -> None:
        """Above the panels: nothing lies over them."""
        self.query_one("#trial", Static).update(self.app.keyed(text))

    def action_exchange(self) -> None:
        """The spindle that moved is the one that was asked for: its port belongs there."""
        if self._trial and self._trial.finding is PushResult.OTHER:
            self._trial.exchange()
            if opened := self.app.indicators:
                self.app.indicators = replace(opened, gauges=opened.gauges[::-1])
            self.query_one(Gauges).name_them(self._trial.instruments)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Begin is offered once the indicators are open, another try where they did not open."""
        fits = {
            "retry": self._problem is not None,
            "port": self._problem is not None and bool(self._gone),
            "exchange": self._trial is not None and self._trial.finding is PushResult.OTHER,
            "begin": self.app.indicators is not None,
        }
        return fits.get(action, True)

    def action_retry(self) -> None:
        self._problem = None
        self.query_one("#words", Static).update(OPENING)
        self.refresh_bindings()
        self._open()

    @once("port")
    async def action_port(self) -> None:
        """The first indicator whose port has gone is at another one: choose it, and try again."""
        number, instruments = self._gone[0], list(self._plan.instruments)
        adapter = adapter_before(instruments[number].port)
        used = [instrument.port for instrument in instruments]
        dialog = port_dialog(indicator_words(number, instruments[number]), adapter, used)
        if dialog is None:
            self._show_trial(preparing.NO_OTHER_PORT_HERE)
        elif port := await self.ask(dialog):
            instruments[number] = instruments[number].model_copy(update={"port": port})
            self._plan = replace(self._plan, instruments=tuple(instruments))
            self.query_one(Gauges).name_them(instruments)
            self.action_retry()

    def action_begin(self) -> None:
        if self.app.indicators is None:
            return
        with self.app.complaining():
            plan, trial = self._plan, self._trial
            if trial:
                plan = replace(plan, instruments=trial.known())
            guided = begin(plan, self.app.indicators)
            self.app.indicators, self.app.guided = None, guided
            self.app.go_to(self.app.measuring(guided, plan))
            if trial:
                guided.note(trial.remark())

    async def action_back(self) -> None:
        indicators, self.app.indicators = self.app.indicators, None
        if indicators is not None:
            indicators.close()
        if len(self.app.screen_stack) > 2:
            self.app.pop_screen()
        elif self._problem is not None:
            self.app.exit(f"glidecal: {self._problem}", return_code=exit_code(self._problem))
        else:
            await self.app.action_quit()


class DryRunScreen(PagedScreen[None]):
    """Every step of a procedure, and what it will tell."""

    HELP = DRY_RUN_HELP
    PAGES = (Page("dry-run", "Every step"), Page("expected", "What to expect"))

    def __init__(self, plan: Plan) -> None:
        super().__init__()
        self._plan = plan

    @work
    async def begin(self) -> None:
        plan = self._plan
        self.head(f"Dry run of {plan.procedure.name}")
        self.put("dry-run", motion.plan_text(plan))
        self.put("expected", await apart(self, self._expected))

    def _expected(self) -> str:
        from app.planning.tripod import before_measuring
        from app.report.text.planning import before_measuring_text

        plan = self._plan
        try:
            asked = before_measuring(plan.procedure, plan.machine, plan.instruments)
            return before_measuring_text(*asked)
        except GlidecalError as problem:
            return str(problem)
