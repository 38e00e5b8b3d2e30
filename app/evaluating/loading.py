"""Session files that are evaluated together: their order, what none may be, what is remarkable."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from calib.errors import RecordError
from protocols.record import Record, read_record
from protocols.session import Session
from protocols.table import off_bar_words


def records_in_order(paths: Sequence[Path]) -> list[Record]:
    """Records in the order in which they were measured. Raises RecordError."""
    records = [read_record(path) for path in paths]
    return sorted(records, key=measured_first)


def measured_first(session: Record | Session) -> tuple[datetime, datetime, str]:
    """The order in which sessions were measured: the last one tells how the machine is now."""
    return session.opened.measured_at, session.opened.at, session.digest


def table_of(session: Session) -> tuple[object, ...]:
    """The readings as a table has them: the same in every import of it."""
    return tuple((r.leg, r.axis, r.posture_mm, r.text, r.mount) for r in session.readings)


def refuse_twice(sessions: Sequence[tuple[object, Session]]) -> None:
    """One session, or one table beside where it is from: its readings would count double.

    Raises RecordError with their names.
    """
    name_by_content: dict[object, object] = {}
    by_origin = sorted(sessions, key=lambda entry: entry[1].opened.origin == "imported")
    for name, session in by_origin if len(sessions) > 1 else ():
        table = table_of(session)
        contents: dict[object, str] = {session.digest or id(session): "the same session twice"}
        if table and session.opened.origin == "imported":
            contents[table] = "the same readings twice"
        for content, message in contents.items():
            if content in name_by_content:
                see = f"{message}, see {name_by_content[content]}"
                raise RecordError(f"session {name}", see, "each once")
        name_by_content |= dict.fromkeys((*contents, table), name)


def load_sessions(paths: Sequence[Path]) -> tuple[list[Session], list[str]]:
    """Sessions in the order in which they were measured, the last one tells how the machine is now;
    and warnings: no proper end, times that go back, points off the bars.

    Raises RecordError.
    """
    records = records_in_order(paths)
    refuse_twice([(record.path, record.session) for record in records])
    warnings = [record.unfinished for record in records if record.unfinished]
    sessions = [record.session for record in records]
    for session in sessions:
        back = session.time_goes_back()
        if back:
            warnings.append(
                f"{session.name}: time_s goes back at reading {back.reading}: the clock was set. "
                "Its times are not used, so drift with time cannot be computed."
            )
        if off_bar := off_bar_words(session.readings, session.opened.machine.geometry()):
            warnings.append(
                f"{session.name}: {off_bar}. They are used as if the bar continued there."
            )
    return sessions, warnings
