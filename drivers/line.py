"""One indicator on one port: a thread of its own opens, asks, reads and closes."""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future

import serial

from drivers.errors import IndicatorError
from drivers.outcome import Fault, FaultKind, Outcome
from drivers.profile import Profile

try:
    import termios

    PORT_ERRORS: tuple[type[Exception], ...] = (
        serial.SerialException,
        OSError,
        ValueError,  # pyserial for an impossible URL or setting
        termios.error,
    )
except ImportError:  # Windows has no termios
    PORT_ERRORS = (serial.SerialException, OSError, ValueError)

SLICE_S = 0.05
"""How long the thread listens before it looks up whether it is to stop."""

REOPEN_S = 0.5
"""Pause between attempts to open a port that was lost."""


class IndicatorLine:
    """Requests from any thread, answered by the one thread that owns the port.

    While nothing is asked the line is read at the profile's own pace (or ``interval_s``, for
    simulated devices in compressed time). ``listener`` hears every outcome, in the thread of the
    line. A lost port is opened again at the next exchange.
    """

    def __init__(
        self,
        profile: Profile,
        port: str,
        *,
        interval_s: float | None = None,
        listener: Callable[[Outcome], None] = lambda _: None,
    ) -> None:
        self.profile = profile
        self.port = port
        self._interval_s = profile.interval_s if interval_s is None else interval_s
        self._listener = listener
        self._requests: queue.SimpleQueue[Future[Outcome]] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._serial: serial.Serial | None = None
        self._ready_at = 0.0
        self._thread = threading.Thread(target=self._own, name=f"indicator {port}", daemon=True)

    def start(self) -> None:
        """Open the port and begin. Raises IndicatorError where it cannot be opened."""
        self._serial = open_port(self.profile, self.port)
        self._thread.start()

    def ask(self) -> Future[Outcome]:
        """A fresh reading, taken after this call."""
        answer: Future[Outcome] = Future()
        if self._stop.is_set():
            answer.set_result(Fault(FaultKind.DISCONNECTED, "", "the line is closed"))
        else:
            self._requests.put(answer)
        return answer

    def close(self) -> None:
        """Stop the thread and close the port; waits for both."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._hang_up()

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
        while not self._requests.empty():
            self._requests.get().set_result(
                Fault(FaultKind.DISCONNECTED, "", "the line was closed")
            )

    def _heard(self) -> Outcome:
        outcome = self._outcome()
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
            # a late answer to an earlier request must not be taken for this one
            self._serial.reset_input_buffer()
            self._serial.write(self.profile.request)
            return self._listen(self._serial)
        except IndicatorError as problem:
            self._ready_at = time.monotonic() + REOPEN_S
            return Fault(FaultKind.DISCONNECTED, "", str(problem))
        except PORT_ERRORS as problem:
            self._hang_up()
            return Fault(
                FaultKind.DISCONNECTED, "", f"port {self.port} is gone ({problem}): check the cable"
            )

    def _listen(self, port: serial.Serial) -> Outcome:
        received = b""
        deadline = time.monotonic() + self.profile.timeout_s
        while time.monotonic() < deadline and not self._stop.is_set():
            received += port.read(max(1, port.in_waiting))
            received = received.lstrip(b"\x00\n\r")
            line, end, _ = received.replace(b"\n", b"\r").partition(b"\r")
            if end:
                return self.profile.parse(line)
        if received:
            text = received.decode("latin-1")
            return Fault(FaultKind.PARTIAL_LINE, text, "the answer broke off: check the settings")
        return Fault(
            FaultKind.NO_ANSWER,
            "",
            f"no answer within {self.profile.timeout_s:g} s: is the indicator on and connected?",
        )

    def _hang_up(self) -> None:
        port, self._serial = self._serial, None
        if port is not None:
            # pyserial leaves the socket of a vanished peer open: its shutdown fails before close
            behind: socket.socket | None = getattr(port, "_socket", None)
            with contextlib.suppress(*PORT_ERRORS):
                port.close()
            if behind is not None:
                behind.close()


def open_port(profile: Profile, port: str) -> serial.Serial:
    """The open port with the profile's settings. Raises IndicatorError in plain words."""
    settings = profile.line
    is_url = "://" in port
    try:
        return serial.serial_for_url(
            port,
            baudrate=settings.baud,
            bytesize=settings.data_bits,
            parity=settings.parity,
            stopbits=settings.stop_bits,
            timeout=SLICE_S,
            write_timeout=profile.timeout_s,
            **({} if is_url else {"exclusive": True}),
        )
    except PORT_ERRORS as problem:
        raise _cannot_open(port, problem) from problem


def _cannot_open(port: str, problem: Exception) -> IndicatorError:
    said = str(problem)
    reasons = {
        "No such file": (
            "no such port",
            "Plug the indicator in; glidecal ports lists what is there",
        ),
        "FileNotFoundError": (
            "no such port",
            "Plug the indicator in; glidecal ports lists what is there",
        ),
        "Permission": (
            "no permission",
            "Join the group that owns the port (dialout) and log in again",
        ),
        "PermissionError": ("no permission or in use", "Close other programs that use the port"),
        "exclusively lock": ("in use by another program", "Close the other program"),
        "busy": ("in use by another program", "Close the other program"),
        "refused": ("nobody listens there", "Start the device or the simulator first"),
    }
    for sign, (found, next_step) in reasons.items():
        if sign in said:
            return IndicatorError(f"port {port}", found, "a free serial port", next_step)
    return IndicatorError(
        f"port {port}", said, "a serial port", "glidecal ports lists what is there"
    )
