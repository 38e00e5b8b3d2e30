"""Measuring: what to do now, what the indicators show, what has been taken."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType

from app.measuring.doubts import TakenStep
from app.measuring.gauges import Live, Motion
from app.measuring.indicators import remember
from app.measuring.lost import LostIndicators
from app.measuring.moving import Mover
from app.measuring.plan import Plan
from app.measuring.session import GuidedSession
from app.measuring.unattended import lost_words, release_lost
from app.report.text import motion, questions
from app.report.text import session as texts
from app.report.text.session import TakenBy
from app.screens.corrections import Corrections
from app.screens.interface import ChoiceDialog
from app.screens.pages import KeyLine, Resting, apart, is_left
from app.screens.session_view import LegReviewScreen, MotionDialog, SessionView, port_dialog
from calib.errors import GlidecalError
from drivers.motion.states import State
from protocols.clock import SleepWatch
from protocols.expectation import Movement
from protocols.procedure import Step

GATHER_S = 0.015
"""One picture shows all that is heard within so long after the first news."""

IDLE_S = 5.0
IDLE_GATHER_S = 0.09
"""After so long of standing still only a last digit flickers: ten pictures a second are enough.

With GATHER_S alone waiting takes half as much again (`make bench` allows 5 % of a core).
"""

ATTEND_S = 0.05
"""The thread of the controller is told so often that the screens run."""

AGES_S = 0.2
"""Ages and stale indicators are looked at so often."""

HELD_KEY_S = 0.15
"""Presses that follow this closely are one held key."""

ANYWAY_S = 4.0
"""How long a second press takes readings that still move."""


class KeysInForce(KeyLine, Resting):
    """The keys, at the bottom."""


class MeasureScreen(Corrections, Resting):
    """One step after the other; Space takes it."""

    HELP = texts.MEASURE_HELP
    FINISHES, LEAVES = "measure.take", "measure.leave"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space", "take", "Take", id="measure.take"),
        Binding("enter", "take", "Take", show=False, id="measure.take-too"),
        Binding("u", "undo", "Repeat", id="measure.repeat"),
        Binding("b", "earlier", "Back", id="measure.earlier"),
        Binding("s", "skip", "Skip", id="measure.skip"),
        Binding("a", "automatic", "Auto", id="measure.automatic"),
        Binding("p", "hold", "Hold", id="measure.hold"),
        Binding("m", "remount", "Moved", id="measure.remount"),
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
        self.held = False
        self.lost = LostIndicators(guided.gauges)
        self._waits: tuple[int, Movement] | None = None
        self._pressed_at = self._anyway_until = self._moved_at = self._shown_at = 0.0
        self._sleep = SleepWatch()
        self.automatic = guided.mover is not None
        self._moving: tuple[object, ...] | None = None

    def compose(self) -> ComposeResult:
        yield self.view
        yield KeysInForce()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """G is for a machine that a controller moves, and takes by itself there; A for the rest."""
        moves_itself = self.guided.mover is not None
        return {"go": moves_itself, "automatic": not moves_itself}.get(action, True)

    def on_mount(self) -> None:
        # Collections pass over all that is loaded by now. `make bench`, event loop blocked while
        # taking steps: 130 to 420 ms in three runs without, 50 to 100 with (limit 100).
        gc.freeze()
        self.proceed()
        self._follow()
        self.set_interval(AGES_S, self._look)
        self.set_interval(ATTEND_S, self._attend)

    def _attend(self) -> None:
        """Tell the controller's thread that the screens run, and look at the indicators.

        Both stop a machine that nobody watches.
        """
        mover = self.guided.mover
        if mover is None or self.guided.closed:
            return
        mover.alive()
        self.write(self.guided.follow_proof)
        if mover.line.may_move:
            lost_words(self.guided)
            release_lost(self.guided)

    @work
    async def _follow(self) -> None:
        """Show what the indicators tell, in one picture where it comes together."""
        loop, news = asyncio.get_running_loop(), asyncio.Event()

        def tell() -> None:  # called in the thread of an indicator
            if not news.is_set():  # else the picture that is due shows it, too
                with suppress(RuntimeError):  # the loop has ended: nobody looks any more
                    loop.call_soon_threadsafe(news.set)

        for gauge in self.guided.gauges:
            gauge.on_news = tell
        if self.guided.mover is not None:
            self.guided.mover.on_news = tell
        while True:
            await news.wait()
            idle = time.monotonic() - self._moved_at > IDLE_S
            await asyncio.sleep(IDLE_GATHER_S if idle else GATHER_S)
            news.clear()
            self._show_live()

    def _look(self) -> None:
        now = time.monotonic()
        if slept_s := self._sleep.slept_s():
            self._set_hold(True, f"the computer slept for {slept_s:.0f} s")
            self.say(texts.slept_text(slept_s, self._goes_on))
        if not self.busy:  # a take holds the record, and looks itself
            self.write(self._look_at_clock)
        if self.lost.is_due():
            self._look_at_lost()
        if now - self._shown_at > AGES_S / 2:  # else news has just shown the ages
            self._show_live()

    def _look_at_clock(self) -> None:
        if jump_s := self.guided.look_at_clock():
            self.say(texts.clock_set_text(jump_s))

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
        session = self.guided.session
        mode = "ON HOLD" if self.held else "automatic" if self.automatic else "by hand"
        self.view.show_progress(texts.progress_text(session, self.guided.steps, mode))
        by_hand = TakenBy.INDICATORS if self.automatic else TakenBy.HAND
        by = TakenBy.CONTROLLER if self.guided.mover is not None else by_hand
        self.view.show_step(session, self.guided.steps, self.guided.step(), by)
        self._draw_live()  # in the same picture: a step takes long to draw, readings must not wait

    def _draw_live(self) -> Sequence[Live]:
        states = [gauge.live() for gauge in self.guided.gauges]
        if self.busy or any(live.motion is not Motion.STABLE for live in states):
            self._moved_at = time.monotonic()
        if not isinstance(self.app.screen, LegReviewScreen):  # it lies over the digits
            self.view.show_live(states)
        return states

    def _show_live(self) -> None:
        if is_left(self):  # news come while the screen is being closed, too
            return
        self._shown_at = time.monotonic()
        states = self._draw_live()
        asks = self._tell_motion()
        pressed = [gauge.button_pressed() for gauge in self.guided.gauges]
        if asks or self.asking or self.held or self.busy or not self.guided.there:
            return
        still = all(live.motion is Motion.STABLE for live in states)  # a fault is none
        if self._anyway_until and still and self.ready_by_hand():
            self._anyway_until = 0.0
            self.say("The readings are stable now: {measure.take} takes them.")
        if any(pressed):
            self.action_take()
        elif self.automatic and all(live.motion is Motion.STABLE for live in self._of_step(states)):
            self._take_if_moved()

    def _of_step(self, states: Sequence[Live]) -> Sequence[Live]:
        step = self.guided.step()
        return [states[k] for k in step.indicators] if step else states

    @work
    async def _look_at_lost(self) -> None:
        """One line when an indicator goes, comes back, or is at another port.

        On hold where another adapter answers: the names of two may be exchanged.
        """
        for news in await apart(self, self.lost.look):
            name = self.guided.name_of(news.number)
            if news.fault:
                self._anyway_until = 0.0
            if news.adapters:
                before, now = news.adapters
                self._set_hold(True, f"{name}: adapter {now or 'unknown'}, before {before}")
                self.say(questions.other_adapter_text(name, before, now))
            else:
                self.say(questions.lost_text(name, news))

    @work
    async def action_port(self) -> None:
        """The first indicator that is lost is read at another port from here on."""
        if self.busy or self.asking:
            return
        if not self.lost.ports:
            self.say(questions.NO_PORT_LOST)
            return
        number, gauges = min(self.lost.ports), self.guided.gauges
        name, used = self.guided.name_of(number), [gauge.port for gauge in gauges]
        dialog = port_dialog(name, gauges[number].adapter, used)
        if dialog is None:
            self.say(questions.NO_OTHER_PORT)
        elif (port := await self.ask(dialog)) is not None:
            try:
                await apart(self, self.guided.go_on_at, number, port)
            except GlidecalError as problem:
                self.say(f"FAULT: {problem}")
                return
            instruments = self.view.rename(number, port)
            self._show_step()
            with suppress(GlidecalError):  # a proposal for the next time
                await apart(self, remember, self.plan.machine.name, instruments)
            self.say(f"{self.guided.name_of(number).capitalize()} is read from here on.")

    def _tell_motion(self) -> bool:
        """One line when a machine that moves itself does something else; a stop is a hold.

        Whether something is asked now.
        """
        mover = self.guided.mover
        step = self.guided.step() if mover is not None else None
        if mover is None or step is None or self.guided.closed:  # leaving stops it, too
            return False
        asks, wrong = (proof.question, proof.wrong) if (proof := mover.unproved) else ("", "")
        there = mover.is_there(step)
        news = mover.state, mover.why, there, mover.line.not_stopped, mover.proving, asks, wrong
        if news == self._moving:
            return False
        self._moving = news
        self.say(motion.moving_text(mover, step))
        if mover.state is State.STOPPED or mover.interrupted:
            self._set_hold(True, f"the machine stopped: {mover.why}")
        if mover.interrupted:
            self._ask_what_happened(mover)
        elif asks:
            self._ask_what_moved(asks)
        return mover.interrupted or bool(asks)

    @work
    async def _ask_what_moved(self, question: str) -> None:
        answer = await self.ask(ChoiceDialog(question, motion.SAW_CHOICES))
        if answer is not None:
            self.write(partial(self.guided.answer_proof, yes=answer == "yes"))

    @work
    async def _ask_what_happened(self, mover: Mover) -> None:
        if not any(isinstance(screen, MotionDialog) for screen in self.app.screen_stack):
            await self.ask(MotionDialog(mover), over=True)
            self._show_step()

    def _take_if_moved(self) -> None:
        """Take what stands still where it tells of a move; else say once why not."""
        step, moved = self.guided.step(), self.guided.moved()
        if moved is Movement.SEEN or step is None:
            self._begin_take()
        elif (step.number, moved) != self._waits:
            self._waits = step.number, moved
            self.say(texts.automatic_waits_text(moved, step, self.guided.session))

    def action_take(self) -> None:
        """Read the indicators for the present step; twice to take readings that still move."""
        now = time.monotonic()
        is_held, self._pressed_at = now - self._pressed_at < HELD_KEY_S, now
        if is_held or self.busy:
            return
        mover, step = self.guided.mover, self.guided.step()
        if self.held:
            self.say(f"WAIT: on hold, nothing is taken. Press {{{self._goes_on}}} to continue.")
        elif mover is not None and step is not None and not mover.is_there(step):
            self.say(motion.moving_text(mover, step))
        elif step is None:
            self._begin_finish()
        elif now < self._anyway_until or self.ready_by_hand():
            self._begin_take()
        else:
            self._anyway_until = now + ANYWAY_S
            self.say("WAIT: the readings move. Press {measure.take} again to take them anyway.")

    def ready_by_hand(self) -> bool:
        """Whether a single press takes: nothing moves, or there is a fault to be shown."""
        moving = (Motion.MOVING, Motion.WAITING)
        states = [gauge.live() for gauge in self.guided.gauges]
        return all(live.motion not in moving for live in self._of_step(states))

    def _begin_take(self) -> None:
        if not self.busy:
            self.busy, self._anyway_until = True, 0.0
            self._take()

    @work
    async def _take(self) -> None:
        try:
            step_taken = await apart(self, self.guided.take)
        except GlidecalError as problem:
            self.refused(str(problem))
            return
        self.busy = False
        if step_taken is None:
            return
        if step_taken.faults:
            self.refused(texts.not_taken_text(step_taken.faults))
            return
        self.app.bell()
        self.say(texts.taken_text(step_taken))
        if step_taken.doubt:
            self._by_hand()
            self._show_step()
            question = questions.question_text(step_taken, self.guided.session)
            choices = questions.question_choices(step_taken)
            dialog = ChoiceDialog(question, choices, leaving=questions.NOT_KEPT)
            answer = await self.ask(dialog, over=True)
            await self._answered(answer or "", step_taken)
        else:
            await self._go_on(step_taken.step)

    async def _answered(self, answer: str, step_taken: TakenStep) -> None:
        reason = questions.answer_reason(answer, step_taken)
        unsure: list[int] = []  # steps that are measured again for a new zero
        if not self.write(lambda: unsure.extend(self.guided.answer(answer, step_taken, reason))):
            return
        self.say(questions.answered_text(answer, step_taken, unsure))
        if answer == "keep":
            await self._go_on(step_taken.step)
        elif answer == "read":  # without moving: what is stable stays so
            self._show_step()
        else:
            self.proceed()

    async def _go_on(self, step: Step) -> None:
        """To the next step; after the last one of a leg its review comes between."""
        following = self.guided.step()
        if following is None or self.guided.session.is_new_place(following):
            unattended = self.automatic and self.plan.simulated
            rests_mm = [self.guided.gauges[k].rest_mm for k in step.indicators]
            review = LegReviewScreen(self.guided.session, step, rests_mm, unattended=unattended)
            if await self.ask(review, over=True) and not self.held:
                self.action_hold()
        self.proceed()

    def refused(self, text: str) -> None:
        self._by_hand()
        super().refused(text)
        self._show_step()

    def say(self, text: str, *, wrong: bool = False) -> None:
        self.view.say(self.app.keyed(text))

    @property
    def _goes_on(self) -> str:
        """The id of the key that ends a hold."""
        return "measure.hold" if self.guided.mover is None else "measure.go"

    def _by_hand(self) -> None:
        """Nothing is taken, and nothing moves, without a key."""
        self.automatic = False
        if self.guided.mover is not None:
            self.guided.mover.release()

    def action_automatic(self) -> None:
        """Take by itself whenever all indicators stand still."""
        self.automatic, self._waits = not self.automatic, None
        self._show_step()

    def action_hold(self) -> None:
        """Nothing is taken until the same key again; a machine that moves itself needs G."""
        if self.held and self.guided.mover is not None:
            self.say("On hold. Press {measure.go} to continue.")
            return
        self._set_hold(not self.held, "on hold" if not self.held else "continued")
        again = f"On hold. Press {{{self._goes_on}}} to continue."
        self.say(again if self.held else "The session continues.")

    def _set_hold(self, held: bool, note: str) -> None:
        if held and self.guided.mover is not None:
            self.guided.mover.release()
        if self.write(partial(self.guided.note, note)):
            self.held = held
            self._show_step()

    def action_go(self) -> None:
        """The operator's consent to the next way of the machine; no other key moves it."""
        mover, step = self.guided.mover, self.guided.step()
        if mover is None or step is None or self.busy or self.asking:
            return
        if mover.interrupted:
            self._ask_what_happened(mover)
        elif mover.line.needs_homing_confirmed:
            self._ask_whether_homed(mover)
        elif mover.unproved and mover.unproved.question:
            self._ask_what_moved(mover.unproved.question)
        elif mover.consent():
            self.held, self.automatic, self._waits = False, True, None
            self._show_step()
        else:
            self.say(motion.no_consent_text(mover))

    @work
    async def _ask_whether_homed(self, mover: Mover) -> None:
        answer = await self.ask(ChoiceDialog(motion.HOMED_QUESTION, motion.HOMED_CHOICES))
        if answer == "homed":
            mover.confirm_homed()
        elif answer == "home":
            mover.home()
        self.write(partial(self.guided.note, f"homing: {answer or 'not answered'}"))

    def action_plot(self) -> None:
        self.view.turn_page()

    @work
    async def action_where(self) -> None:
        picture = self.view.where(self.guided.session, self.guided.step())
        if picture:
            await self.ask(picture)

    def _begin_finish(self) -> None:
        if self.plan.reference and not self.guided.closed:
            from app.screens.align import AlignScreen

            self.app.go_to(AlignScreen(self.guided, self.plan))
        elif not self.busy:
            self.busy = True
            self.say("Every reading is on the disk. Computing the result …")
            self.finish()
