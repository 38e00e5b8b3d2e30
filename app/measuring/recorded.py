"""Records looked at from outside: their state in a folder, and whether values fit their texts."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import cast

from app.measuring.indicators import SIMULATED, asked_of, profile_of
from calib.errors import GlidecalError, RecordError
from calib.printable import counted
from drivers.profile import IndicatorReading, Profile, Query
from protocols.documents import Origin
from protocols.machine import Instrument
from protocols.machine_files import beginning_of, form_name
from protocols.record import END_BYTES, Record, count_readings, read_ends, read_record, record_form
from protocols.session import Closed, Continued, Event, Opened, Reading, Superseded

DEMO_FOLDER = Path("demo-sessions")

MOST = 12

SMALL_BYTES = 2 * END_BYTES
"""Up to here, 400 readings, a record is read whole and checked; of others both ends."""


@dataclass(frozen=True)
class SessionFile:
    """One session file: its state in words, whether it can go on, what it verifies.

    ``machine`` is its title, ``day`` when it was measured; empty where the file cannot be read.
    ``origin`` is that of its readings.

    ``empty``: it was left before its first reading. ``problem`` is the reason why a file cannot be
    used; empty for a readable session. One with its ``own_form`` is
    continued in the terminal alone.
    """

    path: Path
    state: str
    interrupted: bool = False
    empty: bool = False
    verifies: str | None = None
    problem: str = ""
    own_form: bool = False
    machine: str = ""
    day: str = ""
    origin: Origin = "measured"


def recent_sessions(*folders: Path) -> list[SessionFile]:
    """The newest sessions of these folders; unreadable ones are there with their reason."""
    paths = {path for folder in folders for path in _session_files(folder)}
    return [look_at(path) for path in sorted(paths, key=_changed_at, reverse=True)[:MOST]]


MOST_LISTED = 100
"""Sessions of a folder that are listed where others look at it, the newest."""


def sessions_below(folder: Path) -> list[Path]:
    """Every session file of a folder and those below it, the newest first."""
    try:
        paths = [path for path in folder.rglob("*.jsonl") if path.is_file()]
    except OSError:  # gone meanwhile, or not to be read
        return []
    return sorted(filter(_may_be_record, paths), key=_changed_at, reverse=True)


def named_sessions(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """The folders among these paths, and the files that are named or, of a folder, the newest."""
    folders = [path for path in dict.fromkeys(paths) if path.is_dir()]
    files = [path for path in paths if path not in folders]
    for folder in folders:
        files += sessions_below(folder)[:MOST_LISTED]
    return folders, list(dict.fromkeys(files))


def _session_files(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.glob("*.jsonl") if _may_be_record(path)]
    except OSError:
        return []


def _may_be_record(path: Path) -> bool:
    """Whether its first line is more than the bracket with which a document begins."""
    return beginning_of(path).split(b"\n")[0].strip() != b"{"


def _changed_at(path: Path) -> float:
    status = _stat(path)
    return status.st_mtime if status else 0.0


def _stat(path: Path) -> os.stat_result | None:
    """None for what is gone meanwhile, or a link to nothing: reading it tells why."""
    try:
        return path.stat()
    except OSError:
        return None


def look_at(path: Path) -> SessionFile:
    """The state of one session file."""
    try:
        status = _stat(path)
        if form := form_name(path):
            record = read_record(path, record_form(form))
            opened = cast("Opened", record.events[0])  # but for what it may verify
            state = _state_of_form(record)
        elif status is not None and status.st_size > SMALL_BYTES:
            opened, last = read_ends(path)
            state = _state_by_ends(opened, last)
        else:
            record = read_record(path)
            opened, state = record.opened, _state(record)
    except GlidecalError as problem:
        return SessionFile(path, "unreadable", problem=str(problem))
    return SessionFile(
        path,
        *state,
        verifies=None if form else opened.verifies,
        own_form=bool(form),
        machine=opened.machine.title,
        day=opened.measured_words(),
        origin=opened.origin,
    )


State = tuple[str, bool, bool]
"""Words for it, whether the session can go on, and whether it has no readings at all."""


def _state_of_form(record: Record) -> State:
    """The state of a record of its own form; it goes on in the terminal alone."""
    superseded = {
        number
        for event in record.events
        if isinstance(event, Superseded)
        for number in event.readings
    }
    count = count_readings(record.events)
    state = f"{count - len(superseded)} readings, {record.end}"
    if record.end != "closed":
        state += "; go on in the terminal: glidecal run --continue"
    return state, False, not count


def check_session(path: Path) -> None:
    """Raises RecordError for a record of any form that cannot be read."""
    read_record(path, record_form(form_name(path)))


def _state_by_ends(opened: Opened, last: Sequence[Event]) -> State:
    """The state of a large record: superseded readings count here, and no line is checked."""
    end = next((event for event in reversed(last) if isinstance(event, Closed | Reading)), None)
    if isinstance(end, Closed):
        return f"{counted(end.readings, 'reading')}, closed", False, False
    state = f"{counted(end.reading, 'reading')}, not closed" if end else "not closed"
    return state, opened.procedure is not None, False


def _state(record: Record) -> State:
    session = record.session
    readings = counted(len(session.readings), "reading")
    if record.end == "closed":
        return f"{readings}, closed", False, False
    steps, following = session.steps(), session.next_step()
    if not steps:
        return f"{readings}, cut", False, False
    where = f"interrupted at step {following.number} of {len(steps)}" if following else "not closed"
    return f"{readings}, {where}", True, not session.all_readings


def follow_up(session: SessionFile, among: Sequence[SessionFile]) -> SessionFile | None:
    """The session that verifies this one, if it is there."""
    folder, name = session.path.parent, session.path.name
    entries = (entry for entry in among if entry.path.parent == folder)
    return next((entry for entry in entries if entry.verifies == name), None)


Parser = Callable[[str], float | None]

SAME_MM = 1e-9


def check_values(record: Record) -> None:
    """Read every text again, as its profile does. Raises RecordError at the first other value.

    A text that the profile of today does not read tells nothing, nor do texts after an
    interruption: there another indicator may have been used.
    """
    session = record.session
    steps = {step.number: step for step in session.steps()}
    parsers = [_parser(instrument) for instrument in session.opened.instruments]
    before_a_break = takewhile(lambda event: not isinstance(event, Continued), record.events)
    for reading in (event for event in before_a_break if isinstance(event, Reading)):
        step = steps.get(reading.step or 0)
        number = step.indicators[step.axes.index(reading.axis)] if step else None
        parser = _plain if number is None else parsers[number]
        said_mm, name, value_mm = parser(reading.text), "value_mm", reading.value_mm
        if reading.contact and reading.position_mm:  # its text is that of the place
            name, value_mm = f"{reading.axis}_mm", reading.position_mm["xyz".index(reading.axis)]
        if said_mm is not None and abs(said_mm - value_mm) > SAME_MM:
            raise RecordError(
                f"session {record.path}, line {reading.line}",
                f"{name} {value_mm} beside the text {reading.text!r}",
                f"{said_mm}, as the text says",
                "Use an unaltered copy.",
            )


def _parser(instrument: Instrument) -> Parser:
    if instrument.profile == SIMULATED:
        return _plain
    try:
        return partial(_as_read, profile_of(instrument), asked_of(instrument))
    except GlidecalError:  # of a program with other profiles
        return lambda _: None


def _as_read(profile: Profile, query: Query, text: str) -> float | None:
    outcome = profile.parse(text, query)
    return outcome.value_mm if isinstance(outcome, IndicatorReading) else None


def _plain(text: str) -> float | None:
    """Millimetres, as tables and simulations have them."""
    try:
        return float(text)
    except ValueError:
        return None
