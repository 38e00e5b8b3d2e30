"""The result: the sentence that matters, the tables, export, verification, comparison."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import VerticalScroll
from textual.screen import Screen
from textual.widgets import Footer, Header, Static

from app.demo import export_offsets, verification_plan
from app.exports.linuxcnc import UNKNOWN_HOME_OFFSET
from app.opening import Plan
from app.screens.interface import Interface
from app.solving import Solved, solve_sessions
from app.wording.result import comparison_text, solution_text
from calib.errors import GlidecalError
from calib.solution import Subset

CHOICES: dict[str, Subset] = {"1": "joint-offsets", "2": "leg-lengths", "3": "both"}


class ResultScreen(Screen[None]):
    """One solution; with the plan of its session it can be verified."""

    app: Interface
    BINDINGS: ClassVar[list[BindingType]] = [
        ("e", "export", "Export"),
        ("v", "verify", "Verify"),
        ("1", "choose('1')", "Offsets"),
        ("2", "choose('2')", "Lengths"),
        ("3", "choose('3')", "Both"),
        ("h", "home", "Home"),
        ("f10", "app.quit", "Quit"),
    ]

    def __init__(self, solved: Solved, plan: Plan | None, path: Path) -> None:
        super().__init__()
        self.solved = solved
        self.plan = plan
        self.path = path

    def compose(self) -> ComposeResult:
        yield Header()
        with VerticalScroll(id="result"):
            yield Static("", id="text", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        self._show(self._comparison())
        self.query_one("#result").focus()

    def _show(self, opening: str = "") -> None:
        hint = "" if opening or self.plan is None else NEXT + "\n\n"
        self.query_one("#text", Static).update(opening + hint + solution_text(self.solved))

    def _comparison(self) -> str:
        before = self.plan.before if self.plan else None
        if before is None:
            return ""
        return comparison_text(before.solution, self.solved.solution) + "\n\n"

    def action_choose(self, key: str) -> None:
        """Show another set of parameters."""
        try:
            names, sessions = self.solved.names, self.solved.sessions
            self.solved = solve_sessions(names, sessions, subset=CHOICES[key])
        except GlidecalError as problem:
            self.app.complain(problem)
        else:
            self._show()

    def action_export(self) -> None:
        """Write the offsets in every format beside the session."""
        self._export()

    @work(thread=True)
    def _export(self) -> None:
        folder = self.path.with_suffix("")
        try:
            paths = export_offsets(self._joint_offsets(), folder)
        except GlidecalError as problem:
            self.app.call_from_thread(self.app.complain, problem)
        else:
            names = ", ".join(path.name for path in paths)
            said = f"Written to {folder}: {names}"
            if self.solved.sessions[0].opened.machine.home_offset_mm is None:
                said += ". WARNING: " + UNKNOWN_HOME_OFFSET
            self.app.call_from_thread(self.app.notify, said, timeout=10, markup=False)

    def _joint_offsets(self) -> Solved:
        return solve_sessions(self.solved.names, self.solved.sessions, subset="joint-offsets")

    def action_verify(self) -> None:
        """The same procedure again, after the offsets were entered in the controller."""
        from app.screens.check import CheckScreen

        if self.plan is None:
            self.app.complain("Verify is offered right after a session was measured.")
            return
        before = self._joint_offsets()
        plan = verification_plan(self.plan, before)
        self.app.push_screen(CheckScreen(plan))

    def action_home(self) -> None:
        """Back to the first screen."""
        from app.screens.home import HomeScreen

        self.app.go_to(HomeScreen())


NEXT = (
    "Next: E exports the joint offsets. Enter them in the controller, then V measures again "
    "and compares."
)
