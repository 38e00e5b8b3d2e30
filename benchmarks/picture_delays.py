"""How long a picture takes from reading to digits, and how long the event loop is blocked."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass, field
from unittest import mock

from textual.await_complete import AwaitComplete
from textual.drivers.headless_driver import HeadlessDriver
from textual.strip import Strip

from app.measuring.gauges import Gauge
from app.report.text.tables import signed
from app.screens.measure import MeasureScreen
from app.screens.session_view import GaugeDisplay, LegReviewScreen
from drivers.profile import IndicatorReading, Outcome

TICK_S = 0.005


class Terminal(HeadlessDriver):
    """Takes whatever is drawn and says when it was handed over."""

    on_flush: Callable[[], None] = staticmethod(lambda: None)

    @property
    def is_headless(self) -> bool:
        """Not for Textual: it would not draw."""
        return False

    def flush(self) -> None:
        """Everything drawn so far has left the program."""
        Terminal.on_flush()


@dataclass
class Delays:
    """From the arrival of a reading in the program to its digits leaving it.

    A reading that a newer one replaced before the next picture counts until that picture.
    """

    arrived: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    drawn: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def hear(self, gauge: str, text: str) -> None:
        """A reading came; called in the thread of its line."""
        with self.lock:
            self.arrived.setdefault(gauge, []).append((time.perf_counter(), text))

    def draw(self, gauge: str, text: str) -> None:
        """Its digits were rendered, and with them all that came before."""
        with self.lock:
            waiting = self.arrived.get(gauge, [])
            newest = max(
                (k for k, (_, picture) in enumerate(waiting) if picture == text), default=-1
            )
            self.drawn += [at for at, _ in waiting[: newest + 1]]
            del waiting[: newest + 1]

    def flush(self) -> None:
        """What was rendered has left the program."""
        now = time.perf_counter()
        with self.lock:
            self.seconds += [now - at for at in self.drawn]
            self.drawn.clear()

    def give_up(self) -> None:
        """What came by now is to be shown no more."""
        with self.lock:
            self.arrived.clear()

    def taken(self) -> list[float]:
        """The delays so far, in seconds; then begin again."""
        with self.lock:
            delays, self.seconds = self.seconds, []
            self.arrived.clear()
            self.drawn.clear()
            return delays


@contextmanager
def listening(delays: Delays) -> Iterator[None]:
    """Within this, `delays` hears of every reading, every drawing and every flush."""
    hear, render_line = Gauge.hear, GaugeDisplay.render_line
    dismiss = LegReviewScreen.dismiss

    def heard(gauge: Gauge, outcome: Outcome) -> None:
        if isinstance(outcome, IndicatorReading):
            delays.hear(gauge.port, signed(outcome.value_mm, 3))
        hear(gauge, outcome)

    def drawn(display: GaugeDisplay, y: int) -> Strip:
        if y == 0 and isinstance(display.screen, MeasureScreen):
            number = int((display.id or "").removeprefix("gauge"))
            delays.draw(display.screen.guided.gauges[number].port, display.number)
        return render_line(display, y)

    def uncovered(review: LegReviewScreen, hold: bool | None = None) -> AwaitComplete:
        delays.give_up()  # what came while the review lay over the digits
        return dismiss(review, hold)

    with (
        mock.patch.object(Gauge, "hear", heard),
        mock.patch.object(LegReviewScreen, "dismiss", uncovered),
        mock.patch.object(GaugeDisplay, "render_line", drawn),
        mock.patch.object(Terminal, "on_flush", delays.flush),
    ):
        yield


class Blocked:
    """The longest time in which the event loop did nothing else."""

    def __init__(self) -> None:
        self.longest_s = 0.0

    async def watch(self) -> None:
        """Wake up every few milliseconds and see how late it is."""
        while True:
            before = time.perf_counter()
            await asyncio.sleep(TICK_S)
            self.longest_s = max(self.longest_s, time.perf_counter() - before - TICK_S)

    @asynccontextmanager
    async def watched(self) -> AsyncIterator[None]:
        """Watch within this."""
        task = asyncio.create_task(self.watch())
        try:
            yield
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
