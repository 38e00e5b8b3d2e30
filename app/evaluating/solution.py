"""From session files to a solution: what the solve command and the result screen share."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import NotIdentifiable
from calib.identify.accuracy import ToolError
from calib.identify.solution import Method, Solution, Subset, Weights
from calib.identify.subset_choice import SubsetChoice, choose_subset
from calib.noise.reading import IndicatorFigures, Noise, visit_numbers
from calib.observations import Observations
from calib.ties import descending
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model
from protocols.errors import RecordError
from protocols.events import Reading
from protocols.observations import to_observations
from protocols.record import Record, read_record
from protocols.session import Session, fold


@dataclass(frozen=True, eq=False)
class Solved:
    """A solution with the choice it was made from.

    ``tool_before`` is the tool's error with what the controller holds now, ``tool_after`` what
    is expected with the solution entered, each with its standard uncertainty, for which
    ``tool_factor`` is the coverage factor (95 %). ``enlarged`` is the factor on the standard
    deviation of the noise if what the model leaves is counted as noise. ``visit_count`` counts
    readings without a movement between them as one. ``suspects`` do not fit their own repeats;
    those ``alone`` have no other posture to compare with.
    """

    names: tuple[str, ...]
    sessions: tuple[Session, ...]
    reading_count: int
    choice: SubsetChoice
    solution: Solution
    tool_before: ToolError
    tool_after: ToolError
    tool_factor: float
    enlarged: float
    visit_count: int
    suspects: tuple[Suspect, ...]
    loud: tuple[Loud, ...]
    alone: tuple[Alone, ...]

    @property
    def joint_offsets_mm(self) -> tuple[float, float, float]:
        """d_rho of joints x, y, z; 0 for a set that holds them as they are."""
        found = dict(zip(self.solution.names, map(float, self.solution.values_mm), strict=True))
        x, y, z = (found.get(name, 0.0) for name in PARAMETER_NAMES[:3])
        return x, y, z


@dataclass(frozen=True)
class Alone:
    """Readings of a mounting in one posture: without another posture they say nothing."""

    session: str
    readings: tuple[Reading, ...]


@dataclass(frozen=True)
class Loud:
    """An indicator that scatters more than the quietest: its first reading and its scatter, mm.

    ``mounting`` is False where it was used in more than one mounting; ``number`` counts from 1.
    """

    session: str
    reading: Reading
    mounting: bool
    number: int
    scatter_mm: float


@dataclass(frozen=True)
class Suspect:
    """A reading that does not fit its own repeats, its distance in standard deviations."""

    session: str
    reading: Reading
    studentised: float


def load_sessions(paths: Sequence[Path]) -> tuple[list[Session], list[str]]:
    """Sessions, and warnings about records without a proper end or with times that go back.

    Raises RecordError.
    """
    records = [read_record(path) for path in paths]
    digests = [record.digest for record in records]
    for number, record in enumerate(records):
        if record.digest in digests[:number]:
            raise RecordError(f"session {record.path}", "the same session twice", "each one once")
    warnings = [end_warning(record) for record in records if record.end != "closed"]
    sessions = [fold(record.events) for record in records]
    for path, session in zip(paths, sessions, strict=True):
        back = session.time_goes_back()
        if back:
            warnings.append(
                f"{path.name}: time_s goes back at reading {back.reading}: the clock was set. Its "
                "times are not used, so drift with time cannot be told."
            )
    return sessions, warnings


def end_warning(record: Record) -> str:
    """One sentence about a record that was cut or is still open."""
    lines = len(record.events)
    if record.end == "torn":
        return f"{record.path.name}: cut inside line {lines + 1}; used up to line {lines}."
    return f"{record.path.name}: not closed after line {lines}; the session is not finished."


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
    nominal = Model(sessions[0].opened.machine.geometry())
    choice = choose_subset(
        nominal,
        observed,
        method,
        weights=weights,
        indicator=indicator_figures(sessions),
        tolerance_mm=np.array(sessions[0].opened.machine.tolerances_mm()),
    )
    wanted = subset or choice.recommended
    if wanted not in choice.solutions:
        raise choice.refused[wanted]
    solution = choice.solutions[wanted]
    return Solved(
        names=tuple(names),
        sessions=tuple(sessions),
        reading_count=len(observed),
        choice=choice,
        solution=solution,
        tool_before=choice.error_before(wanted, nominal),
        tool_after=choice.tool_after[wanted],
        tool_factor=_tool_factor(choice, wanted),
        enlarged=solution.spread**0.5,
        visit_count=int(visit_numbers(observed).max()) + 1,
        suspects=_suspects(names, sessions, observed, solution),
        loud=_loud(names, sessions, observed, solution.noise),
        alone=_alone(names, sessions),
    )


def _tool_factor(choice: SubsetChoice, subset: Subset) -> float:
    """Coverage factor of what the tool's error is worked out from: of the full set if there is one.

    What the model leaves counts as noise there, with its own degrees of freedom.
    """
    return choice.solutions.get("both", choice.solutions[subset]).left_over_factor


def _alone(names: Sequence[str], sessions: Sequence[Session]) -> tuple[Alone, ...]:
    """Mountings of a single posture, as breaks can leave them."""
    found = []
    for name, session in zip(names, sessions, strict=True):
        mountings: dict[str, list[Reading]] = {}
        for reading in session.readings:
            mountings.setdefault(reading.mount, []).append(reading)
        found += [
            Alone(name, tuple(readings))
            for readings in mountings.values()
            if len({reading.posture_mm for reading in readings}) == 1
        ]
    return tuple(found)


def _loud(
    names: Sequence[str], sessions: Sequence[Session], observed: Observations, noise: Noise
) -> tuple[Loud, ...]:
    """Indicators with an estimate of their own, the loudest first."""
    known = [(name, r) for name, one in zip(names, sessions, strict=True) for r in one.readings]
    quiet = min(one.variance_mm2 for one in noise.indicators)
    first = np.unique(observed.indicator, return_index=True)[1]
    found = []
    for k, one in enumerate(noise.indicators):
        if one.variance_mm2 > quiet:
            mounts = np.unique(observed.mount[observed.indicator == k])
            name, reading = known[int(first[k])]
            scatter = math.sqrt(one.variance_mm2)
            found.append(Loud(name, reading, len(mounts) == 1, k + 1, scatter))
    return tuple(descending(found, lambda one: one.scatter_mm))


def _suspects(
    names: Sequence[str],
    sessions: Sequence[Session],
    observed: Observations,
    solution: Solution,
) -> tuple[Suspect, ...]:
    """The wild readings of a solution, as the sessions know them."""
    known = [(name, r) for name, one in zip(names, sessions, strict=True) for r in one.readings]
    first = np.unique(visit_numbers(observed), return_index=True)[1]
    return tuple(
        Suspect(*known[int(first[wild.row])], wild.studentised) for wild in solution.noise.wild
    )


def indicator_figures(sessions: Sequence[Session]) -> IndicatorFigures:
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
