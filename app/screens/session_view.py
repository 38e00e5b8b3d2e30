"""A session on the screen: where it stands, what the indicators show, dialogs over that."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from itertools import zip_longest
from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.geometry import Region
from textual.renderables.digits import Digits
from textual.selection import Selection
from textual.strip import Strip
from textual.widgets import Static

from app.measuring.attended import TakenBy
from app.measuring.gauges import Live, Motion
from app.measuring.moving import Mover
from app.report.charts.digits import large_digits
from app.report.charts.results import readings_by_posture
from app.report.charts.strips import strip_rows
from app.report.charts.tripod import drawn_set_up
from app.report.text import motion
from app.report.text import session as texts
from app.report.text.help import help_of
from app.report.text.indicator import NO_NUMBER, panel_title, port_words, shown_number, state_words
from app.report.text.leg_review import leg_review_text
from app.screens.interface import WIDE, Dialog, Glidecal, MainScreen
from app.screens.pages import Resting, signalled
from app.screens.plot import ChartPlot
from drivers.motion.line import DEAD_S
from protocols.machine import Instrument
from protocols.procedure import Step
from protocols.session import Session

LEAST_STRIP_ROWS = 1
"""Digits are large where so many rows of the strip chart are left."""

STRIP_S, RESTING_STRIP_S = 1.0, 2.0
"""The strip chart is drawn at most so often, while the reading moves and while it rests: drawing
it costs more than the digits."""


@lru_cache(maxsize=64)
def big_digits(number: str) -> tuple[str, ...]:
    """The rows of a number in big digits; one that flickers comes back to the same few."""
    pieces = Digits(number).render(Style())
    return tuple("".join(p.text for p in pieces if isinstance(p, Segment)).splitlines())


class GaugeDisplay(Resting):
    """One indicator: big digits, unit, a word for its state, age, strip chart.

    One widget draws it all: widgets within it would cost more than the drawing.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = {"gauge--strip"}

    def __init__(self, number: int, instrument: Instrument | None) -> None:
        super().__init__(id=f"gauge{number}", classes="gauge")
        self._index = number
        self.name_it(instrument)
        self.number, self.rows, self.digits = NO_NUMBER, list[str](), big_digits(NO_NUMBER)
        self._live: Live | None = None
        self.strip: tuple[str, ...] = ()
        self._strip_at = 0.0

    def name_it(self, instrument: Instrument | None, axis: str = "") -> None:
        """Number, profile and port of the indicator, and along which axis it measures now.

        A table of readings does not tell which indicator it was.
        """
        self.border_title = Content(panel_title(self._index, instrument, axis))
        self._port = instrument.port if instrument else ""
        self.border_subtitle = Content(self._port)

    def on_resize(self) -> None:
        self._strip_at = 0.0
        if self._live is not None:
            self.rows = self._drawn(self._live)
        self.refresh()

    def show(self, live: Live) -> None:
        """Show what the indicator tells now; only rows that changed are drawn again."""
        live_before, self._live = self._live, live
        rows_before, self.rows = self.rows, self._drawn(live)
        motions = {live.motion, live_before.motion if live_before else None}
        if len(motions) > 1:
            self.set_classes(f"gauge {live.motion.value}")
        if len(motions) > 1 and Motion.FAULT in motions:
            self.refresh()
        else:
            pairs = enumerate(zip_longest(rows_before, self.rows))
            if changed := [y for y, (row_before, row) in pairs if row_before != row]:
                self.refresh(Region(0, 0, self.size.width, 1 + changed[-1]))
        if (port := port_words(self._port, live)) != str(self.border_subtitle):
            self.border_subtitle = Content(port)

    def _drawn(self, live: Live) -> list[str]:
        """Digits, state and strip chart; of a fault its words alone, cut between them."""
        self.number, (width, height) = shown_number(live), self.size
        if live.motion is Motion.FAULT:
            return [row.plain for row in Content(state_words(live)).wrap(max(1, width))]
        large = large_digits(self.number)
        fits = height > len(large) + LEAST_STRIP_ROWS and len(large[0]) <= width
        self.digits = large if fits else big_digits(self.number)
        indent = " " * (max(0, width - len(self.digits[0])) // 2)
        pace_s = RESTING_STRIP_S if live.motion is Motion.STABLE else STRIP_S
        strip_height = max(0, height - len(self.digits) - 1)  # another one below other digits
        if time.monotonic() - self._strip_at > pace_s or len(self.strip) != strip_height:
            self._strip_at = time.monotonic()
            self.strip = strip_rows(live.trace(), width, strip_height)
        digits = (f"{indent}{row}".ljust(width) for row in self.digits)
        return [*digits, state_words(live), *self.strip]

    def render_line(self, y: int) -> Strip:
        """One row; the look of border and ground comes from the style sheet. No control codes."""
        is_chart = y > len(self.digits) and self._live and self._live.motion is not Motion.FAULT
        ground = self.visual_style.rich_style
        style = self.get_component_rich_style("gauge--strip") if is_chart else ground
        row = "".join(filter(str.isprintable, self.rows[y])) if y < len(self.rows) else ""
        return Strip([Segment(row, style)])

    def get_selection(self, selection: Selection) -> tuple[str, str] | None:
        return self.number, "\n"


class SideBySide(Horizontal, Resting):
    """Widgets side by side."""


class Gauges(SideBySide):
    """The indicators side by side."""

    def __init__(self, instruments: Sequence[Instrument | None]) -> None:
        self._displays = [GaugeDisplay(k, instrument) for k, instrument in enumerate(instruments)]
        super().__init__(*self._displays, id="gauges")

    def show(self, states: Sequence[Live]) -> None:
        for display, live in zip(self._displays, states, strict=True):
            display.show(live)

    def name_them(self, instruments: Sequence[Instrument | None], step: Step | None = None) -> None:
        axes = dict(zip(step.indicators, step.axes, strict=True)) if step else {}
        for number, display in enumerate(self._displays):
            display.name_it(instruments[number], axes.get(number, ""))


class Words(Static, Resting):
    """Lines of text, as many as there is room for."""

    _of_rows: Callable[[int], str] | None = None

    def fill(self, text_of_rows: Callable[[int], str]) -> None:
        """Fill in what this gives for so many rows, now and whenever there are more or fewer."""
        self._of_rows = text_of_rows
        self.on_resize()

    def on_resize(self) -> None:
        if self._of_rows is not None:
            self.update(self._of_rows(self.content_size.height), layout=False)


class SessionView(Vertical, Resting):
    """The picture of a session, whether it is measured or replayed."""

    app: Glidecal
    _now: tuple[Session, Step] | None = None

    def __init__(self, instruments: Sequence[Instrument | None]) -> None:
        super().__init__()
        self._instruments = tuple(instruments)
        self.gauges = Gauges(self._instruments)

    def compose(self) -> ComposeResult:
        yield Words("", id="progress", markup=False)
        yield Words("", id="step", markup=False)
        yield Words("", id="steps", markup=False)
        yield self.gauges
        yield Words("", id="said", markup=False)
        with SideBySide(id="lower"):
            yield Words("", id="table", markup=False)
            yield ChartPlot(plot_id="chart")

    def on_mount(self) -> None:
        self.query_one("#steps").border_title = "steps"

    def show(
        self, progress: str, session: Session, steps: Sequence[Step], step: Step | None, by: TakenBy
    ) -> None:
        """A line on all, the present step and who takes it, the list around it, the leg so far."""
        self.query_one("#progress", Words).update(progress, layout=False)
        self.query_one("#steps", Words).fill(partial(texts.steps_text, session, steps, step))
        self._now = (session, step) if step else None
        if step is None:
            return
        text = self.app.keyed(texts.step_text(step, session, by))
        self.query_one("#step", Words).update(text, layout=False)
        self.query_one("#table", Words).fill(partial(texts.so_far_text, session, steps, step))
        # the chart is half of a step's picture; it comes later, so that readings need not wait for
        # it
        self.set_timer(0.06, partial(self._show_chart, session, step))
        self.gauges.name_them(self._instruments, step)

    def _show_chart(self, session: Session, step: Step) -> None:
        """The readings of the leg; the picture of the set-up while there are none to show."""
        chart = readings_by_posture(session, step)
        self.query_one(ChartPlot).show(
            chart if chart.series else drawn_set_up(session, step, self._instruments) or chart
        )

    def where(self) -> SetUpScreen | None:
        """The set-up of the step as a picture with words; None where no leg is read."""
        if self._now is None or self._now[1].leg == "tool":
            return None
        return SetUpScreen(*self._now, self._instruments)

    def rename(self, number: int, port: str) -> tuple[Instrument, ...]:
        """An indicator is at another port now. Returns all of them."""
        names = list(self._instruments)
        names[number] = (name := names[number]) and name.model_copy(update={"port": port})
        self._instruments = tuple(names)
        self.gauges.name_them(self._instruments)
        return tuple(filter(None, self._instruments))

    def say(self, text: str) -> None:
        """What happened last, in one line; only a longer text moves what stands below it."""
        line = self.query_one("#said", Static)
        room = line.content_size.width
        grows = max(len(text), len(str(line.content))) > room or "\n" in text
        line.update(signalled(text), layout=grows)


class SessionScreen(MainScreen[None]):
    """A screen with the picture of a session."""

    view: SessionView

    def action_plot(self) -> None:
        """Below the panels the table, then the plot, then larger strip charts in their place.

        Where plot and table stand side by side they are one page.
        """
        view = self.view
        if view.has_class("stripped"):
            view.remove_class("stripped")
        elif view.has_class("plotted") or self.has_class("wide"):
            view.set_class(True, "stripped").remove_class("plotted")
        else:
            view.add_class("plotted")

    @work
    async def action_where(self) -> None:
        if picture := self.view.where():
            await self.ask(picture)


class SetUpScreen(Dialog[None]):
    """Where the indicators of a step stand: words and picture, as large as the terminal."""

    HELP = "Thick: the bar that is touched, x: where. Dots: each spindle, up to its body."
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,w,enter,space", "dismiss(None)", "Back", id="set-up.back")
    ]

    def __init__(
        self, session: Session, step: Step, instruments: Sequence[Instrument | None]
    ) -> None:
        super().__init__()
        self._words = texts.set_up_text(session, step, instruments)
        self._drawing = drawn_set_up(session, step, instruments)

    def compose(self) -> ComposeResult:
        with Vertical(classes="wide-dialog"):
            yield Static(self._words, markup=False)
            yield ChartPlot(self._drawing)
            yield Static(self.app.keyed("{set-up.back} goes back."), markup=False)


