"""What ``identifiability``, ``postures`` and ``solve`` tell of a Hexa Slide."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Literal

from app.evaluating.hexaslide_calibration import CalibratedMachine
from app.report.schema.document import (
    Count,
    LackOfFitEntry,
    Report,
    Thousandths,
    at,
    called,
    made,
    rows,
    schema,
)
from app.report.schema.planning import ClassicalQrEntry, DirectionEntry, IdentifiabilityReport
from calib.design.criteria import Criterion, Observability
from calib.hexaslide.checked import PAIRS, inner_lengths
from calib.hexaslide.geometry import unit_of
from calib.hexaslide.planning import DIFFERENCE_STEP, UNITS, HexaSlideSeen
from calib.hexaslide.procedures import ANGLES, ProcedureKind
from calib.hexaslide.residuals import Residuals

if TYPE_CHECKING:
    from protocols.hexaslide_session import PostureSession


class HexaSlideDirection(DirectionEntry):
    """A lost combination, whole; other postures may show it."""

    at_every_posture: bool


def _lost(view: HexaSlideSeen) -> tuple[SimpleNamespace, ...]:
    return tuple(
        SimpleNamespace(**vars(parameter), at_every_posture=parameter.name in view.always)
        for parameter in view.seen.unidentifiable
    )


class ForwardDifferences(Report):
    """The rule of papers/001 on derivatives as the paper took them."""

    step_m: float = DIFFERENCE_STEP
    postures: int = at("posture_count")
    row_count: int
    rank: int = at("counted", "what the rule counts")
    true_rank: int = at("rank")
    decided_by: Literal["geometry", "rows", "parameters", "postures"]
    tolerance: float = at("qr.tolerance")
    flagged: tuple[str, ...] = at("qr.flagged")
    errors_in_tolerances: tuple[float, float] | None = at("errors", "least and largest")


class PaperRules(ClassicalQrEntry):
    """The rule of papers/001 on exact derivatives, and as the paper took them."""

    tolerance: float = at("seen.qr.tolerance")
    flagged: tuple[str, ...] = at("seen.qr.flagged")
    rank: Annotated[int, made(lambda seen: len(seen.found.names) - len(seen.qr.flagged))] = at(
        "seen", "what the rule counts"
    )
    forward_differences: tuple[ForwardDifferences, ...] = at("rules")


class HexaSlideIdentifiabilityReport(IdentifiabilityReport):
    """``identifiability hexaslide --json``."""

    lost_directions: Annotated[tuple[HexaSlideDirection, ...], made(_lost)] = at("found")
    classical_qr: PaperRules = at("found")
    reachable_rank: int | None = at("seen.examined.reachable_rank", "with postures enough")
    condition_numbers: dict[str, float] = at("found.conditions", "by units, and without")
    parameter_units: Annotated[
        dict[str, str], made(lambda names: {name: unit_of(name) for name in names})
    ] = at("seen.found.names", "of rails' components m/m")


class HexaSlidePosturesReport(Report):
    """``postures hexaslide --json``: figures are of the identifiable combinations."""

    schema_id: Literal["glidecal.postures/1"] = schema("glidecal.postures/1")
    machine: Literal["hexaslide"] = "hexaslide"
    procedure: ProcedureKind = at("best.procedure.kind")
    measured: tuple[str, ...] = at("best.procedure.read")
    count: Count = at("best.refined.coordinates")
    criterion: Criterion = at("best.search.criterion")
    value: float = at("best.refined.value")
    start_value: float = at("best.refined.start_value")
    rank: int = at("best.rank", "combinations that are judged")
    reachable_rank: int = at("best.reachable_rank", "those that more postures may show")
    condition_number: float = at("best.condition_number")
    start_condition_number: float = at("best.start_condition_number")
    published_criteria: Observability = at("best.found")
    start_published_criteria: Observability = at("best.start")
    units: str = at("best.units")
    space: Literal["box", "joints"] = at("best.space", "where the search moved")
    postures: tuple[dict[str, float], ...] = at("best.postures")
    coordinates_on_bound: int = at("best.refined.on_bound")
    start_coordinates_on_bound: int = at("best.start_on_bound")
    source: str = at("best.search.source", "of the first start")
    seconds: float = at("best.seconds")
    starts: Count = at("best.values")
    values_of_starts: tuple[float, ...] = at("best.values")
    asked_starts: int = at("best.search.starts", "more than starts: it was stopped")
    seed: int = at("best.search.seed")


@dataclass(frozen=True)
class Rms:
    """Root mean squares of lengths and angles; null where there are none."""

    length_mm: float | None
    angle_mrad: float | None


def _rms(residuals: Residuals) -> Rms:
    values = (residuals.rms(angles=False), residuals.rms(angles=True))
    return Rms(*(None if size is None else 1000.0 * size for size in values))


RmsOf = Annotated[Rms, made(_rms)]


class PosturesUsed(Report):
    """How many were measured and fitted, which kept out as a check, how many are needed."""

    count: Count = at("solved.source.postures")
    fitted: Count = at("solved.numbers")
    held_out: Annotated[
        tuple[int, ...], made(lambda one: one.held_out.numbers if one.held_out else ())
    ] = at("solved")
    fewest: int = at("solved.fewest")


@dataclass(frozen=True)
class MeasuringNoiseEntry:
    """Of one measured value; null where nothing tells it or no angle is measured."""

    length_mm: float | None
    angle_mrad: float | None
    source: Literal["stated", "residuals"]
    degrees_of_freedom: float | None


def _noise(solved: CalibratedMachine) -> MeasuringNoiseEntry:
    calibrated, noise = solved.found, solved.source.noise
    stated = math.isinf(calibrated.degrees_of_freedom)
    length = None if calibrated.noise_m is None else 1000.0 * calibrated.noise_m
    angles = any(name in ANGLES for name in solved.source.measured)
    ratio = noise.angle_mrad / noise.length_mm if stated else 1.0
    return MeasuringNoiseEntry(
        length,
        length * ratio if angles and length is not None else None,
        "stated" if stated else "residuals",
        None if stated else calibrated.degrees_of_freedom,
    )


def _lack_of_fit(solved: CalibratedMachine) -> LackOfFitEntry:
    """Variance that is left by the stated one."""
    if solved.p_value is None:
        return LackOfFitEntry()
    return LackOfFitEntry(statistic=solved.found.lack_of_fit, p_value=solved.p_value)


@dataclass(frozen=True)
class HexaSlideParameter:
    """Uncertainties of those only that are known one by one; of others they mean nothing."""

    value: float
    nominal: float
    unit: str
    individually_known: bool
    standard_uncertainty: float | None = None
    expanded_uncertainty: float | None = None
    coverage_factor: float | None = None


def _parameters(solved: CalibratedMachine) -> dict[str, HexaSlideParameter]:
    calibrated, u, factor = solved.found, solved.uncertainty, solved.factor
    parameters = {}
    for k, name in enumerate(calibrated.names):
        is_known = name in calibrated.known
        deviation = float(u[k]) if is_known and u is not None else None
        uncertain = () if deviation is None else (deviation, deviation * (factor or 0.0), factor)
        value, nominal = float(calibrated.parameters[k]), float(solved.start[k])
        parameters[name] = HexaSlideParameter(value, nominal, unit_of(name), is_known, *uncertain)
    return parameters


@dataclass(frozen=True)
class InnerLength:
    """A distance that no frame changes."""

    value_m: float
    standard_uncertainty_m: float | None = None


INNER_NAMES = (
    *(f"B{i + 1}-B{j + 1}" for i, j in PAIRS),
    *(f"A1-A{chain}" for chain in range(2, 7)),
    *(f"l{chain}" for chain in range(1, 7)),
)


def _inner(solved: CalibratedMachine) -> dict[str, InnerLength]:
    u = solved.inner_uncertainty_m
    uncertain = () if u is None else (u,)
    return rows(InnerLength, INNER_NAMES, inner_lengths(solved.found.machine.geometry), *uncertain)


@dataclass(frozen=True)
class ComponentResidual:
    """What is left of one component, or of one chain with pose-inverse."""

    component: str
    rms: float
    unit: Literal["mm", "mrad"]
    share: float


def _by_component(solved: CalibratedMachine) -> tuple[ComponentResidual, ...]:
    after = solved.found.after
    sizes = 1000.0 * (after.values**2).mean(axis=0) ** 0.5
    columns = (after.names, sizes.tolist(), after.angular, solved.by_column.tolist())
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

    by_component: Annotated[tuple[ComponentResidual, ...], made(_by_component)] = at("solved")
    by_posture: Annotated[
        tuple[PostureResidual, ...],
        made(lambda one: tuple(map(PostureResidual, one.numbers, one.by_posture.tolist()))),
    ] = at("solved")
    effects: tuple[str, ...] = ()
    remark: str = "glidecal diagnose looks for what the parameters do not have."


class HeldOutReport(Report):
    """At the postures kept out of the fit."""

    rms_before: RmsOf = at("before")
    rms_after: RmsOf = at("after")


class MachineDistance(Report):
    """A machine against the true one; constant motions are laid over first."""

    position_rms_mm: Thousandths = at("places_rms_m")
    position_worst_mm: Thousandths = at("places_worst_m")
    angle_rms_mrad: Thousandths = at("angles_rms_rad")
    platform_frame_turned_mrad: Thousandths = at("turned_rad")
    platform_frame_shifted_mm: Thousandths = at("shifted_m")
    base_turned_mrad: Thousandths = at("base_turned_rad")


class TruthReport(Report):
    """The nominal and the identified machine against the true one."""

    postures: Annotated[
        Literal["held out", "all"], made(lambda kept_out: "held out" if kept_out else "all")
    ] = at("kept_out")
    before: MachineDistance
    after: MachineDistance
    individually_known_within_95_percent: int | None = at("within")
    individually_known_count: Count = at("misses")
    individually_known_worst: Annotated[
        float, made(lambda misses: float(abs(misses).max(initial=0.0)))
    ] = at("misses")
    inner_lengths_worst_mm: Annotated[
        float, made(lambda inner: 1000.0 * float(abs(inner).max()))
    ] = at("inner_m")


class PlatformReport(Report):
    """The platform's places over the box, frames laid over: off by now, and with the result."""

    now_rms_mm: Thousandths = at("now.places_rms_m", "off with the machine file")
    now_worst_mm: Thousandths = at("now.places_worst_m")
    bound_rms_mm: Annotated[float | None, made(lambda bound: 1000.0 * bound)] = at(
        "bound_m", "off at most with the calibrated machine, 95 %; null where not known"
    )
    left_open: int = at("left_open", "lost combinations that are no motions of frames")


