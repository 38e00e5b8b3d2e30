"""What simulated devices share: waiting for whole requests, and faults on demand."""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import StrEnum

from drivers.profile import Profile, Spindle, Twin


class Answering:
    """A device that answers each whole request with the text of ``answer``.

    ``end`` closes a request (empty: every byte is one). ``answer`` gets the request without it and
    returns the bytes to send.
    """

    def __init__(self, answer: Callable[[bytes], bytes], end: bytes = b"\r") -> None:
        self._answer = answer
        self._end = end
        self._received = b""

    def receive(self, request: bytes) -> bytes:
        """Answers to all whole requests so far; an incomplete one is kept."""
        self._received += request
        if not self._end:
            whole = [bytes([byte]) for byte in self._received]
            self._received = b""
        else:
            *whole, self._received = self._received.split(self._end)
        return b"".join(self._answer(part.strip()) for part in whole)


class Trouble(StrEnum):
    """Faults that any device may show, besides those of its own profile."""

    SILENCE = "silence"
    SPLIT = "split"
    NOISE = "noise"
    ECHO = "echo"
    DROP_OUTS = "drop-outs"
    SLOW = "slow"
    DISCONNECT = "disconnect"
    PARITY = "parity"


SLOW_S = 0.4
NOISE = b"\xff\x80"


class Disconnected(Exception):
    """The device pulled its cable."""


class SuspectData:
    """A twin with a fault: one of `Trouble`, or the name of one of the profile's bad replies.

    ``split`` cuts the answer in the middle of a line, ``noise`` puts stray bytes in front of it,
    ``drop-outs`` leaves out every third answer and ``parity`` sends seven data bits with even
    parity to a reader of eight.
    """

    def __init__(self, twin: Twin, profile: Profile, fault: str) -> None:
        self._twin = twin
        self._profile = profile
        self._fault = fault
        self._count = 0

    def receive(self, request: bytes) -> bytes:
        """The answer as the fault leaves it."""
        answer = self._twin.receive(request)
        if not answer:
            return b""
        self._count += 1
        if self._fault == Trouble.DISCONNECT:
            raise Disconnected
        if self._fault == Trouble.SLOW:
            time.sleep(SLOW_S)
        bad = self._profile.bad_replies.get(self._fault)
        return bad.reply if bad else self._shaped(request, answer)

    def _shaped(self, request: bytes, answer: bytes) -> bytes:
        shapes = {
            Trouble.SILENCE: b"",
            Trouble.SPLIT: answer[: max(1, len(answer) // 2)],
            Trouble.NOISE: NOISE + answer,
            Trouble.ECHO: request + answer,
            Trouble.DROP_OUTS: b"" if self._count % 3 == 0 else answer,
            Trouble.PARITY: bytes(byte | (byte.bit_count() % 2) << 7 for byte in answer),
        }
        return next((shape for name, shape in shapes.items() if name == self._fault), answer)


def faults_of(profile: Profile) -> tuple[str, ...]:
    """Names of the faults that a twin of this profile can show."""
    return (*Trouble, *profile.bad_replies)


def twin_of(profile: Profile, spindle: Spindle, fault: str | None = None) -> Twin:
    """The simulated device, with a fault if one is named."""
    twin = profile.make_twin(spindle)
    return SuspectData(twin, profile, fault) if fault else twin
