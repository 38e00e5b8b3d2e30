"""What comes of asking an indicator: a reading or a typed fault."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from enum import StrEnum


class Unit(StrEnum):
    """Units of length that indicators show."""

    MM = "mm"
    INCH = "inch"
    MICROMETRE = "µm"


LONGEST_NUMBER = 18
"""More digits than this no indicator shows."""

MILLIMETRES = {Unit.MM: Decimal(1), Unit.INCH: Decimal("25.4"), Unit.MICROMETRE: Decimal("0.001")}
"""Exact by definition."""


LARGEST_MM = 100_000.0
"""No indicator measures further; records allow no more."""


@dataclass(frozen=True)
class Reading:
    """A value with the text it came from.

    ``value_mm`` and ``resolution_mm`` are converted exactly from the decimal text and its ``unit``;
    ``unit_assumed`` tells that the reply names no unit. ``warning`` is for the operator, as a
    battery that runs low.
    """

    text: str
    value_mm: float
    resolution_mm: float
    unit_assumed: bool
    unit: Unit = Unit.MM
    warning: str = ""


class FaultKind(StrEnum):
    """Why there is no value."""

    NO_ANSWER = "no answer"
    PARTIAL_LINE = "partial line"
    NOT_UNDERSTOOD = "not understood"
    DEVICE_FAULT = "device fault"
    OVER_RANGE = "over range"
    LOW_BATTERY = "low battery"
    BUSY = "busy"
    WRONG_CHANNEL = "wrong channel"
    WRONG_UNIT = "wrong unit"
    WRONG_PARITY = "wrong parity"
    DISCONNECTED = "disconnected"
    TOO_SLOW = "too slow"
    SENDS_UNASKED = "sends unasked"


@dataclass(frozen=True)
class Fault:
    """No value: the kind, the text received, and plain words with what to do."""

    kind: FaultKind
    text: str
    words: str


Outcome = Reading | Fault


@dataclass(frozen=True)
class Asked:
    """What was asked for: the channel of an interface and the unit that the display is set to."""

    channel: int = 1
    unit: Unit = Unit.MM


def reading(
    text: str, number: str, asked: Asked, unit: Unit | None = None, warning: str = ""
) -> Outcome:
    """A decimal number (sign and blanks allowed) as a reading, its unit compared with the asked.

    ``unit`` None: the reply names none, the asked one is assumed.
    """
    if unit is not None and unit != asked.unit:
        return Fault(
            FaultKind.WRONG_UNIT,
            text,
            f"the indicator reads in {unit}, {asked.unit} is expected: change its unit",
        )
    if sum(map(str.isdigit, number)) > LONGEST_NUMBER:
        return not_understood(text)
    value = Decimal(number.replace(" ", ""))
    factor = MILLIMETRES[asked.unit]
    if abs(value) * factor > LARGEST_MM:
        return not_understood(text)
    step = Decimal(1).scaleb(int(value.as_tuple().exponent)) * factor
    return Reading(
        text=text,
        value_mm=float(value * factor),
        resolution_mm=float(step),
        unit_assumed=unit is None,
        unit=asked.unit,
        warning=warning,
    )


def wrong_channel(text: str, found: str, asked: Asked) -> Fault:
    """The answer of another input than the one that was asked."""
    words = f"answer of channel {found} where channel {asked.channel} was asked"
    return Fault(FaultKind.WRONG_CHANNEL, text, words)


def not_understood(text: str) -> Fault:
    """A line outside the grammar of the profile."""
    return Fault(FaultKind.NOT_UNDERSTOOD, text, "not an answer of this profile: wrong profile?")
