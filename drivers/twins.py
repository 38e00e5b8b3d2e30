"""What simulated devices share: waiting for whole requests, and faults on demand."""

from __future__ import annotations

import time
from enum import StrEnum
from typing import Protocol

from drivers.profile import Asked, Profile, Spindle


class Twin(Protocol):
    """A simulated device: bytes in, bytes out."""

    def receive(self, request: bytes) -> bytes:
        """The bytes that the device answers to these."""


class Device:
    """A device that answers each whole request, or streams and listens to nothing."""

    def __init__(self, profile: Profile, spindle: Spindle) -> None:
        self._profile = profile
        self._spindle = spindle
        asked = Asked(channel=spindle.channel)
        self._request = profile.request(asked) if profile.request else b""
        self._received = b""

    def receive(self, request: bytes) -> bytes:
        """Answers to all whole requests so far; the next line of a stream for no request."""
        if not self._request:
            return b"" if request else self._profile.reply(self._spindle).encode("latin-1")
        known, received = self._request.strip(), self._received + request
        if self._request.endswith((b"\r", b"\n")):
            *parts, self._received = received.split(self._request[-1:])
            requests = [part.strip() for part in parts]
        else:  # nothing ends a request: only the one that is known can be told
            *parts, self._received = received.split(self._request)
            requests = [known] * len(parts)
        return b"".join(self._answer(part, known) for part in requests)

    def _answer(self, request: bytes, known: bytes) -> bytes:
        if request == known:
            return self._profile.reply(self._spindle).encode("latin-1")
        said = self._profile.otherwise(request.decode("latin-1"), self._spindle)
        return said.encode("latin-1")


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


WORDS = {
    Trouble.SILENCE: "no answer at all: switched off, or the cable is out",
    Trouble.SPLIT: "half an answer, without its end",
    Trouble.NOISE: "wrong bytes before each answer",
    Trouble.ECHO: "each request comes back before its answer",
    Trouble.DROP_OUTS: "every third answer is missing",
    Trouble.SLOW: "each answer comes 0.4 s late",
    Trouble.DISCONNECT: "the port is gone at the first request",
    Trouble.PARITY: "seven data bits with even parity, to a reader of eight",
}

SLOW_S = 0.4
NOISE = b"\xff\x80"


class Disconnected(Exception):
    """The device pulled its cable."""


class SuspectData:
    """A twin with a fault: one of `Trouble`, or the name of one of the profile's bad replies."""

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


def faults_of(profile: Profile) -> dict[str, str]:
    """The faults that a twin of this profile can show: names, and what each is."""
    own = {
        name: f"answers {bad.reply.decode('latin-1').strip()}, {bad.kind}"
        for name, bad in profile.bad_replies.items()
    }
    return {**{trouble.value: words for trouble, words in WORDS.items()}, **own}


def twin_of(profile: Profile, spindle: Spindle, fault: str | None = None) -> Twin:
    """The simulated device, with a fault if one is named."""
    device = Device(profile, spindle)
    return SuspectData(device, profile, fault) if fault else device
