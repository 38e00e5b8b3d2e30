"""Before measuring: the dry run, and the check whether the indicators answer, each in its place."""

from __future__ import annotations

from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.widgets import Static

from app.dialogue.corrections import other_port
from app.exit_codes import exit_code
from app.measuring.opening import PlanCheck
from app.measuring.plan import Plan
from app.measuring.session import Indicators
from app.report.text import motion, preparing
from app.report.text.help import help_of
from app.screens.interface import MainScreen, once, screen_of
from app.screens.paged import Page, PagedScreen
from app.screens.pages import apart, is_left
from app.screens.session_view import Gauges


class CheckScreen(MainScreen[None]):
    """Live readings before the record begins."""

    HELP = help_of("check")
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
        self._check = PlanCheck(plan)

    def content(self) -> ComposeResult:
        text = Static(preparing.OPENING, id="words", markup=False)
        plan = self._check.plan
        moves = plan.motion or plan.by_itself  # every posture, to scroll through
        yield VerticalScroll(text, id="moves") if moves else text
        yield Static("", id="trial", markup=False)
        yield Gauges(plan.instruments)

    def on_mount(self) -> None:
        self._open()

    @work(thread=True)
    def _open(self) -> None:
        """Open all ports even if this screen is left meanwhile: the open ones are then closed
        again.
        """
        interface = self.app  # a screen that is gone has none
        interface.call_from_thread(self._opened, self._check.open())

    def _opened(self, indicators: Indicators | None) -> None:
        if is_left(self):
            if indicators is not None:
                indicators.close()
        elif indicators is None:
            self._say(preparing.refused_text(self._check))
        else:
            self.app.indicators = indicators
            self._say(motion.opened_text(self._check.plan, indicators.mover))
            with self.app.complaining():
                self._check.find_spindles()
            self.set_interval(0.1, self._show_live)

    def _say(self, text: str, where: str = "#words") -> None:
        """Show a text in the words, or in ``#trial`` above the panels: nothing lies over them."""
        self.query_one(where, Static).update(self.app.keyed(text))
        self.refresh_bindings()

    def _show_live(self) -> None:
        if self.app.indicators is None:
            return
        states = [gauge.live() for gauge in self.app.indicators.gauges]
        self.query_one(Gauges).show(states)
        changed, pushed = self._check.look(states)
        if pushed:
            self.app.bell()
        if changed and self._check.spindles and self._check.first:
            self._say(preparing.trial_text(self._check.spindles, self._check.first), "#trial")

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Begin is offered once the indicators are open, another try where they did not open."""
        return self._check.fits(action, opened=self.app.indicators is not None)

    def action_exchange(self) -> None:
        if self._check.spindles and self.app.indicators:
            self.app.indicators = self._check.exchange(self.app.indicators)
            self.query_one(Gauges).name_them(self._check.spindles.instruments)

    def action_retry(self) -> None:
        self._check.problem = None
        self._say(preparing.OPENING)
        self._open()

    @once("port")
    async def action_port(self) -> None:
        """The first indicator whose port has gone is at another one: choose it, and try again."""
        if port := await other_port(self, *self._check.lost):
            self._check.read_at(port)
            self.query_one(Gauges).name_them(self._check.plan.instruments)
            self.action_retry()

    def action_begin(self) -> None:
        if self.app.indicators is None:
            return
        with self.app.complaining():
            guided = self._check.begin(self.app.indicators)
            self.app.indicators, self.app.guided = None, guided
            self.app.go_to(screen_of("measure.MeasureScreen", guided, self._check.plan))
            self._check.remark(guided)

    async def action_back(self) -> None:
        indicators, self.app.indicators = self.app.indicators, None
        if indicators is not None:
            indicators.close()
        if len(self.app.screen_stack) > 2:
            self.app.pop_screen()
        elif problem := self._check.problem:
            self.app.exit(f"glidecal: {problem}", return_code=exit_code(problem))
        else:
            await self.app.action_quit()


class DryRunScreen(PagedScreen[None]):
    """Every step of a procedure, and what it will tell."""

    HELP = help_of("dry-run")
    PAGES = (Page("dry-run", "Every step"), Page("expected", "What to expect"))

    def __init__(self, plan: Plan) -> None:
        super().__init__()
        self._plan = plan

    @work
    async def begin(self) -> None:
        from app.report.text.planning import plan_expected_text  # loads the planning

        self.head(f"Dry run of {self._plan.procedure.name}")
        self.put("dry-run", motion.plan_text(self._plan))
        self.put("expected", await apart(self, plan_expected_text, self._plan))
