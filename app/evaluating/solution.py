"""From session files to a solution: what the solve command and the result screen share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from calib.errors import NotIdentifiable, RecordError, UsageError
from calib.identify.accuracy import ToolError
from calib.identify.solution import Method, Solution, Subset, Weights
from calib.identify.subset_choice import SubsetChoice, choose_subset
from calib.noise.reading import (
    IndicatorFigures,
    NoisyIndicator,
    noisy_indicators,
    single_posture_rows,
    visit_starts,
)
from calib.observations import Observations
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model
from protocols.events import Reading
from protocols.observations import to_observations
from protocols.record import Record, read_record
from protocols.session import Session, fold
from protocols.table import off_bar_words

if TYPE_CHECKING:  # asked for by option only
    from calib.identify.fit import Size
    from protocols.machine import Machine
    from protocols.model_file import ModelFile


@dataclass(frozen=True, eq=False)
class SessionSolution:
    """A solution with the choice it was made from.

    ``tool_before`` is the tool's error with what the controller holds now, ``tool_after`` what
    is expected with the solution entered, each with its standard uncertainty, for which
    ``tool_factor`` is the coverage factor (95 %). ``visit_count`` counts readings without a
    movement between them as one. ``suspects`` do not fit their own repeats,
    ``isolated`` readings have no other posture to compare with. ``ambiguous`` are effects of the
    model that stand for a set of which any would do.
    """

    names: tuple[str, ...]
    sessions: tuple[Session, ...]
    observed: Observations
    choice: SubsetChoice
    solution: Solution
    tool_before: ToolError
    tool_after: ToolError
    tool_factor: float
    visit_count: int
    suspects: tuple[Suspect, ...]
    noisy: tuple[NoisyChannel, ...]
    isolated: tuple[IsolatedReadings, ...]
    ambiguous: tuple[str, ...]

    def with_subset(self, subset: Subset) -> SessionSolution:
        """Another set of the same choice; nothing is fitted again. Raises NotIdentifiable."""
        known = self.names, self.sessions, self.observed, self.choice
        return _solved(*known, subset, self.ambiguous)

    @property
    def reading_count(self) -> int:
        """How many readings count."""
        return len(self.observed)

    @property
    def joint_offsets_mm(self) -> tuple[float, float, float]:
        """d_rho of joints x, y, z; 0 for a set that holds them as they are."""
        found = dict(zip(self.solution.names, map(float, self.solution.values_mm), strict=True))
        x, y, z = (found.get(name, 0.0) for name in PARAMETER_NAMES[:3])
        return x, y, z


@dataclass(frozen=True)
class IsolatedReadings:
    """Readings of a mounting in one posture: without another posture they say nothing."""

    session: str
    readings: tuple[Reading, ...]


@dataclass(frozen=True)
class NoisyChannel:
    """An indicator that scatters more than the quietest, and its first reading."""

    session: str
    reading: Reading
    indicator: NoisyIndicator


@dataclass(frozen=True)
class Suspect:
    """A reading that does not fit its own repeats, its distance in standard deviations."""

    session: str
    reading: Reading
    studentised: float


def load_sessions(paths: Sequence[Path]) -> tuple[list[Session], list[str]]:
    """Sessions, and warnings: no proper end, times that go back, points off the bars.

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
        if off_bar := off_bar_words(session.readings, session.opened.machine.geometry()):
            warnings.append(f"{path.name}: {off_bar}. They are used as if the bar went on there.")
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
    model: ModelFile | None = None,
) -> SessionSolution:
    """Identify; without a subset the recommended one is taken.

    The sizes of a model's effects are fitted with the parameters. Raises NotIdentifiable where the
    readings do not determine what was asked for, UsageError for a model of another machine.
    """
    observed = to_observations(sessions)
    machine = sessions[0].opened.machine
    start, sizes = (Model(machine.geometry()), ()) if model is None else _of(model, machine, method)
    choice = choose_subset(
        start,
        observed,
        method,
        weights=weights,
        indicator=indicator_figures(sessions),
        tolerance_mm=machine.tolerances_mm(),
        sizes=sizes,
    )
    ambiguous: tuple[str, ...] = ()
    if model is not None:
        from protocols.model_file import ambiguous_effects

        ambiguous = ambiguous_effects(model)
    return _solved(names, sessions, observed, choice, subset or choice.recommended, ambiguous)


