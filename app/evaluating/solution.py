"""From session files to a solution: what the solve command and the result screen share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from app.evaluating.correction import ControllerCorrections, SessionCorrection
from app.evaluating.loading import load_sessions
from app.evaluating.printer import PrinterChange, printer_change
from app.evaluating.tolerance import check_tolerance
from calib.arrays import FloatArray, Observations, descending, joined_values
from calib.errors import NotIdentifiable, RecordError, UsageError, check_choice
from calib.identify.accuracy import Decision, decide
from calib.identify.fit import plane_tilts_mrad
from calib.identify.identify import IdentificationCase
from calib.identify.monte_carlo import Campaign, MonteCarlo, simulate_and_identify
from calib.identify.solution import Difference, Method, Solution, Subset, TabledEstimate, Weights
from calib.identify.subset_choice import SubsetChoice
from calib.noise.reading import (
    Noise,
    NoisyIndicator,
    noisy_indicators,
    single_posture_rows,
    still_rows,
    visit_starts,
)
from calib.quantity import Quantity
from calib.stats import normal_scores
from calib.tripod.curves import LegCurve, leg_curves
from calib.tripod.pipeline import MOVES_THE_TOOL, Model
from protocols.data_table import DataTable, Tabled
from protocols.machine import Frame
from protocols.observations import indicator_figures, to_observations
from protocols.session import Distance, Reading, Session

if TYPE_CHECKING:  # asked for by option only
    from pandas import DataFrame

    from calib.diagnosis.results import Verdict
    from calib.identify.fit import Size
    from calib.posterior.correction import Holds, ToolOff
    from calib.tripod.effects.effect import AdoptedLaws
    from calib.tripod.workspace import PlaneMap
    from protocols.machine import Machine
    from protocols.model_file import ModelFile


BEYOND_CHANCE = 4.0
"""Standard deviations; by chance one of 16,000 distances between marks is further off."""


@dataclass(frozen=True)
class FurthestDistance:
    """A ``distance`` in the record of ``session``, longer than all else tells.

    By so many standard ``deviations``; shorter where they are negative.
    """

    session: str
    distance: Distance
    deviations: float


@dataclass(frozen=True, eq=False)
class SessionSolution(Tabled):
    """What to enter, and one of the papers' sets as a view beside it, with what readings tell.

    ``view`` is the set that was asked for, None: the usual one. ``holds`` is what the controller
    can hold. ``ambiguous`` are effects of the model that stand for a set of which any would do,
    ``held`` sizes of the model that a person stated; ``warnings`` are those of the session files.
    """

    sessions: tuple[Session, ...]
    observations: Observations
    choice: SubsetChoice
    corrections: ControllerCorrections
    view: Subset | None = None
    holds: Holds = "offsets"
    ambiguous: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sessions."""
        return tuple(session.name for session in self.sessions)

    @property
    def subset(self) -> Subset:
        """The set that is shown. Raises NotIdentifiable where none is determined."""
        return self.view or self.choice.usual

    @property
    def solution(self) -> Solution:
        """The solution of the set that is shown. Raises NotIdentifiable."""
        return self.choice.solution(self.subset)

    @property
    def view_solution(self) -> Solution | None:
        """`solution`; None where the readings determine no set, though they tell what to enter."""
        return self.solution if self.view or self.choice.solutions else None

    @property
    def frame(self) -> Frame:
        """What is free where the tool is judged."""
        return self.corrections.frame

    @property
    def correction(self) -> SessionCorrection:
        """What to enter in the controller. Raises NotIdentifiable."""
        return self.corrections.of(self.holds)

    @cached_property
    def printer_change(self) -> PrinterChange | None:
        """What the owner of a printer changes in its firmware; None for another machine."""
        machine = self.sessions[0].opened.machine
        contacts = [reading for _, reading in self.visits] if self.of_contacts else []
        repeats = self.noise if self.noise.source == "repeats" else None
        scatter_mm = repeats.scatter_of_repeats[0] if repeats else None
        return printer_change(machine, self.corrections, contacts, scatter_mm)

    @cached_property
    def lines(self) -> tuple[LineParameter, ...]:
        """Parameters of the drives' lines of which the machine file has tolerances."""
        tolerances = self.sessions[-1].opened.machine.geometry_tolerances()
        parameters = []
        for (law, place), tolerance in tolerances.items():
            if law.stage not in MOVES_THE_TOOL:
                continue
            value, deviation = self.corrections.posterior.value_of((law, place))
            unit = law.parameters[0].unit
            parameters.append(LineParameter(law.id, place, value, 2.0 * deviation, tolerance, unit))
        return tuple(parameters)

    @property
    def entered(self) -> PrinterChange | SessionCorrection:
        """What is shown first and entered: all values of a printer, else those that are held."""
        return self.printer_change or self.correction

    def work_out(self) -> SessionSolution:
        """Work out every correction and its bounds: later they take no time."""
        _, change = self.corrections.others(self.correction), self.printer_change
        off = change.off if change else self.correction.off
        _ = self.correction.off_now.bound_mm, off.bound_mm, self.choice.solutions
        return self

    @cached_property
    def readings(self) -> list[tuple[str, Reading]]:
        """The readings that count, with the names of their sessions."""
        return _counting(self.sessions)

    @cached_property
    def visits(self) -> tuple[tuple[str, Reading], ...]:
        """The readings, of those without a movement between them the first, with their sessions."""
        return tuple(self.readings[row] for row in visit_starts(self.observations).tolist())

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict of the posterior, as the diagnosis has it."""
        from calib.diagnosis.diagnose import verdict_of  # all of it comes with it

        return verdict_of(self.corrections.posterior)

    @property
    def lacks_something(self) -> bool:
        """Whether the posterior says that anything is missing from the model."""
        return self.verdict not in ("agrees", "cannot-tell")

    @property
    def is_part_of_the_model(self) -> bool:
        """Whether the set leaves lines of drives out with which nothing is missing."""
        return bool(self.lines) and self.verdict == "agrees"

    @property
    def noise(self) -> Noise:
        """Noise of a single reading, as the posterior has it; else, what the fit of the set leaves.

        Suspect readings and drift from cycle to cycle are those of all sessions together.
        """
        of_set = self._noise_of_sets
        stated_noise = self.corrections.noise or of_set
        return replace(stated_noise, outliers=of_set.outliers, cycle_drift_mm=of_set.cycle_drift_mm)

    @property
    def _noise_of_sets(self) -> Noise:
        """Noise as all sets have it that are identified of these readings."""
        return self.choice.case.noise or self.solution.noise

    @property
    def suspects(self) -> tuple[Suspect, ...]:
        """Readings that do not fit their own repeats."""
        outliers = self.noise.outliers
        return tuple(
            Suspect(*self.visits[outlier.row], outlier.studentised) for outlier in outliers
        )

    @property
    def noise_of_each(self) -> Noise:
        """In which indicators differ only beyond chance, those of several sessions, too."""
        return self.noise if len(self.sessions) == 1 else self._noise_of_sets

    @property
    def noisy(self) -> tuple[NoisyChannel, ...]:
        """Indicators that scatter more than the quietest."""
        return tuple(
            NoisyChannel(*self.readings[indicator.row], indicator)
            for indicator in noisy_indicators(self.observations, self.noise_of_each)
        )

    @cached_property
    def isolated(self) -> tuple[IsolatedReadings, ...]:
        """Readings that have no other posture to compare with."""
        return tuple(
            IsolatedReadings(
                self.readings[rows[0]][0], tuple(self.readings[row][1] for row in rows)
            )
            for rows in single_posture_rows(self.observations)
        )

    @cached_property
    def still(self) -> tuple[tuple[str, Reading, int], ...]:
        """Set-ups that read one value in every posture: session, first reading, how many."""
        return tuple((*self.readings[rows[0]], len(rows)) for rows in still_rows(self.observations))

    def with_subset(self, subset: Subset) -> SessionSolution:
        """Another set of the same choice; nothing is fitted again.

        Raises NotIdentifiable, and RecordError as `refuse_leaning_planes`.
        """
        view = replace(self, view=subset)
        refuse_leaning_planes(self.sessions, view.solution.model, self.observations)
        return view

    @property
    def tool_maps(self) -> tuple[PlaneMap, ...]:
        """Expected error of the tool with the values of the view, on three planes through Zero."""
        return self.corrections.off(self.solution.model).maps(self.frame)

    @cached_property
    def curves(self) -> list[LegCurve]:
        """Readings of each leg and axis over its travel, about all offsets and lengths.

        Both are held by their tolerances, so that what no value of them explains is left; where
        that set is not determined, it is the fit of the view.
        """
        fit = self.choice.solutions.get("with-tolerances", self.solution)
        return leg_curves(fit.model, self.observations, fit.residual_mm)

    @property
    def left_over_normal(self) -> tuple[FloatArray, FloatArray]:
        """What `curves` leave of all visits ``(n,)``, mm, and their normal scores ``(n,)``."""
        left_mm = joined_values([curve.left_mm for curve in self.curves])
        return left_mm, normal_scores(left_mm)

    @property
    def budget(self) -> tuple[BudgetShare, ...]:
        """What each source gives to the uncertainties of the view, the largest first."""
        sources = self.solution.budget_mm
        squares = {name: sum(mm * mm for mm in parts.tolist()) for name, parts in sources.items()}
        total, count = math.fsum(squares.values()), len(self.solution.names)
        shares, together = [], 0.0
        for name in descending([*squares], squares.__getitem__):
            together += squares[name]
            root_mm = math.sqrt(squares[name] / count)
            shares.append(BudgetShare(name, root_mm, together / total if total else 1.0))
        return tuple(shares)

    @property
    def furthest_distance(self) -> FurthestDistance | None:
        """The distance between marks that is furthest off; None where none is beyond chance."""
        distances = [
            (session.name, line) for session in self.sessions for line in session.distances
        ]
        off = self.corrections.posterior.distances_left.tolist()
        if not distances or max(map(abs, off)) <= BEYOND_CHANCE:
            return None
        furthest = max(range(len(off)), key=lambda k: abs(off[k]))
        return FurthestDistance(*distances[furthest], off[furthest])

    @property
    def reads_tool(self) -> bool:
        """Whether any reading is of the tool, as against a plate, and not of a leg."""
        return any(r.leg == "tool" for session in self.sessions for r in session.readings)

    @property
    def of_contacts(self) -> bool:
        """Whether all are contacts, which a probe or the tool itself made."""
        return all(session.of_contacts for session in self.sessions)

    @property
    def residuals(self) -> list[tuple[str, Reading, float]]:
        """What the model leaves of each visit, mm, with its session and first reading."""
        residuals_mm = self.solution.residual_mm.tolist()
        return [(*visit, mm) for visit, mm in zip(self.visits, residuals_mm, strict=True)]

    def table(self, name: TableName = "parameters") -> DataTable:
        """Parameters, differences or residuals, mm; the columns are those of docs/python.md.

        Raises UsageError for another name.
        """
        check_choice("table", name, TableName)
        if name == "parameters":
            return DataTable.of(TabledEstimate, self.solution.estimates, "parameter")
        if name == "differences":
            return DataTable.of(Difference, self.solution.tabulated, "difference")
        return _residuals(self)

    def to_frame(self, name: TableName = "parameters") -> DataFrame:
        """`table` for pandas. Raises UsageError where that is not installed."""
        return self.table(name).to_frame()

    @property
    def display_found_mm(self) -> float | None:
        """Step of the display that the values show and nobody stated, mm; None without one."""
        return indicator_figures(self.sessions).display_found_mm

    @property
    def reading_count(self) -> int:
        """How many readings count: those that are alone with their zero do not."""
        return len(self.observations) - sum(len(alone.readings) for alone in self.isolated)

    @property
    def joint_offsets_mm(self) -> tuple[float, float, float]:
        """d_rho of joints x, y, z that are entered where the controller holds nothing else."""
        return self.corrections.of("offsets").joint_offsets_mm


@dataclass(frozen=True)
class LineParameter:
    """Where a drive's line lies, how it points, or its travel: a law at a place, in its unit.

    Beyond what the machine file states.
    """

    id: Annotated[str, Quantity("line of a drive", words="a law that docs/effects.md describes")]
    place: Annotated[str, Quantity("at", words="the drive, and the way across it")]
    value: Annotated[float, Quantity("value", kind="measured", words="in the unit, as in a model")]
    expanded_uncertainty: Annotated[
        float, Quantity("± U (k = 2)", kind="uncertainty", words="expanded uncertainty, k = 2")
    ]
    tolerance: Annotated[
        float,
        Quantity(
            "tolerance",
            kind="tolerance",
            words="of the machine file: standard deviation before measuring",
        ),
    ]
    unit: Annotated[str, Quantity("", words="unit of all three")]


@dataclass(frozen=True)
class BudgetShare:
    """A source of uncertainty: r.m.s. over the parameters (95 %), and with those before it.

    ``cumulative`` is the share of the squares of all.
    """

    source: str
    expanded_mm: float
    cumulative: float


TableName = Literal["parameters", "differences", "residuals"]


PLACE = (
    *("session", "reading", "leg", "axis", "displacement_mm", "x_mm", "y_mm", "z_mm", "station"),
    *("mount", "cycle", "time_s", "temperature_c", "value_mm"),
)


def _residuals(result: SessionSolution) -> DataTable:
    nowhere = (None, None, None)
    return DataTable.plain(
        (*PLACE, "residual_mm"),
        (
            (
                *(name, reading.reading, reading.leg, reading.axis, reading.displacement_mm),
                *(reading.position_mm or nowhere),
                *(
                    reading.station,
                    reading.mount,
                    reading.cycle,
                    reading.time_s,
                    reading.temperature_c,
                ),
                *(reading.value_mm, left_mm),
            )
            for name, reading, left_mm in result.residuals
        ),
    )


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


def solve_sessions(
    sessions: Sequence[Session],
    *,
    subset: Subset | None = None,
    method: Method = "exact",
    weights: Weights = "equal",
    model: ModelFile | None = None,
    frame: Frame | None = None,
    holds: Holds = "offsets",
) -> SessionSolution:
    """Identify; without a subset joint offsets are the view, or what takes their place.

    That is identified when it is first asked for: what is entered needs no set.

    The correction is for a ``frame``, that of the machine file where none is named, and for a
    controller that ``holds`` so much. The sizes of a model's effects are fitted with the
    parameters, except those that it holds. Raises NotIdentifiable where the readings do not
    determine what was asked for, UsageError for a model of another machine and for a word that is
    none of those, RecordError as `refuse_leaning_planes`.
    """
    for option, word, choices in (
        ("subset", subset, Subset),
        ("method", method, Method),
        ("frame", frame, Frame),
    ):
        check_choice(option, word, choices)
    if not sessions:
        raise NotIdentifiable("sessions", "none", "at least one session")
    observations = to_observations(sessions)
    machine = sessions[0].opened.machine
    start = Model(machine.geometry())
    sizes: tuple[Size, ...] = ()
    free: AdoptedLaws = {}
    if model is not None:
        start, sizes, free = _of(model, machine, method)
    case = IdentificationCase.of(start, observations, indicator_figures(sessions), sizes)
    choice = SubsetChoice(case, machine.tolerances_mm(), method, weights)
    corrections = ControllerCorrections.of_sessions(sessions, start, frame, free=free)
    result = SessionSolution(tuple(sessions), observations, choice, corrections, subset, holds)
    if model is not None:
        from protocols.model_file import ambiguous_effects, held_sizes

        result = replace(result, ambiguous=ambiguous_effects(model), held=held_sizes(model))
    leans = bool(observations.over_plane.any())
    return result.with_subset(result.subset) if subset or leans else result


def _of(
    model: ModelFile, machine: Machine, method: Method
) -> tuple[Model, tuple[Size, ...], AdoptedLaws]:
    """Where a fit with this model begins, what it frees of the effects, and `free_effects`."""
    from app.evaluating.own_effects import known_effects  # files of users: only where asked for
    from protocols.model_file import free_effects, sizes_of, to_model

    if replace(model.machine.geometry(), load=machine.load) != machine.geometry():
        raise UsageError(
            "--model",
            f"the model of another machine, {model.machine.name}",
            f"one of {machine.name} as the session has it",
        )
    if model.effects and method != "exact":
        raise UsageError("--method with --model", method, "exact: sizes of effects are fitted, too")
    effects = known_effects()
    start = to_model(model, "model", effects)
    return start, sizes_of(model, effects), free_effects(model, effects)


def _counting(sessions: Sequence[Session]) -> list[tuple[str, Reading]]:
    """The readings that count, as `to_observations` has them, with the names of their sessions."""
    return [(session.name, reading) for session in sessions for reading in session.readings]


def refuse_leaning_planes(
    sessions: Sequence[Session], model: Model, observations: Observations
) -> None:
    """Raises RecordError for a reference plane that leans by more than the machine file allows."""
    limit_mrad = sessions[0].opened.machine.plane_tilt_mrad
    for row, tilt_mrad in plane_tilts_mrad(model, observations):
        if abs(tilt_mrad) > limit_mrad:
            name, reading = _counting(sessions)[row]
            raise RecordError(
                f"session {name}, plane under leg {reading.leg.upper()} along "
                f"{reading.axis.upper()}, from reading {reading.reading} on",
                f"tilted by {tilt_mrad:+.1f} mrad",
                f"up to {limit_mrad:g} mrad, plane_tilt_mrad in the machine file",
                "Level it and measure this leg again, or state a larger limit there.",
            )


def solve_files(
    paths: Sequence[Path],
    *,
    subset: Subset | None = None,
    method: Method = "exact",
    weights: Weights = "equal",
    model: Path | None = None,
    frame: Frame | None = None,
    holds: Holds = "offsets",
) -> SessionSolution:
    """`load_sessions` and `solve_sessions` in one step, with the warnings."""
    sessions, warnings = load_sessions(paths)
    model_file = None
    if model:
        from protocols.model_file import read_model_file

        model_file = read_model_file(model)
    result = solve_sessions(
        sessions,
        subset=subset,
        method=method,
        weights=weights,
        model=model_file,
        frame=frame,
        holds=holds,
    )
    return replace(result, warnings=tuple(warnings))


@dataclass(frozen=True)
class Judgement:
    """What the tool is off by against a tolerance, as it is now and with the correction entered."""

    tolerance_mm: float
    before: Decision
    after: Decision


def judge(result: SessionSolution, tolerance_mm: float) -> Judgement:
    """Pass, fail or undecided, now and with the correction entered (ISO 14253-1).

    Raises UsageError for a tolerance that is no positive length.
    """
    check_tolerance(tolerance_mm)
    return Judgement(
        tolerance_mm,
        decided_in(result.corrections.off_now, result.frame, tolerance_mm),
        decided_in(result.entered.off, result.frame, tolerance_mm),
    )


def decided_in(off: ToolOff, frame: Frame, tolerance_mm: float) -> Decision:
    """The decision on what the tool is off by in a frame."""
    return decide(off.least_in(frame), off.bound_in(frame), tolerance_mm)


def monte_carlo_of(result: SessionSolution, sessions: int, seed: int) -> MonteCarlo:
    """Sessions like this one on machines like this one, identified as this one was.

    All indicators scatter alike there; with a coarse display the machines differ by some steps. A
    stated noise is simulated as stated. Raises UsageError where the noise is what the fit left, and
    for the set held by tolerances.
    """
    solution = result.solution
    if solution.noise.source == "residuals" or solution.subset == "with-tolerances":
        raise UsageError(
            "--monte-carlo",
            f"noise from {solution.noise.source}, set {solution.subset}",
            "a session with repeats or a stated indicator, and one of the plain sets",
        )
    campaign = Campaign.like(solution, result.observations, indicator_figures(result.sessions))
    return simulate_and_identify(campaign, sessions, seed)