class HexaSlideVerificationReport(Report):
    """``verify --json`` of a Hexa Slide."""

    schema_id: Literal["glidecal.hexaslide-verification/1"] = schema(
        "glidecal.hexaslide-verification/1"
    )
    before: str = at("found.before.name")
    after: str = at("found.after.name")
    platform_before: PlatformReport = at("found.before.platform")
    platform_after: PlatformReport = at("found.after.platform")
    tolerance_mm: float | None = at("found.tolerance_mm")
    decision: Literal["pass", "fail", "undecided"] | None = at("found.decision")
    same_machine_file: bool = at("found.same_machine", "nothing was entered")
    lost_motions: tuple[str, ...] = at("found.after.found.unidentifiable")


@dataclass(frozen=True)
class ReplayedPosture:
    """One reading; millimetres and degrees."""

    reading: int
    posture: int
    sliders_mm: tuple[float, ...]
    values: tuple[float, ...]
    superseded: str | None


def _replayed(session: PostureSession) -> tuple[ReplayedPosture, ...]:
    return tuple(
        ReplayedPosture(
            reading.reading,
            reading.posture,
            reading.sliders_mm,
            reading.values,
            session.superseded.get(reading.reading),
        )
        for reading in session.all_readings
    )


class HexaSlideReplayReport(Report):
    """``replay --json`` of a session of postures."""

    schema_id: Literal["glidecal.hexaslide-replay/1"] = schema("glidecal.hexaslide-replay/1")
    session: str = at("session.name")
    machine: str = at("session.opened.machine.name")
    procedure: str = at("session.opened.procedure.name")
    measured: Annotated[tuple[str, ...], made(lambda procedure: procedure.whole().measured)] = at(
        "session.opened.procedure"
    )
    origin: Literal["measured", "simulated", "imported"] = at("session.opened.origin")
    end: Literal["closed", "open", "torn"] = at("end")
    readings: Annotated[tuple[ReplayedPosture, ...], made(_replayed)] = at("session")
    skipped: dict[int, str] = at("session.skipped")
    notes: tuple[str, ...] = at("session.notes")