def _of(model: ModelFile, machine: Machine, method: Method) -> tuple[Model, tuple[Size, ...]]:
    """Where a fit with this model begins, and what it frees of the effects."""
    from app.evaluating.own_effects import known_effects  # files of users: only where asked for
    from protocols.model_file import sizes_of, to_model

    if replace(model.machine.geometry(), load=machine.load) != machine.geometry():
        raise UsageError(
            "--model",
            f"the model of another machine, {model.machine.name}",
            f"one of {machine.name} as the session has it",
        )
    if model.effects and method != "exact":
        raise UsageError("--method with --model", method, "exact: sizes of effects are fitted, too")
    effects = known_effects()
    return to_model(model, "model", effects), sizes_of(model, effects)


def _solved(
    names: Sequence[str],
    sessions: Sequence[Session],
    observed: Observations,
    choice: SubsetChoice,
    subset: Subset,
    ambiguous: tuple[str, ...],
) -> SessionSolution:
    """One set of a choice, with what its readings tell, as the sessions know them."""
    if subset not in choice.solutions:
        raise choice.refused[subset]
    solution = choice.solutions[subset]
    nominal = Model(sessions[0].opened.machine.geometry())
    known = [(name, r) for name, one in zip(names, sessions, strict=True) for r in one.readings]
    starts: list[int] = visit_starts(observed).tolist()
    return SessionSolution(
        names=tuple(names),
        sessions=tuple(sessions),
        observed=observed,
        choice=choice,
        solution=solution,
        tool_before=choice.error_before(subset, nominal),
        tool_after=choice.tool_after[subset],
        tool_factor=choice.tool_factor(subset),
        visit_count=len(starts),
        suspects=tuple(
            Suspect(*known[starts[wild.row]], wild.studentised) for wild in solution.noise.wild
        ),
        noisy=tuple(
            NoisyChannel(*known[one.row], one) for one in noisy_indicators(observed, solution.noise)
        ),
        isolated=tuple(
            IsolatedReadings(known[rows[0]][0], tuple(known[row][1] for row in rows))
            for rows in single_posture_rows(observed)
        ),
        ambiguous=ambiguous,
    )


def indicator_figures(sessions: Sequence[Session]) -> IndicatorFigures:
    """The worst that is stated or seen of the indicators of all sessions.

    ``resolution_mm`` is the coarsest stated of an indicator or with a reading, ``step_mm`` the
    coarsest step in which the readings of a session are written down.
    """

    def worst(figures: Iterable[float | None]) -> float | None:
        return max((figure for figure in figures if figure is not None), default=None)

    stated = [one for session in sessions for one in session.opened.instruments]
    shown = [reading for session in sessions for reading in session.readings]
    return IndicatorFigures(
        resolution_mm=worst(
            [*(one.resolution_mm for one in stated), *(one.resolution_mm for one in shown)]
        ),
        repeatability_mm=worst(one.repeatability_mm for one in stated),
        step_mm=worst(session.step_mm for session in sessions),
    )


def solve_files(
    paths: Sequence[Path],
    *,
    subset: Subset | None = None,
    method: Method = "exact",
    weights: Weights = "equal",
    model: Path | None = None,
) -> tuple[SessionSolution, list[str]]:
    """`load_sessions` and `solve_sessions` in one step, with the warnings."""
    sessions, warnings = load_sessions(paths)
    if not sessions:
        raise NotIdentifiable("sessions", "none", "at least one session")
    names = [path.name for path in paths]
    known = None
    if model:
        from protocols.model_file import read_model_file

        known = read_model_file(model)
    solved = solve_sessions(
        names, sessions, subset=subset, method=method, weights=weights, model=known
    )
    return solved, warnings


def solve_for_controller(path: Path) -> SessionSolution:
    """The solution whose offsets go into the controller: joint offsets, exact fit."""
    solved, _ = solve_files([path], subset="joint-offsets")
    return solved
