"""The diagnosis: what is missing, where, what else it could be, and what adopting it does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual.binding import Binding, BindingType

from app.evaluating.diagnosis import (
    SessionDiagnosis,
    adopt,
    correct,
    diagnose_files,
    resize,
    write_procedure,
)
from app.report.charts.results import residuals_before_and_after
from app.report.text import diagnosis as texts
from app.screens.interface import once, screen_of
from app.screens.paged import Page, PagedScreen
from app.screens.pages import apart
from app.screens.what_if import tried
from protocols.effect_entries import EffectEntry
from protocols.files import unused_path
from protocols.model_file import ModelFile, read_model_file


class DiagnoseScreen(PagedScreen[None]):
    """One diagnosis; what was named can be adopted into a model and is then looked for no more."""

    HELP = texts.DIAGNOSE_HELP
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
        self.paths = tuple(paths)
        self.model: Path | None = None
        self.diagnosed: SessionDiagnosis | None = None
        self._gap_before_mm: float | None = None
        self._adopted_words: Callable[[], str] | None = None
        self._known: ModelFile | None = None

    def begin(self) -> None:
        self.diagnosed = self._known = None
        heading = texts.heading_text([path.name for path in self.paths], self.model)
        self.begin_to_look(heading, texts.LOOKING)
        self.look(self._diagnosis, self._show, texts.problem_text)

    def _diagnosis(self) -> tuple[ModelFile | None, SessionDiagnosis, str]:
        known = read_model_file(self.model) if self.model else None
        diagnosed = diagnose_files(self.paths, model=self.model).work_out()
        return known, diagnosed, self._adopted_words() if self._adopted_words else ""

    def _show(self, outcome: tuple[ModelFile | None, SessionDiagnosis, str]) -> None:
        (self._known, diagnosed, at_tool), adopted = outcome, ""
        self.diagnosed = diagnosed
        if self.model is not None and self._gap_before_mm is not None:
            now = diagnosed.diagnosis.gap_before.rms_mm
            adopted = texts.ADOPTED.format(self.model.name, self._gap_before_mm, now)
            adopted = f"{adopted} {at_tool}".rstrip()
        self.put("verdict", texts.verdict_text(diagnosed, adopted))
        self.put("where", texts.where_text(diagnosed))
        self.put("candidates", texts.ranking_text(diagnosed))
        chart = residuals_before_and_after(diagnosed.diagnosis.residuals.cells)
        self.put("change", texts.change_text(diagnosed), chart)

    def on_screen_resume(self) -> None:
        """The model may have been given another size on the screen that was above."""
        if self._known is not None and self.model is not None:
            with self.app.complaining():
                if read_model_file(self.model) != self._known:
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
        diagnosed = self.diagnosed
        if diagnosed is not None:
            choices = texts.adopt_choices(diagnosed)
            answer = await self.choice(texts.WHAT_TO_ADOPT, choices)
            if answer == texts.CORRECT:
                await self._correct(diagnosed)
            elif answer:
                await self._adopt(diagnosed, answer)

    @once("adopt")
    async def action_what_if(self) -> None:
        """What an effect does at any size: one of the model gets it, another is adopted as by A."""
        diagnosed = self.diagnosed
        if diagnosed is None:
            return
        pair = await tried(self, diagnosed.sessions, self.model, diagnosed=diagnosed)
        if pair is None:
            return
        choice, entry = pair
        if choice.standing != "model":
            answer = "named" if choice.standing == "named" else f"{entry.id}:{entry.where}"
            await self._adopt(diagnosed, answer, entry)
        elif self.model is not None:
            await apart(self, resize, diagnosed.sessions, self.model, entry)
            self._look_again(diagnosed, self.model)

    async def _correct(self, diagnosed: SessionDiagnosis) -> None:
        source = self.paths[0]
        proposed = unused_path(source.with_name(f"{source.stem}_corrected.jsonl"))
        target = await self.line(texts.WHICH_SESSION, "path", proposed=str(proposed))
        if target:
            path = Path(target).expanduser()
            correct(diagnosed, source, path)
            self.app.notify(texts.CORRECTED.format(path, source.name))
            self.paths = (path,)
            self.begin()

    async def _adopt(
        self, diagnosed: SessionDiagnosis, answer: str, held: EffectEntry | None = None
    ) -> None:
        first = self.paths[0]
        proposed = self.model or unused_path(first.with_name(f"{first.stem}_model.json"))
        target = await self.line(texts.WHICH_FILE, "path", proposed=str(proposed))
        if not target:
            return
        path, candidate = Path(target).expanduser(), None if answer == "named" else answer
        job = partial(adopt, diagnosed, path, known=self.model, candidate=candidate, held=held)
        if await self.app.written(job):
            # a size that a person holds is no part of the posterior given the name
            words = None if held else partial(texts.words_on_adopting, diagnosed, candidate)
            self._look_again(diagnosed, path, words)

    def _look_again(
        self, diagnosed: SessionDiagnosis, model: Path, words: Callable[[], str] | None = None
    ) -> None:
        self.app.notify(texts.MODEL_WRITTEN.format(model))
        self.model, self._gap_before_mm = model, diagnosed.diagnosis.gap_before.rms_mm
        self._adopted_words = words
        self.begin()

    def action_next(self) -> None:
        """The next measurement as a procedure file beside the session."""
        diagnosed = self.diagnosed
        if diagnosed is None or diagnosed.separation is None:
            return
        procedure = diagnosed.separation.candidate.text
        if not procedure.startswith("schema"):
            self.app.notify(texts.NO_FILE_NEEDED.format(procedure))
            return
        first = self.paths[0]
        path = unused_path(first.with_name(f"{first.stem}_next.toml"))
        with self.app.complaining():
            write_procedure(diagnosed, path)
            self.app.notify(texts.NEXT_WRITTEN.format(path))

    @once("result")
    async def action_result(self) -> None:
        """What these sessions give, with the adopted effects where there are any."""
        verified = not self.app.read_only
        job = partial(screen_of, "result.result_of", self.paths, self.model, verified=verified)
        self.app.push_screen(await apart(self, job))
