"""What ``solve``, ``compare`` and ``export`` tell."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from types import SimpleNamespace
from typing import Annotated, Literal

from app.evaluating.comparison import Comparison, Entered
from app.evaluating.solution import Judgement
from app.report.schema.document import (
    Finite,
    Holes,
    LackOfFitEntry,
    Matrix,
    Numbers,
    Report,
    Root,
    asked,
    at,
    called,
    made,
    rows,
    schema,
)
from calib.identify.accuracy import Decision
from calib.identify.solution import FittedSize, Method, Solution, Subset, Weights
from calib.noise.reading import NoiseSource, Repeated
from protocols.machine import Frame, Instrument


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

    names: tuple[str, ...]
    matrix: Matrix = at("covariance_mm2")
    unit: Literal["mm²"] = "mm²"


class IndicatorScatter(Report):
    """One indicator; repeats in a posture share a part of the rounding."""

    standard_deviation_mm: Root = at("variance_mm2")
    rounding_shared_by_repeats_mm: Root = at("quantisation_mm2")


class ReadingNoise(Report):
    """Of a single reading."""

    standard_deviation_mm: float
    degrees_of_freedom: Finite = at("degrees_of_freedom", "null: stated, taken as known")
    source: NoiseSource
    pooled: bool
    repeats_show: Repeated = at("repeated")
    wander_mm: float | None = at("cycle_drift_mm", "from cycle to cycle; null if chance may do it")
    indicators: tuple[IndicatorScatter, ...]


class SuspectReading(Report):
    """It does not fit its own repeats: how many standard deviations."""

    session: str
    reading: int = at("reading.reading")
    studentised: float


class IsolatedReadingsEntry(Report):
    """Alone in their mounting: without another posture they say nothing."""

    session: str
    readings: Annotated[list[int], made(lambda readings: [one.reading for one in readings])]


class FramesEntry(Report):
    """R.m.s. error of the tool over the workspace that 95 of 100 such machines keep, by frame."""

    touched_off_mm: float = at("touched_off_mm", "a shift is free")
    aligned_mm: float = at("aligned_mm", "a shift and a turn are free")
    machine_mm: float = at("machine_mm", "in the machine's own frame")


def _by_frame(bound_mm: dict[Frame, float]) -> SimpleNamespace:
    names = {f"{frame.replace('-', '_')}_mm": mm for frame, mm in bound_mm.items()}
    return SimpleNamespace(**names)


ByFrame = Annotated[FramesEntry, made(_by_frame)]


class EnteredEntry(Report):
    """A value to enter, in its unit."""

    value: float
    unit: str


class LeftOutEntry(Report):
    """A part that is not entered, and why."""

    part: str
    reason: str


class MistakeEntry(Report):
    """A mistake of labels or readings that is likely; aliases fit as well."""

    id: str
    where: str
    title: str
    probability: float


class GainEntry(Report):
    """What the tool keeps where the same controller holds something else."""

    holds: Literal["offsets", "play", "tables", "kinematics"]
    bound_mm: float


class CorrectionEntry(Report):
    """What is entered in the controller: what every screen, report and export shows first."""

    frame: Frame = at("correction.frame")
    holds: Literal["offsets", "play", "tables", "kinematics"] = at("correction.holds")
    values: dict[str, EnteredEntry] = at(
        "correction.values", "true position = believed position + d_rho; sizes as in a model"
    )
    bound: ByFrame = at("correction.off.bound_mm", "with the values entered")
    bound_now: ByFrame = at("correction.off_now.bound_mm", "with what the controller holds now")
    left_out: tuple[LeftOutEntry, ...] = at("correction.left_out")
    others: tuple[GainEntry, ...] = at("others", "in the same frame")
    mistakes: tuple[MistakeEntry, ...] = at(
        "corrections.mistakes", "in the readings; the values count with them put right"
    )


class WeakDirection(Report):
    """A combination of parameters and what it costs at the tool."""

    combination: str
    standard_uncertainty_mm: float
    tool_mm: float


class ToolMapEntry(Report):
    """Expected tool error on a plane through Zero; rows go up."""

    across: str
    up: str
    coordinate_mm: Numbers = at("coordinate_mm", "across")
    up_mm: Numbers | None = asked(
        "other_up_mm", "upwards, where these places are others than those across"
    )
    error_mm: Holes = at("value", "null beyond the joint limits")


@dataclass(frozen=True)
class Coverage:
    """Share of the 95 % intervals that held the truth, true and stated standard uncertainty."""

    covered: float
    true_mm: float
    stated_mm: float


class SimulatedSessions(Report):
    """Sessions like this one, simulated and identified."""

    sessions: int = at("simulated.sessions")
    failed: int = at("simulated.failed")
    parameters: Annotated[
        dict[str, Coverage],
        made(lambda it: rows(Coverage, it.names, it.covered, it.true_mm, it.stated_mm)),
    ] = at("simulated")


class MeasuredSession(Report):
    """Who measured when and with what; ``notes`` are the remarks made on the way."""

    origin: str = at("opened.origin")
    begun: datetime = at("opened.at")
    operator: str = at("opened.operator")
    temperature_c: float | None = at("opened.temperature_c")
    indicators: tuple[Instrument, ...] = at("opened.instruments")
    notes: tuple[str, ...]


class LineEntry(Report):
    """A parameter of a drive's line, or its travel, beyond what the machine file states."""

    id: str
    place: str = at("place", "the drive, and the way across it")
    value: float = at("value", "in the unit, as in a model")
    expanded_uncertainty: float = at("expanded", "k = 2")
    tolerance: float = at("tolerance", "of the machine file: standard deviation before measuring")
    unit: str


