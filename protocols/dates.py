"""When a session was measured; of an imported table that is known only where the day is stated."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, date, datetime
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # a session loads the machines that are read on their legs
    from protocols.session import Beginning, Line


def measured_at(opened: Beginning) -> datetime:
    """When it was measured: of an imported table the stated day, else when it was imported."""
    day = opened.measured_on
    return datetime(day.year, day.month, day.day, tzinfo=UTC) if day else opened.at


def is_dated(opened: Beginning) -> bool:
    """Whether it is known when it was measured."""
    return opened.origin != "imported" or opened.measured_on is not None


def measured_words(opened: Beginning, form: str = "%Y-%m-%d") -> str:
    """When it was measured in this form; of an imported table the day, or that nobody stated it."""
    recorded = format(opened.at, form)
    if opened.origin != "imported":
        return recorded
    return f"{opened.measured_on or 'not stated'}, imported {recorded}"


def measured_days(opened: Beginning, readings: Iterable[Line]) -> tuple[date, date]:
    """The day when the session began, and that of its last reading; of a table the day of all."""
    first = measured_at(opened).date()
    if opened.origin == "imported":
        return first, first
    return first, max([first, *(reading.at.date() for reading in readings)])


def day_words(opened: Beginning, readings: Iterable[Line]) -> str:
    """The days when it was measured; where nobody stated it, the day of the import."""
    if not is_dated(opened):
        return measured_words(opened)
    return " to ".join(f"{day}" for day in dict.fromkeys(measured_days(opened, readings)))
