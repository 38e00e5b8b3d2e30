"""What ``history`` tells."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Literal

from app.evaluating.posture_history import Decision
from app.report.schema.document import Finite, Numbers, Report, at, made, schema
from protocols.documents import Triple

FileName = Annotated[str, made(lambda path: path.name)]
Flags = Annotated[list[bool], made(lambda array: array.tolist())]
Rules = Annotated[list[list[int]], made(lambda rules: [[*each] for each in rules])]
OrNull = Annotated[list[Finite], made(lambda array: array.tolist())]


class PastSession(Report):
    """One session; offsets with what was entered before added, mm."""

    session: FileName = at("path")
    began: datetime = at("entry.began")
    event: str = at("event", "what changed before it, as the records tell; empty: nothing known")
    offsets_mm: Triple = at("entry.offsets_mm", "d_rho of joints x, y, z plus entered offsets")
    expanded_mm: Triple = at("entry.expanded_mm", "expanded uncertainties (95 %)")
    tool_bound_mm: float = at("entry.bound_before_mm", "r.m.s., as the machine was found")
    temperature_c: float | None = at("entry.temperature_c")
    effects: tuple[str, ...] | None = at("entry.effects", "null: not diagnosed")


class Steady(Report):
    """mm per day with its expanded uncertainty (95 %); ``shown`` where it is beyond that."""

    per_day: float
    expanded: float
    shown: bool


class WatchedJoint(Report):
    """Control chart of one joint offset, a value for each session."""

    change_mm: Numbers = at("change", "from the first session")
    changed: Flags = at("chart.changed", "beyond its uncertainty and the limits so far")
    centre_mm: Numbers = at("chart.centre", "mean of the phase that the session is in")
    limit_mm: OrNull = at("chart.limit", "limits from it; null for a phase of one session")
    signals: Rules = at("chart.signals", "Western Electric rules, 1 to 4, that a value completes")
    drift: Steady | None


class PastMachine(Report):
    """Sessions of one machine by their date."""

    machine: str
    origin: str = at("origin", "measured, simulated or imported: each has a history of its own")
    sessions: tuple[PastSession, ...] = at("points")
    days: tuple[float, ...] = at("days", "since the first session")
    joints: tuple[WatchedJoint, ...] = at("joints", "x, y, z")
    due: datetime | None = at("due", "null: no drift, no tolerance or no end to be seen")


class PastPostureSession(Report):
    """One session of postures; mm r.m.s. over the box."""

    session: FileName = at("path")
    began: datetime = at("entry.began")
    event: str = at("event", "what changed before it, as the records tell; empty: nothing known")
    procedure: str = at("entry.procedure")
    postures: int = at("entry.postures")
    platform_now_mm: float = at("entry.now_mm", "how far the platform was off")
    platform_bound_mm: float | None = at(
        "entry.bound_mm", "at most with the calibrated machine (95 %); null: not known"
    )
    decision: Decision | None = at("entry.decision", "null: no tolerance in the machine file")
    temperature_c: float | None = at("entry.temperature_c")
    effects: tuple[str, ...] | None = at("entry.effects", "null: not diagnosed")


class PastPostureMachine(Report):
    """Sessions of postures of one machine by their date."""

    machine: str
    origin: str = at("origin", "measured, simulated or imported: each has a history of its own")
    sessions: tuple[PastPostureSession, ...] = at("points")


@dataclass(frozen=True)
class Unusable:
    """A file that is altered, cut or gives no result."""

    file: str
    problem: str


class HistoryReport(Report):
    """``history --json``."""

    schema_id: Literal["glidecal.history/1"] = schema("glidecal.history/1")
    folder: Annotated[str, made(str)] = at("found.folder")
    machines: tuple[PastMachine, ...] = at("found.machines")
    posture_machines: tuple[PastPostureMachine, ...] = at(
        "found.of_postures", "those that are measured in postures"
    )
    problems: Annotated[
        list[Unusable], made(lambda found: [Unusable(str(path), text) for path, text in found])
    ] = at("found.problems")
