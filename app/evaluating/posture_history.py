"""The past of a machine that is measured in postures: what each session says, and what changed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from pydantic import AwareDatetime

from calib.identify.accuracy import Decision
from protocols.documents import Document, Origin


class PastEntry(Document):
    """What one record says of its machine; ``problem`` in place of a result where it gives none.

    ``decision`` is on the machine as it was found, None without a tolerance in its file.
    ``effects`` are None where nobody asked for a diagnosis. ``dated`` is false for an imported
    table whose day nobody stated. ``table`` is a digest of the readings of an imported table.
    """

    began: AwareDatetime
    dated: bool = True
    origin: Origin = "measured"
    unfinished: bool = False
    temperature_c: float | None = None
    decision: Decision | None = None
    effects: tuple[str, ...] | None = None
    problem: str = ""
    table: str = ""


class PostureEntry(PastEntry):
    """What a record of postures says.

    ``name`` is that of the machine before any calibration, ``machine`` its file by keys.
    ``now_mm`` is how far the platform was off, r.m.s. over the box, ``bound_mm`` (95 %) how far it
    is at most with the calibrated machine, None where that is not known.
    """

    name: str
    machine: dict[str, Any]
    procedure: str = ""
    postures: int = 0
    now_mm: float | None = None
    bound_mm: float | None = None

    @property
    def has_result(self) -> bool:
        """Whether the record gave a machine."""
        return self.now_mm is not None


class PostureSessions(Protocol):
    """Sessions of a kind of machine."""

    @property
    def reads(self) -> Callable[[Path], bool]:
        """Whether a file is one of them."""

    @property
    def past(self) -> Callable[[Path, bool], PostureEntry]:
        """What a file says, with a diagnosis where that is asked for."""


E = TypeVar("E", bound=PastEntry)


@dataclass(frozen=True)
class Point(Generic[E]):
    """A session with a result; ``event`` is what changed before it, empty for nothing known."""

    path: Path
    entry: E
    event: str


def in_turn(
    entries: Iterable[tuple[Path, E]], changed: Callable[[E, E], str]
) -> tuple[Point[E], ...]:
    """The sessions of one machine by their date, and what ``changed`` between neighbours."""
    ordered = sorted(entries, key=lambda pair: (pair[1].began, pair[0]))
    events = ["", *(changed(a, b) for (_, a), (_, b) in pairwise(ordered))]
    return tuple(Point(*pair, event) for pair, event in zip(ordered, events, strict=True))


@dataclass(frozen=True)
class PastSessions(Generic[E]):
    """Sessions of one machine by their date, all of one origin.

    Machines are known apart by name and serial number; ``machine`` is both. What was simulated or
    imported is no part of a machine's own history.
    """

    machine: str
    origin: Origin
    points: tuple[Point[E], ...]

    @property
    def last(self) -> E:
        """Entry of the last session."""
        return self.points[-1].entry

    @property
    def names(self) -> tuple[str | None, ...]:
        """What the machine may be called."""
        return (self.machine,)

    @property
    def place(self) -> str | None:
        """Where the machine is."""
        return None


class PostureHistory(PastSessions[PostureEntry]):
    """Sessions of postures of one machine."""


def posture_history(
    name: str, origin: Origin, entries: Iterable[tuple[Path, PostureEntry]]
) -> PostureHistory:
    """The sessions of one machine in turn, and what changed between neighbours."""
    return PostureHistory(name, origin, in_turn(entries, _event))


def _event(earlier: PostureEntry, later: PostureEntry) -> str:
    """What the machine files say was changed between two sessions."""
    keys = [key for key, value in later.machine.items() if earlier.machine.get(key) != value]
    keys = [key for key in keys if key not in ("name", "schema")]
    return f"machine file changed: {', '.join(keys)}" if keys else ""
