"""What ``identifiability``, ``postures`` and ``solve`` tell of a Hexa Slide."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from app.evaluating.hexaslide_calibration import CalibratedMachine, VerifiedMachine
from app.report.schema.document import LackOfFitEntry, Report, Source, maybe, schema
from app.report.schema.identifiability import SeenReport
from calib.design.criteria import Criterion, Observability
from calib.design.identifiability import ClassicalQr, Combination, SeenBy
from calib.hexaslide.checked import PAIRS, AgainstTruth, FramesApart, HeldOut
from calib.hexaslide.diagnosis import CauseSize
from calib.hexaslide.geometry import unit_of
from calib.hexaslide.planning import DIFFERENCE_STEP, UNITS, HexaSlideSeen, PaperRule
from calib.hexaslide.platform import PlatformError
from calib.hexaslide.procedures import ANGLES, ProcedureKind
from calib.hexaslide.residuals import Residuals
from calib.hexaslide.search import BestPostures
from calib.quantity import rows


@dataclass(frozen=True, eq=False)
class LostCombination(Combination):
    """A combination that is not seen, perhaps at no posture."""

    at_every_posture: bool


class ForwardDifferences(Report):
    """The rule of papers/001 on derivatives as the paper took them."""

    of = Source[PaperRule]()
    step_m: float = DIFFERENCE_STEP
    postures: int = of(lambda r: r.posture_count)
    row_count: int = of(lambda r: r.row_count)
    rank: int = of(lambda r: r.counted)
    """rank by the rule"""
    true_rank: int = of(lambda r: r.rank)
    decided_by: Literal["geometry", "rows", "parameters", "postures"] = of(lambda r: r.decided_by)
    tolerance: float = of(lambda r: r.qr.tolerance)
    flagged: tuple[str, ...] = of(lambda r: r.qr.flagged)
    errors_in_tolerances: tuple[float, float] | None = of(lambda r: r.errors)
    """least and largest"""


@dataclass(frozen=True)
class PaperRules(ClassicalQr):
    """The rule of papers/001 on exact derivatives, and as the paper took them."""

    rank: int = field(metadata={"description": "rank by the rule"})
    forward_differences: tuple[ForwardDifferences, ...]


def rules_of(view: HexaSlideSeen) -> PaperRules:
    """The rules at the postures of a view."""
    counted = len(view.seen.identifiability.names) - len(view.seen.qr.flagged)
    paper = tuple(map(ForwardDifferences.of, view.rules))
    return PaperRules(**vars(view.seen.qr), rank=counted, forward_differences=paper)


class HexaSlideIdentifiabilityReport(SeenReport):
    """``identifiability hexaslide --json``."""

    of = Source[SeenBy, HexaSlideSeen]()
    lost_directions: tuple[LostCombination, ...] = of(
        lambda r, view: tuple(
            LostCombination(**vars(combination), at_every_posture=combination.name in view.always)
            for combination in r.unidentifiable
        )
    )
    classical_qr: PaperRules = of(lambda _, view: rules_of(view))
    reachable_rank: int | None = of(lambda r, _: r.examined.reachable_rank)
    """with postures enough"""
    condition_numbers: dict[str, float] = of(lambda _, view: view.conditions)
    """by units, and without"""
    parameter_units: dict[str, str] = of(
        lambda r, _: {name: unit_of(name) for name in r.identifiability.names}
    )
    """of rails' components m/m"""


