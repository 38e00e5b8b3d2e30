"""What ``solve``, ``compare`` and ``export`` tell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from app.evaluating.comparison import Comparison, Entered, RemainingOffset, Verification
from app.evaluating.correction import EnteredValue, Gain
from app.evaluating.solution import (
    IsolatedReadings,
    Judgement,
    LineParameter,
    SessionSolution,
    Suspect,
)
from app.report.schema.document import (
    Holes,
    LackOfFitEntry,
    Matrix,
    Numbers,
    Report,
    Source,
    by_name,
    finite,
    holes,
    numbers,
    rows,
    schema,
)
from calib.design.identifiability import Direction
from calib.identify.accuracy import Decision
from calib.identify.monte_carlo import MonteCarlo
from calib.identify.solution import FittedSize, LackOfFit, Method, Solution, Subset, Weights
from calib.noise.reading import IndicatorNoise, Noise, NoiseSource, Repeated
from calib.posterior.correction import Holds, LeftOut
from calib.posterior.models import LikelyMistake
from calib.tripod.workspace import PlaneMap
from protocols.machine import Frame, Instrument
from protocols.session import Session


@dataclass(frozen=True)
class Parameter:
    """An identified parameter; the expanded uncertainty is for 95 %."""

    value: float
    standard_uncertainty: float
    expanded_uncertainty: float
    coverage_factor: float
    unit: Literal["mm"] = "mm"


def _parameters(solution: Solution) -> dict[str, Parameter]:
    uncertain = (solution.uncertainty_mm, solution.expanded_mm, solution.coverage_factors)
    return rows(Parameter, solution.names, solution.values_mm, *uncertain)


@dataclass(frozen=True)
class Difference:
    """A reading less that at another posture, and what the solution predicts of it, mm."""

    value: float
    standard_uncertainty: float
    predicted: float
    residual: float


def _differences(solution: Solution) -> dict[str, Difference]:
    measured, u = solution.differences, solution.difference_uncertainty_mm
    columns = (measured.value_mm, u, solution.predicted_mm, solution.left_mm)
    entries = rows(Difference, measured.names, *columns)
    return {name: entries[name] for name in (measured.names[k] for k in measured.published_rows)}


class Covariance(Report):
    """Of the parameters, from the noise of the readings."""

    of = Source[Solution]()
    names: tuple[str, ...] = of(lambda solution: solution.names)
    matrix: Matrix = of(lambda solution: solution.covariance_mm2.tolist())
    unit: Literal["mm²"] = "mm²"


class IndicatorScatter(Report):
    """One indicator; repeats in a posture share a part of the rounding."""

    of = Source[IndicatorNoise]()
    standard_deviation_mm: float = of(lambda noise: math.sqrt(noise.variance_mm2))
    rounding_shared_by_repeats_mm: float = of(lambda noise: math.sqrt(noise.quantisation_mm2))


class ReadingNoise(Report):
    """Of a single reading."""

    of = Source[Noise]()
    standard_deviation_mm: float = of(lambda noise: noise.standard_deviation_mm)
    degrees_of_freedom: float | None = of(
        lambda noise: finite(noise.degrees_of_freedom), "null: stated, taken as known"
    )
    source: NoiseSource = of(lambda noise: noise.source)
    pooled: bool = of(lambda noise: noise.pooled)
    repeats_show: Repeated = of(lambda noise: noise.repeated)
    wander_mm: float | None = of(
        lambda noise: noise.cycle_drift_mm, "from cycle to cycle; null if chance may do it"
    )
    indicators: tuple[IndicatorScatter, ...] = of(
        lambda noise: tuple(map(IndicatorScatter.of, noise.indicators))
    )


class SuspectReading(Report):
    """It does not fit its own repeats: how many standard deviations."""

    of = Source[Suspect]()
    session: str = of(lambda suspect: suspect.session)
    reading: int = of(lambda suspect: suspect.reading.reading)
    studentised: float = of(lambda suspect: suspect.studentised)


class IsolatedReadingsEntry(Report):
    """Alone in their mounting: without another posture they say nothing."""

    of = Source[IsolatedReadings]()
    session: str = of(lambda isolated: isolated.session)
    readings: list[int] = of(lambda isolated: [reading.reading for reading in isolated.readings])


class FramesEntry(Report):
    """R.m.s. error of the tool over the workspace that 95 of 100 such machines keep, by frame."""

    of = Source[dict[Frame, float]]()
    touched_off_mm: float = of(lambda bound_mm: bound_mm["touched-off"], "a shift is free")
    aligned_mm: float = of(lambda bound_mm: bound_mm["aligned"], "a shift and a turn are free")
    machine_mm: float = of(lambda bound_mm: bound_mm["machine"], "in the machine's own frame")


class GainEntry(Report):
    """What the tool keeps where the same controller holds something else."""

    of = Source[Gain]()
    holds: Holds = of(lambda gain: gain.holds)
    bound_mm: float = of(lambda gain: gain.bound_mm)


class CorrectionEntry(Report):
    """What is entered in the controller: what every screen, report and export shows first."""

    of = Source[SessionSolution]()
    frame: Frame = of(lambda solved: solved.correction.frame)
    holds: Holds = of(lambda solved: solved.correction.holds)
    values: dict[str, EnteredValue] = of(
        lambda solved: solved.correction.values,
        "true position = believed position + d_rho; sizes as in a model",
    )
    bound: FramesEntry = of(
        lambda solved: FramesEntry.of(solved.correction.off.bound_mm), "with the values entered"
    )
    bound_now: FramesEntry = of(
        lambda solved: FramesEntry.of(solved.correction.off_now.bound_mm),
        "with what the controller holds now",
    )
    left_out: tuple[LeftOut, ...] = of(lambda solved: solved.correction.left_out)
    others: tuple[GainEntry, ...] = of(
        lambda solved: tuple(map(GainEntry.of, solved.others)), "in the same frame"
    )
    mistakes: tuple[LikelyMistake, ...] = of(
        lambda solved: solved.corrections.mistakes,
        "in the readings; the values count with them put right",
    )


class WeakDirection(Report):
    """A combination of parameters and what it costs at the tool."""

    of = Source[Direction]()
    combination: str = of(lambda direction: direction.combination)
    standard_uncertainty_mm: float = of(lambda direction: direction.standard_uncertainty_mm)
    tool_mm: float = of(lambda direction: direction.tool_mm)


class ToolMapEntry(Report):
    """Expected tool error on a plane through Zero; rows go up."""

    of = Source[PlaneMap]()
    across: str = of(lambda plane: plane.across)
    up: str = of(lambda plane: plane.up)
    coordinate_mm: Numbers = of(lambda plane: plane.coordinate_mm.tolist(), "across")
    up_mm: Numbers | None = of(
        lambda plane: None if plane.other_up_mm is None else plane.other_up_mm.tolist(),
        "upwards, where these places are others than those across",
        asked=True,
    )
    error_mm: Holes = of(lambda plane: holes(plane.value), "null beyond the joint limits")


@dataclass(frozen=True)
class Coverage:
    """Share of the 95 % intervals that held the truth, true and stated standard uncertainty."""

    covered: float
    true_mm: float
    stated_mm: float


class SimulatedSessions(Report):
    """Sessions like this one, simulated and identified."""

    of = Source[MonteCarlo]()
    sessions: int = of(lambda simulated: simulated.sessions)
    failed: int = of(lambda simulated: simulated.failed)
    parameters: dict[str, Coverage] = of(
        lambda simulated: rows(
            Coverage,
            simulated.names,
            simulated.covered,
            simulated.true_mm,
            simulated.stated_mm,
        )
    )


class MeasuredSession(Report):
    """Who measured when and with what; ``notes`` are the remarks made on the way."""

    of = Source[Session]()
    origin: str = of(lambda session: session.opened.origin)
    begun: datetime = of(lambda session: session.opened.at)
    operator: str = of(lambda session: session.opened.operator)
    temperature_c: float | None = of(lambda session: session.opened.temperature_c)
    indicators: tuple[Instrument, ...] = of(lambda session: session.opened.instruments)
    notes: tuple[str, ...] = of(lambda session: session.notes)


class LineEntry(Report):
    """A parameter of a drive's line, or its travel, beyond what the machine file states."""

    of = Source[LineParameter]()
    id: str = of(lambda line: line.id)
    place: str = of(lambda line: line.place, "the drive, and the way across it")
    value: float = of(lambda line: line.value, "in the unit, as in a model")
    expanded_uncertainty: float = of(lambda line: line.expanded, "k = 2")
    tolerance: float = of(
        lambda line: line.tolerance, "of the machine file: standard deviation before measuring"
    )
    unit: str = of(lambda line: line.unit)


