"""What comes of asking an indicator: a reading or a typed fault."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


@dataclass(frozen=True)
class Reading:
    """A value with the text it came from.

    ``resolution_mm`` follows from the decimals of the text; ``unit_assumed`` tells that the reply
    names no unit and mm was taken.
    """

    text: str
    value_mm: float
    resolution_mm: float
    unit_assumed: bool


class FaultKind(StrEnum):
    """Why there is no value."""

    NO_ANSWER = "no answer"
    PARTIAL_LINE = "partial line"
    NOT_UNDERSTOOD = "not understood"
    DEVICE_FAULT = "device fault"
    BUSY = "busy"
    WRONG_CHANNEL = "wrong channel"
    DISCONNECTED = "disconnected"


@dataclass(frozen=True)
class Fault:
    """No value: the kind, the text received, and plain words with what to do."""

    kind: FaultKind
    text: str
    words: str


Outcome = Reading | Fault
