"""The record of a session: append-only JSON Lines, on the disk before anyone is told.

Each line carries its number and the SHA-256 digest of the line before it, so a changed, missing
or doubled line is found and named. A file cut anywhere opens up to its last whole line.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal, TypeVar

import filelock
from pydantic import ValidationError

from protocols.documents import describe
from protocols.errors import RecordError
from protocols.events import EVENT, FIRST_DIGEST, SCHEMA, Closed, Continued, Event, Line, Opened

L = TypeVar("L", bound=Line)


@dataclass(frozen=True)
class Record:
    """A session file as read: whole events, and what is wrong with its end.

    ``end`` is ``closed`` for a finished session, ``open`` where the closing event is missing and
    ``torn`` where the last line is cut; ``whole_bytes`` is the length up to the last whole line.
    """

    path: Path
    events: tuple[Event, ...]
    end: Literal["closed", "open", "torn"]
    whole_bytes: int
    torn_bytes: int
    digest: str

    @property
    def opened(self) -> Opened:
        """The first line."""
        first = self.events[0]
        assert isinstance(first, Opened)
        return first


def read_record(path: Path) -> Record:
    """Read and check a session file.

    Raises RecordError naming the first line that is altered, out of order or not an event.
    """
    try:
        content = path.read_bytes()
    except OSError as problem:
        raise RecordError(
            f"session {path}", problem.strerror or str(problem), "a readable session file"
        ) from problem
    lines = content.split(b"\n")
    torn = lines.pop()
    events: list[Event] = []
    digest = FIRST_DIGEST
    for number, line in enumerate(lines, start=1):
        events.append(_read_line(path, number, line, digest, events))
        digest = digest_of(line)
    if not events:
        raise RecordError(
            f"session {path}",
            "no whole line" if content else "an empty file",
            f"a session whose first line names the schema {SCHEMA}",
        )
    closed = isinstance(events[-1], Closed)
    return Record(
        path=path,
        events=tuple(events),
        end="torn" if torn else "closed" if closed else "open",
        whole_bytes=len(content) - len(torn),
        torn_bytes=len(torn),
        digest=digest,
    )


def digest_of(line: bytes) -> str:
    """Digest of a line without its newline."""
    return hashlib.sha256(line).hexdigest()


def _read_line(path: Path, number: int, line: bytes, digest: str, before: list[Event]) -> Event:
    """One checked event. Raises RecordError with the line number."""
    thing = f"session {path}, line {number}"
    try:
        plain = json.loads(line)
    except ValueError as problem:
        raise RecordError(thing, _shown(line), "one JSON event") from problem
    if not isinstance(plain, dict) or "event" not in plain:
        raise RecordError(thing, _shown(line), f"an event of schema {SCHEMA}")
    if number == 1:
        _check_schema(path, plain)
    try:
        event = EVENT.validate_json(line)
    except ValidationError as problem:
        raise RecordError(thing, describe(problem), f"an event of schema {SCHEMA}") from problem
    _check_chain(path, number, line, digest, event)
    if (number == 1) != isinstance(event, Opened):
        raise RecordError(thing, f"event '{event.event}'", "'opened' on line 1 and only there")
    if before and isinstance(before[-1], Closed):
        raise RecordError(thing, f"event '{event.event}' after 'closed'", "nothing after 'closed'")
    if isinstance(event, Closed) and event.readings != _count_readings(before):
        raise RecordError(thing, f"{event.readings} readings", f"{_count_readings(before)}")
    return event


def _check_chain(path: Path, number: int, line: bytes, digest: str, event: Event) -> None:
    """Numbers count up, and each line vouches for the one before; the closing line for itself."""
    broken, found = 0, ""
    if event.line != number:
        broken, found = number, f"line number {event.line}: a line is missing, doubled or moved"
    elif event.previous != digest:
        broken, found = max(number - 1, 1), "a content that does not fit its digest: it was changed"
    elif isinstance(event, Closed) and event.seal != digest_of(_unsealed(line, event.seal)):
        broken, found = number, "a content that does not fit its digest: it was changed"
    if broken:
        raise RecordError(
            f"session {path}, line {broken}",
            found,
            "a record as the program wrote it",
            "Use an unaltered copy.",
        )


def _unsealed(line: bytes, seal: str) -> bytes:
    return line.replace(f'"seal":"{seal}"'.encode(), b'"seal":""', 1)


def _count_readings(events: list[Event] | tuple[Event, ...]) -> int:
    return sum(event.event == "reading" for event in events)


def _check_schema(path: Path, plain: dict[str, object]) -> None:
    schema = plain.get("schema")
    if schema != SCHEMA:
        newer = isinstance(schema, str) and schema.startswith("glidecal.session/")
        raise RecordError(
            f"session {path}, schema",
            repr(schema),
            SCHEMA,
            "Written by a newer glidecal: update the program." if newer else "Not a session file.",
        )


def _shown(line: bytes) -> str:
    text = line[:60].decode("utf-8", errors="replace")
    return repr(text) + ("…" if len(line) > 60 else "")


class Journal:
    """The one writer of a session file. `append` returns only when the line is on the disk."""

    def __init__(self, path: Path, file: BinaryIO, lock: filelock.BaseFileLock) -> None:
        self.path = path
        self._file = file
        self._lock = lock
        self._events: list[Event] = []
        self._digest = FIRST_DIGEST
        self._size = 0

    @classmethod
    def create(cls, path: Path, opened: Opened) -> Journal:
        """Start a new record. Raises RecordError where the file exists or cannot be written."""
        lock = _lock(path)
        try:
            file = path.open("xb", buffering=0)
        except FileExistsError as problem:
            _unlock(lock)
            raise RecordError(
                f"session {path}",
                "a file that exists already",
                "a new file: a record is never overwritten",
                "Choose another name, or continue it with: glidecal run --continue SESSION.",
            ) from problem
        except OSError as problem:
            _unlock(lock)
            raise _cannot_write(path, problem) from problem
        journal = cls(path, file, lock)
        try:
            journal.append(opened)
        except RecordError:
            journal.close()
            path.unlink(missing_ok=True)
            raise
        _sync_folder(path.parent)
        return journal

    @classmethod
    def resume(cls, path: Path, program: str) -> Journal:
        """Go on with an interrupted record; a torn last line is set aside in ``*.torn``.

        Raises RecordError where the record is closed, altered or in use.
        """
        lock = _lock(path)
        try:
            record = _read_interrupted(path)
            file = path.open("r+b", buffering=0)
            if record.torn_bytes:
                _set_torn_aside(file, path, record.whole_bytes)
        except OSError as problem:
            _unlock(lock)
            raise _cannot_write(path, problem) from problem
        except RecordError:
            _unlock(lock)
            raise
        journal = cls(path, file, lock)
        journal._events = list(record.events)
        journal._digest, journal._size = record.digest, record.whole_bytes
        journal.append(Continued(program=program, torn_bytes=record.torn_bytes))
        return journal

    @property
    def events(self) -> tuple[Event, ...]:
        """Every event on the disk."""
        return tuple(self._events)

    def append(self, *events: Line) -> None:
        """Write events and wait until they are on the disk: all of them or none.

        Raises RecordError where the disk refuses; the file then ends where it ended before.
        """
        digest, number = self._digest, len(self._events)
        lines: list[bytes] = []
        placed: list[Event] = []
        for event in events:
            number += 1
            whole = event.model_copy(update={"line": number, "previous": digest})
            line = _encoded(whole)
            if isinstance(whole, Closed):
                line = _encoded(whole.model_copy(update={"seal": digest_of(line)}))
            digest = digest_of(line)
            lines.append(line + b"\n")
            placed.append(EVENT.validate_json(line))
        content = b"".join(lines)
        try:
            self._write(content)
        except OSError as problem:
            self._take_back()
            raise _cannot_write(self.path, problem) from problem
        self._events += placed
        self._digest, self._size = digest, self._size + len(content)

    def _write(self, content: bytes) -> None:
        self._file.seek(self._size)
        left = memoryview(content)
        while left:
            left = left[self._file.write(left) :]
        os.fsync(self._file.fileno())

    def _take_back(self) -> None:
        """Cut a half-written line off again; if even that fails, reading copes with a torn end."""
        try:
            self._file.truncate(self._size)
            os.fsync(self._file.fileno())
        except OSError:
            return

    def finish(self, complete: bool) -> None:
        """Write the closing event and let go of the file."""
        self.append(Closed(readings=_count_readings(self.events), complete=complete))
        self.close()

    def close(self) -> None:
        """Let go of the file without closing the session: it can be continued."""
        self._file.close()
        _unlock(self._lock)


def _encoded(event: Line) -> bytes:
    return event.model_dump_json(exclude_none=True).encode()


def write_whole(path: Path, opened: Opened, events: list[Line], complete: bool = True) -> None:
    """A finished record in one go, for imported and simulated sessions.

    Nothing is left behind where writing fails. Raises RecordError.
    """
    journal = Journal.create(path, opened)
    try:
        journal.append(*events)
        journal.finish(complete)
    except RecordError:
        journal.close()
        path.unlink(missing_ok=True)
        raise


def _lock(path: Path) -> filelock.BaseFileLock:
    """One writer at a time. Raises RecordError where another program has the session open."""
    lock = filelock.FileLock(path.with_name(path.name + ".lock"), timeout=0)
    try:
        lock.acquire()
    except filelock.Timeout as problem:
        raise RecordError(
            f"session {path}", "in use by another glidecal", "one writer at a time"
        ) from problem
    except OSError as problem:
        raise _cannot_write(path, problem) from problem
    return lock


def _read_interrupted(path: Path) -> Record:
    record = read_record(path)
    if record.end == "closed":
        raise RecordError(f"session {path}", "a closed session", "an interrupted one to continue")
    return record


def _unlock(lock: filelock.BaseFileLock) -> None:
    """Remove the lock file while it is still held, then let go (Windows keeps an empty file)."""
    with contextlib.suppress(OSError):
        Path(lock.lock_file).unlink(missing_ok=True)
    lock.release()


def _set_torn_aside(file: BinaryIO, path: Path, whole_bytes: int) -> None:
    file.seek(whole_bytes)
    torn = file.read()
    with path.with_name(path.name + ".torn").open("ab") as aside:
        aside.write(torn + b"\n")
        aside.flush()
        os.fsync(aside.fileno())
    file.truncate(whole_bytes)
    os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """Make the new name itself durable where the system can (not on Windows)."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _cannot_write(path: Path, problem: OSError) -> RecordError:
    return RecordError(
        f"writing {path}",
        problem.strerror or str(problem),
        "a folder with write permission and free space",
        "Every reading acknowledged so far is on the disk; make room and continue the session.",
    )
