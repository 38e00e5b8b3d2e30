"""What ``plan`` tells."""

from __future__ import annotations

from typing import Annotated, Literal

from app.report.schema.document import Report, at, made, schema
from calib.identify.next_mounting import FurtherSetUp, Proposal
from calib.tripod.pool import STATIONS


class PlanReport(Report):
    """``plan --json``: the next measurement worth making."""

    schema_id: Literal["glidecal.plan/1"] = schema("glidecal.plan/1")
    sessions: tuple[str, ...] = at("plan.sessions")
    machine: str = at("plan.machine")
    noise: str = at("plan.found.noise_words")
    tool_before_mm: float = at("plan.found.tool_before_mm")
    next: Proposal = at("plan.best")
    runners_up: Annotated[tuple[Proposal, ...], made(lambda all_of_them: all_of_them[1:])] = at(
        "plan.found.proposals"
    )
    bound_mm: float = at(
        "plan.found.reach.bound_mm",
        "what the tool is off by at most now (95 %) with the values that are known entered",
    )
    bound_for: str = at(
        "plan.found.reach.open_name", "the name it is for; empty: noise and tolerances"
    )
    further: tuple[FurtherSetUp, ...] = at(
        "plan.found.reach.further",
        "set-ups in turn, each with the bound after it; no more are worth it",
    )
    stations: tuple[float, ...] = STATIONS
