"""What an operator may correct in a session: what is asked, and what is written."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial

from app.dialogue.person import Person
from app.measuring.gauges import LostIndicators
from app.measuring.indicators import ports_to_choose
from app.measuring.session import GuidedSession
from app.report.text import motion, questions
from app.report.text import session as texts
from app.report.text.home import PORT_HINT
from calib.errors import GlidecalError
from calib.printable import with_capital
from drivers.port import check_port


async def other_port(
    person: Person, name: str, adapter: str, ports_in_use: Collection[str]
) -> str | None:
    """The port at which an indicator is now, by its name and that of its adapter: listed or typed.

    None where the question is left. Raises IndicatorError for a URL that leads to no device.
    """
    ports = ports_to_choose(adapter, ports_in_use)
    choices = [*questions.port_choices(ports, adapter), ("", questions.PORT_ELSEWHERE)]
    port = await person.choice(questions.port_question(name, none=not ports), choices)
    if port == "":
        port = await person.line(questions.WHICH_PORT, PORT_HINT)
    if port:
        check_port(port)
    return port or None


@dataclass(frozen=True)
class CorrectionDialogue:
    """The ``person`` who attends a session corrects it.

    Each correction returns whether anything is another now; those raise RecordError of a disk that
    refuses.
    """

    person: Person
    guided: GuidedSession

    async def undo(self) -> bool:
        """Measure the last step again; its readings stay in the record, superseded.

        Asks as `earlier` does where the stand has left it: then more than this step is measured
        again.
        """
        guided = self.guided
        last = guided.last_step
        if last is None:
            return False
        if len(guided.steps_repeated_with(last)) > 1:
            return await self._bring_back(last)
        self.person.say(questions.next_again_text(guided.undo()))
        return True

    async def earlier(self) -> bool:
        """Choose any earlier step: measure it again, or let superseded readings count again."""
        guided = self.guided
        points = guided.begun_steps()
        if not points:
            return False
        choices = [(step.number, texts.point_text(step, guided.session)) for step in points]
        step = await self.person.choice(questions.WHICH_STEP, choices, len(choices) - 1)
        return step is not None and await self._bring_back(step)

    async def skip(self) -> bool:
        """The present step, or the rest of its leg."""
        guided = self.guided
        step = guided.step()
        if step is None:
            return False
        steps = [following.number for following in guided.rest_of_place()]
        choices = questions.skip_choices(step, steps)
        numbers = await self.person.choice(questions.WHAT_TO_SKIP, choices)
        if not numbers:
            return False
        skip = partial(guided.skip, numbers)
        return await self._with_reason(questions.WHY_SKIP, skip, questions.SKIPPED)

    async def remount(self) -> bool:
        """The stand was moved: later readings have a new zero. Asks first."""
        answer = await self.person.choice(questions.MOVED_QUESTION, questions.MOVED_CHOICES)
        if answer != "moved":
            return False
        self.guided.remount()
        self.person.say(questions.MOVED)
        return True

    async def proof(self) -> bool:
        """What the operator saw of a carriage that indicators cannot tell."""
        mover = self.guided.mover
        if mover and mover.unproved and (question := mover.unproved.question):
            answer = await self.person.choice(question, motion.SAW_CHOICES)
            if answer is not None:
                self.guided.note(*mover.answer_proof(yes=answer == "yes"))
        return False

    async def homing(self) -> bool:
        """Whether the machine was homed since it was switched on."""
        answer = await self.person.choice(motion.HOMED_QUESTION, motion.HOMED_CHOICES)
        if self.guided.mover and answer == "homed":
            self.guided.mover.line.homing_confirmed = True
        elif self.guided.mover and answer == "not homed":
            self.guided.mover.line.deny_homing()
        self.guided.note(f"homing: {answer or 'not answered'}")
        return False

    async def port(self, indicators: LostIndicators) -> tuple[int, str] | None:
        """The first indicator that is lost is read at another port from here on: which, and where.

        None where it is not.
        """
        if not indicators.ports:
            self.person.say(questions.NO_PORT_LOST)
            return None
        number, gauges = min(indicators.ports), self.guided.gauges
        ports_in_use, adapter = [gauge.port for gauge in gauges], gauges[number].adapter
        try:
            port = await other_port(self.person, self.guided.name_of(number), adapter, ports_in_use)
            if port is None:
                return None
            await asyncio.to_thread(self.guided.go_on_at, number, port)
        except GlidecalError as problem:
            self.person.say(f"FAULT: {problem}")
            return None
        return number, port

    async def _bring_back(self, step: int) -> bool:
        guided = self.guided
        session = guided.session
        if any(r.step == step for r in session.readings) or step in session.skipped:
            count = len(guided.steps_repeated_with(step))
            question = questions.again_question(step, step in session.skipped, count)
            text = f"Step {step} is measured again: {{}}"
            return await self._with_reason(question, partial(guided.repeat, step), text)
        question = questions.RESTORE_QUESTION.format(step, guided.why_superseded(step))
        if await self.person.choice(question, questions.RESTORE_CHOICES) != "use":
            return False
        counts = guided.restore(step, "restored by the operator")
        self.person.say(questions.RESTORED[counts].format(step))
        return True

    async def _with_reason(
        self, question: str, writing: Callable[[str], object], text: str
    ) -> bool:
        """Ask for a reason and write it, then tell so; without one nothing changes."""
        as_before = questions.as_before_words(self.guided.step())
        reason = await self.person.line(question, "reason", as_before)
        if reason:
            writing(reason)
        self.person.say(text.replace("{}", reason) if reason else with_capital(as_before))
        return bool(reason)
