"""Question and answer on one port: what is fresh, what is late, what is a press of a button."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

from calib.errors import IndicatorError
from drivers.port import PORT_ERRORS, SLICE_S, SerialPort, ask_by_pulse, close_port, open_port
from drivers.profile import Fault, FaultKind, IndicatorReading, Outcome, Profile, Query

REOPEN_S = 0.25
"""Pause between attempts to open a port that was lost."""


LONGEST_LINE = 512
"""More than this without a line end is no answer of any profile."""

BULK = 4096
FLOOD = 65536
"""More bytes than this on the line at once are a flood."""

LATEST = 6.0
"""After so many time-outs an answer that has not come is lost."""

AFTER_LATE = 9.0
"""Silence after a late answer, in time-outs: longer than from one question to the next."""

PROOF = 2.0
"""Silence after the first prompt answer, in time-outs: what was held up comes in one burst."""

STEADY = 15.0
"""So many time-outs after the last answer that did not come, an unasked line may be a press."""

ALONE_S = 1.5
"""A press is known for one when no other line came unasked for so long after it …"""

APART_S = 4.0
"""… and before it. Unasked lines closer than this are a device that sends by itself."""

PROMPT_S = 0.5
"""Where answers take longer, a press cannot be told from them."""

SLOWEST_MEMORY = 0.95
"""So much of the longest answer time is remembered from one answer to the next."""

WORTH_WORDS_S = 2.0
"""Whoever plugged a cable in again is told how long the line still has to be silent."""

MOST_COMPARED = 4

UNANSWERED = (
    FaultKind.NO_ANSWER,
    FaultKind.PARTIAL_LINE,
    FaultKind.WRONG_PARITY,
    FaultKind.NOT_UNDERSTOOD,
    FaultKind.WRONG_CHANNEL,
)
"""The true answer may still come after these."""

FORM = str.maketrans("123456789+- ", "000000000000")
UNASKED_WORDS = (
    "a line came unasked and was dropped: set the indicator to send on request only; "
    "its DATA button works once in four seconds"
)


class Exchange:
    """Asks one device, each question after the answer of the one before.

    No protocol here numbers its answers, so an answer belongs to a question only if none of an
    earlier question can still come. What holds: **a reading was sent after its question**, as long
    as the device answers in order and each answer comes within `LATEST` time-outs or never. After
    a question without its answer the port is silent until nothing came for so long; then one
    question is asked whose answer is thrown away, silence again, and only then is the line
    believed. A stall of any length ends in a burst, which that second silence hears. An answer
    that comes late names the device too slow; lines that nobody asked for name it as sending
    unasked. A device that streams is not asked: there the newest whole line counts that began
    after the question.

    A press of the DATA button looks like any answer. It is told to ``on_button`` only where the
    profile has a button, as one line outside of any question, alone for `ALONE_S` after and
    `APART_S` before it, while every question had its answer for `STEADY` time-outs, and within
    `PROMPT_S`.

    ``now`` and ``wait`` are the clock in s, ``opener`` opens the port, ``stopped`` ends everything.
    """

    def __init__(
        self,
        profile: Profile,
        port: str,
        query: Query,
        interval_s: float,
        *,
        on_button: Callable[[Outcome], None] = lambda _: None,
        now: Callable[[], float] = time.monotonic,
        wait: Callable[[float], object] = time.sleep,
        stopped: Callable[[], bool] = lambda: False,
        opener: Callable[[Profile, str], SerialPort] = open_port,
    ) -> None:
        self.profile = profile
        self.port = port
        self.ready_at = 0.0
        self._query = query
        self._interval_s = interval_s
        self._on_button = on_button
        self._now, self._wait, self._stopped, self._open = now, wait, stopped, opener
        self._serial: SerialPort | None = None
        self._received = b""
        self._echo = profile.request(query).strip() if profile.request else b""
        self._begun_before = False
        self._form = ""
        self._owed = 0
        self._question_at = self._quiet_until = self._steady_at = 0.0
        self._unasked_at = -APART_S
        self._slowest_s = 0.0
        self._fault: Fault | None = None
        self._probed = self._pending = False
        self._press: IndicatorReading | None = None

    def open(self) -> None:
        """Open the port. Raises IndicatorError."""
        self._serial = self._open(self.profile, self.port)
        self._received = b""

    def hang_up(self) -> None:
        """Close the port."""
        port, self._serial = self._serial, None
        if port is not None:
            close_port(port)

    def checked_outcome(self) -> Outcome:
        """A reading to be kept: of the same form as the one before, else it is asked for again.

        A byte lost on the line makes the answer shorter, and a grammar without a fixed width or a
        check cannot see that in one answer. A press that is still being looked at is forgotten:
        the step that it was meant for is taken now.
        """
        self._press = None
        for _ in range(MOST_COMPARED):
            form = self._form
            outcome = self.outcome()
            if form == self._form or not isinstance(outcome, IndicatorReading):
                return outcome
        message = "answers of different length: bytes are lost, check cable, plugs and speed"
        return Fault(FaultKind.PARTIAL_LINE, outcome.text, message)

    def outcome(self) -> Outcome:
        """One exchange at the device's pace, repeated while the device says that it is busy."""
        self._wait(max(0.0, self.ready_at - self._now()))
        self.ready_at = self._now() + self._interval_s
        outcome = self._exchange()
        for _ in range(self.profile.busy_retries):
            if not (isinstance(outcome, Fault) and outcome.kind is FaultKind.BUSY):
                break
            # as readers of Mitutoyo's USB tools do, whose 918 says that it is busy
            self._wait(0.05)
            outcome = self._exchange()
        if isinstance(outcome, IndicatorReading):
            self._form = outcome.text.translate(FORM)
        return outcome

    def _exchange(self) -> Outcome:
        try:
            if self._serial is None:
                self.open()
            assert self._serial is not None
            self._overhear(self._serial)
            if self.profile.request is None:
                return self._fault or self._newest(self._serial)
            if self._fault and (silence_s := self._quiet_until - self._now()) > 0.0:
                return _until_asked_again(self._fault, silence_s)
            if self._probed:
                self._fault, self._probed, self._owed = None, False, 0
            return self._question(self._serial)
        except IndicatorError as problem:
            self.ready_at = self._now() + REOPEN_S
            return Fault(FaultKind.DISCONNECTED, "", str(problem))
        except PORT_ERRORS as problem:
            self.hang_up()
            if self._pending:
                self._unanswered(self._silence())
            self.ready_at = self._now() + REOPEN_S
            message = f"port {self.port} is gone: check the cable ({problem})"
            return Fault(FaultKind.DISCONNECTED, "", message)

    def _question(self, port: SerialPort) -> Outcome:
        self._received = b""
        self._question_at, self._pending = self._now(), True
        port.write(self.profile.request(self._query) if self.profile.request else b"")
        ask_by_pulse(port, self.profile.line, self._wait)
        outcome = self._answer(port)
        self._pending = False
        if isinstance(outcome, Fault) and outcome.kind in UNANSWERED:
            return self._unanswered(outcome)
        now = self._now()
        self._slowest_s = max(now - self._question_at, SLOWEST_MEMORY * self._slowest_s)
        if self._slowest_s > SLICE_S:  # a surplus answer shows only if nothing is asked meanwhile
            self.ready_at = max(self.ready_at, now + self._slowest_s)
        if self._fault:
            self._probed, self._quiet_until = True, now + PROOF * self.profile.timeout_s
            return self._fault
        pressed, waited_s = self._press, self._question_at - self._unasked_at
        if pressed and self._slowest_s > PROMPT_S:
            self._doubt(_unasked(pressed), APART_S)
        elif pressed and waited_s >= ALONE_S:
            self._press = None
            self._on_button(pressed)
        return outcome

    def _unanswered(self, fault: Fault) -> Fault:
        """The question just asked may still be answered: be silent."""
        self._pending = False
        self._owed += 1
        if self._fault and self._fault.kind is FaultKind.TOO_SLOW:
            fault = self._fault
        self._doubt(fault, 0.0)
        self._quiet_until = self._question_at + LATEST * self.profile.timeout_s
        self._steady_at = self._now() + STEADY * self.profile.timeout_s
        return fault

    def _doubt(self, fault: Fault, silence_s: float) -> None:
        self._fault, self._probed, self._press = fault, False, None
        self._quiet_until = max(self._quiet_until, self._now() + silence_s)

    def _overhear(self, port: SerialPort) -> None:
        """Look at what came before the question: nothing of it may be taken for the answer."""
        content = port.read(BULK) if self._fault else b""
        while not content[FLOOD:] and (waiting := port.in_waiting):
            content += port.read(waiting if len(content) < LONGEST_LINE else BULK)
        if self.profile.request is None and len(content) <= FLOOD:
            self._fault = None
        if not content and not self._received:
            return
        if len(content) > FLOOD:
            self._received, self._begun_before = b"", True
            message = "the device sends without end: wrong device on this port, or wrong speed?"
            self._doubt(Fault(FaultKind.SENDS_UNASKED, "", message), APART_S)
            return
        *lines, remainder = (self._received + content).replace(b"\n", b"\r").split(b"\r")
        self._received = remainder.lstrip(b"\x00")
        if self.profile.request is None:
            self._begun_before = bool(self._received)
            return
        if self._received and not self._fault:
            remainder = self._next_line(port, SLICE_S, gap=True) or self._received
            self._received = b""
            lines.append(remainder)
        outcomes = [self._outcome_of(line.lstrip(b"\x00")) for line in lines]
        unasked = [outcome for outcome in outcomes if outcome is not None]
        if unasked:
            self._judge_unasked(unasked)

    def _judge_unasked(self, unasked: list[Outcome]) -> None:
        """Late answers, a press of the button, or a device that sends by itself."""
        now = self._now()
        is_alone = now - self._unasked_at >= APART_S and self._slowest_s <= PROMPT_S
        is_alone = is_alone and now >= self._steady_at
        self._unasked_at = now
        if self._fault:
            owed, self._owed = self._owed, max(0, self._owed - len(unasked))
            is_late = now - self._question_at > self.profile.timeout_s
            unprompted = self._fault.kind is FaultKind.SENDS_UNASKED and not owed
            silence_s = APART_S if unprompted else AFTER_LATE * self.profile.timeout_s
            fault = self._fault if owed else _unasked(unasked[-1])
            if owed and is_late:
                message = (
                    f"answers come later than {self.profile.timeout_s:g} s, too slow to separate "
                    "old from new: none is taken; check cable, radio link and what else asks this "
                    "indicator"
                )
                fault = Fault(FaultKind.TOO_SLOW, "", message)
            self._doubt(fault, silence_s)
            return
        (first, *later) = unasked
        if self.profile.button and is_alone and isinstance(first, IndicatorReading) and not later:
            self._press = first
        else:
            self._doubt(_unasked(unasked[-1]), APART_S)

    def _newest(self, port: SerialPort) -> Outcome:
        """The last line of those of a stream that came together."""
        deadline = self._now() + self.profile.timeout_s
        if self._begun_before:
            self._next_line(port, self.profile.timeout_s)
            self._begun_before = False
        outcome = self._answer(port)
        while port.in_waiting and self._now() < deadline:
            line = self._next_line(port, SLICE_S, gap=True)
            outcome = (self._outcome_of(line) if line else None) or outcome
        return outcome

    def _answer(self, port: SerialPort) -> Outcome:
        """The outcome of the next line that is neither echo nor identification."""
        deadline = self._now() + self.profile.timeout_s
        while (remaining_s := deadline - self._now()) > 0.0 and not self._stopped():
            line = self._next_line(port, remaining_s)
            if line is None:
                break
            if (outcome := self._outcome_of(line)) is not None:
                return outcome
        return self._silence()

    def _next_line(self, port: SerialPort, patience_s: float, *, gap: bool = False) -> bytes | None:
        """The next whole line without its end; None if it does not come in time.

        CR, LF and both end a line. With ``gap`` the patience begins anew with every byte.
        """
        deadline = self._now() + patience_s
        while not self._stopped():  # by hand: readline knows LF only, and most devices end with CR
            received = self._received.replace(b"\n", b"\r").lstrip(b"\x00\r")
            line, end, remainder = received.partition(b"\r")
            if end:
                self._received = remainder
                return line
            if self._now() >= deadline or len(self._received) > LONGEST_LINE:
                return None
            chunk = port.read(max(1, port.in_waiting))
            self._received += chunk
            if gap and chunk:
                deadline = self._now() + patience_s
        return None

    def _outcome_of(self, line: bytes) -> Outcome | None:
        """What a line says; None for an empty one, an echo or an identification."""
        # latin-1: no byte is left out, for 12°345 without its ° would be a number
        outcome = self.profile.parse(line.decode("latin-1"), self._query) if line else None
        return None if line == self._echo and not isinstance(outcome, IndicatorReading) else outcome

    def _silence(self) -> Fault:
        """Why no line came: nothing at all, a broken line, or bytes of a wrong parity."""
        received, self._received = self._received, b""
        text = received.decode("latin-1")
        # seven data bits with even parity, read as eight: CR comes as 0x8D and never ends a line
        if b"\x8d" in received and all(byte.bit_count() % 2 == 0 for byte in received):
            message = "the bytes carry a parity bit: set 7 data bits, even parity on this port"
            return Fault(FaultKind.WRONG_PARITY, text, message)
        if received.strip(b"\x00\r\n"):
            message = "the answer broke off: check cable, speed and line settings"
            return Fault(FaultKind.PARTIAL_LINE, text, message)
        message = f"no answer within {self.profile.timeout_s:g} s: is it switched on and connected?"
        return Fault(FaultKind.NO_ANSWER, "", message)


def _unasked(line: Outcome) -> Fault:
    return Fault(FaultKind.SENDS_UNASKED, line.text, UNASKED_WORDS)


def _until_asked_again(fault: Fault, silence_s: float) -> Fault:
    """The fault with the time after which the device is asked again; a short one is not said."""
    if silence_s < WORTH_WORDS_S:
        return fault
    end = "" if fault.words.endswith(("?", ".")) else "."
    return replace(fault, words=f"{fault.words}{end} Asked again in {math.ceil(silence_s)} s")