LINES = "none where the machine file has no tolerances of lines"


class SolutionReport(Report):
    """``solve --json``: `SessionSolution`; what was asked beyond it is there only then."""

    schema_id: Literal["glidecal.solution/1"] = schema("glidecal.solution/1")
    sessions: tuple[str, ...] = at("solved.names")
    measured: tuple[MeasuredSession, ...] = at("solved.sessions", "in the order of the sessions")
    method: Method = at("solved.solution.method")
    weights: Weights = at("solved.solution.weights")
    correction: CorrectionEntry = at("solved", "what is entered; parameters are a view")
    lines: tuple[LineEntry, ...] = at("solved.lines", f"lines of the drives; {LINES}")
    subset: Subset = at("solved.solution.subset", "of the view")
    parameters: Annotated[dict[str, Parameter], made(_parameters)] = at("solved.solution")
    covariance: Covariance = at("solved.solution")
    differences: Annotated[dict[str, Difference], made(_differences)] = at(
        "solved.solution",
        "up to twelve, keys axis_leg with + for Max and - for Min; y_x alone is Max minus Min; "
        "of the tool z(x, y, z) minus Zero",
    )
    rms_before_mm: float = at("solved.solution.rms_before_mm", "over all differences")
    rms_after_mm: float = at("solved.solution.rms_after_mm", "over all differences")
    degrees_of_freedom: int = at("solved.solution.degrees_of_freedom")
    noise: ReadingNoise = at("solved.solution.noise")
    display_step_found_mm: float | None = at(
        "solved.display_found_mm",
        "step of the display that the values show and nobody stated; null where they show none",
    )
    suspect_readings: tuple[SuspectReading, ...] = at("solved.suspects")
    lost_readings: tuple[IsolatedReadingsEntry, ...] = at("solved.isolated")
    enlarged_by_lack_of_fit: float = at(
        "solved.solution.inflation",
        "factor on the standard deviation of the noise if what the model leaves is taken for "
        "noise; 1 if that is no more",
    )
    expanded_with_lack_of_fit_mm: Annotated[
        dict[str, float], made(lambda one: rows(float, one.names, one.inflated_expanded_mm))
    ] = at("solved.solution", "expanded uncertainty (95 %) of each parameter then")
    expanded_with_tolerances_mm: Annotated[
        dict[str, float],
        made(lambda one: rows(float, one.names, one.expanded_with_tolerances_mm)),
    ] = at(
        "solved.solution",
        "expanded uncertainty (95 %) of each parameter with those outside the set off within "
        "their tolerance",
    )
    difference_expanded_mm: Numbers | None = at(
        "solved.solution.expanded_of_difference_mm",
        "expanded uncertainty (95 %) of d_rho - d_L of x, y, z where the readings tell little of "
        "d_rho but that; else null",
    )
    lack_of_fit: Annotated[
        LackOfFitEntry, made(lambda one: one.lack_of_fit or LackOfFitEntry())
    ] = at("solved.solution")
    condition_number: float = at("solved.solution.condition_number")
    weak_directions: tuple[WeakDirection, ...] = at("solved.solution.weak_directions")
    recommended_subset: Subset = at(
        "solved.choice.usual", "the view where none is asked for; what is entered is correction"
    )
    reasons: tuple[str, ...] = at("solved.choice.reasons", "why sets are missing")
    effects: tuple[FittedSize, ...] | None = asked("sizes", "with --model")
    ambiguous_effects: tuple[str, ...] = at(
        "solved.ambiguous", "those of the model that are one of several that would do"
    )
    held_sizes: tuple[str, ...] = at(
        "solved.held", "those of the model that a person stated and nothing fitted"
    )
    tolerance: Judgement | None = asked("judged", "with --tolerance")
    tool_maps: tuple[ToolMapEntry, ...] | None = asked("maps", "with --map")
    monte_carlo: Annotated[SimulatedSessions | None, called("simulated")] = asked(
        "simulated", "with --monte-carlo"
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


FirstName = Annotated[str, made(lambda names: names[0])]


class ComparisonReport(Report):
    """``compare --json``: two sessions of one machine."""

    schema_id: Literal["glidecal.comparison/1"] = schema("glidecal.comparison/1")
    before: FirstName = at("found.before.names")
    after: FirstName = at("found.after.names")
    differences: Annotated[dict[str, BothValues], made(_both)] = at("found")
    rms_before_mm: float = at("found.before.solution.rms_before_mm")
    rms_after_mm: float = at("found.after.solution.rms_before_mm")
    rms_expected_mm: float | None = at(
        "found.expected_mm",
        "what the fit of the first session left; null across a mechanical change",
    )
    unit: Literal["mm"] = "mm"
    remarks: tuple[str, ...] = at("found.remarks")


class RemainingOffsetEntry(Report):
    """A joint offset before, and what is left of it, mm."""

    name: str
    before_mm: float
    found_mm: float
    expanded_mm: float
    entered: Entered


class VerificationReport(Report):
    """``verify --json``: was it done, and is the machine good enough?"""

    schema_id: Literal["glidecal.verification/1"] = schema("glidecal.verification/1")
    before: FirstName = at("found.compared.before.names")
    after: FirstName = at("found.compared.after.names")
    frame: Frame = at("found.compared.after.frame")
    bound_expected_mm: float = at(
        "found.compared.before.correction.bound_mm", "promised by the first session, 95 %"
    )
    bound_found_mm: float = at(
        "found.compared.after.correction.now_mm", "by the second one; what is decided by"
    )
    tolerance_mm: float | None = at("found.tolerance_mm")
    decision: Decision | None = at("found.decision", "null: no tolerance")
    offsets: tuple[RemainingOffsetEntry, ...] = at("found.offsets")
    something_missing: bool = at(
        "found.compared.after.solution.lacks_fit", "more than noise is left: diagnose"
    )
    remarks: tuple[str, ...] = at("found.compared.remarks")


CONVENTION = "true position = believed position + d_rho; true length = nominal + d_L"


@dataclass(frozen=True)
class Offset:
    """A parameter as exported; null where the source is a model file."""

    value: float
    standard_uncertainty: float | None = None
    expanded_uncertainty: float | None = None
    coverage_factor: float | None = None
    expanded_with_lack_of_fit: float | None = None
    expanded_with_tolerances: float | None = None


class OffsetsReport(Report):
    """``export --format json``: for another controller."""

    schema_id: Literal["glidecal.offsets/1"] = schema("glidecal.offsets/1")
    source: str = at("offsets.source")
    made: str = at(
        "offsets.made", "when measured, digests, program; empty where the source does not tell"
    )
    machine: str = at("offsets.machine.name")
    convention: str = CONVENTION
    unit: Literal["mm"] = "mm"
    cautions: tuple[str, ...] = at("offsets.cautions", "the lines that solve says of this result")
    parameters: dict[str, Offset] = at("offsets.parameters")
    lines: tuple[LineEntry, ...] = at(
        "offsets.lines", f"lines of the drives, which a controller may hold or not; {LINES}"
    )