class HexaSlidePosturesReport(Report):
    """``postures hexaslide --json``: figures are of the identifiable combinations."""

    of = Source[BestPostures]()
    schema_id: Literal["glidecal.postures/1"] = schema("glidecal.postures/1")
    machine: Literal["hexaslide"] = "hexaslide"
    procedure: ProcedureKind = of(lambda r: r.procedure.kind)
    measured: tuple[str, ...] = of(lambda r: r.procedure.read)
    count: int = of(lambda r: len(r.refined.coordinates))
    criterion: Criterion = of(lambda r: r.search.criterion)
    value: float = of(lambda r: r.refined.value)
    start_value: float = of(lambda r: r.refined.start_value)
    rank: int = of(lambda r: r.rank)
    """combinations that are judged"""
    reachable_rank: int = of(lambda r: r.reachable_rank)
    """those that more postures may show"""
    condition_number: float = of(lambda r: r.condition_number)
    start_condition_number: float = of(lambda r: r.start_condition_number)
    published_criteria: Observability = of(lambda r: r.criteria)
    start_published_criteria: Observability = of(lambda r: r.start)
    units: str = of(lambda r: r.units)
    space: Literal["box", "joints", "link"] = of(lambda r: r.space)
    """where the search moved"""
    postures: tuple[dict[str, float], ...] = of(lambda r: r.postures)
    coordinates_on_bound: int = of(lambda r: r.refined.on_bound)
    start_coordinates_on_bound: int = of(lambda r: r.start_on_bound)
    source: str = of(lambda r: r.search.source)
    """of the first start"""
    seconds: float = of(lambda r: r.seconds)
    starts: int = of(lambda r: len(r.values))
    values_of_starts: tuple[float, ...] = of(lambda r: r.values)
    asked_starts: int = of(lambda r: r.search.starts)
    """more than starts: it was stopped"""
    seed: int = of(lambda r: r.search.seed)


@dataclass(frozen=True)
class Rms:
    """Root mean squares of lengths and angles; null where there are none."""

    length_mm: float | None
    angle_mrad: float | None


def _rms(residuals: Residuals) -> Rms:
    values = (residuals.rms(angles=False), residuals.rms(angles=True))
    return Rms(*(None if size is None else 1000.0 * size for size in values))


class PosturesUsed(Report):
    """How many were measured and fitted, which kept out as a check, how many are needed."""

    of = Source[CalibratedMachine]()
    count: int = of(lambda r: len(r.source.postures))
    fitted: int = of(lambda r: len(r.numbers))
    held_out: tuple[int, ...] = of(lambda r: r.held_out.numbers if r.held_out else ())
    fewest: int = of(lambda r: r.fewest)
    left_out: tuple[int, ...] = of(lambda r: r.left_out)
    """named as mistakes by the diagnosis"""


@dataclass(frozen=True)
class MeasuringNoiseEntry:
    """Noise of one measured value; null where nothing tells it or no angle is measured."""

    length_mm: float | None
    angle_mrad: float | None
    source: Literal["stated", "residuals"]
    degrees_of_freedom: float | None


def _noise(result: CalibratedMachine) -> MeasuringNoiseEntry:
    calibrated, noise = result.fit, result.source.noise
    noise_stated = math.isinf(calibrated.degrees_of_freedom)
    length = None if calibrated.noise_m is None else 1000.0 * calibrated.noise_m
    angles = any(name in ANGLES for name in result.source.measured)
    ratio = noise.angle_mrad / noise.length_mm if noise_stated else 1.0
    return MeasuringNoiseEntry(
        length,
        length * ratio if angles and length is not None else None,
        "stated" if noise_stated else "residuals",
        None if noise_stated else calibrated.degrees_of_freedom,
    )


@dataclass(frozen=True)
class HexaSlideParameter:
    """The value to enter. Uncertainties of those only that are known one by one, with what else may
    be missing where that can be told; of others they mean nothing.
    """

    value: float
    nominal: float
    unit: str
    individually_known: bool
    standard_uncertainty: float | None = None
    expanded_uncertainty: float | None = None
    coverage_factor: float | None = None


def _parameters(result: CalibratedMachine) -> dict[str, HexaSlideParameter]:
    calibrated, results = result.fit, result.parameters
    entered = result.entered.parameters(calibrated.names).tolist()
    parameters = {}
    for k, name in enumerate(calibrated.names):
        is_known = name in calibrated.known
        uncertain: tuple[float, ...] = ()
        if is_known and results.standard is not None and results.expanded is not None:
            deviation, half = float(results.standard[k]), float(results.expanded[k])
            uncertain = deviation, half, half / deviation
        nominal, unit = float(result.start[k]), unit_of(name)
        parameters[name] = HexaSlideParameter(entered[k], nominal, unit, is_known, *uncertain)
    return parameters


