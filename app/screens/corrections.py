"""What an operator may correct in a session: repeat, take back, skip, note, re-mount."""

from __future__ import annotations

import asyncio
from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from typing import ClassVar, TypeVar

from textual import work
from textual.screen import ModalScreen, Screen

from app.evaluating.solution import solve_files
from app.measuring.plan import Plan
from app.measuring.session import GuidedSession
from app.report.text import questions
from app.report.text import session as texts
from app.report.text.alignment import adjusted_words
from app.screens.interface import ChoiceDialog, Interface, TextDialog
from calib.errors import GlidecalError

Answer = TypeVar("Answer")


class Corrections(Screen[None]):
    """A screen over a session that is being measured; `MeasureScreen` takes the readings."""

    app: Interface
    FINISHES: ClassVar[str]
    LEAVES: ClassVar[str]
    """Ids of the keys that end and that leave the session."""

    def __init__(self, guided: GuidedSession, plan: Plan) -> None:
        super().__init__()
        self.guided, self.plan = guided, plan
        self.automatic = self.busy = self.asking = False

    @abstractmethod
    def proceed(self) -> None:
        """Go to the present step."""

    @abstractmethod
    def say(self, text: str) -> None:
        """One line of what happened last."""

    @abstractmethod
    def refused(self, text: str) -> None:
        """Something could not be done; the words say why."""

    def ask(self, dialog: ModalScreen[Answer], then: Callable[[Answer | None], None]) -> None:
        """Show a dialog; nothing is taken while it is open, and nothing moves from there on."""
        self.asking, mover = True, self.guided.mover
        if mover is not None:
            mover.release()

        def answered(answer: Answer | None) -> None:
            self.asking = False
            if mover is not None:
                mover.line.calm()
            then(answer)

        self.app.push_screen(dialog, answered)

    def ask_whether(
        self, question: str, choices: Sequence[tuple[str, str]], then: Callable[[], None]
    ) -> None:
        """Ask no or yes, in this order of the choices."""
        (_, _), (yes, _) = choices
        self.ask(ChoiceDialog(question, choices), lambda answer: then() if answer == yes else None)

    def write(self, writing: Callable[[], object]) -> bool:
        """Write to the record; where the disk refuses, say so."""
        try:
            writing()
        except GlidecalError as problem:
            self.refused(str(problem))
            return False
        return True

    @work
    async def finish(self) -> None:
        """Close the record, on to the result."""
        try:
            result = await asyncio.to_thread(self._result)
        except GlidecalError as problem:
            again = f"{{{self.FINISHES}}} tries again, {{{self.LEAVES}}} leaves."
            self.refused(f"Every reading is on the disk, but: {problem} {again}")
            return
        self.app.guided = None
        self.app.go_to(result)
        if self.guided.session.changes:
            self.app.notify(adjusted_words(self.guided.session.adjusted), timeout=30)

    def _result(self) -> Screen[None]:
        from app.screens.result import ResultScreen

        self.guided.finish()
        return ResultScreen(solve_files([self.guided.path]), self.plan, self.guided.path)

    def action_undo(self) -> None:
        """Measure the last step again; its readings stay in the record, superseded.

        Asks as B does where the stand has left it: then more than this step is measured again.
        """
        self.automatic = False
        last = self.guided.session.readings[-1].step if self.guided.session.readings else None
        if self.busy or last is None:
            return
        if len(self.guided.steps_repeated_with(last)) > 1:
            self._chosen(last)
        elif self.write(self.guided.undo):
            step = self.guided.step()
            again = f"Step {step.number if step else 0} is next again."
            self.say(f"{again} Its readings stay in the record and are not used.")
            self.proceed()

    def action_earlier(self) -> None:
        """Choose any earlier step: measure it again, or let superseded readings count again."""
        self.automatic = False
        session = self.guided.session
        steps = {r.step for r in session.all_readings} | set(session.skipped)
        points = [step for step in self.guided.steps if step.number in steps]
        if self.busy or not points:
            return
        choices = [(step.number, texts.point_text(step, session)) for step in points]
        question = "Which step? Nothing changes until you say what to do with it."
        self.ask(ChoiceDialog(question, choices, len(choices) - 1), self._chosen)

    def _chosen(self, step: int | None) -> None:
        if step is None:
            return
        session = self.guided.session
        if any(r.step == step for r in session.readings) or step in session.skipped:
            gone = len(self.guided.steps_repeated_with(step))
            brought = "brought back" if step in session.skipped else "measured again"
            question = f"Why is step {step} {brought}? With a reason it becomes the next step."
            if gone > 1:
                question += f" Its stand is gone: {gone} steps are measured, to share one zero."
            answer = f"Step {step} is measured again: {{}}"
            self._with_reason(question, partial(self.guided.repeat, step), answer)
        else:
            why = session.superseded[max(r.reading for r in session.all_readings if r.step == step)]
            question = questions.RESTORE_QUESTION.format(step, why)
            self.ask_whether(question, questions.RESTORE_CHOICES, partial(self._restore, step))

    def _restore(self, step: int) -> None:
        if self.write(lambda: self.guided.restore(step, "restored by the operator")):
            counts = step in self.guided.session.done()
            self.say(
                f"The readings of step {step} are used again."
                if counts
                else f"Step {step} cannot be restored: the stand was moved after it."
            )
            self.proceed()

    def _with_reason(self, question: str, writing: Callable[[str], object], said: str) -> None:
        """Ask for a reason and write it, then say so; without one nothing changes."""
        step = self.guided.step()
        then = f"step {step.number} stays the next" if step else "the session is done"
        as_before = f"nothing changes, {then}."

        def answered(reason: str | None) -> None:
            if not reason:
                self.say(as_before.capitalize())
            elif self.write(partial(writing, reason)):
                self.say(said.format(reason))
                self.proceed()

        self.ask(TextDialog(question, "reason", without=as_before), answered)

    def action_skip(self) -> None:
        step = self.guided.step()
        if step is None or self.busy:
            return
        steps = [s.number for s in self.guided.rest_of_place()]
        choices = [([step.number], f"Step {step.number} only")]
        if len(steps) > 1:
            choices.append((steps, f"The rest of leg {step.leg.upper()}: {len(steps)} steps"))

        def chosen(numbers: list[int] | None) -> None:
            if numbers:
                question = "Why? The reason stays in the record."
                words = self.app.keyed("{measure.earlier} brings it back.")
                words = f"Skipped: {{}}. {words}"
                self._with_reason(question, partial(self.guided.skip, numbers), words)

        self.ask(ChoiceDialog("What do you want to skip?", choices), chosen)

    def action_remount(self) -> None:
        """The stand was moved: later readings have a new zero. Asks first."""
        if not self.busy:
            self.ask_whether(questions.MOVED_QUESTION, questions.MOVED_CHOICES, self._remount)

    def _remount(self) -> None:
        if self.write(self.guided.remount):
            self.say("New set-up: readings from here on have a new zero")
            self.proceed()

    def action_leave(self) -> None:
        """Back to the home screen, with the session paused. Asks first."""
        self.automatic = False
        if not self.busy:
            self.ask_whether(questions.LEAVE_QUESTION, questions.LEAVE_CHOICES, self._leave)

    def _leave(self) -> None:
        self.app.run_worker(self.app.pause_session())

    def action_note(self) -> None:
        self.ask(TextDialog("Note for the record.", "what happened"), self._noted)

    def _noted(self, text: str | None) -> None:
        if text and self.write(lambda: self.guided.note(text)):
            self.say(f"Noted: {text}")
