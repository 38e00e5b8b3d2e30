"""A session on the screen: where it stands, what to do, what the indicators show."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import lru_cache, partial
from itertools import pairwise
from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.geometry import Region
from textual.renderables.digits import Digits
from textual.renderables.sparkline import Sparkline
from textual.selection import Selection
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import Static

from app.measuring.gauges import Live, Motion
from app.measuring.leg_review import leg_rows
from app.report.charts.charts import readings_by_posture
from app.report.text.session import leg_table_text, step_text
from app.report.text.tables import signed
from app.screens.plot import ChartPlot
from calib.errors import sentence
from calib.tripod.geometry import Geometry
from drivers.profile import Fault, Reading
from protocols.procedure import Step
from protocols.session import Session

MARKS = {
    Motion.STABLE: "= STABLE",
    Motion.MOVING: "~ MOVING",
    Motion.WAITING: "… WAITING",
    Motion.STALE: "! STALE",
    Motion.FAULT: "! FAULT",
}
NO_NUMBER = "------"
DIGIT_ROWS = 3
STATE_ROW, TREND_ROW = 3, 4
"""Rows within the border."""

TREND_S = 0.5
"""The trend is drawn at most so often: drawing it costs more than the digits."""

OLD_S = 1.0
"""A value is shown with its age from here on."""

CHART_S = 0.06
"""The chart is half of a step's picture; it comes later, so that readings need not wait for it."""


@lru_cache(maxsize=64)
def big_digits(number: str) -> tuple[str, ...]:
    """The rows of a number in large digits."""
    pieces = (piece for piece in Digits(number).render(Style()) if isinstance(piece, Segment))
    return tuple(piece.text for piece in pieces if piece.text != "\n")


def decimals_of(resolution_mm: float) -> int:
    """Digits after the point that show a resolution."""
    return max(0, len(f"{resolution_mm:.6f}".rstrip("0")) - 2)