@dataclass(frozen=True)
class InnerLength:
    """A distance that no frame changes."""

    value_m: float
    standard_uncertainty_m: float | None = None
    expanded_uncertainty_m: float | None = None


INNER_NAMES = (
    *(f"B{i + 1}-B{j + 1}" for i, j in PAIRS),
    *(f"A1-A{chain}" for chain in range(2, 7)),
    *(f"l{chain}" for chain in range(1, 7)),
)


def _inner(result: CalibratedMachine) -> dict[str, InnerLength]:
    lengths = result.lengths_m
    uncertain = [column for column in (lengths.standard, lengths.expanded) if column is not None]
    return rows(InnerLength, INNER_NAMES, lengths.values, *uncertain)


@dataclass(frozen=True)
class ComponentResidual:
    """What is left of one component, or of one chain with pose-inverse."""

    component: str
    rms: float
    unit: Literal["mm", "mrad"]
    share: float


def _by_component(result: CalibratedMachine) -> tuple[ComponentResidual, ...]:
    residuals = result.fit.after
    sizes = 1000.0 * (residuals.values**2).mean(axis=0) ** 0.5
    columns = (residuals.names, sizes.tolist(), residuals.angular, result.by_column.tolist())
    return tuple(
        ComponentResidual(name, size, "mrad" if angular else "mm", share)
        for name, size, angular, share in zip(*columns, strict=True)
    )


@dataclass(frozen=True)
class PostureResidual:
    """What is left at one posture."""

    posture: int
    share: float


class ResidualReport(Report):
    """Shares of what is left."""

    of = Source[CalibratedMachine]()
    by_component: tuple[ComponentResidual, ...] = of(_by_component)
    by_posture: tuple[PostureResidual, ...] = of(
        lambda r: tuple(map(PostureResidual, r.numbers, r.by_posture.tolist()))
    )
    effects: tuple[str, ...] = of(
        lambda r: tuple(f"{effect.id}:{effect.where}" for effect in r.adopted)
    )
    """of --model, in what is fitted"""
    remark: str = "glidecal diagnose looks for what the parameters do not have."


class HeldOutReport(Report):
    """What is left at the postures kept out of the fit."""

    of = Source[HeldOut]()
    rms_before: Rms = of(lambda r: _rms(r.before))
    rms_after: Rms = of(lambda r: _rms(r.after))


class MachineDistance(Report):
    """A machine against the true one; constant motions are laid over first."""

    of = Source[FramesApart]()
    position_rms_mm: float = of(lambda r: 1000.0 * r.places_rms_m)
    position_worst_mm: float = of(lambda r: 1000.0 * r.places_worst_m)
    angle_rms_mrad: float = of(lambda r: 1000.0 * r.angles_rms_rad)
    platform_frame_turned_mrad: float = of(lambda r: 1000.0 * r.turned_rad)
    platform_frame_shifted_mm: float = of(lambda r: 1000.0 * r.shifted_m)
    base_turned_mrad: float = of(lambda r: 1000.0 * r.base_turned_rad)


class TruthReport(Report):
    """The nominal and the identified machine against the true one."""

    of = Source[AgainstTruth]()
    postures: Literal["held out", "all"] = of(lambda r: "held out" if r.kept_out else "all")
    before: MachineDistance = of(lambda r: MachineDistance.of(r.before))
    after: MachineDistance = of(lambda r: MachineDistance.of(r.after))
    individually_known_within_95_percent: int | None = of(lambda r: r.within)
    individually_known_count: int = of(lambda r: len(r.misses))
    individually_known_worst: float = of(lambda r: float(abs(r.misses).max(initial=0.0)))
    inner_lengths_worst_mm: float = of(lambda r: 1000.0 * float(abs(r.inner_m).max()))


