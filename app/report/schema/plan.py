"""What ``plan`` tells: what to measure next."""

from __future__ import annotations

from typing import Literal

from app.planning.tripod import MeasurementPlan
from app.report.schema.diagnosis import SeparationEntry
from app.report.schema.document import Report, Source, maybe, schema
from calib.posterior.correction import Holds
from calib.posterior.planning import FurtherSetUp, OutsideMeasurement, Proposal
from calib.posterior.tool import Frame
from calib.tripod.pool import STATIONS


class ProposalEntry(Report):
    """A measurement that was judged, and the bound that is expected after it.

    Before, ``entered_mm`` is added to the joint offsets in the controller, and the tool is loaded
    to ``load`` times its weight.
    """

    of = Source[Proposal]()
    words: str = of(lambda r: r.candidate.words)
    legs: tuple[str, ...] = of(lambda r: r.candidate.legs)
    station: float = of(lambda r: r.candidate.station)
    displacements_mm: tuple[float, ...] = of(lambda r: r.candidate.levels_mm)
    cycles: int = of(lambda r: r.candidate.cycles)
    """where there are several, each begins at Zero"""
    entered_mm: tuple[float, float, float] = of(lambda r: r.candidate.preparation.entered_mm)
    load: float = of(lambda r: r.candidate.preparation.load)
    protocol: str = of(lambda r: r.candidate.text)
    """a procedure file, or the name of one"""
    minutes: float = of(lambda r: r.candidate.minutes)
    bound_mm: float = of(lambda r: r.bound_mm)
    gain_mm_per_minute: float = of(lambda r: r.gain_mm_per_minute)


class PlanReport(Report):
    """``plan --json``: the next measurement worth making."""

    of = Source[MeasurementPlan]()
    schema_id: Literal["glidecal.plan/1"] = schema("glidecal.plan/1")
    sessions: tuple[str, ...] = of(lambda r: r.sessions)
    machine: str = of(lambda r: r.machine)
    frame: Frame = of(lambda r: r.planner.correction.frame)
    holds: Holds = of(lambda r: r.planner.correction.holds)
    noise: str = of(lambda r: r.noise_words)
    noise_mm: float = of(lambda r: r.planner.forecast.noise_mm)
    """standard deviation of a reading"""
    bound_mm: float = of(lambda r: r.planner.bound_mm)
    """what the tool is off by at most now (95 %) with the values that are known entered"""
    next: ProposalEntry = of(lambda r: ProposalEntry.of(r.best))
    runners_up: tuple[ProposalEntry, ...] = of(lambda r: tuple(map(ProposalEntry.of, r.runners_up)))
    more_helps: bool = of(lambda r: r.planner.more_helps)
    """any lowers the bound by a tenth"""
    separation: SeparationEntry | None = of(
        lambda r: maybe(SeparationEntry.of, r.planner.separation)
    )
    outside: OutsideMeasurement | None = of(lambda r: r.planner.outside)
    """where legs do not show the larger part of the bound's square"""
    further: tuple[FurtherSetUp, ...] = of(lambda r: r.planner.reach.further)
    """set-ups in turn, each with the bound after it; no more are worth it"""
    stations: tuple[float, ...] = STATIONS
