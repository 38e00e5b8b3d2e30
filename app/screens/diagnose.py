"""The diagnosis: what is missing, where, what else it could be, and what adopting it does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical, VerticalScroll
from textual.widgets import Footer, Static, TabbedContent, TabPane

from app.evaluating.diagnosis import (
    SessionDiagnosis,
    adopt,
    correct,
    diagnose_files,
    mistakes_of,
    resize,
    write_procedure,
)
from app.evaluating.solution import solve_files
from app.evaluating.what_if import Choice, choices, trial_of
from app.measuring.plan import plan_to_repeat
from app.report.charts.results import residuals_before_and_after
from app.report.text import diagnosis as texts
from app.report.text.result import ONLY_SHOWN
from app.screens.interface import ChoiceDialog, TextDialog
from app.screens.paged import PagedScreen, page_keys
from app.screens.pages import apart, signalled
from app.screens.plot import ChartPlot
from app.screens.what_if import WhatIfScreen, ask_effect
from calib.errors import GlidecalError
from protocols.files import unused_path
from protocols.model_file import EffectEntry, ModelFile, read_model_file

PAGES = {"verdict": "1 Verdict", "where": "2 Where", "candidates": "3 Candidates"}
CHANGE = "change"


class DiagnoseScreen(PagedScreen):
    """One diagnosis; what was named can be adopted into a model and is then looked for no more."""

    HELP = texts.DIAGNOSE_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("a", "adopt", "Adopt", id="diagnose.adopt"),
        Binding("n", "next", "Next measurement", id="diagnose.next"),
        Binding("w", "what_if", "What if", id="diagnose.what_if"),
        Binding("r", "result", "Result", id="diagnose.result"),
        Binding("a", "refuse('adopt')", show=False, id="diagnose.refuse_adopt"),
        Binding("n", "refuse('next')", show=False, id="diagnose.refuse_next"),
        Binding("1", "page('verdict')", "Verdict", show=False, id="diagnose.verdict"),
        Binding("2", "page('where')", "Where", show=False, id="diagnose.where"),
        Binding("3", "page('candidates')", "Candidates", show=False, id="diagnose.candidates"),
        Binding("4", "page('change')", "Before/after", show=False, id="diagnose.change"),
        *page_keys("diagnose"),
    ]

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__()
        self.paths = tuple(paths)
        self.model: Path | None = None
        self.diagnosed: SessionDiagnosis | None = None
        self.looking = False
        self._gap_before_mm: float | None = None
        self._adopted_words: Callable[[], str] | None = None
        self._known: ModelFile | None = None

    def compose(self) -> ComposeResult:
        yield Static("", id="diagnosed", markup=False)
        with TabbedContent(initial="verdict"):
            for name, title in PAGES.items():
                with TabPane(title, id=name), VerticalScroll():
                    yield Static("", id=f"{name}-text", classes="page", markup=False)
            with TabPane("4 Before/after", id=CHANGE), Vertical():
                yield Static("", id=f"{CHANGE}-text", classes="page", markup=False)
                yield ChartPlot(plot_id="change-chart")
        yield Footer(compact=True, show_command_palette=False)

    def on_mount(self) -> None:
        self._look()

    def _look(self) -> None:
        """Diagnose apart from the screen."""
        self.looking, self.diagnosed, self._known = True, None, None
        self.refresh_bindings()
        names = [path.name for path in self.paths]
        self.query_one("#diagnosed", Static).update(texts.heading_text(names, self.model))
        self._say_everywhere(texts.LOOKING)
        self._diagnose()

    def on_screen_resume(self) -> None:
        """The model may have been given another size on the screen that was above."""
        if self._known is not None and self.model is not None:
            with self.app.complaining():
                if read_model_file(self.model) != self._known:
                    self._look()

    def _say_everywhere(self, text: str) -> None:
        for name in (*PAGES, CHANGE):
            self._page_text(name).update(text)
        self.query_one("#change-chart").display = False

    def _page_text(self, name: str) -> Static:
        return self.query_one(f"#{name}-text", Static)

    @work(group="diagnose", exclusive=True)
    async def _diagnose(self) -> None:
        try:
            self._known, found, at_tool = await apart(
                self, _diagnosis, self.paths, self.model, self._adopted_words
            )
        except GlidecalError as problem:
            self.looking = False
            self._say_everywhere(texts.problem_text(problem))
            return
        self.looking, self.diagnosed = False, found
        self.refresh_bindings()
        now = found.diagnosis.gap_before.rms_mm
        adopted = ""
        if self.model is not None and self._gap_before_mm is not None:
            adopted = texts.ADOPTED.format(self.model.name, self._gap_before_mm, now)
            adopted = f"{adopted} {at_tool}".rstrip()
        self._page_text("verdict").update(signalled(texts.verdict_text(found, adopted)))
        self._page_text("where").update(texts.where_text(found))
        self._page_text("candidates").update(texts.ranking_text(found))
        self._page_text(CHANGE).update(texts.change_text(found))
        chart = self.query_one("#change-chart", ChartPlot)
        chart.display = True
        chart.show(residuals_before_and_after(found.diagnosis.residuals.cells))

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """What cannot be done now is not offered; its key says why."""
        return not self._why_not(action) if action in ("adopt", "next") else True

    def _why_not(self, action: str) -> str:
        """Why there is nothing to adopt or to measure next; empty where there is."""
        if self.app.read_only:
            return ONLY_SHOWN
        if self.diagnosed is None:
            return texts.NOT_YET if self.looking else texts.NOTHING_FOUND
        if action == "adopt":
            return "" if texts.adopt_choices(self.diagnosed) else texts.NOTHING_NAMED
        return "" if self.diagnosed.separation else texts.NO_NEXT

    def action_refuse(self, action: str) -> None:
        """Why nothing is written."""
        self.app.complain(self._why_not(action))

    def _ready(self) -> SessionDiagnosis | None:
        """The diagnosis; where there is none, the reason is said."""
        if self.diagnosed is None:
            self.app.complain(texts.NOT_YET if self.looking else texts.NOTHING_FOUND)
        return self.diagnosed

    def action_adopt(self) -> None:
        """Ask what becomes part of the model, then for the file."""
        if found := self._ready():
            dialog = ChoiceDialog(texts.WHAT_TO_ADOPT, texts.adopt_choices(found))
            self.app.ask(dialog, partial(self._ask_file, found))

    def action_what_if(self) -> None:
        """Ask for an effect, then show what it does at any size."""
        if found := self._ready():
            listed = choices(found.sessions, self._known, found)
            ask_effect(self.app, listed, partial(self._try, found))

    def _try(self, found: SessionDiagnosis, choice: Choice) -> None:
        trial = trial_of(choice, found.sessions, self._known)
        mistakes = bool(mistakes_of(found))
        adopt = partial(self._adopt_tried, found)
        screen = WhatIfScreen(choice, trial, adopt, model=self.model, mistakes=mistakes)
        self.app.push_screen(screen)

    def _adopt_tried(self, found: SessionDiagnosis, choice: Choice, entry: EffectEntry) -> None:
        """One of the model gets its size there, another one is adopted as by A."""
        if choice.standing != "model":
            answer = "named" if choice.standing == "named" else f"{entry.id}:{entry.where}"
            self._ask_file(found, answer, entry)
        elif self.model is not None:
            with self.app.complaining():
                resize(found.sessions, self.model, entry)
                said = texts.MODEL_WRITTEN.format(self.model)
                self.app.notify(said, timeout=10, markup=False)
                self._gap_before_mm = found.diagnosis.gap_before.rms_mm
                self._adopted_words = None
                self._look()

    def _ask_file(
        self, found: SessionDiagnosis, answer: str, held: EffectEntry | None = None
    ) -> None:
        first, correcting = self.paths[0], answer == texts.CORRECT
        proposed = self.model or unused_path(first.with_name(f"{first.stem}_model.json"))
        if correcting:
            proposed = unused_path(first.with_name(f"{first.stem}_corrected.jsonl"))

        def named(typed: str) -> None:
            target = Path(typed).expanduser()
            if correcting:
                self._correct(found, target)
            else:
                self._adopt(found, target, None if answer == "named" else answer, held)

        question = texts.WHICH_SESSION if correcting else texts.WHICH_FILE
        self.app.ask(TextDialog(question, "path", str(proposed)), named)

    def _correct(self, found: SessionDiagnosis, target: Path) -> None:
        """Write the session without its mistakes and look again, at that."""
        with self.app.complaining():
            source = self.paths[0]
            correct(found, source, target)
            said = texts.CORRECTED.format(target, source.name)
            self.app.notify(said, timeout=10, markup=False)
            self.paths = (target,)
            self._look()

    def _adopt(
        self,
        found: SessionDiagnosis,
        target: Path,
        candidate: str | None,
        held: EffectEntry | None,
        *,
        replace: bool = False,
    ) -> None:
        """Write the model and look again with it."""
        again = partial(self._adopt, found, target, candidate, held, replace=True)
        with self.app.complaining(again):
            adopt(
                found,
                target,
                known=self.model,
                candidate=candidate,
                held=held,
                replace=replace,
            )
            self.app.notify(texts.MODEL_WRITTEN.format(target), timeout=10, markup=False)
            self.model, self._gap_before_mm = target, found.diagnosis.gap_before.rms_mm
            # a size that a person holds is no part of the posterior given the name
            words = partial(texts.words_on_adopting, found, candidate)
            self._adopted_words = None if held else words
            self._look()

    def action_next(self) -> None:
        """The next measurement as a procedure file beside the session."""
        found = self._ready()
        proposed = found.separation if found else None
        if found is None or proposed is None:
            return
        procedure = proposed.candidate.text
        if not procedure.startswith("schema"):
            self.app.notify(texts.NO_FILE_NEEDED.format(procedure), timeout=12, markup=False)
            return
        first = self.paths[0]
        path = unused_path(first.with_name(f"{first.stem}_next.toml"))
        with self.app.complaining():
            write_procedure(found, path)
            self.app.notify(texts.NEXT_WRITTEN.format(path), timeout=12, markup=False)

    @work(group="result", exclusive=True)
    async def action_result(self) -> None:
        """What these sessions give, with the adopted effects where there are any."""
        from app.screens.result import ResultScreen

        path, model = self.paths[0], self.model
        with self.app.complaining():
            solved = await apart(self, solve_files, self.paths, model=model)
            plan = None if self.app.read_only else await apart(self, plan_to_repeat, path)
            self.app.push_screen(ResultScreen(solved, plan, path, model))

    def action_copy(self) -> None:
        if self._ready():
            super().action_copy()


def _diagnosis(
    paths: Sequence[Path], model: Path | None, adopted_words: Callable[[], str] | None
) -> tuple[ModelFile | None, SessionDiagnosis, str]:
    known = read_model_file(model) if model else None
    found = diagnose_files(paths, model=model)
    _ = found.tool, found.separation  # worked out here, not while the page is drawn
    return known, found, adopted_words() if adopted_words else ""
