"""A profile: what one family of indicators is asked, and how its reply is read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal, Protocol

from drivers.outcome import Asked, FaultKind, Outcome


class Verified(StrEnum):
    """Where the facts of a profile come from."""

    VENDOR = "vendor document"
    CODE = "open-source code"
    UNVERIFIED = "unverified"


@dataclass(frozen=True)
class LineSettings:
    """Serial settings; virtual ports and sockets ignore them.

    ``dtr`` and ``rts`` are the levels to hold. ``dtr_pulse_s`` asks by dropping DTR so long.
    """

    baud: int
    data_bits: Literal[7, 8] = 8
    parity: Literal["N", "E", "O"] = "N"
    stop_bits: Literal[1, 2] = 1
    dtr: bool = True
    rts: bool = True
    dtr_pulse_s: float = 0.0


@dataclass(frozen=True)
class Spindle:
    """What a twin shows: where its spindle stands and how finely, in mm, and its channel."""

    position_mm: Callable[[], float]
    resolution_mm: float
    channel: int = 1

    def text(self, decimals: int | None = None) -> str:
        """The position with its sign, rounded as the display does: ``+0.123``, ``-1.5``."""
        steps = round(self.position_mm() / self.resolution_mm)
        places = decimals if decimals is not None else self.decimals
        return f"{'-' if steps < 0 else '+'}{abs(steps) * self.resolution_mm:.{places}f}"

    @property
    def decimals(self) -> int:
        """Decimals of the display."""
        return max(0, len(f"{self.resolution_mm:.7f}".rstrip("0").partition(".")[2]))


class Twin(Protocol):
    """A simulated device: bytes in, bytes out."""

    def receive(self, request: bytes) -> bytes:
        """The bytes that the device answers to these."""


@dataclass(frozen=True)
class BadReply:
    """What the device sends instead of a value, and the fault that this is."""

    reply: bytes
    kind: FaultKind


@dataclass(frozen=True)
class Profile:
    """Data and two pure functions.

    ``request`` gives the bytes to send (None: the device streams by itself); ``parse`` turns a line
    without its terminator into an outcome, or None for a line to pass over, such as an echo or an
    identification. It is anchored: a whole line of the grammar or no value. ``bad_replies`` are the
    device's own faults by name; the twin shows them on demand. ``button`` tells that a DATA button
    or foot switch of the device sends the frame of an answer unasked; without, nothing is a press.
    """

    name: str
    title: str
    verified: Verified
    source: str
    line: LineSettings
    request: Callable[[Asked], bytes] | None
    parse: Callable[[str, Asked], Outcome | None]
    make_twin: Callable[[Spindle], Twin]
    timeout_s: float = 1.0
    interval_s: float = 0.2
    bad_replies: Mapping[str, BadReply] = field(default_factory=dict)
    busy_retries: int = 0
    busy_wait_s: float = 0.05
    stream_s: float = 0.0
    button: bool = False
    hint: str = ""
