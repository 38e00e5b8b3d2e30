"""Home: what can be done, interrupted sessions first."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.screen import Screen
from textual.widgets import Footer, Header, OptionList, Static
from textual.widgets.option_list import Option

from app.bench import BenchSettings
from app.demo import DEMO_MOTION_S, demo_plan
from app.folders import writable_folder
from app.opening import plan_to_continue
from app.recent import Recent, recent_sessions
from app.screens.check import CheckScreen
from app.screens.interface import Interface
from app.screens.prepare import PrepareScreen
from app.screens.result import ResultScreen
from app.solving import Solved, solve_files
from calib.errors import GlidecalError

DEMO_FOLDER = Path("demo-sessions")


class HomeScreen(Screen[None]):
    """The first screen."""

    app: Interface
    BINDINGS: ClassVar[list[BindingType]] = [("f10", "app.quit", "Quit")]

    def compose(self) -> ComposeResult:
        yield Header()
        yield Static("What do you want to do? Arrow keys and Enter.", markup=False, id="question")
        yield OptionList(id="choices", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        self._recent = recent_sessions(Path(), DEMO_FOLDER)
        choices = self.query_one("#choices", OptionList)
        for number, recent in enumerate(self._recent):
            if recent.interrupted:
                choices.add_option(
                    Option(f"Continue  {recent.path}  ({recent.state})", f"c{number}")
                )
        choices.add_option(Option("New session on real indicators", "new"))
        choices.add_option(Option("Demonstration on a simulated machine", "demo"))
        for number, recent in enumerate(self._recent):
            if not recent.interrupted:
                choices.add_option(Option(f"Result  {recent.path}  ({recent.state})", f"r{number}"))
        choices.highlighted = 0
        choices.focus()

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        choice = event.option.id or ""
        try:
            self._open(choice)
        except GlidecalError as problem:
            self.app.complain(problem)

    def _open(self, choice: str) -> None:
        if choice == "new":
            self.app.push_screen(PrepareScreen())
        elif choice == "demo":
            folder = writable_folder(DEMO_FOLDER)
            plan = demo_plan(folder, "zero-max-min", 1, BenchSettings(motion_s=DEMO_MOTION_S))
            self.app.push_screen(CheckScreen(plan))
        elif choice.startswith("c"):
            plan = plan_to_continue(self._at(choice).path)
            self.app.push_screen(CheckScreen(plan, continued=True))
        else:
            self._solve(self._at(choice).path)

    def _at(self, choice: str) -> Recent:
        return self._recent[int(choice[1:])]

    @work(thread=True)
    def _solve(self, path: Path) -> None:
        try:
            solved, _ = solve_files([path])
        except GlidecalError as problem:
            self.app.call_from_thread(self.app.complain, problem)
        else:
            self.app.call_from_thread(partial(self._show, solved, path))

    def _show(self, solved: Solved, path: Path) -> None:
        self.app.push_screen(ResultScreen(solved, None, path))
