"""A replay in words: what each event was, where the replay stands, the readings as lines."""

from __future__ import annotations

from collections.abc import Sequence

from app.measuring.playback import Playback
from app.report.text.tables import signed
from calib.printable import one_line
from protocols.session import (
    Changed,
    Closed,
    Continued,
    Event,
    Faulted,
    Mounted,
    Noted,
    Opened,
    Reading,
    Restored,
    Session,
    Skipped,
    Superseded,
)

LONGEST_NAME = 40
NUMBERS_SHOWN = 6
HEADING = "   no  step  leg axis      at, mm  cycle  mount         value, mm"


def progress_line(playback: Playback) -> str:
    """Name, place, speed and state in one line."""
    name = playback.record.path.name
    short = name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + "…"
    return f"replay · {short}   {playback.place} · ×{playback.speed} · {playback.state}"


def said_text(playback: Playback) -> str:
    """One line for what is shown last; at both ends also what is wrong with the record."""
    events, frames = playback.frame.events, playback.frames
    readings = [event for event in events if isinstance(event, Reading)]
    faults = [event for event in events if isinstance(event, Faulted)]
    text = _reading_words(readings) if readings else "; ".join(map(_event, faults or events[:1]))
    unfinished = playback.record.unfinished
    at_either_end = playback.frame in (frames[0], frames[-1])
    return f"{text} {unfinished}" if unfinished and at_either_end else text


def _event(event: Event) -> str:
    """A single event that is no reading, in one line."""
    match event:
        case Opened():
            by = f" by {event.operator}" if event.operator else ""
            begun = f"Begun {event.at:%Y-%m-%d %H:%M %Z}{by}, {event.origin}."
            sentence = " ".join([begun, *event.remarks])
        case Mounted():
            axes = " and ".join(axis.upper() for axis in event.mounts)
            sentence = f"Mounted on leg {event.leg.upper()} along {axes}: a new zero."
        case Faulted():
            step = "" if event.step is None else f", step {event.step}"
            text = f" (received {event.text!r})" if event.text else ""
            sentence = (
                f"Fault of the indicator along {event.axis.upper()}{step}: {event.kind}{text}"
            )
        case Superseded():
            sentence = f"Superseded readings {_numbers(event.readings)}: {event.reason}"
        case Skipped():
            sentence = f"Skipped steps {_numbers(event.steps)}: {event.reason}"
        case Restored():
            sentence = _restored(event)
        case Noted():
            sentence = f"Note: {event.text}"
        case Continued():
            torn = f"; {event.torn_bytes} torn bytes set aside" if event.torn_bytes else ""
            sentence = f"Continued after an interruption{torn}."
        case Closed():
            complete_word = "complete" if event.complete else "not complete"
            sentence = f"Closed with {event.readings} readings, {complete_word}."
        case _:
            sentence = _changed(event) if isinstance(event, Changed) else event.event
    return one_line(sentence)


def _changed(event: Changed) -> str:
    end = f", end at {event.support_mm:g} mm" if event.support_mm else ""
    by_mm = event.asked_mm if event.moved_mm is None else event.moved_mm
    way = f" by {signed(by_mm)} mm along {event.towards}" if by_mm and event.towards else ""
    return f"Mechanically changed: {event.reason}{end}{way}. Readings before it do not count."


def _reading_words(readings: Sequence[Reading]) -> str:
    first = readings[0]
    values = ", ".join(f"{r.axis.upper()} {signed(r.value_mm, 4)} mm" for r in readings)
    if first.step is not None:
        return f"Taken, step {first.step}: {values}"
    where = f"leg {first.leg.upper()} at {first.displacement_mm:+.2f} mm"
    if first.position_mm is not None:
        where = first.place_words
    return f"Reading {first.reading}, {where}: {values}"


def _restored(event: Restored) -> str:
    parts = []
    if event.readings:
        parts.append(f"readings {_numbers(event.readings)} are used again")
    if event.steps:
        parts.append(f"steps {_numbers(event.steps)} are measured after all")
    return f"Restored, {' and '.join(parts) or 'nothing'}: {event.reason}"


def _numbers(numbers: Sequence[int]) -> str:
    if len(numbers) <= NUMBERS_SHOWN:
        return ", ".join(map(str, numbers))
    return f"{numbers[0]}, {numbers[1]}, … {numbers[-1]} ({len(numbers)} of them)"


def reading_lines(session: Session) -> list[str]:
    """A heading, one line for each reading taken, below superseded ones the reason."""
    lines = [HEADING]
    for reading in session.all_readings:
        step = "" if reading.step is None else str(reading.step)
        at = f"{reading.displacement_mm:+.2f}"
        if reading.position_mm is not None:
            at = ",".join(f"{v:g}" for v in reading.position_mm)
        if reading.over_plane:
            at = f"{reading.station:g} at {at}"
        lines.append(
            f"{reading.reading:>5}  {step:>4}  {reading.leg:<4}{reading.axis:<4} {at:>12}  "
            f"{reading.cycle:>5}  {one_line(reading.mount):<12} {signed(reading.value_mm, 4):>10}"
        )
        reason = session.superseded.get(reading.reading)
        if reason is not None:
            lines.append(f"     superseded: {one_line(reason)}")
    return lines


JUMP_QUESTION = "To which {}?"
UNSOLVED = "No result of this session: {}"
