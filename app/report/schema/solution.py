"""What ``solve``, ``compare`` and ``export`` tell."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from app.evaluating.comparison import BothValues, Comparison, RemainingOffset, Verification
from app.evaluating.correction import EnteredValue, Gain
from app.evaluating.printer import PrinterChange, TowerChange, ValueChange
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
    V,
    by_name,
    finite,
    holes,
    maybe,
    schema,
)
from calib.design.identifiability import Direction
from calib.identify.accuracy import Decision
from calib.identify.monte_carlo import MonteCarlo
from calib.identify.solution import (
    Difference,
    FittedSize,
    LackOfFit,
    Method,
    Parameter,
    Solution,
    Subset,
    Weights,
)
from calib.noise.reading import IndicatorNoise, Noise, NoiseSource, Repeated
from calib.posterior.correction import Holds, LeftOut
from calib.posterior.models import LikelyMistake
from calib.quantity import rows
from calib.tripod.workspace import PlaneMap
from protocols.machine import Frame, Instrument
from protocols.session import Session


class Covariance(Report):
    """Covariance of the parameters, from the noise of the readings; with-tolerances: of the parts,
    too.
    """

    of = Source[Solution]()
    names: tuple[str, ...] = of(lambda r: r.names)
    matrix: Matrix = of(lambda r: r.covariance_mm2.tolist())
    unit: Literal["mm²"] = "mm²"


class IndicatorScatter(Report):
    """One indicator; repeats in a posture share a part of the rounding."""

    of = Source[IndicatorNoise]()
    standard_deviation_mm: float = of(lambda r: math.sqrt(r.variance_mm2))
    rounding_shared_by_repeats_mm: float = of(lambda r: math.sqrt(r.quantisation_mm2))


class ReadingNoise(Report):
    """Noise of a single reading."""

    of = Source[Noise]()
    standard_deviation_mm: float = of(lambda r: r.standard_deviation_mm)
    degrees_of_freedom: float | None = of(lambda r: finite(r.degrees_of_freedom))
    """null: stated, taken as known"""
    source: NoiseSource = of(lambda r: r.source)
    pooled: bool = of(lambda r: r.pooled)
    repeats_show: Repeated = of(lambda r: r.repeated)
    wander_mm: float | None = of(lambda r: r.cycle_drift_mm)
    """from cycle to cycle; null if chance may do it"""
    indicators: tuple[IndicatorScatter, ...] = of(
        lambda r: tuple(map(IndicatorScatter.of, r.indicators))
    )


class SuspectReading(Report):
    """A reading that does not fit its own repeats: by how many standard deviations."""

    of = Source[Suspect]()
    session: str = of(lambda r: r.session)
    reading: int = of(lambda r: r.reading.reading)
    studentised: float = of(lambda r: r.studentised)


class IsolatedReadingsEntry(Report):
    """Alone in their mounting: without another posture they say nothing."""

    of = Source[IsolatedReadings]()
    session: str = of(lambda r: r.session)
    readings: list[int] = of(lambda r: [reading.reading for reading in r.readings])


class FramesEntry(Report):
    """R.m.s. error of the tool over the workspace that 95 of 100 such machines keep, by frame."""

    of = Source[dict[Frame, float]]()
    touched_off_mm: float = of(lambda r: r["touched-off"])
    """a shift is free"""
    aligned_mm: float = of(lambda r: r["aligned"])
    """a shift and a turn are free"""
    machine_mm: float = of(lambda r: r["machine"])
    """in the machine's own frame"""


class TowerEntry(Report):
    """What the firmware of a printer holds of a tower now, and what it is to hold."""

    of = Source[TowerChange]()
    tower: str = of(lambda r: r.tower)
    endstop_mm: ValueChange = of(lambda r: r.endstop)
    arm_mm: ValueChange = of(lambda r: r.arm)
    angle_deg: ValueChange = of(lambda r: r.angle)
    travel: ValueChange | None = of(lambda r: r.travel)
    """rotation_distance, mm, or steps per mm; null: it stays"""


class FirmwareEntry(Report):
    """What the firmware of a printer holds now, and what it is to hold."""

    of = Source[PrinterChange]()
    towers: tuple[TowerEntry, ...] = of(lambda r: tuple(map(TowerEntry.of, r.towers)))
    radius_mm: ValueChange = of(lambda r: r.radius)
    bound: FramesEntry = of(lambda r: FramesEntry.of(r.off.bound_mm))
    """with all of it entered"""
    left_out: tuple[LeftOut, ...] = of(lambda r: r.left_out)
    """parts that it has no value for"""