class GaugeDisplay(Widget):
    """One indicator: big digits, unit, a word for its state, age, trend.

    One widget draws it all: widgets within it would cost more than the drawing.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = {"gauge--highest", "gauge--lowest"}

    def __init__(self, title: str, gauge_id: str) -> None:
        super().__init__(id=gauge_id, classes="gauge")
        self.border_title = title
        self.number, self.state = NO_NUMBER, ""
        self.trend_mm: tuple[float, ...] = ()
        self._motion: Motion | None = None
        self._trend_at = 0.0

    def show(self, live: Live) -> None:
        """Show what the indicator tells now; only rows that changed are drawn again."""
        number, state = self._number(live), self._state(live)
        if number != self.number:
            self.number = number
            self._draw_rows(0, DIGIT_ROWS)
        if state != self.state:
            self.state = state
            self._draw_rows(STATE_ROW, 1)
            if Motion.FAULT in (live.motion, self._motion):
                self.refresh()
        if live.motion is not self._motion:
            self._motion = live.motion
            self.set_classes(f"gauge {live.motion.value}")
        trend_mm = live.trend_mm
        if trend_mm != self.trend_mm and time.monotonic() - self._trend_at > TREND_S:
            self._draw_trend(trend_mm)
        assumed = isinstance(live.outcome, Reading) and live.outcome.unit_assumed
        if assumed != bool(self.border_subtitle):
            self.border_subtitle = "mm assumed" if assumed else ""

    def render_line(self, y: int) -> Strip:
        """One row; the look of border and ground comes from the style sheet."""
        ground = self.visual_style.rich_style
        if self._motion is Motion.FAULT:  # its words in the place of digits and trend
            rows = self._state_rows()
            return Strip([Segment(rows[y] if y < len(rows) else "", ground)])
        if y < DIGIT_ROWS:
            row, width = big_digits(self.number)[y], self.size.width
            left = max(0, width - len(row)) // 2
            return Strip([Segment((" " * left + row).ljust(width), ground)])
        if y == STATE_ROW:
            return Strip([Segment(self._state_rows()[0], ground)])
        return self._trend_strip(ground) if y == TREND_ROW else Strip([])

    def get_selection(self, selection: Selection) -> tuple[str, str] | None:
        """The number, for the clipboard."""
        return self.number, "\n"

    def _draw_trend(self, trend_mm: tuple[float, ...]) -> None:
        self.trend_mm, self._trend_at = trend_mm, time.monotonic()
        self._draw_rows(TREND_ROW, 1)

    def _draw_rows(self, first: int, rows: int) -> None:
        self.refresh(Region(0, first, self.size.width, rows))

    def _trend_strip(self, ground: Style) -> Strip:
        _, behind = self.background_colors
        lowest, highest = (
            (behind + self.get_component_styles(name).color).rich_color
            for name in ("gauge--lowest", "gauge--highest")
        )
        width = self.size.width
        bars = min(width, len(self.trend_mm)) or 1
        line = Sparkline(self.trend_mm, width=bars, min_color=lowest, max_color=highest)
        drawn = list(self.app.console.render(line))
        ends = [-(-bar * width // bars) for bar in range(bars + 1)]
        cells = [end - start for start, end in pairwise(ends)]
        return Strip(
            Segment(bar.text * count, ground + bar.style)
            for bar, count in zip(drawn, cells, strict=True)
        )

    def _state_rows(self) -> list[str]:
        """The state in rows, cut between words; never control codes."""
        rows = Content(self.state).wrap(max(1, self.size.width))
        return ["".join(filter(str.isprintable, row.plain)) for row in rows] or [""]

    def _number(self, live: Live) -> str:
        if not isinstance(live.outcome, Reading):
            return NO_NUMBER
        return signed(live.outcome.value_mm, decimals_of(live.outcome.resolution_mm))

    def _state(self, live: Live) -> str:
        state = MARKS[live.motion]
        if isinstance(live.outcome, Fault):
            return f"{state}  {sentence(live.outcome.words)}"
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


class SessionView(Vertical):
    """The same picture whether a session is measured or replayed."""

    def __init__(self, gauge_count: int) -> None:
        super().__init__()
        self._displays = tuple(
            GaugeDisplay(f"indicator {number + 1}", f"gauge{number}")
            for number in range(gauge_count)
        )

    def compose(self) -> ComposeResult:
        yield Static("", id="progress", markup=False)
        with Horizontal(id="upper"):
            yield Static("", id="step", markup=False)
            yield StepList()
        with Horizontal(id="gauges"):
            yield from self._displays
        yield Static("", id="said", markup=False)
        with Horizontal(id="lower"):
            yield Static("", id="table", markup=False)
            yield ChartPlot(plot_id="chart")

    def show_progress(self, text: str) -> None:
        """The line at the top."""
        self.query_one("#progress", Static).update(text, layout=False)

    def show_step(self, session: Session, steps: Sequence[Step], step: Step | None) -> None:
        """The present step, the list around it, the leg so far."""
        geometry = session.opened.machine.geometry()
        self.query_one(StepList).show(steps, step, session, geometry)
        if step is None:
            return
        self.query_one("#step", Static).update(step_text(step, session), layout=False)
        table = leg_table_text(leg_rows(session, step), geometry)
        self.query_one("#table", Static).update(table, layout=False)
        self.set_timer(CHART_S, partial(self._show_chart, session, step))
        for display, axis in zip(self._displays, step.axes, strict=False):
            display.border_title = f"along {axis.upper()}, mm"

    def _show_chart(self, session: Session, step: Step) -> None:
        self.query_one(ChartPlot).show(readings_by_posture(session, step))

    def show_live(self, states: Sequence[Live]) -> None:
        """What the indicators tell now."""
        for display, live in zip(self._displays, states, strict=True):
            display.show(live)

    def say(self, text: str) -> None:
        """What happened last, in one line; only a longer text moves what stands below it."""
        said = self.query_one("#said", Static)
        room = said.content_size.width
        grows = max(len(text), len(str(said.content))) > room or "\n" in text
        said.update(text, layout=grows)

    def toggle_plot(self) -> None:
        """Show the plot in the place of the table, or the table again (narrow terminals)."""
        self.toggle_class("plotted")
