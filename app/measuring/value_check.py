"""Whether the values of a record are what the texts beside them say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import takewhile

from app.measuring.indicators import SIMULATED, asked_of, profile_of
from calib.errors import GlidecalError, RecordError
from drivers.profile import Asked, Profile
from drivers.profile import Reading as IndicatorReading
from protocols.machine import Instrument
from protocols.record import Record
from protocols.session import Continued, Event, Reading, fold

Parser = Callable[[str], float | None]

SAME_MM = 1e-9


def check_values(record: Record) -> None:
    """Read every text again, as its profile does. Raises RecordError at the first other value.

    A text that the profile of today does not read tells nothing, nor do texts after an
    interruption: there another indicator may have been used.
    """
    session = fold(record.events)
    steps = {step.number: step for step in session.steps()}
    parsers = [_parser(instrument) for instrument in session.opened.instruments]
    for reading in _before_a_break(record.events):
        step = steps.get(reading.step or 0)
        number = step.indicators[step.axes.index(reading.axis)] if step else None
        read = _plain if number is None else parsers[number]
        said_mm = read(reading.text)
        if said_mm is not None and abs(said_mm - reading.value_mm) > SAME_MM:
            raise RecordError(
                f"session {record.path}, line {reading.line}",
                f"value_mm {reading.value_mm} beside the text {reading.text!r}",
                f"{said_mm}, as the text says",
                "Use an unaltered copy.",
            )


def _before_a_break(events: Sequence[Event]) -> list[Reading]:
    first = takewhile(lambda event: not isinstance(event, Continued), events)
    return [event for event in first if isinstance(event, Reading)]


def _parser(instrument: Instrument) -> Parser:
    if instrument.profile == SIMULATED:
        return _plain
    try:
        return partial(_as_read, profile_of(instrument), asked_of(instrument))
    except GlidecalError:  # of a program with other profiles
        return lambda _: None


def _as_read(profile: Profile, asked: Asked, text: str) -> float | None:
    outcome = profile.parse(text, asked)
    return outcome.value_mm if isinstance(outcome, IndicatorReading) else None


def _plain(text: str) -> float | None:
    """Millimetres, as tables and simulations have them."""
    try:
        return float(text)
    except ValueError:
        return None
