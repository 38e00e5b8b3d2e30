"""Writing the record of a session: a line is on the disk before anyone is told."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path
from typing import BinaryIO

import filelock
from pydantic_core import PydanticSerializationError

from protocols.errors import RecordError
from protocols.events import EVENT, FIRST_DIGEST, Closed, Continued, Event, Line, Opened
from protocols.record import Record, count_readings, digest_of, read_record


class Journal:
    """The one writer of a session file. `append` returns only when the line is on the disk."""

    def __init__(self, path: Path, file: BinaryIO, lock: filelock.BaseFileLock) -> None:
        self.path = path
        self._file = file
        self._lock = lock
        self._events: list[Event] = []
        self._digest = FIRST_DIGEST
        self._size = 0
        self._dirty = False

    @classmethod
    def create(cls, path: Path, opened: Opened) -> Journal:
        """Start a new record. Raises RecordError where the file exists or cannot be written."""
        lock = _lock(path)
        try:
            file = path.open("x+b", buffering=0)
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
            _sync_folder(path.parent)
        except BaseException:
            journal.close()
            path.unlink(missing_ok=True)
            raise
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
        try:
            journal.append(Continued(program=program, torn_bytes=record.torn_bytes))
        except BaseException:
            journal.close()
            raise
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
        if self._dirty:
            self._cut_off()
        if not self._still_there():
            self._restore()
        self._file.seek(self._size)
        left = memoryview(content)
        while left:
            left = left[self._file.write(left) :]
        os.fsync(self._file.fileno())

    def _still_there(self) -> bool:
        """Whether the name still leads to the open file; somebody may have deleted it."""
        try:
            return os.path.samestat(self.path.stat(), os.fstat(self._file.fileno()))
        except FileNotFoundError:
            return False

    def _restore(self) -> None:
        """Write everything that is on the disk without a name to a new file of this name."""
        self._file.seek(0)
        content = self._file.read(self._size)
        fresh = self.path.open("x+b", buffering=0)
        fresh.write(content)
        os.fsync(fresh.fileno())
        self._file.close()
        self._file = fresh

    def _take_back(self) -> None:
        """Cut a half-written line off; where even that fails, before the next line is written."""
        with contextlib.suppress(OSError):
            self._cut_off()

    def _cut_off(self) -> None:
        self._dirty = True
        self._file.truncate(self._size)
        self._dirty = False
        os.fsync(self._file.fileno())

    def finish(self, complete: bool) -> None:
        """Write the closing event and let go of the file."""
        self.append(Closed(readings=count_readings(self.events), complete=complete))
        self.close()

    def close(self) -> None:
        """Let go of the file without closing the session: it can be continued."""
        self._file.close()
        _unlock(self._lock)


def _encoded(event: Line) -> bytes:
    try:
        return event.model_dump_json(exclude_none=True).encode()
    except PydanticSerializationError as problem:
        raise RecordError("session", "text that is not Unicode", "Unicode text") from problem


def write_whole(path: Path, opened: Opened, events: list[Line], complete: bool = True) -> None:
    """A finished record in one go, for imported and simulated sessions.

    Nothing is left behind where writing fails. Raises RecordError.
    """
    journal = Journal.create(path, opened)
    try:
        journal.append(*events)
        journal.finish(complete)
    except BaseException:
        journal.close()
        path.unlink(missing_ok=True)
        raise


def _lock(path: Path) -> filelock.BaseFileLock:
    """One writer at a time. Raises RecordError where another program has the session open."""
    if not path.name:
        raise RecordError("session", f"'{path}', a folder", "the name of a file")
    if not path.parent.is_dir():  # the lock would make the folder
        raise _cannot_write(path, OSError(errno.ENOENT, "no such folder"))
    if not os.access(path.parent, os.W_OK):  # the lock would look taken
        raise _cannot_write(path, OSError(errno.EACCES, "no permission"))
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
        with contextlib.suppress(OSError):  # some network file systems refuse
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _cannot_write(path: Path, problem: OSError) -> RecordError:
    return RecordError(
        f"writing {path}",
        problem.strerror or str(problem),
        "a folder with write permission and free space",
        "What was acknowledged before is on the disk.",
    )
