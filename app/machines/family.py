"""What a command may ask a kind of machine, and what it hands over with the question."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from app.planning.request import Request

if TYPE_CHECKING:  # heavy: imported where used
    from app.report.schema.document import Report
    from calib.design.criteria import Criterion
    from calib.identify.solution import Method, Subset, Weights

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
class Search:
    """How postures are looked for; None: not given."""

    count: int | None
    criterion: Criterion | None
    budget_min: float | None
    starts: int
    repeats: bool
    common: bool
    refine: bool
    as_is: bool
    output: Path | None


@dataclass(frozen=True)
class Simulation:
    """What is to be simulated into ``output``, by the names of the options; None: not given."""

    output: Path
    seed: int = 1
    machine: str | None = None
    protocol: str | None = None
    model: Path | None = None
    scatter_mm: float = 0.002
    resolution_mm: float = 0.001
    effect: str | None = None
    size: float | None = None
    procedure: str | None = None
    postures: int | None = None
    noise_mm: float | None = None
    angle_noise_mrad: float | None = None
    errors_mm: float | None = None
    measured: tuple[str, ...] = ()
    machine_file: Path | None = None
    posture_file: Path | None = None
    truth: Path | None = None


@dataclass(frozen=True)
class Solving:
    """Files to solve, and what is asked for beyond the parameters; None: not given."""

    files: Sequence[Path]
    subset: Subset | None
    method: Method
    weights: Weights
    model: Path | None
    tolerance_mm: float | None
    show_map: bool
    monte_carlo: int
    seed: int
    truth: Path | None
    held_out: float | None


@dataclass(frozen=True)
class Family:
    """One kind of machine.

    ``name`` stands for all of ``names``; ``measured`` says what its files to solve are, ``reads``
    tells whether a file is one. ``own`` are by verb the parameters of the command that not every
    kind takes. ``look`` opens its screen and returns the exit status.
    """

    name: str
    names: tuple[str, ...]
    measured: str
    own: Mapping[str, frozenset[str]]
    reads: Callable[[Path], bool]
    identifiability: Callable[[str, Request], Answer]
    postures: Callable[[str, Request, Search, Say], Answer]
    simulate: Callable[[Simulation, Say], None]
    solve: Callable[[Solving, Say], Answer]
    look: Callable[[Request], int] | None = None
