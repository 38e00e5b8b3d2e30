"""What a diagnosis leads to: a model that adopts, a corrected session, the next measurement."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from app.dialogue.person import Person, asked_path
from app.evaluating.diagnosis import (
    SessionDiagnosis,
    adopt,
    correct,
    diagnose_files,
    resize,
    write_procedure,
)
from app.evaluating.what_if import Choice
from app.report.text import diagnosis as texts
from protocols.effect_entries import EffectEntry
from protocols.files import unused_path
from protocols.model_file import ModelFile, read_model_file


class AdoptionDialogue:
    """A ``person`` makes something of the diagnosis of sessions, with the effects of a ``model``.

    Conversations return whether there is something else to diagnose now.
    """

    def __init__(self, person: Person, paths: Sequence[Path]) -> None:
        self.person, self.paths = person, tuple(paths)
        self.model: Path | None = None
        self._model_file: ModelFile | None = None
        self._gap_before_mm = 0.0
        self._words: Callable[[], str] | None = None

    def diagnose(self) -> tuple[SessionDiagnosis, str]:
        """The diagnosis, and what adopting did to the gap and at the tool.

        Raises as `diagnose_files`.
        """
        model_file = read_model_file(self.model) if self.model else None
        diagnosed, adopted = diagnose_files(self.paths, model=self.model).work_out(), ""
        if self.model is not None:
            now_mm = diagnosed.diagnosis.gap_before.rms_mm
            adopted = texts.ADOPTED.format(self.model.name, self._gap_before_mm, now_mm)
            adopted = f"{adopted} {self._words() if self._words else ''}".rstrip()
        self._model_file = model_file
        return diagnosed, adopted

    def is_stale(self) -> bool:
        """Whether the model is another one than in the last diagnosis. Raises RecordError."""
        return self.model is not None and read_model_file(self.model) != self._model_file

    async def adopt(self, diagnosed: SessionDiagnosis) -> bool:
        """A person chooses names, the rest or a candidate; or a mistake is corrected."""
        choices = texts.adopt_choices(diagnosed)
        answer = await self.person.choice(texts.WHAT_TO_ADOPT, choices)
        if answer == texts.CORRECT:
            return await self._correct(diagnosed)
        return await self._adopt(diagnosed, answer) if answer else False

    async def hold(self, diagnosed: SessionDiagnosis, choice: Choice, entry: EffectEntry) -> bool:
        """An effect at a size that a person tried; one of the model gets this size."""
        if choice.standing != "model" or self.model is None:
            answer = "named" if choice.standing == "named" else f"{entry.id}:{entry.where}"
            return await self._adopt(diagnosed, answer, entry)
        await asyncio.to_thread(resize, diagnosed.sessions, self.model, entry)
        return self._with_model(diagnosed, self.model)

    async def _correct(self, diagnosed: SessionDiagnosis) -> bool:
        source = self.paths[0]
        path = await asked_path(self.person, texts.WHICH_SESSION, self._unused("_corrected.jsonl"))
        if path is None:
            return False
        correct(diagnosed, source, path)
        self.person.say(texts.CORRECTED.format(path, source.name))
        self.paths = (path,)
        return True

    async def _adopt(
        self, diagnosed: SessionDiagnosis, answer: str, entry: EffectEntry | None = None
    ) -> bool:
        model_path = self.model or self._unused("_model.json")
        path = await asked_path(self.person, texts.WHICH_FILE, model_path)
        if path is None:
            return False
        candidate = None if answer == "named" else answer
        job = partial(
            adopt, diagnosed, path, known_model=self.model, candidate=candidate, held=entry
        )
        if not await self.person.written(job):
            return False
        # a size that a person holds is no part of the posterior given the name
        text_of = None if entry else partial(texts.words_on_adopting, diagnosed, candidate)
        return self._with_model(diagnosed, path, text_of)

    def _with_model(
        self, diagnosed: SessionDiagnosis, model: Path, text_of: Callable[[], str] | None = None
    ) -> bool:
        self.person.say(texts.MODEL_WRITTEN.format(model))
        self.model, self._gap_before_mm = model, diagnosed.diagnosis.gap_before.rms_mm
        self._words = text_of
        return True

    def write_next(self, diagnosed: SessionDiagnosis) -> None:
        """The next measurement as a procedure file beside the session, where it needs one.

        Raises UsageError where none is proposed.
        """
        separation = diagnosed.separation
        if separation is not None and not separation.candidate.text.startswith("schema"):
            self.person.say(texts.NO_FILE_NEEDED.format(separation.candidate.text))
            return
        path = self._unused("_next.toml")
        write_procedure(diagnosed, path)
        self.person.say(texts.NEXT_WRITTEN.format(path))

    def _unused(self, ending: str) -> Path:
        return unused_path(self.paths[0].with_name(f"{self.paths[0].stem}{ending}"))
