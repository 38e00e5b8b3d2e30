"""Writing the record of a session: a line is on the disk before anyone is told."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

from pydantic_core import PydanticSerializationError

from calib.errors import RecordError
from protocols import files
from protocols.record import (
    SESSION_FORM,
    RecordForm,
    check_record,
    check_size,
    count_readings,
    digest_of,
)
from protocols.session import FIRST_DIGEST, Closed, Event, Line, local_now


class Journal:
    """The one writer of a session file. `append` returns only when the line is on the disk.

    Everything acknowledged stays in memory too: should the file be removed, replaced or changed
    by another program, it is written again, under its name or beside it.
    """

    def __init__(self, path: Path, file: io.FileIO, form: RecordForm) -> None:
        self.path = path
        self._file = file
        self._form = form
        self._events: list[Event] = []
        self._digest = FIRST_DIGEST
        self._content = bytearray()
        self._unsure = b""
        self._stopped: RecordError | None = None

    @classmethod
    def create(cls, path: Path, opened: Line, form: RecordForm = SESSION_FORM) -> Journal:
        """Start a new record, also in an empty file that a killed program left.

        Raises RecordError where the file exists or cannot be written.
        """
        journal = cls(path, _open_new(path), form)
        try:
            with _writing(path, new=True):
                journal.append(opened)
                files.sync_folder(path.parent)
        except BaseException:
            journal.discard()
            raise
        return journal

    @classmethod
    def resume(cls, path: Path, program: str, form: RecordForm = SESSION_FORM) -> Journal:
        """Go on with an interrupted record; a torn last line is set aside in ``*.torn``.

        Raises RecordError where the record is closed, altered, a link or in use.
        """
        try:
            with _writing(path, PermissionError):
                file = files.open_to_write(path, "r+b")
        except OSError as problem:
            raise files.unreadable(f"session {path}", problem) from problem
        try:
            with _writing(path):
                _lock(path, file)
                return cls._resumed(path, file, program, form)
        except BaseException:
            files.close(file)
            raise

    @classmethod
    def _resumed(cls, path: Path, file: io.FileIO, program: str, form: RecordForm) -> Journal:
        check_size(path, os.fstat(file.fileno()).st_size)
        file.seek(0)
        content = file.readall()
        record = check_record(path, content, form)
        if record.end == "closed":
            requirement = "an interrupted one to continue"
            raise RecordError(f"session {path}", "a closed session", requirement)
        journal = cls(path, file, form)
        journal._events = list(record.events)
        journal._digest = record.digest
        journal._content = bytearray(content[: record.whole_bytes])
        if record.torn_bytes:
            journal._unsure = content[record.whole_bytes :]
            torn_path = files.unused_path(path.with_name(f"{path.name}.torn"))
            files.close(files.write_new(torn_path, journal._unsure))
        now = local_now()
        continued = form.continued(
            at=now,
            schema=form.schema,
            program=program,
            torn_bytes=record.torn_bytes,
            paused_s=round((now - record.events[-1].at).total_seconds(), 3),
        )
        journal.append(continued)
        return journal

    @property
    def events(self) -> tuple[Event, ...]:
        """Every event on the disk; of another form than that of sessions they are of that form."""
        return tuple(self._events)

    def append(self, *events: Line) -> None:
        """Write events and wait until they are on the disk: all of them or none.

        Raises RecordError where the disk refuses; the file then ends where it ended before. The
        same where the file is no longer as it was left: then for every call from now on; and where
        it was let go of.
        """
        if self._stopped:
            raise self._stopped
        if self._file.closed:
            raise RecordError(f"session {self.path}", "a closed record", "one that is still open")
        lines, placed, digest = self._placed(events)
        check_size(self.path, len(self._content) + len(lines))
        with _writing(self.path, new=len(self._events) < 2):
            self._check()
            self._cut_off()
            self._write(lines)
        self._content += lines  # first: an interruption must not leave lines of nobody
        self._unsure, self._digest = b"", digest
        self._events += placed

    def _placed(self, events: tuple[Line, ...]) -> tuple[bytes, list[Event], str]:
        """The lines of these events, the events as they will be read, the last digest."""
        digest = self._digest
        lines: list[bytes] = []
        for number, event in enumerate(events, start=len(self._events) + 1):
            chained = event.model_copy(update={"line": number, "previous": digest, "seal": ""})
            try:
                unsealed = chained.model_dump_json(exclude_none=True).encode()
            except PydanticSerializationError as problem:
                raise RecordError(
                    "session", "text that is not Unicode", "Unicode text"
                ) from problem
            # its own key comes before all text of the event
            seal = f'"seal":"{digest_of(unsealed)}"'.encode()
            lines.append(unsealed.replace(b'"seal":""', seal, 1))
            digest = digest_of(lines[-1])
        placed: list[Event] = [self._form.lines.validate_json(line) for line in lines]
        return b"".join(line + b"\n" for line in lines), placed, digest

    def _write(self, lines: bytes) -> None:
        self._file.seek(len(self._content))
        self._unsure = lines
        try:
            files.write_all(self._file, lines)
        except OSError:
            with suppress(OSError):  # else before the next line is written
                self._cut_off()
            raise

    def _check(self) -> None:
        """The file has its name and ends as it was left. Raises OSError; RecordError if not."""
        if not files.leads_to(self.path, self._file):
            self._restore()
        # so much of the end of the file is looked at before it grows
        tail = self._content[-4096:]
        self._file.seek(len(self._content) - len(tail))
        content = self._file.readall()
        if not (content.startswith(tail) and self._unsure.startswith(content[len(tail) :])):
            self._changed()

    def _restore(self) -> None:
        """Write the record again under its name, or else beside it."""
        try:
            fresh = files.write_new(self.path, bytes(self._content))
        except OSError as problem:
            self._stop(f"removed or replaced; writing it again: {files.reason_of(problem)}")
        files.close(self._file)
        self._file, self._unsure = fresh, b""

    def _changed(self) -> NoReturn:
        """Another program wrote into the file: what was acknowledged is kept, and no more taken."""
        self._file.seek(0)
        content = self._file.readall()
        if content.startswith(self._content) and _is_record(self.path, content, self._form):
            self._stopped = RecordError(
                f"session {self.path}",
                "lines of another program",
                "one writer at a time",
                "Every acknowledged reading is still in it. Leave, and look for the other program.",
            )
            raise self._stopped
        self._stop("changed by another program")

    def _stop(self, value: str) -> NoReturn:
        """Put what was acknowledged in a second place and take no more. Raises RecordError."""
        requirement = "a record that only this program changes"
        for place in _second_places(self.path):
            with suppress(OSError):
                files.close(files.write_new(place, bytes(self._content)))
                next_step = f"Every reading taken is in {place}: continue with that file."
                self._stopped = RecordError(f"session {self.path}", value, requirement, next_step)
                raise self._stopped
        advice = (
            "Nothing could be written beside it either: make room, then try again; do not leave."
        )
        raise RecordError(f"session {self.path}", value, requirement, advice)

    def _cut_off(self) -> None:
        """Take back what a failed write, or a torn line, left behind the last acknowledged one."""
        if not self._unsure:
            return
        self._file.truncate(len(self._content))
        self._unsure = b""
        os.fsync(self._file.fileno())

    def finish(self, complete: bool) -> None:
        """Write the closing event and let go of the file."""
        self.append(Closed(readings=count_readings(self.events), complete=complete))
        files.close(self._file)

    def close(self) -> None:
        """Let go of the file without closing the session: it can be continued.

        Raises RecordError where the file is not as it was left or cannot be looked at; it names
        the place of what was acknowledged.
        """
        if self._file.closed:
            return
        try:
            if self._stopped:
                raise self._stopped
            self._check()
            with suppress(OSError):  # a torn line is set aside later
                self._cut_off()
        except OSError as problem:
            self._stop(f"a disk that does not answer: {files.reason_of(problem)}")
        finally:
            files.close(self._file)

    def discard(self) -> None:
        """Let go of the file and remove it: nobody was told of anything in it."""
        if not self._file.closed:
            files.remove_open(self.path, self._file)


def _is_record(path: Path, content: bytes, form: RecordForm) -> bool:
    with suppress(RecordError):
        return bool(check_record(path, content, form))
    return False


def write_whole(
    path: Path, opened: Line, events: list[Line], form: RecordForm = SESSION_FORM
) -> None:
    """A finished record in one go, for imported and simulated sessions.

    Nothing is left behind where writing fails. Raises RecordError.
    """
    journal = Journal.create(path, opened, form)
    try:
        journal.append(*events)
        journal.finish(complete=True)
    except BaseException:
        journal.discard()
        raise


def check_new(path: Path) -> None:
    """Whether a session may begin under this name; an empty file is none yet.

    Raises RecordError.
    """
    if not path.name:
        raise RecordError("session", f"'{path}', a folder", "the name of a file")
    if path == files.STANDARD_OUTPUT:
        raise RecordError(
            "session",
            "'-', which is standard output",
            "the name of a file: a record grows on the disk",
        )
    # a regular file without a byte is left by a program that was killed as it began
    if os.path.lexists(path) and not (
        path.is_file() and not path.is_symlink() and path.stat().st_size == 0
    ):
        raise RecordError(
            f"session {path}",
            "a file that exists already",
            "a new file: a record is never overwritten",
            "Choose another name, or continue it with: glidecal run --continue SESSION.",
        )


def _open_new(path: Path) -> io.FileIO:
    """A locked file without a byte. Raises RecordError."""
    with _writing(path, new=True):
        check_new(path)
        file = files.open_to_write(path, "r+b" if os.path.lexists(path) else "x+b")
        try:
            _lock(path, file)
            check_new(path)
        except BaseException:
            files.close(file)
            raise
    return file


def _lock(path: Path, file: io.FileIO) -> None:
    """One writer at a time. Raises RecordError where another program has the session open."""
    try:
        files.lock(file)
    except BlockingIOError as problem:
        raise RecordError(
            f"session {path}", reason="in use by another glidecal", next_step="Close that one first"
        ) from problem
    except OSError as problem:
        raise RecordError(
            f"session {path}",
            f"a file that cannot be locked: {files.reason_of(problem)}",
            "a folder whose file system has locks",
            "Record on a disk of this computer and copy the closed session.",
        ) from problem


def _second_places(path: Path) -> Iterator[Path]:
    """New names for a record that lost its own: beside it, then where another disk may be."""
    folders = [path.parent]
    with suppress(RuntimeError):  # nobody's home
        folders.append(Path.home())
    for folder in (*folders, Path(tempfile.gettempdir())):
        yield files.unused_path(folder / f"{path.stem}-kept{path.suffix}")


@contextmanager
def _writing(path: Path, refused: type[OSError] = OSError, *, new: bool = False) -> Iterator[None]:
    """Raises RecordError for what the system does not let be written; of a ``new`` record no
    reading was acknowledged yet.
    """
    try:
        yield
    except refused as problem:
        next_step = "" if new else "Every reading acknowledged before is on the disk."
        if new and not path.parent.is_dir():
            next_step = "Make that folder first, or name another."
        raise RecordError(
            f"writing {path}",
            "",
            "a folder with write permission and free space",
            next_step,
            reason=files.reason_of(problem),
        ) from problem
