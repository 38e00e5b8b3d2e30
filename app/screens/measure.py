"""Measuring: what to do now, what the indicators show, what has been taken."""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType

from app.measuring.attended import Press
from app.measuring.doubts import TakenStep
from app.measuring.gauges import Live, LostIndicators
from app.measuring.indicators import propose_again
from app.measuring.moving import Mover
from app.measuring.plan import Plan
from app.measuring.session import GuidedSession
from app.measuring.unattended import lost_words
from app.report.text import motion, questions
from app.report.text import session as texts
from app.report.text.help import help_of
from app.screens.corrections import Corrections
from app.screens.interface import ChoiceDialog, once, screen_of
from app.screens.pages import KeyLine, Resting, apart, is_left
from app.screens.session_view import LegReviewScreen, MotionDialog, SessionScreen, SessionView
from calib.errors import sentence
from calib.printable import with_capital
from drivers.motion.states import State
from protocols.clock import SleepWatch
from protocols.expectation import Movement

ATTEND_S = 0.05
"""The thread of the controller is told so often that the screens run."""

AGES_S = 0.2
"""Ages and stale indicators are looked at so often."""


class MeasureScreen(Corrections, SessionScreen, Resting):
    """One step after the other; Space takes it."""

    HELP = help_of("measure")
    FINISHES, LEAVES = "measure.take", "measure.leave"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space", "take", "Take", id="measure.take"),
        Binding("enter", "take", "Take", show=False, id="measure.take-too"),
        Binding("u", "correct('undo')", "Repeat", id="measure.repeat"),
        Binding("b", "correct('earlier')", "Back", id="measure.earlier"),
        Binding("s", "correct('skip')", "Skip", id="measure.skip"),
        Binding("a", "automatic", "Auto", id="measure.automatic"),
        Binding("p", "hold", "Hold", id="measure.hold"),
        Binding("m", "correct('remount')", "Moved", id="measure.remount"),
        Binding("n", "note", "Note", id="measure.note"),
        Binding("w", "where", "Where", show=False, id="measure.where"),
        Binding("v", "plot", "View", show=False, id="measure.plot"),
        Binding("o", "port", "Port", show=False, id="measure.port"),
        Binding("g", "go", "Go", id="measure.go"),
        Binding("escape", "leave", "Home", show=False, id="measure.home"),
        Binding("f10", "app.quit", "Leave", id="measure.leave"),
    ]

    def __init__(self, guided: GuidedSession, plan: Plan) -> None:
        super().__init__(guided, plan)
        self.view = SessionView(plan.instruments)
        self.lost = LostIndicators(guided.gauges)
        self._shown_at = 0.0
        self._sleep = SleepWatch()

    def compose(self) -> ComposeResult:
        yield self.view
        yield KeyLine()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """G is for a machine that a controller moves, and takes by itself there; A for the rest.

        While it may move every key stops it: none is offered for anything else.
        """
        mover = self.guided.mover
        if mover is not None and mover.line.may_move and action != "plot":
            return False
        return {"go": mover is not None, "automatic": mover is None}.get(action, True)

    def on_mount(self) -> None:
        # Collections pass over all that is loaded by now. `make bench`, event loop blocked while
        # taking steps: 130 to 420 ms in three runs without, 50 to 100 with (limit 100).
        gc.freeze()
        self.proceed()
        self._follow()
        self.set_interval(AGES_S, self._look)
        self.set_interval(ATTEND_S, self._watch)

    def _watch(self) -> None:
        with self.writing():
            self.attended.watch()

    @work
    async def _follow(self) -> None:
        async for _ in self.attended.news():
            self._show_live()

    def _look(self) -> None:
        if slept_s := self._sleep.slept_s():
            self._set_hold(True, f"the computer slept for {slept_s:.0f} s")
            self.say(texts.slept_text(slept_s))
        if not self.busy:  # a take holds the record, and looks itself
            with self.writing():
                if jump_s := self.guided.look_at_clock():
                    self.say(texts.clock_set_text(jump_s))
        if self.lost.is_due():
            self._look_at_lost()
        if time.monotonic() - self._shown_at > AGES_S / 2:  # else news has just shown the ages
            self._show_live()

    def on_resize(self) -> None:
        self._show_step()

    def proceed(self) -> None:
        following = self.guided.step()
        if following is not None:
            self.guided.go()
        self._show_step()
        if following is None:
            self._begin_finish()

    def _show_step(self) -> None:
        session, steps = self.guided.session, self.guided.steps
        place = session, steps, self.guided.step()
        progress = texts.progress_text(session, steps, self.attended.mode)
        self.view.show(progress, *place, self.attended.taken_by)
        self._draw_live()  # in the same picture: a step takes long to draw, readings must not wait

    def _draw_live(self) -> Sequence[Live]:
        states = self.attended.live(busy=self.busy)
        if not isinstance(self.app.screen, LegReviewScreen):  # it lies over the digits
            self.view.gauges.show(states)
        return states

    def _show_live(self) -> None:
        if is_left(self):  # news come while the screen is being closed, too
            return
        self._shown_at = time.monotonic()
        states = self._draw_live()
        asks = self._tell_motion()
        pressed = [gauge.button_pressed() for gauge in self.guided.gauges]
        waits = asks or self.asking or self.busy or self.attended.on_hold
        if waits or not self.guided.there:
            return
        if self.attended.settled(states):
            self.say(texts.SETTLED)
        step = self.guided.step()
        if any(pressed):
            self.action_take()
        elif (moved := self.attended.by_itself(states)) is Movement.CONFIRMED:
            self._begin_take()
        elif moved and step:
            self._show_step()  # who takes it has changed
            self.say(texts.automatic_waits_text(moved, step, self.guided.session))

    @work
    async def _look_at_lost(self) -> None:
        """One line when an indicator goes, comes back, or is at another port.

        On hold where another adapter answers: the names of two may be exchanged.
        """
        for news in await apart(self, self.lost.look):
            name = self.guided.name_of(news.number)
            if news.fault:
                self.attended.waits_for_press()
            if news.adapters:
                adapter_before, now = news.adapters
                self._set_hold(True, f"{name}: adapter {now or 'unknown'}, before {adapter_before}")
                self.say(questions.other_adapter_text(name, adapter_before, now))
            else:
                self.say(questions.lost_text(name, news, alone=not self._faults()))

    @once("port")
    async def action_port(self) -> None:
        """The first indicator that is lost is read at another port from here on."""
        if self.busy or self.asking:
            return
        if at := await self.correcting.port(self.lost):
            instruments = self.view.rename(*at)
            self._show_step()
            await apart(self, propose_again, self.plan.machine, instruments)
            self.say(f"{with_capital(self.guided.name_of(at[0]))} is read from here on.")

    def _tell_motion(self) -> bool:
        """One line when a machine that moves itself does something else; a stop is a hold.

        Whether something is asked now.
        """
        mover, step = self.guided.mover, self.guided.step()
        if not self.attended.motion_changed() or mover is None or step is None:
            return False
        self.refresh_bindings()
        self.say(motion.moving_text(mover, step))
        if mover.state is State.STOPPED or mover.interrupted:
            self._set_hold(True, f"the machine stopped: {mover.why}")
        if mover.interrupted:
            self._ask_what_happened(mover)
        elif mover.unproved and mover.unproved.question:
            self.converse(self.correcting.proof)
        else:
            return False
        return True

    @work
    async def _ask_what_happened(self, mover: Mover) -> None:
        if not any(isinstance(screen, MotionDialog) for screen in self.app.screen_stack):
            await self.ask(MotionDialog(mover), over=True)
            self._show_step()

    def action_take(self) -> None:
        """Read the indicators for the present step; twice to take readings that still move."""
        press = self.attended.press(busy=self.busy)
        mover, step = self.guided.mover, self.guided.step()
        if press is Press.TAKES:
            self._begin_take()
        elif press is Press.ENDS:
            self._begin_finish()
        elif press is Press.NOT_THERE and mover is not None and step is not None:
            self.say(motion.moving_text(mover, step))
        elif press in texts.PRESSED:
            self.say(texts.PRESSED[press])

    def _begin_take(self) -> None:
        if not self.busy:
            self.busy = True
            self.attended.waits_for_press()
            self._take()

    @work
    async def _take(self) -> None:
        with self.writing():
            step_taken = await apart(self, self.guided.take)
            self.busy = False
            if step_taken is not None and step_taken.faults:
                self.refused(texts.not_taken_text(step_taken.faults))
            elif step_taken is not None:
                self.app.bell()
                self.say(texts.taken_text(step_taken))
                await (self._question if step_taken.doubt else self._go_on)(step_taken)

    async def _question(self, step_taken: TakenStep) -> None:
        self.attended.by_hand()
        self._show_step()
        question = questions.question_text(step_taken, self.guided.session)
        choices = questions.question_choices(step_taken)
        dialog = ChoiceDialog(question, choices, leaving=questions.NOT_KEPT)
        answer = await self.ask(dialog, over=True) or ""
        reason = questions.answer_reason(answer, step_taken)
        # steps that are measured again for a new zero
        unsure = self.guided.answer(answer, step_taken, reason)
        self.say(questions.answered_text(answer, step_taken, unsure))
        if answer == "keep":
            await self._go_on(step_taken)
        elif answer == "read":  # without moving: what is stable stays so
            self._show_step()
        else:
            self.proceed()

    async def _go_on(self, step_taken: TakenStep) -> None:
        """Go to the next step; after the last one of a leg its review comes between."""
        following, step = self.guided.step(), step_taken.step
        if following is None or self.guided.session.is_new_place(following):
            unattended = self.attended.automatic and self.plan.simulated
            rests_mm = [self.guided.gauges[k].rest_mm for k in step.indicators]
            review = LegReviewScreen(self.guided.session, step, rests_mm, unattended=unattended)
            if await self.ask(review, over=True) and not self.attended.on_hold:
                self.action_hold()
        self.proceed()

    def refused(self, text: str) -> None:
        self.attended.by_hand()
        super().refused(text)
        self._show_step()

    def say(self, text: str, *, wrong: bool = False) -> None:
        goes_on = "{measure.hold}" if self.guided.mover is None else "{measure.go}"
        line = "\n".join(dict.fromkeys([text, *self._faults()]))
        self.view.say(self.app.keyed(line.replace("{goes_on}", goes_on)))

    def _faults(self) -> list[str]:
        """Faults of the step that last: no line hides them."""
        step = self.guided.step()
        faults = self.lost.faults(step.indicators if step else ())
        return [questions.lost_text(self.guided.name_of(f.number), f) for f in faults]

    def action_automatic(self) -> None:
        self.attended.take_by_itself(not self.attended.automatic)
        self._show_step()

    def action_hold(self) -> None:
        """Nothing is taken until the same key again; a machine that moves itself needs G."""
        on_hold = self.attended.on_hold
        if not on_hold or self.guided.mover is None:
            self._set_hold(not on_hold, "continued" if on_hold else "on hold")
        self.say(texts.ON_HOLD if self.attended.on_hold else texts.CONTINUED)

    def _set_hold(self, on_hold: bool, note: str) -> None:
        with self.writing():
            self.attended.hold(on_hold, note)
            self._show_step()

    def action_go(self) -> None:
        """The operator's consent to the next way of the machine; no other key moves it."""
        mover, step = self.guided.mover, self.guided.step()
        if mover is None or step is None or self.busy or self.asking:
            return
        if mover.interrupted:
            self._ask_what_happened(mover)
        elif mover.line.needs_homing_confirmed:
            self.converse(self.correcting.homing)
        elif mover.unproved and mover.unproved.question:
            self.converse(self.correcting.proof)
        elif fault_words := lost_words(self.guided):  # it would be stopped as soon as it moves
            self.say(f"FAULT: {sentence(fault_words)}")
        elif mover.consent():
            self.attended.on_hold = False
            self.attended.take_by_itself(True)
            self._show_step()
        else:
            self.say(motion.no_consent_text(mover))

    def _begin_finish(self) -> None:
        if self.plan.reference and not self.guided.closed:
            self.app.go_to(screen_of("align.AlignScreen", self.guided, self.plan))
        elif not self.busy:
            self.busy = True
            self.say(texts.COMPUTING)
            self.finish()
