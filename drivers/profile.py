"""What comes of asking an indicator: a reading or a typed fault."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from enum import StrEnum
from typing import Literal


class Unit(StrEnum):
    """Units of length that indicators show."""

    MM = "mm"
    INCH = "inch"
    MICROMETRE = "µm"


LONGEST_NUMBER = 18
"""More digits than this no indicator shows."""

MILLIMETRES = {Unit.MM: Decimal(1), Unit.INCH: Decimal("25.4"), Unit.MICROMETRE: Decimal("0.001")}
"""Exact by definition."""

UNITS = (
    dict.fromkeys(("mm", "MM", "M"), Unit.MM)
    | dict.fromkeys(("inches", "inch", "in", "IN", "I", '"'), Unit.INCH)
    | dict.fromkeys(("um", "µm"), Unit.MICROMETRE)
)
"""As replies write them."""

LARGEST_MM = 100_000.0
"""No indicator measures further; records allow no more."""

LEAST_STEP_MM = Decimal("1e-9")
"""No indicator shows finer steps; records allow none."""


@dataclass(frozen=True)
class IndicatorReading:
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


Outcome = IndicatorReading | Fault


@dataclass(frozen=True)
class Query:
    """What was asked for: the channel of an interface and the unit that the display is set to."""

    channel: int = 1
    unit: Unit = Unit.MM


def reading(text: str, number: str, query: Query, unit: Unit | None = None) -> Outcome:
    """A decimal number (sign and blanks allowed) as a reading, its unit compared with the asked.

    ``unit`` None: the reply names none, the asked one is assumed.
    """
    if unit is not None and unit != query.unit:
        return Fault(
            FaultKind.WRONG_UNIT,
            text,
            f"the indicator reads in {unit}, {query.unit} is expected: change its unit",
        )
    if sum(map(str.isdigit, number)) > LONGEST_NUMBER:
        return not_understood(text)
    value = Decimal(number.replace(" ", ""))
    factor = MILLIMETRES[query.unit]
    step = Decimal(1).scaleb(int(value.as_tuple().exponent)) * factor
    if abs(value) * factor > LARGEST_MM or step < LEAST_STEP_MM:
        return not_understood(text)
    return IndicatorReading(
        text=text,
        value_mm=float(value * factor),
        resolution_mm=float(step),
        unit_assumed=unit is None,
        unit=query.unit,
    )


def not_understood(text: str) -> Fault:
    """A line outside the grammar of the profile."""
    return Fault(FaultKind.NOT_UNDERSTOOD, text, "not an answer of this profile: wrong profile?")


class Evidence(StrEnum):
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

    def text(self, width: int = 0, fill: str = "0", *, decimals: int | None = None) -> str:
        """Sign, then digits filled up to a width, rounded as the display does: ``-001.5``."""
        steps = round(self.position_mm() / self.resolution_mm)
        places = self.decimals if decimals is None else decimals
        digits = f"{abs(steps) * self.resolution_mm:.{places}f}"
        return f"{'-' if steps < 0 else '+'}{digits.rjust(width, fill)}"

    @property
    def decimals(self) -> int:
        """Decimals of the display, at least one."""
        return max(1, len(f"{self.resolution_mm:.7f}".rstrip("0").partition(".")[2]))


NO_LINE = r"(?!)"
"""Matches no line."""


@dataclass(frozen=True)
class Grammar:
    """The lines of a device without their end. A pattern matches a whole line, or nothing of it.

    ``value`` has a group ``number``, and groups ``unit`` and ``channel`` where replies name them;
    where the form of a reply tells its unit, the part that does is a group ``mm`` or ``inch``.
    ``fault`` may have a ``code`` (none: empty), with ``words`` or else ``other_words``, which may
    name groups and the ``query``, and ``kinds``. What is ``passed_over`` is no answer, such as
    an echo or an identification. Any other line is not understood. A fixed width, such as
    ``(?=[\\d.]{7}$)``, refuses a number that lost a byte on the line.
    """

    value: str
    fault: str = NO_LINE
    passed_over: str = NO_LINE
    words: Mapping[str, str] = field(default_factory=dict)
    other_words: str = "fault {code}"
    kinds: Mapping[str, FaultKind] = field(default_factory=dict)

    def parse(self, text: str, query: Query) -> Outcome | None:
        """The outcome of a line; None for one to pass over."""
        if re.fullmatch(self.passed_over, text, re.ASCII):
            return None
        value = re.fullmatch(self.value, text, re.ASCII)
        match = value or re.fullmatch(self.fault, text, re.ASCII)
        if not match:
            return not_understood(text)
        groups = match.groupdict()
        channel, code = groups.get("channel"), groups.get("code") or ""
        unit = (groups.get("unit") or "").strip()
        if unit and unit not in UNITS:
            return not_understood(text)
        if channel is not None and int(channel) != query.channel:
            message = f"answer of channel {channel} where channel {query.channel} was asked"
            return Fault(FaultKind.WRONG_CHANNEL, text, message)
        if value:
            unit_groups = (name for name in ("mm", "inch") if groups.get(name) is not None)
            return reading(text, groups["number"], query, UNITS.get(unit or next(unit_groups, "")))
        message = (self.words.get(code) or self.other_words).format(query=query, **groups)
        return Fault(self.kinds.get(code, FaultKind.DEVICE_FAULT), text, message)


@dataclass(frozen=True)
class BadReply:
    """What the device sends instead of a value, and the fault that this is."""

    reply: bytes
    kind: FaultKind


@dataclass(frozen=True)
class Profile:
    """An indicator as data and pure functions.

    ``request`` gives the bytes to send (None: the device streams by itself); ``parse`` turns a line
    without its terminator into an outcome, or None for a line to pass over. It is anchored: a whole
    line of the grammar or no value. ``reply`` is what its twin answers to that request, with the
    line's end, and ``otherwise`` what it answers to any other one. ``bad_replies`` are the device's
    own faults by name; the twin shows them on demand. ``button`` tells that a DATA button or foot
    switch of the device sends the frame of an answer unasked; without, nothing is a press.
    """

    name: str
    title: str
    verified: Evidence
    source: str
    line: LineSettings
    request: Callable[[Query], bytes] | None
    parse: Callable[[str, Query], Outcome | None]
    reply: Callable[[Spindle], str]
    otherwise: Callable[[str, Spindle], str] = lambda _request, _spindle: ""
    timeout_s: float = 1.0
    interval_s: float = 0.2
    bad_replies: Mapping[str, BadReply] = field(default_factory=dict)
    busy_retries: int = 0
    stream_s: float = 0.0
    button: bool = False
    hint: str = ""
