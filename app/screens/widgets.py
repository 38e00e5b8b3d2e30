"""Small pieces of the screens: one indicator, the list of steps."""

from __future__ import annotations

from collections.abc import Sequence

from textual.app import ComposeResult
from textual.containers import Vertical
from textual.widgets import Digits, Sparkline, Static

from app.acquisition import Live, Motion
from app.wording.tables import signed
from calib.orthoglide.geometry import Geometry
from drivers.outcome import Fault, Reading
from protocols.procedure import Step
from protocols.session import Session

MARKS = {
    Motion.STABLE: "= STABLE",
    Motion.MOVING: "~ MOVING",
    Motion.WAITING: "… WAITING",
    Motion.STALE: "! STALE",
    Motion.FAULT: "! FAULT",
}
TREND_POINTS = 22
TREND_S = 0.3
"""The trend is drawn at most so often: drawing it costs more than the digits."""

OLD_S = 1.0
"""A value is shown with its age from here on."""

WORDS_FIT = 38
"""Columns that a fault's words need; narrower panels name its kind only."""


class GaugeDisplay(Vertical):
    """One indicator: big digits, unit, a word for its state, age, trend."""

    def __init__(self, title: str, gauge_id: str) -> None:
        super().__init__(id=gauge_id, classes="gauge")
        self.border_title = title
        self._shown: tuple[str, str, Motion, tuple[float, ...]] | None = None
        self._trend_waits = False

    def compose(self) -> ComposeResult:
        yield Digits("------")
        yield Static("", classes="state", markup=False)
        yield Sparkline([])

    def show(self, live: Live) -> None:
        """Show what the indicator tells now; nothing is drawn again that did not change."""
        shown = (self._number(live), self._state(live), live.motion, live.trend_mm[-TREND_POINTS:])
        if shown == self._shown:
            return
        number, state, motion, trend = shown
        before = self._shown or ("", "", None, ())
        self._shown = shown
        if number != before[0]:
            self.query_one(Digits).update(number)
        if state != before[1]:
            self.query_one(".state", Static).update(state, layout=False)
        if motion is not before[2]:
            self.set_classes(f"gauge {motion.value}")
        if trend != before[3] and not self._trend_waits:
            self._trend_waits = True
            self.set_timer(TREND_S, self._draw_trend)
        assumed = isinstance(live.outcome, Reading) and live.outcome.unit_assumed
        if assumed != bool(self.border_subtitle):
            self.border_subtitle = "mm assumed" if assumed else ""

    def _draw_trend(self) -> None:
        self._trend_waits = False
        if self._shown is not None:
            self.query_one(Sparkline).data = list(self._shown[3])

    def _number(self, live: Live) -> str:
        if not isinstance(live.outcome, Reading):
            return "------"
        decimals = max(0, len(f"{live.outcome.resolution_mm:.6f}".rstrip("0")) - 2)
        return signed(live.outcome.value_mm, decimals)

    def _state(self, live: Live) -> str:
        state = MARKS[live.motion]
        if isinstance(live.outcome, Fault):
            roomy = self.size.width >= WORDS_FIT
            return f"{state}  {live.outcome.words if roomy else live.outcome.kind}"
        return f"{state}  {live.age_s:.0f} s old" if live.age_s >= OLD_S else state


class StepList(Static):
    """The steps around the present one: + done, - skipped, > now."""

    def __init__(self) -> None:
        super().__init__(id="steps", markup=False)
        self.border_title = "steps"

    def show(
        self, steps: Sequence[Step], now: Step | None, session: Session, geometry: Geometry
    ) -> None:
        """List the steps so that the present one stays in view."""
        done = session.done()
        height = max(self.content_size.height, 5)
        at = (now.number if now else len(steps)) - 1
        first = max(0, min(at - height // 2, len(steps) - height))
        lines = []
        for step in steps[first : first + height]:
            mark = "+" if step.number in done else "-" if step.number in session.skipped else " "
            mark = ">" if now and step.number == now.number else mark
            posture = step.posture(geometry)
            lines.append(f"{mark} {step.number:>3} {step.leg.upper()} {posture} {step.cycle}")
        self.update("\n".join(lines), layout=False)
