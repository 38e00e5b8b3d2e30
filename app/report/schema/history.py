"""What ``history`` tells."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal, cast

from app.evaluating.history import Entry, History, MachineHistory
from app.evaluating.posture_history import Point, PostureEntry, PostureHistory
from app.report.schema.document import Numbers, Report, Source, finite, schema
from calib.control_chart import Drift, WatchedQuantity
from calib.identify.accuracy import Decision
from protocols.documents import Triple


class PastSession(Report):
    """One session; offsets with what was entered before added, mm."""

    of = Source[Point[Entry]]()
    session: str = of(lambda r: r.path.as_posix())
    """its path in the folder"""
    began: datetime = of(lambda r: r.entry.began)
    event: str = of(lambda r: r.event)
    """what changed before it, as the records tell; empty: nothing known"""
    offsets_mm: Triple = of(lambda r: cast("Triple", r.entry.offsets_mm))
    """d_rho of joints x, y, z plus entered offsets"""
    expanded_mm: Triple = of(lambda r: cast("Triple", r.entry.expanded_mm))
    """expanded uncertainties (95 %)"""
    tool_bound_mm: float = of(lambda r: r.entry.bound_before_mm)
    """r.m.s., as the machine was found"""
    decision: Decision | None = of(lambda r: r.entry.decision)
    """as it was found; null: no tolerance in the machine file"""
    temperature_c: float | None = of(lambda r: r.entry.temperature_c)
    effects: tuple[str, ...] | None = of(lambda r: r.entry.effects)
    """null: not diagnosed"""


class WatchedJoint(Report):
    """Control chart of one joint offset, a value for each session."""

    of = Source[WatchedQuantity]()
    change_mm: Numbers = of(lambda r: r.change.tolist())
    """from the first session"""
    changed: list[bool] = of(lambda r: r.chart.changed.tolist())
    """beyond its uncertainty and the limits so far"""
    centre_mm: Numbers = of(lambda r: r.chart.centre.tolist())
    """mean of the phase that the session is in"""
    limit_mm: list[float | None] = of(lambda r: [finite(value) for value in r.chart.limit.tolist()])
    """limits from it; null for a phase of one session"""
    signals: list[list[int]] = of(lambda r: [[*numbers] for numbers in r.chart.signals])
    """Western Electric rules, 1 to 4, that a value completes"""
    drift: Drift | None = of(lambda r: r.drift)


class PastMachine(Report):
    """Sessions of one machine by their date."""

    of = Source[MachineHistory]()
    machine: str = of(lambda r: r.last.machine.name)
    title: str = of(lambda r: r.machine)
    """its name, with its serial number where one is stated"""
    serial_number: str | None = of(lambda r: r.last.machine.serial_number)
    """null: none stated"""
    place: str | None = of(lambda r: r.last.machine.place)
    """of the last session"""
    origin: str = of(lambda r: r.origin)
    """measured, simulated or imported: each has a history of its own"""
    sessions: tuple[PastSession, ...] = of(lambda r: tuple(map(PastSession.of, r.points)))
    days: tuple[float, ...] = of(lambda r: r.days)
    """since the first session"""
    joints: tuple[WatchedJoint, ...] = of(lambda r: tuple(map(WatchedJoint.of, r.joints)))
    """x, y, z"""
    due: datetime | None = of(lambda r: r.due)
    """null: no drift, no tolerance or no end to be seen"""


class PastPostureSession(Report):
    """One session of postures; mm r.m.s. over the box."""

    of = Source[Point[PostureEntry]]()
    session: str = of(lambda r: r.path.as_posix())
    """its path in the folder"""
    began: datetime = of(lambda r: r.entry.began)
    event: str = of(lambda r: r.event)
    """what changed before it, as the records tell; empty: nothing known"""
    procedure: str = of(lambda r: r.entry.procedure)
    postures: int = of(lambda r: r.entry.postures)
    platform_now_mm: float = of(lambda r: cast("float", r.entry.now_mm))
    """how far the platform was off"""
    platform_bound_mm: float | None = of(lambda r: r.entry.bound_mm)
    """at most with the calibrated machine (95 %); null: not known"""
    decision: Decision | None = of(lambda r: r.entry.decision)
    """null: no tolerance in the machine file"""
    temperature_c: float | None = of(lambda r: r.entry.temperature_c)
    effects: tuple[str, ...] | None = of(lambda r: r.entry.effects)
    """null: not diagnosed"""


class PastPostureMachine(Report):
    """Sessions of postures of one machine by their date."""

    of = Source[PostureHistory]()
    machine: str = of(lambda r: r.machine)
    title: str = of(lambda r: r.machine)
    """the same"""
    origin: str = of(lambda r: r.origin)
    """measured, simulated or imported: each has a history of its own"""
    sessions: tuple[PastPostureSession, ...] = of(
        lambda r: tuple(map(PastPostureSession.of, r.points))
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
    folder: str = of(lambda r: str(r.folder))
    files: int = of(lambda r: r.sessions)
    """session files in the folder and below"""
    waiting: int = of(lambda r: r.waiting)
    """sessions that are not worked out yet (--within)"""
    machines: tuple[PastMachine, ...] = of(lambda r: tuple(map(PastMachine.of, r.machines)))
    posture_machines: tuple[PastPostureMachine, ...] = of(
        lambda r: tuple(map(PastPostureMachine.of, r.of_postures))
    )
    """those that are measured in postures"""
    problems: list[Unusable] = of(
        lambda r: [Unusable(str(path), text) for path, text in r.problems]
    )
