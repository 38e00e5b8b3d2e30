"""After each leg: repeatability, differences so far, and the readings as a plot."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.widgets import Static

from app.measuring.leg_review import review_leg
from app.report.charts.charts import readings_by_posture
from app.report.text.session import review_text
from app.screens.fast_keys import Dialog
from app.screens.interface import WIDE
from app.screens.plot import ChartPlot
from calib.errors import GlidecalError
from protocols.procedure import Step
from protocols.session import Session

UNATTENDED_S = 1.0
"""How long an unattended demonstration shows the review."""


class LegReviewScreen(Dialog[bool]):
    """Look, then go on to the next leg; dismissed with whether the session shall be on hold."""

    HELP = (
        "Scatter: standard deviation of a reading among the repeats of its posture.\n"
        "Stated: what repeatability and resolution of the indicator promise.\n"
        "Worst return: the largest difference between two Zeros of one cycle.\n"
        "Drift shows there, and a stand that slipped."
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        ("space", "dismiss(False)", "Go on"),
        ("enter", "dismiss(False)", "Go on"),
        ("escape", "dismiss(False)", "Go on"),
        Binding("p", "dismiss(True)", "Hold", id="measure.hold"),
    ]

    def __init__(self, session: Session, step: Step, *, unattended: bool = False) -> None:
        super().__init__()
        self._session = session
        self._step = step
        self._unattended = unattended

    def compose(self) -> ComposeResult:
        try:
            text = review_text(review_leg(self._session, self._step))
        except GlidecalError as problem:
            text = str(problem)
        with Horizontal(classes="wide-dialog"):
            with VerticalScroll(id="review"):
                yield Static(text, id="review-text", markup=False)
                yield Static("Space goes on, P holds the session.", markup=False)
            yield ChartPlot(plot_id="review-chart")

    def on_mount(self) -> None:
        self.query_one("#review").focus()
        self.set_class(self.app.size.width >= WIDE, "wide")  # before the first picture, not after
        self.call_after_refresh(self._draw_chart)  # a chart takes long; the words come first
        if self._unattended:
            self.set_timer(UNATTENDED_S, self._go_on)

    def _draw_chart(self) -> None:
        self.query_one(ChartPlot).show(readings_by_posture(self._session, self._step))

    def _go_on(self) -> None:
        self.dismiss(False)  # not awaited: it is this screen's own handler
