"""All sessions of a folder: what each says of its machine, what changed, what drifts.

The index remembers what a record said, by the digest of all its bytes and the number of the
solver's results. It is never asked about a record that is not there byte for byte, and it may be
deleted at any time.
"""

from __future__ import annotations

import hashlib
import sqlite3
import time
from collections.abc import Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from app.evaluating.loading import table_of
from app.evaluating.posture_history import (
    PastEntry,
    PastSessions,
    PostureEntry,
    PostureHistory,
    PostureSessions,
    in_turn,
    posture_history,
)
from app.settings import cache_path
from calib.clusters import in_parallel, on_processors
from calib.control_chart import WatchedQuantity, watch
from calib.errors import GlidecalError, RecordError, UsageError
from calib.identify.accuracy import Decision
from calib.posterior.tool import days_in_tolerance, tool_field
from protocols.documents import Document, Origin, read_bytes
from protocols.machine import Machine
from protocols.record import MOST_BYTES, check_record
from protocols.session import Session

RESULTS = 12
"""Number of the solver's results: it is raised when sessions give other ones, or an `Entry` says
more. What the index remembers under another number is worked out again.
"""

ORIGINS: tuple[Origin, ...] = ("measured", "imported", "simulated")
"""In this order the histories of a folder follow each other."""

PART_S = 2.0
"""On a screen one part of a history is worked out for so long; then what is known is shown."""

DAY_S = 86_400.0
LONGEST_DAYS = 36_500.0
"""A date beyond a hundred years is none."""

E = TypeVar("E", bound=Document)


class Entry(PastEntry):
    """What one record says.

    ``offsets_mm`` are d_rho with what was entered before added: where the joints truly stand, so
    that entering offsets changes nothing. ``expanded_mm`` (95 %) is over all that may be true of
    the machine. ``adjusted`` names the mechanical state, as `Session.adjusted`.
    """

    machine: Machine
    adjusted: str | None = None
    verifies: str | None = None
    offsets_mm: tuple[float, float, float] | None = None
    expanded_mm: tuple[float, float, float] | None = None
    bound_before_mm: float = 0.0
    bound_after_mm: float = 0.0

    @property
    def name(self) -> str:
        """Name of the machine, with its serial number where one is stated."""
        return self.machine.title

    @property
    def has_result(self) -> bool:
        """Whether the record gave offsets."""
        return self.offsets_mm is not None


AnyEntry = Entry | PostureEntry


@dataclass(frozen=True, eq=False)
class MachineHistory(PastSessions[Entry]):
    """Sessions of one machine; ``joints`` are offsets x, y, z over ``days``.

    ``due`` is when the drift that is shown will have used up the tolerance, None where there is no
    drift, no tolerance or no end to be seen.
    """

    days: tuple[float, ...]
    joints: tuple[WatchedQuantity, ...]
    due: datetime | None

    @property
    def names(self) -> tuple[str | None, ...]:
        """What the machine may be called: name, serial number, or both."""
        machine = self.last.machine
        return self.machine, machine.name, machine.serial_number

    @property
    def place(self) -> str | None:
        """Where the machine is, as the last session states it."""
        return self.last.machine.place


@dataclass(frozen=True)
class History:
    """Machines by name, those that are measured in postures last; ``problems`` are files that
    cannot be used, or not as they are.

    Paths are relative to the ``folder``. So many of its ``sessions`` are still ``waiting`` to be
    worked out.
    """

    folder: Path
    all_machines: tuple[MachineHistory | PostureHistory, ...]
    problems: tuple[tuple[Path, str], ...]
    sessions: int = 0
    waiting: int = 0

    @property
    def machines(self) -> tuple[MachineHistory, ...]:
        """Machines that are measured on their legs."""
        return tuple(past for past in self.all_machines if isinstance(past, MachineHistory))

    @property
    def of_postures(self) -> tuple[PostureHistory, ...]:
        """Machines that are measured in postures."""
        return tuple(past for past in self.all_machines if isinstance(past, PostureHistory))

    def of_number(self, number: int) -> History:
        """One machine of `all_machines`; the problems are of the folder."""
        pasts = self.all_machines[number : number + 1]
        return replace(self, all_machines=pasts, problems=(), waiting=0)

    def of_shown(self, listing: History | None) -> History:
        """The machine that the ``listing`` showed, as it is known by now; else the first one."""
        past_machines = (
            [(past.machine, past.origin) for past in listing.all_machines] if listing else []
        )
        names = [(past.machine, past.origin) for past in self.all_machines]
        return self.of_number(next((k for k, name in enumerate(names) if name in past_machines), 0))

    def only(self, name: str) -> History:
        """The machines with this name, serial number or both, as `Machine.title` has them.

        Raises UsageError where there is none.
        """
        pasts = tuple(past for past in self.all_machines if name in past.names)
        if not pasts:
            allowed = ", ".join(dict.fromkeys(past.machine for past in self.all_machines))
            raise UsageError(
                "--machine", f"no sessions of {name!r}", allowed or "none has sessions"
            )
        return replace(self, all_machines=pasts)