class PlatformReport(Report):
    """The platform's places over the box, frames laid over: off by now, and with the result."""

    of = Source[PlatformError]()
    now_rms_mm: float = of(lambda r: 1000.0 * r.now.places_rms_m)
    """off with the machine file"""
    now_worst_mm: float = of(lambda r: 1000.0 * r.now.places_worst_m)
    bound_rms_mm: float | None = of(lambda r: None if r.bound_m is None else 1000.0 * r.bound_m)
    """off at most with the calibrated machine, 95 %; null where not known"""
    left_open: int = of(lambda r: r.left_open)
    """lost combinations other than motions of frames"""
    in_frame_of_tracker: bool = of(lambda r: r.in_frame_of_tracker)
    """aligned by a shift and a turn of what was measured"""


class HexaSlideVerificationReport(Report):
    """``verify --json`` of a Hexa Slide."""

    of = Source[VerifiedMachine]()
    schema_id: Literal["glidecal.hexaslide-verification/1"] = schema(
        "glidecal.hexaslide-verification/1"
    )
    before: str = of(lambda r: r.before.name)
    after: str = of(lambda r: r.after.name)
    platform_before: PlatformReport = of(lambda r: PlatformReport.of(r.before.platform))
    platform_after: PlatformReport = of(lambda r: PlatformReport.of(r.after.platform))
    tolerance_mm: float | None = of(lambda r: r.tolerance_mm)
    decision: Literal["pass", "fail", "undecided"] | None = of(lambda r: r.decision)
    same_machine_file: bool = of(lambda r: r.same_machine)
    """nothing was entered"""
    remarks: tuple[str, ...] = of(lambda r: r.remarks)
    lost_motions: tuple[str, ...] = of(lambda r: r.after.fit.unidentifiable)


class HexaSlideCalibrationReport(Report):
    """``solve --json`` of a Hexa Slide."""

    of = Source[CalibratedMachine]()
    schema_id: Literal["glidecal.hexaslide-calibration/1"] = schema(
        "glidecal.hexaslide-calibration/1"
    )
    measurements: str = of(lambda r: r.name)
    origin: Literal["measured", "simulated"] = of(lambda r: r.source.origin)
    seed: int | None = of(lambda r: r.source.seed)
    machine: str = of(lambda r: r.source.machine.full_name)
    machine_file: str = of(lambda r: r.source.machine_file)
    procedure: ProcedureKind = of(lambda r: r.source.procedure)
    measured: tuple[str, ...] = of(lambda r: r.source.measured)
    postures: PosturesUsed = of(PosturesUsed.of)
    rank: int = of(lambda r: r.fit.rank)
    parameter_count: int = of(lambda r: len(r.fit.names))
    steps: int = of(lambda r: r.fit.steps)
    converged: bool = of(lambda _: True)
    rms_before: Rms = of(lambda r: _rms(r.fit.before))
    rms_after: Rms = of(lambda r: _rms(r.fit.after))
    noise: MeasuringNoiseEntry = of(_noise)
    lack_of_fit: LackOfFitEntry = of(lambda r: LackOfFitEntry(r.fit.lack_of_fit, r.fit.p_value))
    condition_number: float = of(lambda r: r.fit.condition_number)
    units: str = UNITS
    parameters: dict[str, HexaSlideParameter] = of(_parameters)
    individually_known: tuple[str, ...] = of(lambda r: r.fit.known)
    lost_motions: tuple[str, ...] = of(lambda r: r.fit.unidentifiable)
    lost_count: int = of(lambda r: r.fit.unidentifiable_count)
    platform: PlatformReport = of(lambda r: PlatformReport.of(r.platform))
    inner_lengths: dict[str, InnerLength] = of(_inner)
    """26 that no frame changes, of the machine; `parameters` has what to enter"""
    residuals: ResidualReport = of(ResidualReport.of)
    sizes: tuple[CauseSize, ...] = of(lambda r: r.sizes)
    """of effects of --model, fitted again"""
    held_out: HeldOutReport | None = of(lambda r: maybe(HeldOutReport.of, r.held_out))
    truth: TruthReport | None = of(lambda r: maybe(TruthReport.of, r.truth))