class LegReviewScreen(Dialog[bool]):
    """Look, then go on to the next leg; dismissed with whether the session shall be on hold."""

    HELP = help_of("review")
    AUTO_FOCUS = "#review"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space,enter,escape", "dismiss(False)", "Continue", id="review.continue"),
        Binding("p", "dismiss(True)", "Hold", id="measure.hold"),
        # the plot in the place of the text, where there is no room for both
        Binding("v", "app.toggle_class('#both', 'plotted')", "View", id="measure.plot"),
    ]

    def __init__(
        self,
        session: Session,
        step: Step,
        rests_mm: Sequence[float] = (),
        *,
        unattended: bool = False,
    ) -> None:
        super().__init__()
        self._session, self._step = session, step
        self._words, self._unattended = leg_review_text(session, step, rests_mm), unattended

    def compose(self) -> ComposeResult:
        with Horizontal(
            id="both", classes=f"wide-dialog {'' if 'WARNING:' in self._words else 'done'}"
        ):
            with VerticalScroll(id="review"):
                yield Static(signalled(self.app.keyed(self._words)), id="review-text")
            yield ChartPlot(plot_id="review-chart")

    def on_mount(self) -> None:
        self.set_class(self.app.size.width >= WIDE, "wide")  # before the first picture, not after
        self.call_after_refresh(self._draw_chart)  # a chart takes long; the words come first
        if self._unattended:
            # how long an unattended demonstration shows the review
            self.set_timer(1.0, partial(self.action_dismiss, False))

    def _draw_chart(self) -> None:
        self.query_one(ChartPlot).show(readings_by_posture(self._session, self._step))


