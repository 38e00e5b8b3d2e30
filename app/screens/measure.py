"""Measuring: what to do now, what the indicators show, what has been taken."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Horizontal
from textual.events import Resize
from textual.geometry import Size
from textual.screen import Screen
from textual.widgets import Footer, Static

from app.acquisition import Live, Motion
from app.guided import GuidedSession, Taken
from app.leg_table import leg_rows
from app.opening import Plan
from app.screens.dialogs import HelpDialog, NoteDialog
from app.screens.interface import Interface
from app.screens.widgets import GaugeDisplay, StepList
from app.solving import solve_for_controller
from app.wording.session import MEASURE_HELP, leg_table_text, progress_text, step_text, taken_text
from calib.errors import GlidecalError
from drivers.outcome import Fault, Reading
from protocols.procedure import Step

REFRESH_S = 0.1
LEAST_SIZE = Size(80, 24)
HELD_KEY_S = 0.15
"""Presses that follow this closely are one held key."""

ANYWAY_S = 4.0
"""How long a second press takes readings that still move."""


class MeasureScreen(Screen[None]):
    """One step after the other; Space takes it."""

    app: Interface
    BINDINGS: ClassVar[list[BindingType]] = [
        ("space", "take", "Take"),
        ("enter", "take", ""),
        ("u", "undo", "Repeat"),
        ("a", "automatic", "Auto"),
        ("m", "remount", "Re-mount"),
        ("n", "note", "Note"),
        ("f1", "help", "Help"),
        ("f10", "app.quit", "Pause"),
    ]

    def __init__(self, guided: GuidedSession, plan: Plan) -> None:
        super().__init__()
        self.guided = guided
        self.plan = plan
        self.automatic = False
        self.busy = False
        self._lost: set[int] = set()
        self._pressed_at = self._anyway_until = 0.0

    def compose(self) -> ComposeResult:
        yield Static("", id="progress", markup=False)
        yield Static("", id="step", markup=False)
        with Horizontal(id="upper"):
            for number in range(len(self.guided.gauges)):
                yield GaugeDisplay("", f"gauge{number}")
            yield StepList()
        yield Static("", id="said", markup=False)
        yield Static("", id="table", markup=False)
        yield Footer(show_command_palette=False)

    def on_mount(self) -> None:
        self._next()
        self.set_interval(REFRESH_S, self._show_live)

    def on_resize(self, event: Resize) -> None:
        self._show_step()
        if event.size.width < LEAST_SIZE.width or event.size.height < LEAST_SIZE.height:
            self._say(f"This screen needs {LEAST_SIZE.width} × {LEAST_SIZE.height} characters.")

    def _next(self) -> None:
        """Go to the present step, or finish when there is none."""
        if self.guided.step() is None:
            self._finish()
        else:
            self.guided.go()
            self._show_step()

    def _show_step(self) -> None:
        step = self.guided.step()
        session = self.guided.session
        geometry = session.opened.machine.geometry()
        text = progress_text(session, self.guided.steps, automatic=self.automatic)
        self.query_one("#progress", Static).update(text)
        self.query_one(StepList).show(self.guided.steps, step, session.done(), geometry)
        if step is None:
            return
        self.query_one("#step", Static).update(step_text(step, geometry, session))
        self.query_one("#table", Static).update(leg_table_text(leg_rows(session, step), geometry))
        for display, axis in zip(self.query(GaugeDisplay), step.axes, strict=False):
            display.border_title = f"along {axis.upper()}, mm"

    def _show_live(self) -> None:
        states = [gauge.live() for gauge in self.guided.gauges]
        for display, live in zip(self.query(GaugeDisplay), states, strict=True):
            display.show(live)
        self._tell_lost_and_found(states)
        pressed = [gauge.button_pressed() for gauge in self.guided.gauges]
        if any(pressed):
            self.action_take()
        elif self.automatic and self._ready(states):
            self._begin_take()

    def _tell_lost_and_found(self, states: Sequence[Live]) -> None:
        """One line when an indicator goes and when it comes back."""
        for number, live in enumerate(states):
            lost = isinstance(live.outcome, Fault)
            if lost and number not in self._lost:
                self._lost.add(number)
                words = live.outcome.words if isinstance(live.outcome, Fault) else ""
                self._say(f"Indicator {number + 1}: {words}. The session waits.")
            elif isinstance(live.outcome, Reading) and number in self._lost:
                self._lost.remove(number)
                self._say(f"Indicator {number + 1} answers again; go on with this step.")

    def _ready(self, states: Sequence[Live]) -> bool:
        """All stand still; with a real machine something must have moved before."""
        moved = self.plan.simulated or any(gauge.has_moved() for gauge in self.guided.gauges)
        return moved and all(live.motion is Motion.STABLE for live in states)

    def action_take(self) -> None:
        """Read the indicators for the present step; twice to take readings that still move."""
        now = time.monotonic()
        held, self._pressed_at = now - self._pressed_at < HELD_KEY_S, now
        if held or self.busy:
            return
        if self.guided.step() is None:
            self._finish()
        elif now < self._anyway_until or self.ready_by_hand():
            self._begin_take()
        else:
            self._anyway_until = now + ANYWAY_S
            self._say("The readings still move. Wait, or press Space again to take them anyway.")

    def ready_by_hand(self) -> bool:
        """Whether a single press takes: nothing moves, or there is a fault to be shown."""
        moving = (Motion.MOVING, Motion.WAITING)
        return all(gauge.live().motion not in moving for gauge in self.guided.gauges)

    def _begin_take(self) -> None:
        if not self.busy:
            self.busy, self._anyway_until = True, 0.0
            self._take()

    @work(thread=True)
    def _take(self) -> None:
        try:
            taken = self.guided.take()
        except GlidecalError as problem:
            self.app.call_from_thread(self._refused, str(problem))
        else:
            self.app.call_from_thread(self._taken, taken)

    def _taken(self, taken: Taken | None) -> None:
        self.busy = False
        if taken is None:
            return
        if taken.faults:
            self._refused("Not taken: " + "; ".join(fault.words for fault in taken.faults))
            return
        self.app.bell()
        self.app.clear_notifications()
        self._say(taken_text(taken))
        self._next()

    def _refused(self, text: str) -> None:
        self.busy = self.automatic = False
        self._say(text)
        self._show_step()

    def _say(self, text: str) -> None:
        self.query_one("#said", Static).update(text)

    def _record(self, what: str, step: Step | None = None) -> None:
        self._say(f"{what}: step {step.number} is next" if step else what)
        self._next()

    def action_undo(self) -> None:
        """Measure the last step again; its readings stay in the record, superseded."""
        self.automatic = False
        try:
            step = None if self.busy else self.guided.undo()
        except GlidecalError as problem:
            self._refused(str(problem))
            return
        if step is not None:
            self._record("Superseded, kept in the record", step)

    def action_automatic(self) -> None:
        """Take by itself whenever all indicators stand still."""
        self.automatic = not self.automatic
        self._show_step()

    def action_remount(self) -> None:
        """The stand was moved: later readings have a new zero."""
        if self.busy:
            return
        try:
            self.guided.remount()
        except GlidecalError as problem:
            self._refused(str(problem))
        else:
            self._record("New mounting: readings from here on have a zero of their own")

    def action_note(self) -> None:
        """A remark for the record."""
        resume, self.automatic = self.automatic, False
        self.app.push_screen(NoteDialog(), lambda text: self._noted(text, resume))

    def _noted(self, text: str | None, automatic: bool) -> None:
        self.automatic = automatic
        if text:
            try:
                self.guided.note(text)
            except GlidecalError as problem:
                self._refused(str(problem))
            else:
                self._say(f"Noted: {text}")

    def action_help(self) -> None:
        """What the keys do."""
        self.app.push_screen(HelpDialog(MEASURE_HELP))

    @work(thread=True)
    def _finish(self) -> None:
        """Close the record and show the result."""
        from app.screens.result import ResultScreen

        try:
            self.guided.finish()
            solved = solve_for_controller(self.guided.path)
        except GlidecalError as problem:
            said = f"Every reading is on the disk, but: {problem} Space tries again, F10 leaves."
            self.app.call_from_thread(self._refused, said)
            return
        self.app.guided = None
        result = ResultScreen(solved, self.plan, self.guided.path)
        self.app.call_from_thread(self.app.go_to, result)