def _lack_of_fit(lack: LackOfFit | None) -> LackOfFitEntry:
    return LackOfFitEntry(lack.statistic, lack.p_value) if lack else LackOfFitEntry()


LINES = "none where the machine file has no tolerances of lines"


@dataclass(frozen=True, eq=False)
class SolutionResults:
    """A solution, and what was asked for beyond it."""

    solved: SessionSolution
    judged: Judgement | None = None
    maps: tuple[PlaneMap, ...] | None = None
    simulated: MonteCarlo | None = None

    @property
    def solution(self) -> Solution:
        """The view."""
        return self.solved.solution


class SolutionReport(Report):
    """``solve --json``: `SessionSolution`; what was asked beyond it is there only then."""

    of = Source[SolutionResults]()
    schema_id: Literal["glidecal.solution/1"] = schema("glidecal.solution/1")
    sessions: tuple[str, ...] = of(lambda results: results.solved.names)
    measured: tuple[MeasuredSession, ...] = of(
        lambda results: tuple(map(MeasuredSession.of, results.solved.sessions)),
        "in the order of the sessions",
    )
    method: Method = of(lambda results: results.solution.method)
    weights: Weights = of(lambda results: results.solution.weights)
    correction: CorrectionEntry = of(
        lambda results: CorrectionEntry.of(results.solved),
        "what is entered; parameters are a view",
    )
    lines: tuple[LineEntry, ...] = of(
        lambda results: tuple(map(LineEntry.of, results.solved.lines)),
        f"lines of the drives; {LINES}",
    )
    subset: Subset = of(lambda results: results.solution.subset, "of the view")
    parameters: dict[str, Parameter] = of(lambda results: _parameters(results.solution))
    covariance: Covariance = of(lambda results: Covariance.of(results.solution))
    differences: dict[str, Difference] = of(
        lambda results: _differences(results.solution),
        "up to twelve, keys axis_leg with + for Max and - for Min; y_x alone is Max minus Min; "
        "of the tool z(x, y, z) minus Zero",
    )
    rms_before_mm: float = of(
        lambda results: results.solution.rms_before_mm, "over all differences"
    )
    rms_after_mm: float = of(lambda results: results.solution.rms_after_mm, "over all differences")
    degrees_of_freedom: int = of(lambda results: results.solution.degrees_of_freedom)
    noise: ReadingNoise = of(lambda results: ReadingNoise.of(results.solution.noise))
    display_step_found_mm: float | None = of(
        lambda results: results.solved.display_found_mm,
        "step of the display that the values show and nobody stated; null where they show none",
    )
    suspect_readings: tuple[SuspectReading, ...] = of(
        lambda results: tuple(map(SuspectReading.of, results.solved.suspects))
    )
    lost_readings: tuple[IsolatedReadingsEntry, ...] = of(
        lambda results: tuple(map(IsolatedReadingsEntry.of, results.solved.isolated))
    )
    enlarged_by_lack_of_fit: float = of(
        lambda results: results.solution.inflation,
        "factor on the standard deviation of the noise if what the model leaves is taken for "
        "noise; 1 if that is no more",
    )
    expanded_with_lack_of_fit_mm: dict[str, float] = of(
        lambda results: by_name(results.solution.names, results.solution.inflated_expanded_mm),
        "expanded uncertainty (95 %) of each parameter then",
    )
    expanded_with_tolerances_mm: dict[str, float] = of(
        lambda results: by_name(
            results.solution.names, results.solution.expanded_with_tolerances_mm
        ),
        "expanded uncertainty (95 %) of each parameter with those outside the set off within "
        "their tolerance",
    )
    difference_expanded_mm: Numbers | None = of(
        lambda results: numbers(results.solution.expanded_of_difference_mm),
        "expanded uncertainty (95 %) of d_rho - d_L of x, y, z where the readings tell little of "
        "d_rho but that; else null",
    )
    lack_of_fit: LackOfFitEntry = of(lambda results: _lack_of_fit(results.solution.lack_of_fit))
    condition_number: float = of(lambda results: results.solution.condition_number)
    weak_directions: tuple[WeakDirection, ...] = of(
        lambda results: tuple(map(WeakDirection.of, results.solution.weak_directions))
    )
    recommended_subset: Subset = of(
        lambda results: results.solved.choice.usual,
        "the view where none is asked for; what is entered is correction",
    )
    reasons: tuple[str, ...] = of(
        lambda results: results.solved.choice.reasons, "why sets are missing"
    )
    effects: tuple[FittedSize, ...] | None = of(
        lambda results: results.solution.sizes or None, "with --model", asked=True
    )
    ambiguous_effects: tuple[str, ...] = of(
        lambda results: results.solved.ambiguous,
        "those of the model that are one of several that would do",
    )
    held_sizes: tuple[str, ...] = of(
        lambda results: results.solved.held,
        "those of the model that a person stated and nothing fitted",
    )
    tolerance: Judgement | None = of(lambda results: results.judged, "with --tolerance", asked=True)
    tool_maps: tuple[ToolMapEntry, ...] | None = of(
        lambda results: tuple(map(ToolMapEntry.of, results.maps)) if results.maps else None,
        "with --map",
        asked=True,
    )
    monte_carlo: SimulatedSessions | None = of(
        lambda results: SimulatedSessions.of(results.simulated) if results.simulated else None,
        "with --monte-carlo",
        asked=True,
    )


