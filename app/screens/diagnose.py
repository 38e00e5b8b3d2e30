"""The diagnosis: what is missing, where, what else it could be, and what adopting it does."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual.binding import Binding, BindingType

from app.dialogue.adoption import AdoptionDialogue
from app.evaluating.diagnosis import SessionDiagnosis
from app.report.charts.results import residuals_before_and_after
from app.report.text import diagnosis as texts
from app.report.text.help import help_of
from app.screens.interface import once, screen_of
from app.screens.paged import Page, PagedScreen
from app.screens.pages import apart
from app.screens.what_if import tried


class DiagnoseScreen(PagedScreen[None]):
    """One diagnosis; what was named can be adopted into a model and is then looked for no more."""

    HELP = help_of("diagnose")
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("a", "adopt", "Adopt", id="diagnose.adopt"),
        Binding("n", "next", "Next measurement", id="diagnose.next"),
        Binding("w", "what_if", "What if", id="diagnose.what_if"),
        Binding("l", "result", "Result", id="diagnose.result"),
    ]
    WRITES = ("adopt", "next")
    NEEDS = ("adopt", "next", "what_if", "copy")
    LOOKING, NOTHING = texts.NOT_YET, texts.NOTHING_FOUND
    PAGES = (
        Page("verdict", "Verdict"),
        Page("where", "Where"),
        Page("candidates", "Candidates"),
        Page("change", "Before/after", charts=1),
    )

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__()
        self.adopting = AdoptionDialogue(self, paths)
        self.diagnosed: SessionDiagnosis | None = None

    def begin(self) -> None:
        self.diagnosed, adopting = None, self.adopting
        heading = texts.heading_text([path.name for path in adopting.paths], adopting.model)
        self.look(heading, texts.LOOKING, adopting.diagnose, self._show, texts.problem_text)

    def _show(self, outcome: tuple[SessionDiagnosis, str]) -> None:
        self.diagnosed, adopted = outcome
        self.put("verdict", texts.verdict_text(self.diagnosed, adopted))
        self.put("where", texts.where_text(self.diagnosed))
        self.put("candidates", texts.ranking_text(self.diagnosed))
        chart = residuals_before_and_after(self.diagnosed.diagnosis.residuals.cells)
        self.put("change", texts.change_text(self.diagnosed), chart)

    def on_screen_resume(self) -> None:
        """The model may have been given another size on the screen that was above."""
        with self.app.complaining():
            if self.looked and self.adopting.is_stale():
                self.begin()

    def why_not(self, action: str) -> str:
        diagnosed = self.diagnosed
        if reason := super().why_not(action):
            return reason
        if action == "adopt" and diagnosed and not texts.adopt_choices(diagnosed):
            return texts.NOTHING_NAMED
        return texts.NO_NEXT if action == "next" and diagnosed and not diagnosed.separation else ""

    @once("adopt")
    async def action_adopt(self) -> None:
        if self.diagnosed and await self.adopting.adopt(self.diagnosed):
            self.begin()

    @once("adopt")
    async def action_what_if(self) -> None:
        """What an effect does at any size: one of the model gets it, another is adopted as by A."""
        diagnosed, model = self.diagnosed, self.adopting.model
        if diagnosed is None:
            return
        pair = await tried(self, diagnosed.sessions, model, diagnosed=diagnosed)
        if pair and await self.adopting.hold(diagnosed, *pair):
            self.begin()

    def action_next(self) -> None:
        if self.diagnosed:
            with self.app.complaining():
                self.adopting.write_next(self.diagnosed)

    @once("result")
    async def action_result(self) -> None:
        """What these sessions give, with the adopted effects where there are any."""
        paths, model = self.adopting.paths, self.adopting.model
        verified = not self.app.read_only
        job = partial(screen_of, "result.result_of", paths, model, verified=verified)
        self.app.push_screen(await apart(self, job))
