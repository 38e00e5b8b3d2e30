"""What ``plan`` tells."""

from __future__ import annotations

from typing import Annotated, Literal

from app.report.schema.document import Report, at, made, schema
from calib.identify.next_mounting import Proposal
from calib.tripod.pool import STATIONS


class PlanReport(Report):
    """``plan --json``: the next measurement worth making."""

    schema_id: Literal["glidecal.plan/1"] = schema("glidecal.plan/1")
    sessions: tuple[str, ...] = at("plan.sessions")
    machine: str = at("plan.machine")
    noise: str = at("plan.noise_words")
    tool_before_mm: float = at("plan.tool_before_mm")
    next: Proposal = at("plan.best")
    runners_up: Annotated[tuple[Proposal, ...], made(lambda all_of_them: all_of_them[1:])] = at(
        "plan.proposals"
    )
    stations: tuple[float, ...] = STATIONS
