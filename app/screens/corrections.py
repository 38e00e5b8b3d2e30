"""What an operator may correct in a session: repeat, take back, skip, note, re-mount."""

from __future__ import annotations

import asyncio
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import ClassVar, TypeVar

from textual import work
from textual.screen import Screen

from app.evaluating.solution import solve_files
from app.measuring.attended import Attended
from app.measuring.plan import Plan
from app.measuring.session import GuidedSession
from app.report.text import questions
from app.report.text import session as texts
from app.report.text.alignment import adjusted_words
from app.screens.interface import ChoiceDialog, MainScreen, TextDialog
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
        self.attended = Attended(guided)
        self.busy = self.asking = False

    @abstractmethod
    def proceed(self) -> None:
        """Go to the present step."""

    def refused(self, text: str) -> None:
        """Something could not be done; the words say why."""
        self.busy = False
        self.say(text)

    async def ask(self, dialog: Screen[Answer], *, over: bool = False) -> Answer | None:
        """For workers: nothing is taken while a dialog is open, and nothing moves from there on.

        None, too, where another dialog is open that this one need not lie over.
        """
        if self.asking and not over:
            return None
        self.asking, mover = True, self.guided.mover
        if mover is not None:
            mover.release()
        answer = await self.app.push_screen_wait(dialog)
        self.asking = False
        if mover is not None:
            mover.line.calm()
        return answer

    async def agreed(self, question: str, choices: Sequence[tuple[str, str]]) -> bool:
        """Ask no or yes, in this order of the choices."""
        return await self.ask(ChoiceDialog(question, choices)) == choices[1][0]

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
        from app.screens.result import ResultScreen

        self.guided.finish()
        return ResultScreen(solve_files([self.guided.path]), self.plan, self.guided.path)

    @work
    async def action_undo(self) -> None:
        """Measure the last step again; its readings stay in the record, superseded.

        Asks as B does where the stand has left it: then more than this step is measured again.
        """
        self.attended.automatic = False
        last = self.guided.last_step
        if self.busy or last is None:
            return
        if len(self.guided.steps_repeated_with(last)) > 1:
            await self._bring_back(last)
        else:
            with self.writing():
                self.say(questions.next_again_text(self.guided.undo()))
                self.proceed()

    @work
    async def action_earlier(self) -> None:
        """Choose any earlier step: measure it again, or let superseded readings count again."""
        self.attended.automatic = False
        points = self.guided.begun_steps()
        if self.busy or not points:
            return
        choices = [(step.number, texts.point_text(step, self.guided.session)) for step in points]
        step = await self.ask(ChoiceDialog(questions.WHICH_STEP, choices, len(choices) - 1))
        if step is not None:
            await self._bring_back(step)

    async def _bring_back(self, step: int) -> None:
        session = self.guided.session
        if any(r.step == step for r in session.readings) or step in session.skipped:
            gone = len(self.guided.steps_repeated_with(step))
            question = questions.again_question(step, step in session.skipped, gone)
            repeat = partial(self.guided.repeat, step)
            await self._with_reason(question, repeat, f"Step {step} is measured again: {{}}")
            return
        question = questions.RESTORE_QUESTION.format(step, self.guided.why_superseded(step))
        if await self.agreed(question, questions.RESTORE_CHOICES):
            with self.writing():
                counts = self.guided.restore(step, "restored by the operator")
                self.say(questions.RESTORED[counts].format(step))
                self.proceed()

    async def _with_reason(
        self, question: str, writing: Callable[[str], object], words: str
    ) -> None:
        """Ask for a reason and write it, then say so; without one nothing changes."""
        as_before = questions.as_before_words(self.guided.step())
        reason = await self.ask(TextDialog(question, "reason", without=as_before))
        if not reason:
            self.say(as_before.capitalize())
            return
        with self.writing():
            writing(reason)
            self.say(words.format(reason))
            self.proceed()

    @work
    async def action_skip(self) -> None:
        step = self.guided.step()
        if step is None or self.busy:
            return
        steps = [s.number for s in self.guided.rest_of_place()]
        choices = questions.skip_choices(step, steps)
        numbers = await self.ask(ChoiceDialog(questions.WHAT_TO_SKIP, choices))
        if numbers:
            skipped = self.app.keyed(questions.SKIPPED)
            skip = partial(self.guided.skip, numbers)
            await self._with_reason(questions.WHY_SKIP, skip, skipped)

    @work
    async def action_remount(self) -> None:
        """The stand was moved: later readings have a new zero. Asks first."""
        if self.busy or not await self.agreed(questions.MOVED_QUESTION, questions.MOVED_CHOICES):
            return
        with self.writing():
            self.guided.remount()
            self.say(questions.MOVED)
            self.proceed()

    @work
    async def action_leave(self) -> None:
        """Back to the home screen, with the session paused. Asks first."""
        self.attended.automatic = False
        if self.busy or not await self.agreed(questions.LEAVE_QUESTION, questions.LEAVE_CHOICES):
            return
        self.app.run_worker(self.app.pause_session())

    @work
    async def action_note(self) -> None:
        if text := await self.ask(TextDialog("Note for the record.", "what happened")):
            with self.writing():
                self.guided.note(text)
                self.say(f"Noted: {text}")