def read_history(
    folder: Path,
    *,
    effects: bool = False,
    index: Path | None = None,
    of_postures: Sequence[PostureSessions] = (),
    within_s: float | None = None,
    processors: int = 1,
) -> History:
    """Every record below a folder; with ``effects`` each one is diagnosed, too. Sessions of other
    kinds of machines are those of ``of_postures``.

    What is not in the ``index`` (None: that of the user) is worked out and remembered, on so many
    ``processors`` if it is much; after ``within_s`` the others are left for the next time. Raises
    RecordError where there is no such folder, or no session in it.
    """
    ends_s = None if within_s is None else time.monotonic() + within_s
    if not folder.is_dir():
        reason = "a file. Name the folder that it is in" if folder.exists() else "no such folder"
        raise RecordError(f"folder {folder}", reason=reason)
    paths = sorted(folder.rglob("*.jsonl"), key=lambda path: (len(path.parts), path))
    if not paths:
        raise RecordError(
            f"folder {folder}",
            "no session file",
            "files that end with .jsonl",
            "Measure one first, or begin in the folder that has them.",
        )
    entries: dict[Path, AnyEntry] = {}
    problem_by_path: dict[Path, str] = {}
    path_by_digest: dict[str, Path] = {}
    unknown: list[tuple[Path, PostureSessions | None, bool]] = []
    with closing(Index(index or index_path())) as remembered:
        for path in paths:
            try:
                key = key_of(read_bytes(path, "session", MOST_BYTES))
                kind = next((kind for kind in of_postures if kind.reads(path)), None)
            except GlidecalError as problem:
                problem_by_path[path] = str(problem)
                continue
            if (first_path := path_by_digest.setdefault(key, path)) != path:
                problem_by_path[path] = f"{path}: the same session as {first_path}, used once."
                continue
            of_kind: type[AnyEntry] = PostureEntry if kind else Entry
            entry = remembered.get(key, of_kind)
            if entry is not None:
                entries[path] = entry
            if entry is None or (effects and entry.effects is None and entry.has_result):
                unknown.append((path, kind, effects))
        waiting = len(unknown)
        with on_processors(processors if waiting >= MANY else 1):
            results = in_parallel(_worked_out, unknown)
            while waiting and not (ends_s is not None and time.monotonic() > ends_s):
                path, key, outcome = next(results)
                waiting -= 1
                if isinstance(outcome, str):
                    problem_by_path[path] = outcome
                else:
                    remembered.put(key, outcome)
                    entries[path] = outcome
            results.close()
    return _of_entries(folder, paths, entries, problem_by_path, waiting)


MANY = 20
"""So many sessions are worth the start of further processes."""


def _of_entries(
    folder: Path,
    paths: Sequence[Path],
    entries: dict[Path, AnyEntry],
    problem_by_path: dict[Path, str],
    waiting: int,
) -> History:
    path_by_table: dict[tuple[str, str], Path] = {}
    usable: dict[tuple[bool, int, str], list[tuple[Path, Any]]] = {}
    for path in paths:
        entry, file_name = entries.get(path), path.relative_to(folder)
        if entry and entry.problem:
            problem_by_path[path] = f"{file_name}: {entry.problem}"
        if not (entry and entry.has_result) or entry.unfinished:
            continue
        first_path = path_by_table.setdefault((entry.name, entry.table or f"{path}"), path)
        if first_path != path:
            first_name = first_path.relative_to(folder)
            problem_by_path[path] = f"{file_name}: the same readings as {first_name}, used once."
            continue
        of_postures = isinstance(entry, PostureEntry)
        machine = of_postures, ORIGINS.index(entry.origin), entry.name
        usable.setdefault(machine, []).append((file_name, entry))
    machines: list[MachineHistory | PostureHistory] = []
    for (of_postures, origin, name), sessions in sorted(usable.items(), key=itemgetter(0)):
        past = posture_history if of_postures else history_of_machine
        machines.append(past(name, ORIGINS[origin], sessions))
    return History(
        folder,
        tuple(machines),
        tuple((path, problem_by_path[path]) for path in paths if path in problem_by_path),
        sessions=len(paths),
        waiting=waiting,
    )


def _worked_out(
    unknown: tuple[Path, PostureSessions | None, bool],
) -> tuple[Path, str, AnyEntry | str]:
    """A session's key in the index, and what the record says, or why it cannot be used.

    ``unknown`` is its file, the kind of machine, and whether a diagnosis is asked for.
    """
    path, kind, effects = unknown
    try:
        content = read_bytes(path, "session", MOST_BYTES)
        entry = kind.past(path, effects) if kind else _entry_of(path, content, effects=effects)
    except GlidecalError as problem:
        return path, "", str(problem)
    return path, key_of(content), entry


def key_of(content: bytes) -> str:
    """Under which the index has a record with this content."""
    return hashlib.sha256(f"{RESULTS} ".encode() + content).hexdigest()