class CorrectionEntry(Report):
    """What is entered in the controller: what every screen, report and export shows first."""

    of = Source[SessionSolution]()
    frame: Frame = of(lambda r: r.correction.frame)
    holds: Holds = of(lambda r: r.correction.holds)
    values: dict[str, EnteredValue] = of(lambda r: r.correction.values)
    """true position = believed position + d_rho; sizes as in a model"""
    bound: FramesEntry = of(lambda r: FramesEntry.of(r.correction.off.bound_mm))
    """with the values entered"""
    bound_now: FramesEntry = of(lambda r: FramesEntry.of(r.correction.off_now.bound_mm))
    """with the present values of the controller"""
    firmware: FirmwareEntry | None = of(
        lambda r: maybe(FirmwareEntry.of, r.printer_change), asked=True
    )
    """of a printer: what is entered in place of values, and what its tolerance is judged by"""
    left_out: tuple[LeftOut, ...] = of(lambda r: r.correction.left_out)
    others: tuple[Gain, ...] = of(lambda r: r.corrections.others(r.correction))
    """in the same frame"""
    mistakes: tuple[LikelyMistake, ...] = of(lambda r: r.corrections.mistakes)
    """in the readings; the values count with them put right"""


class ToolMapEntry(Report):
    """Expected tool error on a plane through Zero; rows go up."""

    of = Source[PlaneMap]()
    across: str = of(lambda r: r.across)
    up: str = of(lambda r: r.up)
    coordinate_mm: Numbers = of(lambda r: r.coordinate_mm.tolist())
    """across"""
    up_mm: Numbers | None = of(
        lambda r: None if r.other_up_mm is None else r.other_up_mm.tolist(), asked=True
    )
    """upwards, where these places are others than those across"""
    error_mm: Holes = of(lambda r: holes(r.value))
    """null beyond the joint limits"""


@dataclass(frozen=True)
class Coverage:
    """Share of the 95 % intervals that held the truth, true and stated standard uncertainty."""

    covered: float
    true_mm: float
    stated_mm: float


class SimulatedSessions(Report):
    """Sessions like this one, simulated and identified."""

    of = Source[MonteCarlo]()
    sessions: int = of(lambda r: r.sessions)
    failed: int = of(lambda r: r.failed)
    parameters: dict[str, Coverage] = of(
        lambda r: rows(Coverage, r.names, r.covered, r.true_mm, r.stated_mm)
    )


class MeasuredSession(Report):
    """Who measured when and with what; ``notes`` are the remarks made on the way."""

    of = Source[Session]()
    origin: str = of(lambda r: r.opened.origin)
    begun: datetime = of(lambda r: r.opened.measured_at)
    """of an imported table the stated day, else when it was imported"""
    operator: str = of(lambda r: r.opened.operator)
    temperature_c: float | None = of(lambda r: r.opened.temperature_c)
    indicators: tuple[Instrument, ...] = of(lambda r: r.opened.instruments)
    notes: tuple[str, ...] = of(lambda r: r.notes)


def _lack_of_fit(lack: LackOfFit | None) -> LackOfFitEntry:
    return LackOfFitEntry(lack.statistic, lack.p_value) if lack else LackOfFitEntry()


_of_results = Source[
    SessionSolution, Judgement | None, tuple[PlaneMap, ...] | None, MonteCarlo | None
]()
"""A solution, and what was asked for beyond it."""


def of_view(getter: Callable[[Solution], V], *, asked: bool = False) -> V | None:
    """A field of the view; null where the readings determine no set."""
    return _of_results(lambda r, *_: maybe(getter, r.view_solution), asked=asked)


