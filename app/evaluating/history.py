"""All sessions of a folder: what each says of its machine, what changed, what drifts.

The index remembers what a record said, by the digest of all its bytes and the program's version. It
is never asked about a record that is not there byte for byte, and it may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import TypeVar

from pydantic import AwareDatetime, ValidationError

from app.evaluating.posture_history import (
    Origin,
    Point,
    PostureEntry,
    PostureHistory,
    PostureSessions,
    in_turn,
    posture_history,
)
from app.settings import cache_path
from app.version import version
from calib.control_chart import Watched, watch
from calib.errors import GlidecalError, RecordError
from calib.identify.accuracy import days_in_tolerance
from protocols.documents import Document, read_bytes
from protocols.machine import Machine
from protocols.record import MOST_BYTES, check_record
from protocols.session import Session, is_dated, measured_at

ORIGINS = ("measured", "imported", "simulated")
"""In this order the histories of a folder follow each other."""

DAY_S = 86_400.0
LONGEST_DAYS = 36_500.0
"""A date beyond a hundred years is none."""

E = TypeVar("E", bound=Document)


class Entry(Document):
    """What one record says; ``problem`` in place of a result where it gives none.

    ``offsets_mm`` are d_rho with what was entered before added: where the joints truly stand, so
    that entering offsets changes nothing. ``expanded_mm`` (95 %) is over all
    that may be true of the machine. ``effects`` are None where nobody asked for a diagnosis.
    ``dated`` is false for an imported table whose day nobody stated.
    """

    began: AwareDatetime
    dated: bool = True
    machine: Machine
    origin: Origin = "measured"
    unfinished: bool = False
    temperature_c: float | None = None
    verifies: str | None = None
    offsets_mm: tuple[float, float, float] | None = None
    expanded_mm: tuple[float, float, float] | None = None
    bound_before_mm: float = 0.0
    bound_after_mm: float = 0.0
    effects: tuple[str, ...] | None = None
    problem: str = ""

    @property
    def has_result(self) -> bool:
        """Whether the record gave offsets."""
        return self.offsets_mm is not None


AnyEntry = Entry | PostureEntry


@dataclass(frozen=True, eq=False)
class MachineHistory:
    """Sessions of one machine by their date; ``joints`` are offsets x, y, z over ``days``.

    Machines are known apart by name and serial number; ``machine`` is both.
    ``origin`` is that of all of them: what was simulated or imported is no part of a machine's own
    history.

    ``due`` is when the drift that is shown will have used up the tolerance, None where there is no
    drift, no tolerance or no end to be seen.
    """

    machine: str
    origin: str
    points: tuple[Point[Entry], ...]
    days: tuple[float, ...]
    joints: tuple[Watched, ...]
    due: datetime | None

    @property
    def last(self) -> Entry:
        """Of the last session."""
        return self.points[-1].entry


@dataclass(frozen=True)
class History:
    """Machines by name, those that are measured in postures apart; ``problems`` are files that
    cannot be used, or not as they are.
    """

    folder: Path
    machines: tuple[MachineHistory, ...]
    problems: tuple[tuple[Path, str], ...]
    of_postures: tuple[PostureHistory, ...] = ()


def read_history(
    folder: Path,
    *,
    effects: bool = False,
    index: Path | None = None,
    of_postures: Sequence[PostureSessions] = (),
) -> History:
    """Every record below a folder; with ``effects`` each one is diagnosed, too. Sessions of other
    kinds of machines are those of ``of_postures``.

    What is not in the ``index`` (None: that of the user) is solved and remembered. Raises
    RecordError where there is no such folder, or no session in it.
    """
    if not folder.is_dir():
        raise RecordError(f"folder {folder}", reason="no such folder")
    paths = sorted(folder.rglob("*.jsonl"), key=lambda path: (len(path.parts), path))
    if not paths:
        raise RecordError(
            f"folder {folder}",
            "no session file",
            "files that end with .jsonl",
            "Measure one first, or begin in the folder that has them.",
        )
    problems: list[tuple[Path, str]] = []
    files: dict[tuple[str, Origin], list[tuple[Path, Entry]]] = {}
    posture_files: dict[tuple[str, Origin], list[tuple[Path, PostureEntry]]] = {}
    path_by_digest: dict[str, Path] = {}
    with closing(Index(index or cache_path() / "history-2.sqlite")) as remembered:
        for path in paths:
            try:
                digest, entry = _entry_of(path, remembered, of_postures, effects=effects)
            except GlidecalError as problem:
                problems.append((path, str(problem)))
                continue
            if (first_path := path_by_digest.setdefault(digest, path)) != path:
                problems.append((path, f"{path}: the same session as {first_path}, used once."))
                continue
            if entry.problem:
                problems.append((path, entry.problem))
            if not entry.has_result or entry.unfinished:
                continue
            if isinstance(entry, PostureEntry):
                of_machine = entry.name, entry.origin
                posture_files.setdefault(of_machine, []).append((path, entry))
            else:
                files.setdefault((entry.machine.title, entry.origin), []).append((path, entry))
    machines = [history_of_machine(*key, files[key]) for key in sorted(files, key=_by_origin)]
    measured_in_postures = [
        posture_history(*key, posture_files[key]) for key in sorted(posture_files, key=_by_origin)
    ]
    return History(folder, tuple(machines), tuple(problems), tuple(measured_in_postures))


def _by_origin(key: tuple[str, Origin]) -> tuple[int, tuple[str, Origin]]:
    return ORIGINS.index(key[1]), key


def _entry_of(
    path: Path, remembered: Index, of_postures: Sequence[PostureSessions], *, effects: bool
) -> tuple[str, AnyEntry]:
    content = read_bytes(path, "session", MOST_BYTES)
    key, kind = key_of(content), next((kind for kind in of_postures if kind.reads(path)), None)
    entry: AnyEntry | None = (
        remembered.get(key, Entry) if kind is None else remembered.get(key, PostureEntry)
    )
    if entry is None or (effects and entry.effects is None and entry.has_result):
        if kind is None:
            entry = _told_by(path, content, effects=effects)
        else:
            entry = kind.past(path, effects)
        remembered.put(key, entry)
    return key, entry


def key_of(content: bytes) -> str:
    """Under which the index has a record with this content."""
    return hashlib.sha256(version().encode() + content).hexdigest()


def _told_by(path: Path, content: bytes, *, effects: bool) -> Entry:
    """What a record says. Raises RecordError for one that is altered."""
    from app.evaluating.solution import solve_sessions  # heavy: not for what is known

    record = check_record(path, content)
    session, opened = record.session, record.opened
    entry = Entry(
        began=measured_at(opened),
        dated=is_dated(opened),
        machine=opened.machine,
        origin=opened.origin,
        unfinished=bool(record.unfinished),
        temperature_c=opened.temperature_c,
        verifies=opened.verifies,
    )
    try:
        solved = solve_sessions([session])
        entered = solved.correction
        half_widths_mm = solved.corrections.half_widths_mm()
        named = _named(session) if effects else None
    except GlidecalError as problem:
        return entry.model_copy(update={"problem": f"{path.name}: {problem}"})
    x, y, z = half_widths_mm.tolist()
    totals = zip(opened.machine.entered_offsets_mm, solved.joint_offsets_mm, strict=True)
    return Entry.model_validate(
        {
            **dict(entry),
            "offsets_mm": tuple(entered + remaining for entered, remaining in totals),
            "expanded_mm": (x, y, z),
            "bound_before_mm": entered.now_mm,
            "bound_after_mm": entered.bound_mm,
            "effects": named,
            "problem": record.unfinished,
        }
    )


def _named(session: Session) -> tuple[str, ...]:
    from app.evaluating.diagnosis import diagnose_sessions

    effects = diagnose_sessions([session]).diagnosis.effects
    return tuple(f"{effect.id}:{effect.where}" for effect in effects)


def history_of_machine(
    name: str, origin: str, entries: Iterable[tuple[Path, Entry]]
) -> MachineHistory:
    """The sessions of one machine in turn, and what changed between neighbours."""
    points = in_turn(entries, _event)
    ordered = [point.entry for point in points]
    days = [(entry.began - ordered[0].began).total_seconds() / DAY_S for entry in ordered]
    known = days if all(entry.dated for entry in ordered) else [0.0] * len(days)  # no drift of it
    rebuilt = [point.event.startswith(MECHANICAL) for point in points]
    columns = zip(
        zip(*(entry.offsets_mm or () for entry in ordered), strict=True),
        zip(*(entry.expanded_mm or () for entry in ordered), strict=True),
        strict=True,
    )
    joints = tuple(watch(known, values, expanded, rebuilt) for values, expanded in columns)
    return MachineHistory(name, origin, points, tuple(days), joints, _due(ordered[-1], joints))


MECHANICAL, ENTERED = "machine changed", "offsets entered"


def _event(before: Entry, after: Entry) -> str:
    """What the records say was changed between two sessions."""
    machine, later_machine = before.machine, after.machine
    if machine == later_machine:
        return ""
    if machine.geometry() != later_machine.geometry():
        keys = [
            key
            for key in Machine.model_fields
            if getattr(machine, key) != getattr(later_machine, key)
        ]
        return f"{MECHANICAL}: {', '.join(keys)}"
    return ENTERED if machine.entered_offsets_mm != later_machine.entered_offsets_mm else ""


def _due(last: Entry, joints: Sequence[Watched]) -> datetime | None:
    rates = [joint.drift.per_day if joint.drift and joint.drift.shown else 0.0 for joint in joints]
    tolerance_mm = last.machine.tool_tolerance_mm
    if tolerance_mm is None or not any(rates):
        return None
    # with the offsets of the last session entered
    days = days_in_tolerance(last.machine.geometry(), rates, last.bound_after_mm, tolerance_mm)
    return last.began + timedelta(days=days) if days < LONGEST_DAYS else None


class Index:
    """Entries by digest in one SQLite file; without a file that can be used, for this time only."""

    def __init__(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # SQLite follows links, and no file is written through one
            self._data = self._opened(":memory:" if path.is_symlink() else path)
        except sqlite3.OperationalError:  # no such place, or somebody else has it
            self._data = self._opened(":memory:")
        except (OSError, sqlite3.DatabaseError) as problem:
            if isinstance(problem, sqlite3.DatabaseError):  # no index any more: made again
                path.unlink()
            self._data = self._opened(":memory:" if isinstance(problem, OSError) else path)

    @staticmethod
    def _opened(path: Path | str) -> sqlite3.Connection:
        data = sqlite3.connect(path, isolation_level=None, timeout=2.0)
        data.execute("PRAGMA synchronous = OFF")  # what is lost is made again from the records
        data.execute("CREATE TABLE IF NOT EXISTS entry (digest TEXT PRIMARY KEY, said TEXT)")
        data.execute("SELECT digest, said FROM entry LIMIT 1").fetchone()
        return data

    def get(self, digest: str, kind: type[E]) -> E | None:
        """None where there is none that can be read."""
        with suppress(sqlite3.Error, ValidationError):
            rows = self._data.execute("SELECT said FROM entry WHERE digest = ?", (digest,))
            for (text,) in rows:
                return kind.model_validate_json(text)
        return None

    def put(self, digest: str, entry: Document) -> None:
        """Remember, where that can be done."""
        with suppress(sqlite3.Error):  # another process writes, the disk is full: next time
            row = (digest, entry.model_dump_json())
            self._data.execute("INSERT OR REPLACE INTO entry VALUES (?, ?)", row)

    def close(self) -> None:
        """Let go of the file."""
        self._data.close()
