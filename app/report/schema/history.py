"""What ``history`` tells."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal, cast

from app.evaluating.history import History, MachineHistory, Point
from app.report.schema.document import Numbers, Report, Source, finite, maybe, schema
from calib.control_chart import Drift, Watched
from protocols.documents import Triple


class PastSession(Report):
    """One session; offsets with what was entered before added, mm."""

    of = Source[Point]()
    session: str = of(lambda point: point.path.name)
    began: datetime = of(lambda point: point.entry.began)
    event: str = of(
        lambda point: point.event,
        "what changed before it, as the records tell; empty: nothing known",
    )
    offsets_mm: Triple = of(
        lambda point: cast("Triple", point.entry.offsets_mm),
        "d_rho of joints x, y, z plus entered offsets",
    )
    expanded_mm: Triple = of(
        lambda point: cast("Triple", point.entry.expanded_mm), "expanded uncertainties (95 %)"
    )
    tool_bound_mm: float = of(
        lambda point: point.entry.bound_before_mm, "r.m.s., as the machine was found"
    )
    temperature_c: float | None = of(lambda point: point.entry.temperature_c)
    effects: tuple[str, ...] | None = of(lambda point: point.entry.effects, "null: not diagnosed")


class Steady(Report):
    """mm per day with its expanded uncertainty (95 %); ``shown`` where it is beyond that."""

    of = Source[Drift]()
    per_day: float = of(lambda drift: drift.per_day)
    expanded: float = of(lambda drift: drift.expanded)
    shown: bool = of(lambda drift: drift.shown)


class WatchedJoint(Report):
    """Control chart of one joint offset, a value for each session."""

    of = Source[Watched]()
    change_mm: Numbers = of(lambda joint: joint.change.tolist(), "from the first session")
    changed: list[bool] = of(
        lambda joint: joint.chart.changed.tolist(), "beyond its uncertainty and the limits so far"
    )
    centre_mm: Numbers = of(
        lambda joint: joint.chart.centre.tolist(), "mean of the phase that the session is in"
    )
    limit_mm: list[float | None] = of(
        lambda joint: [finite(value) for value in joint.chart.limit.tolist()],
        "limits from it; null for a phase of one session",
    )
    signals: list[list[int]] = of(
        lambda joint: [[*numbers] for numbers in joint.chart.signals],
        "Western Electric rules, 1 to 4, that a value completes",
    )
    drift: Steady | None = of(lambda joint: maybe(Steady.of, joint.drift))


class PastMachine(Report):
    """Sessions of one machine by their date."""

    of = Source[MachineHistory]()
    machine: str = of(lambda machine: machine.machine)
    origin: str = of(
        lambda machine: machine.origin,
        "measured, simulated or imported: each has a history of its own",
    )
    sessions: tuple[PastSession, ...] = of(
        lambda machine: tuple(map(PastSession.of, machine.points))
    )
    days: tuple[float, ...] = of(lambda machine: machine.days, "since the first session")
    joints: tuple[WatchedJoint, ...] = of(
        lambda machine: tuple(map(WatchedJoint.of, machine.joints)), "x, y, z"
    )
    due: datetime | None = of(
        lambda machine: machine.due, "null: no drift, no tolerance or no end to be seen"
    )


@dataclass(frozen=True)
class Unusable:
    """A file that is altered, cut or gives no result."""

    file: str
    problem: str


class HistoryReport(Report):
    """``history --json``."""

    of = Source[History]()
    schema_id: Literal["glidecal.history/1"] = schema("glidecal.history/1")
    folder: str = of(lambda history: str(history.folder))
    machines: tuple[PastMachine, ...] = of(
        lambda history: tuple(map(PastMachine.of, history.machines))
    )
    problems: list[Unusable] = of(
        lambda history: [Unusable(str(path), text) for path, text in history.problems]
    )
