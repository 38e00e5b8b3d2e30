"""What a command may ask a kind of machine, and what it hands over with the question."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # heavy: imported where used
    from app.report.schema.document import Report
    from app.screens.look import Look, MakeScreen
    from calib.design.criteria import Criterion

Say = Callable[[str], None]
"""Takes a line of progress, or a warning."""


@dataclass(frozen=True)
class Answer:
    """A result that can be told as text or as a document."""

    text: Callable[[], str]
    document: Callable[[], Report]

    def shown(self, *, as_json: bool) -> str:
        """One of them, as it is printed."""
        from app.report.schema.document import to_json

        return to_json(self.document()) if as_json else self.text()


@dataclass(frozen=True)
class OnScreen:
    """A result that is looked at on a screen."""

    screen: MakeScreen


@dataclass(frozen=True)
class Question:
    """A machine by its name or the path of its file, and a procedure; empty: none given."""

    machine: str
    procedure: str
    machine_file: Path | None = None


@dataclass(frozen=True)
class Search:
    """How postures are looked for; None: not given. With ``force`` a file is replaced unasked."""

    count: int | None
    criterion: Criterion
    seed: int
    starts: int
    output: Path | None
    force: bool = False


@dataclass(frozen=True)
class Simulation:
    """The machine by its name or file, None: the usual one, and the file to write, as `Search`."""

    output: Path
    machine: str | None = None
    seed: int = 1
    force: bool = False


Plan = Callable[[str | None, Sequence[Path], Any, Say], Answer]
"""Proposes the next measurement of a machine, None: that of the sessions."""


@dataclass(frozen=True)
class Family:
    """One kind of machine.

    ``name`` stands for all of ``names``; ``measured`` says what its files to solve are, ``reads``
    tells whether a file is one. ``criterion`` is what its postures are chosen by where nothing is
    asked for, ``posture_file`` what they are written to. ``options`` are by verb a class of the
    options that not every kind takes, fields with their `typer.Option`; what a person gave of them
    is the ``Any`` of the verb. Without ``plan`` there is no next measurement to propose. ``look``
    is its screen that needs no session.
    """

    name: str
    names: tuple[str, ...]
    measured: str
    criterion: str
    posture_file: str
    options: Mapping[str, type]
    reads: Callable[[Path], bool]
    identifiability: Callable[[Question, Any], Answer | OnScreen]
    postures: Callable[[Question, Search, Any, Say], Answer]
    simulate: Callable[[Simulation, Any, Say], None]
    solve: Callable[[Sequence[Path], Any, Say], Answer]
    plan: Plan | None = None
    look: Look | None = None
