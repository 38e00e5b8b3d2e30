"""One indicator on one port: a thread of its own opens, asks, reads and closes."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future

import serial

from drivers.errors import IndicatorError
from drivers.outcome import Asked, Fault, FaultKind, Outcome, Reading
from drivers.port import PORT_ERRORS, SLICE_S, ask_by_pulse, close_port, open_port
from drivers.profile import Profile

REOPEN_S = 0.25
"""Pause between attempts to open a port that was lost."""

LONGEST_LINE = 512
"""More than this without a line end is no answer of any profile."""

Heard = Callable[[Outcome], None]


class IndicatorLine:
    """Requests from any thread, answered by the one thread that owns the port.

    While nothing is asked the line is read at the profile's own pace (or ``interval_s``, for
    simulated devices in compressed time). ``listener`` hears every outcome and ``on_button`` every
    value that the device sent unasked; both are called in the thread of the line. A lost port is
    opened again by itself.
    """

    def __init__(
        self,
        profile: Profile,
        port: str,
        *,
        asked: Asked | None = None,
        interval_s: float | None = None,
        listener: Heard = lambda _: None,
        on_button: Heard = lambda _: None,
    ) -> None:
        self.profile = profile
        self.port = port
        self._asked = asked or Asked()
        self._interval_s = profile.interval_s if interval_s is None else interval_s
        self._listener = listener
        self._on_button = on_button
        self._requests: queue.SimpleQueue[Future[Outcome]] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._serial: serial.Serial | None = None
        self._received = b""
        self._owed = False
        self._ready_at = 0.0
        self._thread = threading.Thread(target=self._own, name=f"indicator {port}", daemon=True)

    def start(self) -> None:
        """Open the port and begin. Raises IndicatorError where it cannot be opened."""
        self._serial = open_port(self.profile, self.port)
        self._thread.start()

    def ask(self) -> Future[Outcome]:
        """A fresh reading, taken after this call."""
        answer: Future[Outcome] = Future()
        self._requests.put(answer)
        if self._stop.is_set():
            self._answer_nobody()
        return answer

    def close(self) -> None:
        """Stop the thread and close the port; waits for both."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._answer_nobody()
        self._hang_up()

    def _answer_nobody(self) -> None:
        """Whoever still waits gets a fault."""
        while True:
            try:
                waiting = self._requests.get_nowait()
            except queue.Empty:
                return
            waiting.set_result(Fault(FaultKind.DISCONNECTED, "", "the line was closed"))

    def _own(self) -> None:
        while not self._stop.is_set():
            idle_s = max(0.0, self._ready_at - time.monotonic())
            try:
                asked = self._requests.get(timeout=min(idle_s, SLICE_S))
            except queue.Empty:
                if time.monotonic() >= self._ready_at:
                    self._heard()
                continue
            asked.set_result(self._heard())

    def _heard(self) -> Outcome:
        outcome = self._outcome()
        if not self._stop.is_set():  # a line that is being closed tells nothing any more
            self._listener(outcome)
        return outcome

    def _outcome(self) -> Outcome:
        """One exchange, repeated while the device says that it is busy."""
        self._stop.wait(max(0.0, self._ready_at - time.monotonic()))
        self._ready_at = time.monotonic() + self._interval_s
        outcome = self._exchange()
        for _ in range(self.profile.busy_retries):
            if not (isinstance(outcome, Fault) and outcome.kind is FaultKind.BUSY):
                break
            self._stop.wait(self.profile.busy_wait_s)
            outcome = self._exchange()
        return outcome

    def _exchange(self) -> Outcome:
        try:
            if self._serial is None:
                self._serial = open_port(self.profile, self.port)
                self._received, self._owed = b"", False
            self._clear_the_line(self._serial)
            if self.profile.request is not None:
                self._serial.write(self.profile.request(self._asked))
                ask_by_pulse(self._serial, self.profile.line)
            return self._listen(self._serial)
        except IndicatorError as problem:
            self._ready_at = time.monotonic() + REOPEN_S
            return Fault(FaultKind.DISCONNECTED, "", str(problem))
        except PORT_ERRORS as problem:
            self._hang_up()
            self._ready_at = time.monotonic() + REOPEN_S
            words = f"port {self.port} is gone: check the cable ({problem})"
            return Fault(FaultKind.DISCONNECTED, "", words)

    def _clear_the_line(self, port: serial.Serial) -> None:
        """Nothing that came before a request may be taken for its answer.

        An answer still owed to a request that timed out is waited for and dropped. Any other value
        that lies there was sent unasked: somebody pressed the button. A streaming device has no
        requests; there only the newest line counts.
        """
        if self._owed:
            self._owed = False
            self._next_line(port, self.profile.timeout_s)
        while port.in_waiting:
            self._received += port.read(port.in_waiting)
        for line in self._whole_lines():
            outcome = self._parsed(line)
            if isinstance(outcome, Reading) and self.profile.request is not None:
                self._on_button(outcome)
        self._received = b""

    def _listen(self, port: serial.Serial) -> Outcome:
        """The outcome of the next line that is neither echo nor identification."""
        deadline = time.monotonic() + self.profile.timeout_s
        request = self.profile.request
        echo = request(self._asked).strip() if request else b""
        while (left_s := deadline - time.monotonic()) > 0.0 and not self._stop.is_set():
            line = self._next_line(port, left_s)
            if line is None:
                break
            if not line or (line == echo and not isinstance(self._parsed(line), Reading)):
                continue
            outcome = self._parsed(line)
            if outcome is not None:
                return outcome
        self._owed = request is not None
        return self._silence()

    def _next_line(self, port: serial.Serial, patience_s: float) -> bytes | None:
        """The next whole line without its end; None if it does not come in time."""
        deadline = time.monotonic() + patience_s
        while not self._stop.is_set():
            for line in self._whole_lines(at_most=1):
                return line
            if time.monotonic() >= deadline or len(self._received) > LONGEST_LINE:
                return None
            self._received += port.read(max(1, port.in_waiting))
        return None

    def _whole_lines(self, at_most: int = LONGEST_LINE) -> list[bytes]:
        """Cut whole lines off what was received; CR, LF and both end a line."""
        lines: list[bytes] = []
        while len(lines) < at_most:
            received = self._received.replace(b"\n", b"\r").lstrip(b"\x00\r")
            line, end, rest = received.partition(b"\r")
            if not end:
                break
            lines.append(line)
            self._received = rest
        return lines

    def _parsed(self, line: bytes) -> Outcome | None:
        return self.profile.parse(line.decode("latin-1"), self._asked)

    def _silence(self) -> Fault:
        """Why no line came: nothing at all, a broken line, or bytes of a wrong parity."""
        received, self._received = self._received, b""
        text = received.decode("latin-1")
        if looks_like_parity(received):
            words = "the bytes carry a parity bit: set 7 data bits, even parity on this port"
            return Fault(FaultKind.WRONG_PARITY, text, words)
        if received:
            words = "the answer broke off: check cable, speed and line settings"
            return Fault(FaultKind.PARTIAL_LINE, text, words)
        words = f"no answer within {self.profile.timeout_s:g} s: is it switched on and connected?"
        return Fault(FaultKind.NO_ANSWER, "", words)

    def _hang_up(self) -> None:
        port, self._serial = self._serial, None
        if port is not None:
            close_port(port)


def looks_like_parity(received: bytes) -> bool:
    """Seven data bits with even parity, read as eight: CR comes as 0x8D and never ends a line."""
    return b"\x8d" in received and all(byte.bit_count() % 2 == 0 for byte in received)
