"""One indicator on one port: a thread of its own opens, asks, reads and closes."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future

from drivers.exchange import Exchange
from drivers.profile import Fault, FaultKind, Outcome, Profile, Query

Listener = Callable[[Outcome], None]


class IndicatorLine:
    """Requests from any thread, answered by the one thread that owns the port.

    While nothing is asked the line is read at the profile's own pace (or ``interval_s``, for
    simulated devices in compressed time). ``listener`` hears every outcome and ``on_button`` every
    press of the device's DATA button; both are called in the thread of the line. A lost port is
    opened again by itself. What is fresh and what is a press: `Exchange`.
    """

    def __init__(
        self,
        profile: Profile,
        port: str,
        *,
        query: Query | None = None,
        interval_s: float | None = None,
        listener: Listener = lambda _: None,
        on_button: Listener = lambda _: None,
    ) -> None:
        self.profile = profile
        self.port = port
        self._listener = listener
        self._requests: queue.SimpleQueue[Future[Outcome] | None] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._exchange = Exchange(
            profile,
            port,
            query or Query(),
            profile.interval_s if interval_s is None else interval_s,
            on_button=on_button,
            wait=self._stop.wait,
            stopped=self._stop.is_set,
        )
        self._thread = threading.Thread(target=self._run, name=f"indicator {port}", daemon=True)

    def start(self) -> None:
        """Open the port and begin. Raises IndicatorError where it cannot be opened."""
        self._exchange.open()
        self._thread.start()

    def ask(self) -> Future[Outcome]:
        """A fresh reading to be kept, taken after this call."""
        answer: Future[Outcome] = Future()
        self._requests.put(answer)
        if self._stop.is_set():
            self._answer_nobody()
            self._requests.put(None)  # that of `close` may have been among them
        return answer

    def close(self) -> None:
        """Stop the thread and close the port; waits for both."""
        self._stop.set()
        self._requests.put(None)  # it may wait for the next request
        if self._thread.is_alive():
            self._thread.join()
        self._answer_nobody()
        self._exchange.hang_up()

    def _answer_nobody(self) -> None:
        """Whoever still waits gets a fault."""
        with contextlib.suppress(queue.Empty):
            while True:
                waiting = self._requests.get_nowait()
                if waiting is not None:
                    waiting.set_result(Fault(FaultKind.DISCONNECTED, "", "the line was closed"))

    def _run(self) -> None:
        while not self._stop.is_set():
            idle_s = max(0.0, self._exchange.ready_at - time.monotonic())
            try:
                request = self._requests.get(timeout=idle_s)
            except queue.Empty:
                self._report(self._exchange.outcome())
                continue
            if request is not None:
                request.set_result(self._report(self._exchange.checked_outcome()))

    def _report(self, outcome: Outcome) -> Outcome:
        if not self._stop.is_set():  # a line that is being closed tells nothing any more
            self._listener(outcome)
        return outcome
