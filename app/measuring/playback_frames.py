"""When each event of a record is shown in a replay: groups of events with their play time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from protocols.events import Event, Faulted, Opened, Reading

LONG_BREAK_S = 30.0
BREAK_S = 2.0
"""Play time of everything longer than LONG_BREAK_S: nobody wants to watch an interruption."""

SHORTEST_S = 1.0
"""Play time between moments that were recorded at once, so that each can be read."""

AT_ONCE_S = 0.5
"""Readings closer than this on the average were written by a program, not measured."""

EVEN_S = 2.0
"""Play time between the readings of a record that knows no times."""


@dataclass(frozen=True)
class Frame:
    """Events shown at one moment.

    ``end`` is how many events of the record are shown then, ``time_s`` the play time at ×1.
    """

    events: tuple[Event, ...]
    end: int
    time_s: float


def frames_of(events: Sequence[Event]) -> tuple[Frame, ...]:
    """The moments of a record: readings of one step together, everything else by itself.

    Times are those of the events. Where a program wrote the events at once they are the
    ``time_s`` of the readings, or EVEN_S apart where these tell nothing.
    """
    groups = _groups(events)
    when = _clock(groups)
    last_s: float | None = None
    frames: list[Frame] = []
    time_s, end = 0.0, 0
    for group in groups:
        at_s = when(group)
        if frames:
            time_s += _play_gap_s(group, at_s, last_s)
        last_s = at_s if at_s is not None else last_s
        end += len(group)
        frames.append(Frame(tuple(group), end, time_s))
    return tuple(frames)


def _groups(events: Sequence[Event]) -> list[list[Event]]:
    groups: list[list[Event]] = []
    for event in events:
        if groups and _together(groups[-1], event):
            groups[-1].append(event)
        else:
            groups.append([event])
    return groups


def _together(group: Sequence[Event], event: Event) -> bool:
    """Readings, or faults, of the axes of one step."""
    if not isinstance(event, Reading | Faulted) or event.step is None:
        return False
    return all(
        isinstance(other, type(event)) and other.step == event.step and other.axis != event.axis
        for other in group
    )


def _clock(groups: Sequence[Sequence[Event]]) -> Callable[[Sequence[Event]], float | None]:
    """How to tell the time of a group in seconds; None where it has none of its own."""
    opened = groups[0][0]

    def recorded_s(group: Sequence[Event]) -> float | None:
        return (group[-1].at - opened.at).total_seconds()

    def stated_s(group: Sequence[Event]) -> float | None:
        last = group[-1]
        return last.time_s if isinstance(last, Reading) else None

    measured = isinstance(opened, Opened) and opened.origin == "measured"
    if measured or _apart(groups, recorded_s):
        return recorded_s
    return stated_s if _apart(groups, stated_s) else lambda _: None


def _apart(
    groups: Sequence[Sequence[Event]], when: Callable[[Sequence[Event]], float | None]
) -> bool:
    """Whether the readings are as far apart in time as a person measures; all need a time."""
    times = [when(group) for group in groups if isinstance(group[0], Reading)]
    known = [time_s for time_s in times if time_s is not None]
    if len(known) < max(len(times), 2):
        return False
    return (known[-1] - known[0]) / (len(known) - 1) >= AT_ONCE_S


def _play_gap_s(group: Sequence[Event], at_s: float | None, last_s: float | None) -> float:
    """Play time before a group: as recorded, breaks cut short; set where nothing is known."""
    if at_s is None:
        return EVEN_S if isinstance(group[0], Reading) else SHORTEST_S
    gap_s = at_s - last_s if last_s is not None else SHORTEST_S
    return BREAK_S if gap_s > LONG_BREAK_S else max(gap_s, SHORTEST_S)
