"""Reading and checking the record of a session.

Each line carries its number, the SHA-256 digest of the line before it and one of itself, so a
changed, missing or doubled line is found and named. A file cut anywhere opens up to its last whole
line. The digests have no key: they show accidents, not a forger.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import TypeAdapter, ValidationError

from calib.errors import RecordError
from protocols.documents import describe
from protocols.files import open_to_read, unreadable
from protocols.procedure import Step
from protocols.session import (
    EVENT,
    FIRST_DIGEST,
    SCHEMA,
    Closed,
    Continued,
    Distance,
    Event,
    Line,
    Opened,
    Reading,
    Restored,
    Session,
    Superseded,
    fold,
)

MOST_BYTES = 64_000_000
"""More than 80 000 readings."""

END_BYTES = 131_072
"""So much of the beginning and of the end of a large record tells what it is."""

COUNTED = re.compile(rb'"indicators":[12],')
"""A key of the first hours of schema 1: how many there are, which ``instruments`` tells."""

OF_ANOTHER_KIND = (
    "It is a session of another kind of machine: validate, replay, solve, diagnose, report, "
    "history, serve and export in a terminal take it, compare and verify two of one kind."
)

SCHEMA_NAME_NUMBER = re.compile(r"(.+)/([1-9][0-9]{0,8})")


class Meaning:
    """Looks at the events of one record in their order: an ``opened`` is first, a ``closed`` last,
    lines and readings count up and refer to what exists.
    """

    opened: ClassVar[type[Line]]

    def __init__(self, path: Path) -> None:
        self._path = path
        self._closed = False
        self._readings = 0
        self._superseded: set[int] = set()

    def check_place(self, number: int, event: Event) -> None:
        """Raises RecordError for one that cannot be in this line."""
        if event.line != number:
            fault = f"line number {event.line}: a line is missing, doubled or moved"
            requirement = "an unaltered record"
        elif (number == 1) != isinstance(event, self.opened):
            fault, requirement = f"event '{event.event}'", "'opened' on line 1 and only there"
        elif self._closed:
            fault, requirement = f"event '{event.event}' after 'closed'", "nothing after 'closed'"
        elif isinstance(event, Closed) and event.readings != self._readings:
            fault = f"a count of {event.readings} readings"
            requirement = f"{self._readings}, as many as there are"
        else:
            self._closed = isinstance(event, Closed)
            return
        raise self.error(number, fault, requirement)

    def check(self, number: int, event: Any) -> None:  # noqa: ANN401 (of its form)
        """Raises RecordError for one that does not follow from those before."""
        if isinstance(event, Superseded):
            missing = [n for n in event.readings if not 1 <= n <= self._readings]
            if missing:
                fault = f"reading {missing[0]} superseded before it was taken"
                raise self.error(number, fault, f"1 … {self._readings}")
            self._superseded.update(event.readings)

    def count(self, number: int, reading: int) -> None:
        """Raises RecordError where the number of a reading is not the next one."""
        self._readings += 1
        if reading != self._readings:
            raise self.error(number, f"reading {reading}", f"reading {self._readings}")

    def error(self, number: int, fault: str, requirement: str) -> RecordError:
        """The error for this line."""
        return RecordError(_subject(self._path, number), fault, requirement)


@dataclass(frozen=True)
class RecordForm:
    """What the lines of a record are.

    ``schema`` is that of what is written; all numbers before it are read.
    ``lines`` reads one, the one after a break is a ``continued``; ``meaning`` looks at their order.
    """

    schema: str
    lines: TypeAdapter[Any]
    continued: Callable[..., Line]
    meaning: type[Meaning]

    @property
    def name(self) -> str:
        """The schema without its number."""
        return self.schema.rpartition("/")[0]

    @property
    def number(self) -> int:
        """Number of the schema."""
        return int(self.schema.rpartition("/")[2])


class SessionMeaning(Meaning):
    """Distances count up, too, readings are of their steps, a mounting stays in one place."""

    opened = Opened

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._distances = 0
        self._places: dict[str, tuple[str, str, float]] = {}
        self._steps: dict[int, Step] = {}

    def check(self, number: int, event: Event) -> None:
        """Raises RecordError with the line number."""
        if isinstance(event, Reading):  # most are
            self._check_reading(number, event)
        elif isinstance(event, Opened):
            self._steps = {step.number: step for step in event.steps()}
        elif isinstance(event, Distance):
            self._distances += 1
            if event.distance != self._distances:
                fault = f"distance {event.distance}"
                raise self.error(number, fault, f"distance {self._distances}")
        elif isinstance(event, Restored):
            counting = [n for n in event.readings if n not in self._superseded]
            if counting:
                fault = f"reading {counting[0]} restored"
                raise self.error(number, fault, "readings that were superseded")
            self._superseded.difference_update(event.readings)
        else:
            super().check(number, event)

    def _check_reading(self, number: int, event: Reading) -> None:
        step = self._steps.get(event.step or 0)
        if step and (event.leg != step.leg or event.axis not in step.axes):
            fault = f"leg {event.leg}, axis {event.axis} in step {step.number}"
            requirement = f"leg {step.leg}, axis {' or '.join(step.axes)}, as in the procedure"
            raise self.error(number, fault, requirement)
        self.count(number, event.reading)
        place = event.set_up
        if self._places.setdefault(event.mount, place) != place:
            raise self.error(number, f"mounting {event.mount} in a second place", "one place")


SESSION_FORM = RecordForm(SCHEMA, EVENT, Continued, SessionMeaning)
"""Of sessions with indicators or contacts."""


def record_form(name: str) -> RecordForm:
    """The form of sessions ``glidecal.NAME-session``, which is in ``protocols/NAME_session.py``.

    Without a name that of indicators or contacts. Raises RecordError where there is none.
    """
    if not name:
        return SESSION_FORM
    with suppress(ModuleNotFoundError):
        for value in vars(import_module(f"protocols.{name}_session")).values():
            if isinstance(value, RecordForm) and value.name == f"glidecal.{name}-session":
                return value
    raise RecordError("session", f"of the form {name}", "a form that this program knows")


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

    @cached_property
    def session(self) -> Session:
        """The state after all its events."""
        return replace(fold(self.events), name=self.path.name, digest=self.digest)

    @property
    def unfinished(self) -> str:
        """One sentence about a record that was cut or is still open; empty for a closed one."""
        lines = len(self.events)
        if self.end == "torn":
            return f"{self.path.name}: cut inside line {lines + 1}; used up to line {lines}."
        if self.end == "open":
            return f"{self.path.name}: not closed after line {lines}; the session is not finished."
        return ""


def read_record(path: Path, form: RecordForm = SESSION_FORM) -> Record:
    """Read and check a session file.

    Raises RecordError naming the first line that is altered, out of order or not an event, and
    for what is no regular file or too large to be a session.
    """
    try:
        with open_to_read(path) as file:
            check_size(path, os.fstat(file.fileno()).st_size)
            content = file.readall()
    except OSError as problem:
        raise unreadable(f"session {path}", problem) from problem
    return check_record(path, content, form)


def check_record(path: Path, content: bytes, form: RecordForm = SESSION_FORM) -> Record:
    """The record with this content. Raises RecordError as `read_record` does."""
    lines = content.split(b"\n")
    _refuse_converted(path, lines[0])
    torn = lines.pop()
    events: list[Event] = []
    meaning = form.meaning(path)
    digest = FIRST_DIGEST
    for number, line in enumerate(lines, start=1):
        event = parse_line(path, number, line, form)
        meaning.check_place(number, event)
        _check_chain(path, number, lines, digest, event)
        meaning.check(number, event)
        events.append(event)
        digest = digest_of(line)
    if not events:
        raise RecordError(
            f"session {path}",
            "no whole line" if content else "an empty file: a program was stopped as it began",
            f"a session whose first line names the schema {form.schema}",
            "" if content else "Nothing was measured. Begin again under this name, or remove it.",
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


def _refuse_converted(path: Path, first: bytes) -> None:
    """Raises RecordError for a record that a program saved again in another form."""
    marked = ["\ufeff{".encode(encoding) for encoding in ("utf-8", "utf-16-le", "utf-16-be")]
    conversion = "a byte order mark before it" if first.startswith(tuple(marked)) else ""
    if first.startswith(b"{") and first.endswith(b"\r"):
        conversion = "an end as Windows writes it (CR LF)"
    if conversion:
        raise RecordError(
            _subject(path, 1),
            conversion,
            "the bytes that were written, which every digest is of",
            "An editor, mail or version control saved it again. Use an unaltered copy.",
        )


def check_size(path: Path, size_bytes: int) -> None:
    """Raises RecordError for a file that is too large to be a session."""
    if size_bytes > MOST_BYTES:
        size = f"{size_bytes / 1e6:,.1f} MB"
        raise RecordError(f"session {path}", size, f"up to {MOST_BYTES / 1e6:.0f} MB")


def read_ends(path: Path) -> tuple[Opened, list[Event]]:
    """First line and last whole lines of a record of any size, not checked against each other.

    Raises RecordError where they are no lines of a session.
    """
    try:
        with open_to_read(path) as file:
            size_bytes = os.fstat(file.fileno()).st_size
            check_size(path, size_bytes)
            first = file.read(END_BYTES).partition(b"\n")[0]
            file.seek(max(len(first), size_bytes - END_BYTES))
            last = file.read(END_BYTES).split(b"\n")[1:-1]
    except OSError as problem:
        raise unreadable(f"session {path}", problem) from problem
    opened = parse_line(path, 1, first)
    if not isinstance(opened, Opened):
        raise RecordError(f"session {path}", f"first event '{opened.event}'", "'opened'")
    return opened, [parse_line(path, 0, line) for line in last]


def digest_of(line: bytes) -> str:
    """Digest of a line without its newline."""
    return hashlib.sha256(line).hexdigest()


def parse_line(path: Path, number: int, line: bytes, form: RecordForm = SESSION_FORM) -> Event:
    """One line as an event; number 0 is somewhere in the file. Raises RecordError.

    Of another ``form`` than that of sessions with indicators it is an event of that form.
    """
    try:
        event: Event = form.lines.validate_json(line)
    except ValidationError as problem:
        fault = describe(problem)
    else:
        return event
    subject = _subject(path, number) if number else f"session {path}"
    try:
        plain = json.loads(line)
    except (ValueError, RecursionError) as problem:
        next_step = "Is it a session? glidecal import converts a table." if number == 1 else ""
        raise RecordError(subject, _excerpt(line), "one JSON event", next_step) from problem
    if isinstance(plain, dict):
        _check_not_newer(path, plain, form)
    if not isinstance(plain, dict) or "event" not in plain:
        raise RecordError(subject, _excerpt(line), f"an event of schema {form.schema}")
    if number == 1:
        _check_schema(path, plain, form)
        with suppress(ValidationError):
            return EVENT.validate_json(COUNTED.sub(b"", line))
    raise RecordError(
        subject,
        reason=fault,
        allowed=f"an event of schema {form.schema}",
        next_step="The line was changed or damaged. Use an unaltered copy.",
    )


def _subject(path: Path, number: int) -> str:
    return f"session {path}, line {number}"


def _check_chain(path: Path, number: int, lines: list[bytes], digest: str, event: Event) -> None:
    """Each line vouches for the one before it and, by its seal, for itself.

    Where two neighbours disagree, the later one is at fault if it fails its own digest too.
    """
    line = lines[number - 1]
    if event.seal or isinstance(event, Closed):
        unsealed = line.replace(f'"seal":"{event.seal}"'.encode(), b'"seal":""', 1)
        seal_fits = event.seal == digest_of(unsealed)
        fits = seal_fits and event.previous == digest
    else:  # of an older program: the line after it tells
        fits = event.previous == digest
        following = lines[number] if number < len(lines) else b""
        seal_fits = fits or f'"previous":"{digest_of(line)}"'.encode() in following
    if not fits:
        raise RecordError(
            f"session {path}, line {number - 1 if seal_fits and number > 1 else number}",
            "a content that does not fit its digest: it was changed",
            "an unaltered record",
            "Use an unaltered copy.",
        )


def count_readings(events: Sequence[Event]) -> int:
    """How many readings, superseded ones included."""
    return sum(event.event == "reading" for event in events)


def _check_not_newer(path: Path, line: dict[str, object], form: RecordForm) -> None:
    """Check a line that is not understood: the first one and ``continued`` name the schema."""
    match = SCHEMA_NAME_NUMBER.fullmatch(str(line.get("schema")))
    if match and match[1] == form.name and int(match[2]) > form.number:
        raise RecordError(
            f"session {path}",
            reason=f"written by a newer glidecal (record schema {match[2]}; this one reads up to "
            f"{form.number}): update glidecal",
        )


def _check_schema(path: Path, first: dict[str, object], form: RecordForm) -> None:
    schema = first.get("schema")
    if schema not in {f"{form.name}/{number}" for number in range(1, form.number + 1)}:
        match = SCHEMA_NAME_NUMBER.fullmatch(str(schema))
        is_other = match and match[1] != form.name and match[1].endswith("session")
        requirement = f"{form.name}/1 … {form.number}" if form.number > 1 else form.schema
        raise RecordError(
            f"session {path}, schema",
            repr(schema),
            requirement,
            OF_ANOTHER_KIND if is_other else "Not a session file.",
        )


def _excerpt(line: bytes) -> str:
    text = line[:60].decode("utf-8", errors="replace")
    return repr(text) + ("…" if len(line) > 60 else "")
