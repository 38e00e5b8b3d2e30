"""What ``diagnose`` tells: what is missing, and what separates the names."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import starmap
from typing import Literal

from app.evaluating.diagnosis import AdoptedTool, DiagnosedTool, SessionDiagnosis
from app.report.schema.document import Report, Source, finite, maybe, schema
from calib.diagnosis.results import (
    AliasMap,
    Contender,
    Detectable,
    Diagnosis,
    Finding,
    Gap,
    GapPart,
    HeldOutGap,
    Imitation,
    LikelyName,
    ModelDiscrepancy,
    Named,
    SharedPattern,
    Value,
    Verdict,
)
from calib.posterior.correction import Holds
from calib.posterior.planning import FurtherSetUp, Reach, Separation
from calib.posterior.tool import Frame


class GapNoise(Report):
    """Of a single reading."""

    of = Source[Diagnosis]()
    standard_deviation_mm: float | None = of(
        lambda diagnosis: diagnosis.known_noise_mm,
        "null: no repeats and none stated, so no p-value means anything",
    )
    degrees_of_freedom: float | None = of(
        lambda diagnosis: finite(diagnosis.noise_df), "null: stated, taken as known"
    )
    source: str = of(lambda diagnosis: diagnosis.noise_source)


class GapPartEntry(Report):
    """A part of the gap: which leg, axis or pattern, its share and its chance."""

    of = Source[GapPart]()
    leg: str | None = of(lambda part: part.leg or None)
    axis: str | None = of(lambda part: part.axis or None)
    posture_or_pattern: str = of(lambda part: part.pattern)
    share: float = of(lambda part: part.share)
    p_value: float = of(lambda part: part.p_value)


class FindingEntry(Report):
    """An effect or a gross error that was named, and what adopting it does to the gap.

    A ``where`` with commas lists legs or places that have values of their own.
    """

    of = Source[Finding]()
    id: str = of(lambda effect: effect.id)
    kind: str = of(lambda effect: effect.kind)
    title: str = of(lambda effect: effect.title)
    where: str = of(lambda effect: effect.where)
    parameters: tuple[Value, ...] = of(lambda effect: effect.parameters)
    probability: float = of(lambda effect: effect.probability, "of this name at this place")
    gap_rms_before_mm: float = of(lambda effect: effect.gap_rms_before_mm)
    gap_rms_after_mm: float = of(lambda effect: effect.gap_rms_after_mm)
    indistinguishable_from: tuple[Named, ...] = of(lambda effect: effect.indistinguishable_from)


class UnnamedEffectEntry(FindingEntry):
    """What is left without a name, like an effect."""

    of = Source[ModelDiscrepancy]()  # type: ignore[assignment] # reads more
    held_out_gap: HeldOutGap | None = of(lambda discrepancy: discrepancy.held_out)


class ContenderEntry(Report):
    """A candidate of the model selection, and why it was not named."""

    of = Source[Contender]()
    id: str = of(lambda candidate: candidate.id)
    where: str = of(lambda candidate: candidate.where)
    parameters: tuple[Value, ...] = of(lambda candidate: candidate.parameters)
    probability: float = of(
        lambda candidate: candidate.probability,
        "of this name at this place, whatever acts beside it",
    )
    gap_rms_after_mm: float = of(lambda candidate: candidate.gap_rms_after_mm)
    held_out_gap_rms_mm: float | None = of(lambda candidate: candidate.held_out_gap_rms_mm)
    reason_rejected: str = of(lambda candidate: candidate.reason_rejected)


class SeparationEntry(Report):
    """The measurement that separates the names that stay open."""

    of = Source[Separation]()
    words: str = of(lambda separation: separation.words)
    names: tuple[tuple[Named, ...], ...] = of(
        lambda separation: tuple(tuple(starmap(Named, name)) for name in separation.names),
        "what is true together; none: no effect",
    )
    apart: float = of(
        lambda separation: separation.apart, "noise variances between the two nearest"
    )
    protocol: str = of(
        lambda separation: separation.candidate.text, "a procedure file, or the name of one"
    )
    entered_mm: tuple[float, float, float] = of(
        lambda separation: separation.candidate.preparation.entered_mm,
        "to be added to the entered joint offsets before",
    )
    load: float = of(
        lambda separation: separation.candidate.preparation.load, "times the tool's weight"
    )


class ToolEntry(Report):
    """R.m.s. over the workspace that 95 of 100 machines keep, in a frame."""

    of = Source[DiagnosedTool]()
    frame: Frame = of(lambda tool: tool.frame)
    now_mm: float = of(lambda tool: tool.now_mm, "with what the controller holds now")
    entered_mm: dict[Holds, float] = of(
        lambda tool: tool.entered_mm, "with what a controller holds entered"
    )


@dataclass(frozen=True, eq=False)
class DiagnosisResults:
    """A diagnosis, and what was asked for beyond it."""

    diagnosed: SessionDiagnosis
    reach: Reach | None = None
    adopted: AdoptedTool | None = None

    @property
    def diagnosis(self) -> Diagnosis:
        """Of the sessions."""
        return self.diagnosed.diagnosis


class DiagnosisReport(Report):
    """``diagnose --json``: what is missing in the model."""

    of = Source[DiagnosisResults]()
    schema_id: Literal["glidecal.diagnosis/2"] = schema("glidecal.diagnosis/2")
    sessions: tuple[str, ...] = of(lambda results: results.diagnosed.names)
    held_out: tuple[str, ...] = of(lambda results: results.diagnosed.held_out)
    noise: GapNoise = of(lambda results: GapNoise.of(results.diagnosis))
    verdict: Verdict = of(lambda results: results.diagnosis.verdict)
    sentence: str = of(lambda results: results.diagnosis.sentence)
    missing: float = of(
        lambda results: results.diagnosis.missing, "probability that anything is missing"
    )
    something_else: float = of(
        lambda results: results.diagnosis.something_else,
        "probability that something without a name acts",
    )
    names: tuple[LikelyName, ...] = of(
        lambda results: results.diagnosis.names,
        "what may act anywhere, the likeliest first",
    )
    gap_before: Gap = of(lambda results: results.diagnosis.gap_before)
    gap_after: Gap = of(lambda results: results.diagnosis.gap_after)
    held_out_gap: HeldOutGap | None = of(lambda results: results.diagnosis.held_out)
    where: tuple[GapPartEntry, ...] = of(
        lambda results: tuple(map(GapPartEntry.of, results.diagnosis.where))
    )
    effects: tuple[FindingEntry, ...] = of(
        lambda results: tuple(map(FindingEntry.of, results.diagnosis.effects)),
        "in the order adopted; empty where nothing may be claimed",
    )
    candidates: tuple[ContenderEntry, ...] = of(
        lambda results: tuple(map(ContenderEntry.of, results.diagnosis.candidates))
    )
    next_measurement: SeparationEntry | None = of(
        lambda results: maybe(SeparationEntry.of, results.diagnosed.separation)
    )
    smallest_detectable: tuple[Detectable, ...] = of(
        lambda results: results.diagnosis.smallest_detectable
    )
    tool: ToolEntry = of(lambda results: ToolEntry.of(results.diagnosed.tool))
    tool_adopted: ToolEntry | None = of(
        lambda results: ToolEntry.of(results.adopted.tool) if results.adopted else None,
        "with --adopt: if the adopted names are true",
        asked=True,
    )
    further: tuple[FurtherSetUp, ...] | None = of(
        lambda results: results.reach.further if results.reach else None,
        "with --next: set-ups in turn, each with the bound after it",
        asked=True,
    )
    left_over: UnnamedEffectEntry | None = of(
        lambda results: maybe(UnnamedEffectEntry.of, results.diagnosis.left_over)
    )
    pattern: SharedPattern | None = of(
        lambda results: results.diagnosis.pattern,
        "of several sessions: how alike is what is left of each; numbered from 0, held-out last",
    )
    remarks: tuple[str, ...] = of(lambda results: results.diagnosis.remarks)


class ImitationEntry(Report):
    """How well one effect is imitated by another."""

    of = Source[Imitation]()
    effect: Named = of(lambda imitation: Named(*imitation.effect))
    by: Named = of(lambda imitation: Named(*imitation.by))
    contained: float = of(lambda imitation: imitation.contained, "1 is never to be told apart")
    left_in_noise_variances: float = of(
        lambda imitation: imitation.distinguishable, "of an unremarkable size"
    )


class AliasReport(Report):
    """``diagnose --aliases --json``: what a procedure cannot tell apart."""

    of = Source[AliasMap]()
    schema_id: Literal["glidecal.aliases/1"] = schema("glidecal.aliases/1")
    effects: tuple[Named, ...] = of(lambda aliases: tuple(starmap(Named, aliases.effects)))
    imitations: tuple[ImitationEntry, ...] = of(
        lambda aliases: tuple(map(ImitationEntry.of, aliases.imitations))
    )
    invisible: tuple[Named, ...] = of(lambda aliases: tuple(starmap(Named, aliases.invisible)))
