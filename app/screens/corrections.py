"""What an operator may correct in a session: repeat, take back, skip, note, re-mount."""

from __future__ import annotations

import asyncio
from abc import abstractmethod
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import ClassVar, TypeVar

from textual import work
from textual.screen import Screen

from app.dialogue.corrections import CorrectionDialogue
from app.evaluating.solution import solve_files
from app.measuring.attended import AttendedSession
from app.measuring.plan import Plan
from app.measuring.session import GuidedSession
from app.report.text import questions
from app.report.text.alignment import adjusted_words
from app.screens.interface import MainScreen, screen_of
from calib.errors import GlidecalError

Answer = TypeVar("Answer")


class Corrections(MainScreen[None]):
    """A screen over a session that is being measured; `MeasureScreen` takes the readings."""

    FINISHES: ClassVar[str]
    LEAVES: ClassVar[str]
    """Ids of the keys that end and that leave the session."""

    def __init__(self, guided: GuidedSession, plan: Plan) -> None:
        super().__init__()
        self.guided, self.plan = guided, plan
        self.attended = AttendedSession(guided)
        self.correcting = CorrectionDialogue(self, guided)
        self.busy = self.asking = False

    @abstractmethod
    def proceed(self) -> None:
        """Go to the present step."""

    def refused(self, text: str) -> None:
        """Something could not be done; the words say why."""
        self.busy = False
        self.say(text)

    async def ask(self, dialog: Screen[Answer], *, over: bool = False) -> Answer | None:
        """Ask from a worker: nothing is taken while a dialog is open, and nothing moves from there
        on.

        None, too, where another dialog is open that this one need not lie over.
        """
        if self.asking and not over:
            return None
        asked_before, self.asking, mover = self.asking, True, self.guided.mover
        if mover is not None:
            mover.release()
        answer = await self.app.push_screen_wait(dialog)
        self.asking = asked_before  # a question below this one is still open
        if mover is not None:
            mover.line.calm()
        return answer

    async def agreed(self, question: str, choices: Sequence[tuple[str, str]]) -> bool:
        """Ask no or yes, in this order of the choices."""
        return await self.choice(question, choices) == choices[1][0]

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Within this a disk that refuses is told, and what would follow it there is left out."""
        try:
            yield
        except GlidecalError as problem:
            self.refused(str(problem))

    @work
    async def finish(self) -> None:
        try:
            result = await asyncio.to_thread(self._result)
        except GlidecalError as problem:
            again = f"{{{self.FINISHES}}} tries again, {{{self.LEAVES}}} leaves."
            self.refused(f"Every reading is on the disk, but: {problem} {again}")
            return
        self.app.guided = None
        self.app.go_to(result)
        if self.guided.session.changes:
            self.app.notify(adjusted_words(self.guided.session.adjusted))

    def _result(self) -> Screen[None]:
        self.guided.finish()
        path = self.guided.path
        return screen_of("result.ResultScreen", solve_files([path]), self.plan, path)

    def action_correct(self, correction: str) -> None:
        """Repeat, take back, skip or set up anew, as `CorrectionDialogue` calls it."""
        if not self.busy:
            by_hand = correction in ("undo", "earlier")
            self.converse(getattr(self.correcting, correction), by_hand=by_hand)

    @work
    async def converse(
        self, correction: Callable[[], Awaitable[bool]], *, by_hand: bool = False
    ) -> None:
        """Ask, and go to the present step where anything is another now, ``by_hand`` from there."""
        with self.writing():
            if await correction():
                self.attended.automatic &= not by_hand
                self.proceed()

    @work
    async def action_leave(self) -> None:
        """Back to the home screen, with the session paused. Asks first."""
        if self.busy or not await self.agreed(questions.LEAVE_QUESTION, questions.LEAVE_CHOICES):
            return
        self.attended.automatic = False
        self.app.run_worker(self.app.pause_session())

    @work
    async def action_note(self) -> None:
        if text := await self.line("Note for the record.", "what happened"):
            with self.writing():
                self.guided.note(text)
                self.say(f"Noted: {text}")