class HexaSlideCalibrationReport(Report):
    """``solve --json`` of a Hexa Slide."""

    schema_id: Literal["glidecal.hexaslide-calibration/1"] = schema(
        "glidecal.hexaslide-calibration/1"
    )
    measurements: str = at("solved.name")
    origin: Literal["measured", "simulated"] = at("solved.source.origin")
    seed: int | None = at("solved.source.seed")
    machine: str = at("solved.source.machine.name")
    machine_file: str = at("solved.source.machine_file")
    procedure: ProcedureKind = at("solved.source.procedure")
    measured: tuple[str, ...] = at("solved.source.measured")
    postures: Annotated[PosturesUsed, called("solved")] = at("solved")
    rank: int = at("solved.found.rank")
    parameter_count: Count = at("solved.found.names")
    steps: int = at("solved.found.steps")
    converged: bool = at("solved.found.converged")
    rms_before: RmsOf = at("solved.found.before")
    rms_after: RmsOf = at("solved.found.after")
    noise: Annotated[MeasuringNoiseEntry, made(_noise)] = at("solved")
    lack_of_fit: Annotated[LackOfFitEntry, made(_lack_of_fit)] = at("solved")
    condition_number: float = at("solved.found.condition_number")
    units: str = UNITS
    parameters: Annotated[dict[str, HexaSlideParameter], made(_parameters)] = at("solved")
    individually_known: tuple[str, ...] = at("solved.found.known")
    lost_motions: tuple[str, ...] = at("solved.found.unidentifiable")
    lost_count: int = at("solved.found.unidentifiable_count")
    platform: PlatformReport = at("solved.platform")
    inner_lengths: Annotated[dict[str, InnerLength], made(_inner)] = at(
        "solved", "26 that no frame changes"
    )
    residuals: Annotated[ResidualReport, called("solved")] = at("solved")
    held_out: HeldOutReport | None = at("solved.held_out")
    truth: TruthReport | None = at("solved.truth")
