"""Sessions in a folder with their state, newest first."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from protocols.errors import RecordError
from protocols.record import read_record
from protocols.session import fold

MOST = 12


@dataclass(frozen=True)
class Recent:
    """One session file: its state in words and whether it can go on."""

    path: Path
    state: str
    interrupted: bool


def recent_sessions(*folders: Path) -> list[Recent]:
    """The newest sessions of these folders; files that are no session are left out."""
    paths = [path for folder in folders if folder.is_dir() for path in folder.glob("*.jsonl")]
    newest = sorted(set(paths), key=lambda path: path.stat().st_mtime, reverse=True)[:MOST]
    return [found for path in newest if (found := _look_at(path)) is not None]


def _look_at(path: Path) -> Recent | None:
    try:
        record = read_record(path)
    except RecordError:
        return None
    session = fold(record.events)
    steps, done = session.steps(), session.done()
    if record.end == "closed":
        return Recent(path, f"{len(session.readings)} readings, closed", interrupted=False)
    if not steps:
        return Recent(path, f"{len(session.readings)} readings, cut", interrupted=False)
    return Recent(path, f"interrupted at step {len(done) + 1} of {len(steps)}", interrupted=True)
