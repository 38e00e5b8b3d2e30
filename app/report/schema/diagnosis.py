"""What ``diagnose`` and ``plan`` tell: what is missing, what to measure next."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Annotated, Literal

from app.report.schema.document import Finite, Report, asked, at, made, schema
from calib.diagnosis.results import (
    Detectable,
    Gap,
    HeldOutGap,
    LikelyName,
    ModelDiscrepancy,
    Named,
    SharedPattern,
    Value,
    Verdict,
)
from calib.posterior.correction import Holds
from calib.posterior.planning import FurtherSetUp, Outside
from calib.posterior.tool import Frame
from calib.tripod.pool import STATIONS

OrNone = Annotated[str | None, made(lambda name: name or None)]


class GapNoise(Report):
    """Of a single reading."""

    standard_deviation_mm: float | None = at(
        "known_noise_mm", "null: no repeats and none stated, so no p-value means anything"
    )
    degrees_of_freedom: Finite = at("noise_df", "null: stated, taken as known")
    source: str = at("noise_source")


class GapPartEntry(Report):
    """A part of the gap: which leg, axis or pattern, its share and its chance."""

    leg: OrNone
    axis: OrNone
    posture_or_pattern: str = at("pattern")
    share: float
    p_value: float


class FindingEntry(Report):
    """An effect or a gross error that was named, and what adopting it does to the gap.

    A ``where`` with commas lists legs or places that have values of their own.
    """

    id: str
    kind: str
    title: str
    where: str
    parameters: tuple[Value, ...]
    probability: float = at("probability", "of this name at this place")
    gap_rms_before_mm: float
    gap_rms_after_mm: float
    indistinguishable_from: tuple[Named, ...]


class UnnamedEffectEntry(FindingEntry):
    """What is left without a name, like an effect."""

    held_out_gap: HeldOutGap | None


def _unnamed(discrepancy: ModelDiscrepancy) -> SimpleNamespace:
    return SimpleNamespace(**vars(discrepancy.effect), held_out_gap=discrepancy.held_out)


class ContenderEntry(Report):
    """A candidate of the model selection, and why it was not named."""

    id: str
    where: str
    parameters: tuple[Value, ...]
    probability: float = at("probability", "of this name at this place, whatever acts beside it")
    gap_rms_after_mm: float
    held_out_gap_rms_mm: float | None
    reason_rejected: str


Place = Annotated[Named, made(lambda pair: Named(*pair))]


class SeparationEntry(Report):
    """The measurement that separates the names that stay open."""

    words: str
    names: tuple[tuple[Place, ...], ...] = at("names", "what is true together; none: no effect")
    apart: float = at("apart", "noise variances between the two nearest")
    protocol: str = at("candidate.text", "a procedure file, or the name of one")
    entered_mm: tuple[float, float, float] = at(
        "candidate.preparation.entered_mm", "to be added to the entered joint offsets before"
    )
    load: float = at("candidate.preparation.load", "times the tool's weight")


class ToolEntry(Report):
    """R.m.s. over the workspace that 95 of 100 machines keep, in a frame."""

    frame: Frame
    now_mm: float = at("now_mm", "with what the controller holds now")
    entered_mm: dict[Holds, float] = at("entered_mm", "with what a controller holds entered")


class DiagnosisReport(Report):
    """``diagnose --json``: what is missing in the model."""

    schema_id: Literal["glidecal.diagnosis/2"] = schema("glidecal.diagnosis/2")
    sessions: tuple[str, ...] = at("found.names")
    held_out: tuple[str, ...] = at("found.held_out")
    noise: GapNoise = at("found.diagnosis")
    verdict: Verdict = at("found.diagnosis.verdict")
    sentence: str = at("found.diagnosis.sentence")
    missing: float = at("found.diagnosis.missing", "probability that anything is missing")
    something_else: float = at(
        "found.diagnosis.something_else", "probability that something without a name acts"
    )
    names: tuple[LikelyName, ...] = at(
        "found.diagnosis.names", "what may act anywhere, the likeliest first"
    )
    gap_before: Gap = at("found.diagnosis.gap_before")
    gap_after: Gap = at("found.diagnosis.gap_after")
    held_out_gap: HeldOutGap | None = at("found.diagnosis.held_out")
    where: tuple[GapPartEntry, ...] = at("found.diagnosis.where")
    effects: tuple[FindingEntry, ...] = at(
        "found.diagnosis.effects", "in the order adopted; empty where nothing may be claimed"
    )
    candidates: tuple[ContenderEntry, ...] = at("found.diagnosis.candidates")
    next_measurement: SeparationEntry | None = at("found.separation")
    smallest_detectable: tuple[Detectable, ...] = at("found.diagnosis.smallest_detectable")
    tool: ToolEntry = at("found.tool")
    tool_adopted: ToolEntry | None = asked(
        "adopted.tool", "with --adopt: if the adopted names are true"
    )
    further: tuple[FurtherSetUp, ...] | None = asked(
        "reach.further", "with --next: set-ups in turn, each with the bound after it"
    )
    left_over: Annotated[UnnamedEffectEntry | None, made(_unnamed)] = at(
        "found.diagnosis.left_over"
    )
    pattern: SharedPattern | None = at(
        "found.diagnosis.pattern",
        "of several sessions: how alike is what is left of each; numbered from 0, held-out last",
    )
    remarks: tuple[str, ...] = at("found.diagnosis.remarks")


class ImitationEntry(Report):
    """How well one effect is imitated by another."""

    effect: Place
    by: Place
    contained: float = at("contained", "1 is never to be told apart")
    left_in_noise_variances: float = at("distinguishable", "of an unremarkable size")


class AliasReport(Report):
    """``diagnose --aliases --json``: what a procedure cannot tell apart."""

    schema_id: Literal["glidecal.aliases/1"] = schema("glidecal.aliases/1")
    effects: tuple[Place, ...] = at("found.effects")
    imitations: tuple[ImitationEntry, ...] = at("found.imitations")
    invisible: tuple[Place, ...] = at("found.invisible")


class ProposalEntry(Report):
    """A measurement that was judged, and the bound that is expected after it.

    Before, ``entered_mm`` is added to the joint offsets in the controller, and the tool is loaded
    to ``load`` times its weight.
    """

    words: str = at("candidate.words")
    legs: tuple[str, ...] = at("candidate.legs")
    station: float = at("candidate.station")
    displacements_mm: tuple[float, ...] = at("candidate.levels_mm")
    cycles: int = at("candidate.cycles", "where there are several, each begins at Zero")
    entered_mm: tuple[float, float, float] = at("candidate.preparation.entered_mm")
    load: float = at("candidate.preparation.load")
    protocol: str = at("candidate.text", "a procedure file, or the name of one")
    minutes: float = at("candidate.minutes")
    bound_mm: float
    gain_mm_per_minute: float


class PlanReport(Report):
    """``plan --json``: the next measurement worth making."""

    schema_id: Literal["glidecal.plan/1"] = schema("glidecal.plan/1")
    sessions: tuple[str, ...] = at("plan.sessions")
    machine: str = at("plan.machine")
    frame: Frame = at("plan.planner.correction.frame")
    holds: Holds = at("plan.planner.correction.holds")
    noise: str = at("plan.noise_words")
    noise_mm: float = at("plan.planner.forecast.noise_mm", "standard deviation of a reading")
    bound_mm: float = at(
        "plan.planner.bound_mm",
        "what the tool is off by at most now (95 %) with the values that are known entered",
    )
    next: ProposalEntry = at("plan.best")
    runners_up: tuple[ProposalEntry, ...] = at("plan.runners_up")
    more_helps: bool = at("plan.planner.more_helps", "any lowers the bound by a tenth")
    separation: SeparationEntry | None = at("plan.planner.separation")
    outside: Outside | None = at(
        "plan.planner.outside", "where legs do not show the larger part of the bound's square"
    )
    further: tuple[FurtherSetUp, ...] = at(
        "plan.planner.reach.further",
        "set-ups in turn, each with the bound after it; no more are worth it",
    )
    stations: tuple[float, ...] = STATIONS
