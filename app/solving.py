"""From session files to a solution: what the solve command and the result screen share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import NotIdentifiable
from calib.noise import IndicatorFigures
from calib.orthoglide.model import Model
from calib.solution import Method, Solution, Subset, Weights
from calib.subset_choice import SubsetChoice, choose_subset
from protocols.errors import RecordError
from protocols.observations import to_observations
from protocols.record import Record, read_record
from protocols.session import Session, fold


@dataclass(frozen=True, eq=False)
class Solved:
    """A solution with the choice it was made from."""

    names: tuple[str, ...]
    sessions: tuple[Session, ...]
    reading_count: int
    choice: SubsetChoice
    solution: Solution


def load_sessions(paths: Sequence[Path]) -> tuple[list[Session], list[str]]:
    """Sessions and warnings about records that have no proper end. Raises RecordError."""
    records = [read_record(path) for path in paths]
    digests = [record.digest for record in records]
    for number, record in enumerate(records):
        if record.digest in digests[:number]:
            raise RecordError(f"session {record.path}", "the same session twice", "each one once")
    warnings = [end_warning(record) for record in records if record.end != "closed"]
    return [fold(record.events) for record in records], warnings


def end_warning(record: Record) -> str:
    """One sentence about a record that was cut or is still open."""
    lines = len(record.events)
    if record.end == "torn":
        return f"{record.path}: cut inside line {lines + 1}; used up to line {lines}."
    return f"{record.path}: not closed after line {lines}; the session is not finished."


def solve_sessions(
    names: Sequence[str],
    sessions: Sequence[Session],
    *,
    subset: Subset | None = None,
    method: Method = "exact",
    weights: Weights = "equal",
) -> Solved:
    """Identify; without a subset the recommended one is taken.

    Raises NotIdentifiable where the readings do not determine what was asked for.
    """
    observed = to_observations(sessions)
    choice = choose_subset(
        Model(sessions[0].opened.machine.geometry()),
        observed,
        method,
        weights=weights,
        indicator=_indicator_figures(sessions),
        tolerance_mm=np.array(sessions[0].opened.machine.tolerances_mm()),
    )
    wanted = subset or choice.recommended
    if wanted not in choice.solutions:
        raise choice.refused[wanted]
    solution = choice.solutions[wanted]
    return Solved(tuple(names), tuple(sessions), len(observed), choice, solution)


def _indicator_figures(sessions: Sequence[Session]) -> IndicatorFigures:
    """The worst that is stated or seen of the indicators of all sessions."""

    def worst(figures: Iterable[float | None]) -> float | None:
        return max((figure for figure in figures if figure is not None), default=None)

    return IndicatorFigures(
        resolution_mm=worst(session.resolution_mm for session in sessions),
        repeatability_mm=worst(session.repeatability_mm for session in sessions),
        step_mm=worst(session.step_mm for session in sessions),
    )


def solve_files(
    paths: Sequence[Path],
    *,
    subset: Subset | None = None,
    method: Method = "exact",
    weights: Weights = "equal",
) -> tuple[Solved, list[str]]:
    """`load_sessions` and `solve_sessions` in one step, with the warnings."""
    sessions, warnings = load_sessions(paths)
    if not sessions:
        raise NotIdentifiable("sessions", "none", "at least one session")
    names = [path.name for path in paths]
    return solve_sessions(names, sessions, subset=subset, method=method, weights=weights), warnings


def solve_for_controller(path: Path) -> Solved:
    """The solution whose offsets go into the controller: joint offsets, exact fit."""
    solved, _ = solve_files([path], subset="joint-offsets")
    return solved