@dataclass(frozen=True)
class BothValues:
    """A difference before and after the offsets were entered, mm; null: not measured."""

    before: float
    after: float | None


def _both(comparison: Comparison) -> dict[str, BothValues]:
    later = _differences(comparison.after.solution)
    return {
        name: BothValues(difference.value, later[name].value if name in later else None)
        for name, difference in _differences(comparison.before.solution).items()
    }


class ComparisonReport(Report):
    """``compare --json``: two sessions of one machine."""

    of = Source[Comparison]()
    schema_id: Literal["glidecal.comparison/1"] = schema("glidecal.comparison/1")
    before: str = of(lambda compared: compared.before.names[0])
    after: str = of(lambda compared: compared.after.names[0])
    differences: dict[str, BothValues] = of(_both)
    rms_before_mm: float = of(lambda compared: compared.before.solution.rms_before_mm)
    rms_after_mm: float = of(lambda compared: compared.after.solution.rms_before_mm)
    rms_expected_mm: float | None = of(
        lambda compared: compared.expected_mm,
        "what the fit of the first session left; null across a mechanical change",
    )
    unit: Literal["mm"] = "mm"
    remarks: tuple[str, ...] = of(lambda compared: compared.remarks)


class RemainingOffsetEntry(Report):
    """A joint offset before, and what is left of it, mm."""

    of = Source[RemainingOffset]()
    name: str = of(lambda offset: offset.name)
    before_mm: float = of(lambda offset: offset.before_mm)
    found_mm: float = of(lambda offset: offset.found_mm)
    expanded_mm: float = of(lambda offset: offset.expanded_mm)
    entered: Entered = of(lambda offset: offset.entered)