def known_decisions(
    paths: Sequence[Path], *, index: Path | None = None
) -> dict[Path, Decision | None]:
    """Decisions on the machines as these sessions found them, where the index knows them."""
    decisions: dict[Path, Decision | None] = {}
    with closing(Index(index or index_path())) as remembered:
        for path in paths:
            with suppress(GlidecalError):
                key = key_of(read_bytes(path, "session", MOST_BYTES))
                for kind in (Entry, PostureEntry):
                    if entry := remembered.get(key, kind):
                        decisions[path] = entry.decision
    return decisions


def index_path() -> Path:
    """Path of the user's index."""
    return cache_path() / "history-3.sqlite"


def _entry_of(path: Path, content: bytes, *, effects: bool) -> Entry:
    """What a record says. Raises RecordError for one that is altered."""
    from app.evaluating.solution import decided_in, solve_sessions  # heavy: not for what is known

    record = check_record(path, content)
    session, opened = record.session, record.opened
    entry = Entry(
        began=opened.measured_at,
        dated=opened.is_dated,
        machine=opened.machine,
        adjusted=session.adjusted,
        origin=opened.origin,
        unfinished=bool(record.unfinished),
        temperature_c=opened.temperature_c,
        verifies=opened.verifies,
        table=_digest_of_table(session) if opened.origin == "imported" else "",
    )
    try:
        entered = solve_sessions([session]).correction
        names = _named(session) if effects else None
    except GlidecalError as problem:
        return entry.model_copy(update={"problem": f"{problem}"})
    assert entered.uncertainties_mm is not None  # of joint offsets alone
    x, y, z = entered.uncertainties_mm[1].tolist()
    totals = zip(opened.machine.entered_offsets_mm, entered.joint_offsets_mm, strict=True)
    tolerance_mm = opened.machine.tool_tolerance_mm
    decision = None
    if tolerance_mm is not None:
        decision = decided_in(entered.off_now, entered.frame, tolerance_mm)
    return Entry.model_validate(
        {
            **dict(entry),
            "offsets_mm": tuple(offset_mm + remaining_mm for offset_mm, remaining_mm in totals),
            "expanded_mm": (x, y, z),
            "bound_before_mm": entered.now_mm,
            "bound_after_mm": entered.bound_mm,
            "decision": decision,
            "effects": names,
            "problem": record.unfinished.removeprefix(f"{path.name}: "),
        }
    )


def _digest_of_table(session: Session) -> str:
    return hashlib.sha256(repr(table_of(session)).encode()).hexdigest()


def _named(session: Session) -> tuple[str, ...]:
    from app.evaluating.diagnosis import diagnose_sessions

    effects = diagnose_sessions([session]).diagnosis.effects
    return tuple(f"{effect.id}:{effect.where}" for effect in effects)


def history_of_machine(
    name: str, origin: Origin, entries: Iterable[tuple[Path, Entry]]
) -> MachineHistory:
    """The sessions of one machine in turn, and what changed between neighbours."""
    points = in_turn(entries, _event)
    ordered = [point.entry for point in points]
    days = [(entry.began - ordered[0].began).total_seconds() / DAY_S for entry in ordered]
    times = days if all(entry.dated for entry in ordered) else [0.0] * len(days)  # no drift of it
    rebuilt = [point.event.startswith((FILE_CHANGED, MECHANICAL)) for point in points]
    columns = zip(
        zip(*(entry.offsets_mm or () for entry in ordered), strict=True),
        zip(*(entry.expanded_mm or () for entry in ordered), strict=True),
        strict=True,
    )
    joints = tuple(watch(times, values, expanded, rebuilt) for values, expanded in columns)
    return MachineHistory(name, origin, points, tuple(days), joints, _due(ordered[-1], joints))


FILE_CHANGED, ENTERED = "machine file changed", "offsets entered"
MECHANICAL = "machine mechanically changed"


def _event(earlier: Entry, later: Entry) -> str:
    """What the records say was changed between two sessions."""
    machine, later_machine = earlier.machine, later.machine
    if machine.geometry() != later_machine.geometry():
        keys = [
            key
            for key in Machine.model_fields
            if getattr(machine, key) != getattr(later_machine, key)
        ]
        return f"{FILE_CHANGED}: {', '.join(keys)}"
    if earlier.adjusted != later.adjusted:
        return MECHANICAL
    return ENTERED if machine.entered_offsets_mm != later_machine.entered_offsets_mm else ""


def _due(last: Entry, joints: Sequence[WatchedQuantity]) -> datetime | None:
    rates = [joint.drift.per_day if joint.drift and joint.drift.shown else 0.0 for joint in joints]
    tolerance_mm = last.machine.tool_tolerance_mm
    if tolerance_mm is None or not any(rates):
        return None
    # with the offsets of the last session entered
    field, frame = tool_field(last.machine.geometry(), ()), last.machine.frame
    days = days_in_tolerance(field, frame, rates, last.bound_after_mm, tolerance_mm)
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