LOOK_S = 0.1
"""Between two looks at a machine that was interrupted."""


class MotionDialog(Dialog[None]):
    """Stands until the operator answers; no answer moves the machine.

    A key that comes within the dead time was meant for what was before. Escape leaves the machine
    as it is: the key that goes on asks again.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "answer", "I looked", id="motion.answer"),
        Binding("s", "vouch", "It does not move", id="motion.still"),
        Binding("h", "home", "Home it", id="motion.home"),
        Binding("escape", "dismiss(None)", "Leave it", id="motion.leave"),
    ]

    def __init__(self, mover: Mover) -> None:
        super().__init__()
        self._mover = mover
        self._calm_s = time.monotonic()
        self._event = Static("", id="event", markup=False)

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog alarm"):
            yield self._event

    def on_mount(self) -> None:
        self.app.bell()
        self._show()
        self.set_interval(LOOK_S, self._show)

    def _show(self) -> None:
        if self._mover.interrupted:
            self._event.update(self.app.keyed(motion.event_text(self._mover)))
        else:
            self.dismiss(None)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """No key at first; each only where it is an answer."""
        return self._mover.fits(action) and not self._dead

    @property
    def _dead(self) -> bool:
        return time.monotonic() - self._calm_s < DEAD_S

    def on_key(self) -> None:
        """A key within the dead time begins it anew: a note that is typed on is no answer."""
        if self._dead:
            self._calm_s = time.monotonic()

    def action_answer(self) -> None:
        """The operator looked: is all well again? What is still wrong is shown."""
        self._mover.answer()

    def action_vouch(self) -> None:
        self._mover.line.vouch()

    def action_home(self) -> None:
        """All carriages go to their switches; from here on every key stops them."""
        if self._mover.home() is not None:
            self.dismiss(None)