class VerificationReport(Report):
    """``verify --json``: was it done, and is the machine good enough?"""

    of = Source[Verification]()
    schema_id: Literal["glidecal.verification/1"] = schema("glidecal.verification/1")
    before: str = of(lambda verified: verified.compared.before.names[0])
    after: str = of(lambda verified: verified.compared.after.names[0])
    frame: Frame = of(lambda verified: verified.compared.after.frame)
    bound_expected_mm: float = of(
        lambda verified: verified.compared.before.correction.bound_mm,
        "promised by the first session, 95 %",
    )
    bound_found_mm: float = of(
        lambda verified: verified.compared.after.correction.now_mm,
        "by the second one; what is decided by",
    )
    tolerance_mm: float | None = of(lambda verified: verified.tolerance_mm)
    decision: Decision | None = of(lambda verified: verified.decision, "null: no tolerance")
    offsets: tuple[RemainingOffsetEntry, ...] = of(
        lambda verified: tuple(map(RemainingOffsetEntry.of, verified.offsets))
    )
    something_missing: bool = of(
        lambda verified: verified.compared.after.solution.lacks_fit,
        "more than noise is left: diagnose",
    )
    remarks: tuple[str, ...] = of(lambda verified: verified.compared.remarks)


@dataclass(frozen=True)
class Offset:
    """A parameter as exported; null where the source is a model file."""

    value: float
    standard_uncertainty: float | None = None
    expanded_uncertainty: float | None = None
    coverage_factor: float | None = None
    expanded_with_lack_of_fit: float | None = None
    expanded_with_tolerances: float | None = None
