"""What ``diagnose`` tells: what is missing, and what separates the names."""

from __future__ import annotations

from itertools import starmap
from typing import Literal

from app.evaluating.diagnosis import AdoptedTool, DiagnosedTool, SessionDiagnosis
from app.report.schema.document import Report, Source, finite, maybe, schema
from calib.diagnosis.results import (
    AliasMap,
    Contender,
    Detectable,
    EffectName,
    Finding,
    Gap,
    GapPart,
    HeldOutGap,
    Imitation,
    LikelyName,
    ModelDiscrepancy,
    SharedPattern,
    Verdict,
)
from calib.posterior.correction import Holds
from calib.posterior.planning import FurtherSetUp, Reach, Separation
from calib.posterior.tool import Frame


class GapNoise(Report):
    """Noise of a single reading."""

    of = Source[SessionDiagnosis]()
    standard_deviation_mm: float | None = of(
        lambda r: r.noise.standard_deviation_mm if r.noise else None
    )
    """null: repeats tell none and none is stated, so no p-value means anything"""
    degrees_of_freedom: float | None = of(
        lambda r: finite(r.noise.degrees_of_freedom) if r.noise else 0.0
    )
    """null: stated, taken as known"""
    source: str = of(lambda r: r.noise.source if r.noise else "residuals")


class SeparationEntry(Report):
    """The measurement that separates the names that stay open."""

    of = Source[Separation]()
    words: str = of(lambda r: r.words)
    names: tuple[tuple[EffectName, ...], ...] = of(
        lambda r: tuple(tuple(starmap(EffectName, name)) for name in r.names)
    )
    """what is true together; none: no effect"""
    apart: float = of(lambda r: r.apart)
    """noise variances between the two nearest"""
    protocol: str = of(lambda r: r.candidate.text)
    """a procedure file, or the name of one"""
    entered_mm: tuple[float, float, float] = of(lambda r: r.candidate.preparation.entered_mm)
    """to be added to the entered joint offsets before"""
    load: float = of(lambda r: r.candidate.preparation.load)
    """times the tool's weight"""


class ToolEntry(Report):
    """R.m.s. over the workspace that 95 of 100 machines keep, in a frame."""

    of = Source[DiagnosedTool]()
    frame: Frame = of(lambda r: r.frame)
    now_mm: float = of(lambda r: r.now_mm)
    """with the present values of the controller"""
    entered_mm: dict[Holds, float] = of(lambda r: r.entered_mm)
    """with all values that a controller can take entered"""
    firmware_mm: float | None = of(lambda r: r.firmware_mm, asked=True)
    """of a printer: with all values of its firmware entered"""


class DiagnosisReport(Report):
    """``diagnose --json``: what is missing in the model."""

    of = Source[SessionDiagnosis, Reach | None, AdoptedTool | None]()
    schema_id: Literal["glidecal.diagnosis/2"] = schema("glidecal.diagnosis/2")
    sessions: tuple[str, ...] = of(lambda r, *_: r.names)
    held_out: tuple[str, ...] = of(lambda r, *_: r.held_out)
    noise: GapNoise = of(lambda r, *_: GapNoise.of(r))
    verdict: Verdict = of(lambda r, *_: r.diagnosis.verdict)
    sentence: str = of(lambda r, *_: r.diagnosis.sentence)
    missing: float = of(lambda r, *_: r.diagnosis.missing)
    """probability that anything is missing"""
    something_else: float = of(lambda r, *_: r.diagnosis.something_else)
    """probability that something without a name acts"""
    names: tuple[LikelyName, ...] = of(lambda r, *_: r.diagnosis.names)
    """what may act anywhere, the likeliest first"""
    gap_before: Gap = of(lambda r, *_: r.diagnosis.gap_before)
    gap_after: Gap = of(lambda r, *_: r.diagnosis.gap_after)
    held_out_gap: HeldOutGap | None = of(lambda r, *_: r.diagnosis.held_out)
    where: tuple[GapPart, ...] = of(lambda r, *_: r.diagnosis.where)
    effects: tuple[Finding, ...] = of(lambda r, *_: r.diagnosis.effects)
    """in the order adopted; empty where nothing may be claimed"""
    candidates: tuple[Contender, ...] = of(lambda r, *_: r.diagnosis.candidates)
    next_measurement: SeparationEntry | None = of(
        lambda r, *_: maybe(SeparationEntry.of, r.separation)
    )
    smallest_detectable: tuple[Detectable, ...] = of(lambda r, *_: r.diagnosis.smallest_detectable)
    tool: ToolEntry = of(lambda r, *_: ToolEntry.of(r.tool))
    tool_adopted: ToolEntry | None = of(
        lambda _r, _, adopted: ToolEntry.of(adopted.tool) if adopted else None, asked=True
    )
    """with --adopt: if the adopted names are true"""
    further: tuple[FurtherSetUp, ...] | None = of(
        lambda _r, reach, _: reach.further if reach else None, asked=True
    )
    """with --next: set-ups in turn, each with the bound after it"""
    left_over: ModelDiscrepancy | None = of(lambda r, *_: r.diagnosis.left_over)
    pattern: SharedPattern | None = of(lambda r, *_: r.diagnosis.pattern)
    """of several sessions: how alike is what is left of each; numbered from 0, held-out last"""
    remarks: tuple[str, ...] = of(lambda r, *_: r.diagnosis.remarks)


class AliasReport(Report):
    """``diagnose --aliases --json``: what a procedure cannot tell apart."""

    of = Source[AliasMap]()
    schema_id: Literal["glidecal.aliases/1"] = schema("glidecal.aliases/1")
    effects: tuple[EffectName, ...] = of(lambda r: r.effects)
    imitations: tuple[Imitation, ...] = of(lambda r: r.imitations)
    invisible: tuple[EffectName, ...] = of(lambda r: r.invisible)
