"""A profile: what one family of indicators is asked, and how its reply is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from drivers.outcome import Outcome


@dataclass(frozen=True)
class LineSettings:
    """Serial settings; a virtual port and a socket ignore them."""

    baud: int
    data_bits: Literal[7, 8] = 8
    parity: Literal["N", "E", "O"] = "N"
    stop_bits: Literal[1, 2] = 1


class Twin(Protocol):
    """A simulated device: bytes in, bytes out."""

    def receive(self, request: bytes) -> bytes:
        """The bytes that the device answers to these."""


@dataclass(frozen=True)
class Profile:
    """Data and one pure function: ``parse`` turns a reply without its terminator into an outcome.

    ``make_twin`` gives the simulated device for a function that tells the spindle's position in mm
    and a resolution in mm. ``verified`` says where the facts come from.
    """

    name: str
    title: str
    verified: str
    line: LineSettings
    request: bytes
    timeout_s: float
    interval_s: float
    parse: Callable[[bytes], Outcome]
    make_twin: Callable[[Callable[[], float], float], Twin]
    busy_retries: int = 0
    busy_wait_s: float = 0.05