class SolutionReport(Report):
    """``solve --json``: `SessionSolution`; what was asked beyond it is there only then.

    Where the readings determine no set, ``subset`` and all that is of the view is null.
    """

    of = _of_results
    schema_id: Literal["glidecal.solution/1"] = schema("glidecal.solution/1")
    sessions: tuple[str, ...] = of(lambda r, *_: r.names)
    measured: tuple[MeasuredSession, ...] = of(
        lambda r, *_: tuple(map(MeasuredSession.of, r.sessions))
    )
    """in the order of the sessions"""
    method: Method = of(lambda r, *_: r.choice.method)
    weights: Weights = of(lambda r, *_: r.choice.weights)
    correction: CorrectionEntry = of(lambda r, *_: CorrectionEntry.of(r))
    """what is entered; parameters are a view"""
    lines: tuple[LineParameter, ...] = of(lambda r, *_: r.lines)
    """lines of the drives; none where the machine file has no tolerances of lines"""
    subset: Subset | None = of_view(lambda v: v.subset)
    """of the view"""
    parameters: dict[str, Parameter] | None = of_view(lambda v: v.parameters)
    covariance: Covariance | None = of_view(lambda v: Covariance.of(v))
    differences: dict[str, Difference] | None = of_view(lambda v: v.tabulated)
    """up to twelve, keys axis_leg with + for Max and - for Min; y_x alone is Max minus Min; of the
    tool z(x, y, z) minus Zero
    """
    rms_before_mm: float | None = of_view(lambda v: v.rms_before_mm)
    """over all differences"""
    rms_after_mm: float | None = of_view(lambda v: v.rms_after_mm)
    """over all differences"""
    degrees_of_freedom: int | None = of_view(lambda v: v.degrees_of_freedom)
    noise: ReadingNoise = of(lambda r, *_: ReadingNoise.of(r.noise))
    display_step_found_mm: float | None = of(lambda r, *_: r.display_found_mm)
    """step of the display as the values show it, if it is not stated; null: they show none"""
    suspect_readings: tuple[SuspectReading, ...] = of(
        lambda r, *_: tuple(map(SuspectReading.of, r.suspects))
    )
    lost_readings: tuple[IsolatedReadingsEntry, ...] = of(
        lambda r, *_: tuple(map(IsolatedReadingsEntry.of, r.isolated))
    )
    enlarged_by_lack_of_fit: float | None = of_view(lambda v: v.inflation)
    """factor on the standard deviation of the noise if what the model leaves is taken for noise; 1
    if that is no more
    """
    expanded_with_lack_of_fit_mm: dict[str, float] | None = of_view(
        lambda v: by_name(v.names, v.inflated_expanded_mm)
    )
    """expanded uncertainty (95 %) of each parameter then"""
    expanded_with_tolerances_mm: dict[str, float] | None = of_view(
        lambda v: by_name(v.names, v.expanded_with_tolerances_mm)
    )
    """expanded uncertainty (95 %) of each parameter with those outside the set off within their
    tolerance
    """
    difference_expanded_mm: Numbers | None = of_view(
        lambda v: maybe(lambda mm: mm.tolist(), v.expanded_of_difference_mm)
    )
    """expanded uncertainty (95 %) of d_rho - d_L of x, y, z where the readings tell little of
    d_rho but that; else null
    """
    lack_of_fit: LackOfFitEntry | None = of_view(lambda v: _lack_of_fit(v.lack_of_fit))
    condition_number: float | None = of_view(lambda v: v.condition_number)
    weak_directions: tuple[Direction, ...] | None = of_view(lambda v: v.weak_directions)
    recommended_subset: Subset | None = of(
        lambda r, *_: r.choice.usual if r.choice.solutions else None
    )
    """the view where none is asked for; what is entered is correction"""
    reasons: tuple[str, ...] = of(lambda r, *_: r.choice.reasons)
    """why sets are missing"""
    effects: tuple[FittedSize, ...] | None = of_view(lambda v: v.sizes or None, asked=True)
    """with --model"""
    ambiguous_effects: tuple[str, ...] = of(lambda r, *_: r.ambiguous)
    """those of the model that are one of several that would do"""
    held_sizes: tuple[str, ...] = of(lambda r, *_: r.held)
    """those of the model that a person stated and nothing fitted"""
    tolerance: Judgement | None = of(lambda _, judged, *_m: judged, asked=True)
    """with --tolerance"""
    tool_maps: tuple[ToolMapEntry, ...] | None = of(
        lambda _r, _j, maps, _: tuple(map(ToolMapEntry.of, maps)) if maps else None, asked=True
    )
    """with --map"""
    monte_carlo: SimulatedSessions | None = of(
        lambda _r, _j, _m, simulated: maybe(SimulatedSessions.of, simulated), asked=True
    )
    """with --monte-carlo"""


class ComparisonReport(Report):
    """``compare --json``: two sessions of one machine."""

    of = Source[Comparison]()
    schema_id: Literal["glidecal.comparison/1"] = schema("glidecal.comparison/1")
    before: str = of(lambda r: r.before.names[0])
    after: str = of(lambda r: r.after.names[0])
    differences: dict[str, BothValues] = of(lambda r: r.differences)
    rms_before_mm: float = of(lambda r: r.before.solution.rms_before_mm)
    rms_after_mm: float = of(lambda r: r.after.solution.rms_before_mm)
    rms_expected_mm: float | None = of(lambda r: r.expected_mm)
    """what the fit of the first session left; null across a mechanical change"""
    unit: Literal["mm"] = "mm"
    remarks: tuple[str, ...] = of(lambda r: r.remarks)


class VerificationReport(Report):
    """``verify --json``: was it done, and is the machine good enough?"""

    of = Source[Verification]()
    schema_id: Literal["glidecal.verification/1"] = schema("glidecal.verification/1")
    before: str = of(lambda r: r.compared.before.names[0])
    after: str = of(lambda r: r.compared.after.names[0])
    frame: Frame = of(lambda r: r.compared.after.frame)
    bound_expected_mm: float = of(lambda r: r.compared.before.entered.bound_mm)
    """promised by the first session, 95 %"""
    bound_found_mm: float = of(lambda r: r.compared.after.correction.now_mm)
    """by the second one; what is decided by"""
    tolerance_mm: float | None = of(lambda r: r.tolerance_mm)
    decision: Decision | None = of(lambda r: r.decision)
    """null: no tolerance"""
    offsets: tuple[RemainingOffset, ...] = of(lambda r: r.offsets)
    something_missing: bool = of(lambda r: r.compared.after.lacks_something)
    """more than noise is left: diagnose"""
    remarks: tuple[str, ...] = of(lambda r: r.compared.remarks)


@dataclass(frozen=True)
class Offset:
    """A parameter as exported; null where the source is a model file."""

    value: float
    standard_uncertainty: float | None = None
    expanded_uncertainty: float | None = None
    coverage_factor: float | None = None
    expanded_with_lack_of_fit: float | None = None
    expanded_with_tolerances: float | None = None
