"""What ``replay``, ``indicator read`` and ``ports`` tell."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Annotated, Literal

from app.report.schema.document import Report, asked, at, made, schema
from drivers.profile import Evidence, Fault, FaultKind, Outcome, Unit
from protocols.session import Session

POSITION = "of a reading of the tool, from Zero"


class ReplayedReading(Report):
    """A reading as recorded; ``superseded`` is the reason why it does not count, or null."""

    reading: int
    leg: str
    axis: str
    displacement_mm: float
    position_mm: tuple[float, ...] | None = asked("position_mm", POSITION)
    value_mm: float
    text: str
    cycle: int
    mount: str
    station: float
    time_s: float | None
    temperature_c: float | None
    averaged: int
    superseded: str | None
    extra: dict[str, str]


def _readings(session: Session) -> tuple[SimpleNamespace, ...]:
    return tuple(
        SimpleNamespace(**dict(reading), superseded=session.superseded.get(reading.reading))
        for reading in session.all_readings
    )


class Average(Report):
    """Mean of the readings that count along one axis in one posture."""

    leg: str
    axis: str
    station: float
    displacement_mm: float
    position_mm: tuple[float, ...] | None = asked("position_mm", POSITION)
    mean_mm: float
    readings: int


PLACE = ("leg", "axis", "station", "displacement_mm", "position_mm", "over_plane")


def _averages(session: Session) -> tuple[SimpleNamespace, ...]:
    groups: dict[tuple[object, ...], list[tuple[float, int]]] = {}
    for r in session.readings:
        key = tuple(getattr(r, name) for name in PLACE)
        groups.setdefault(key, []).append((r.value_mm, r.averaged))
    counts = {key: sum(n for _, n in values) for key, values in groups.items()}
    return tuple(
        SimpleNamespace(
            **dict(zip(PLACE, key, strict=True)),
            mean_mm=sum(v * n for v, n in values) / counts[key],
            readings=counts[key],
        )
        for key, values in groups.items()
    )


class ReplayReport(Report):
    """``replay --json``: every reading, and the averages of those that count."""

    schema_id: Literal["glidecal.replay/1"] = schema("glidecal.replay/1")
    session: str = at("name")
    end: str = at("end", "closed, or how the record ends")
    remarks: tuple[str, ...] = at("session.opened.remarks")
    readings: Annotated[tuple[ReplayedReading, ...], made(_readings)] = at("session")
    averages: Annotated[tuple[Average, ...], made(_averages)] = at("session")


class ReadingReport(Report):
    """``indicator read --json``: one value."""

    schema_id: Literal["glidecal.reading/1"] = schema("glidecal.reading/1")
    profile: str = at("profile")
    text: str = at("outcome.text", "as received")
    value_mm: float = at("outcome.value_mm")
    unit: Unit = at("outcome.unit")
    unit_assumed: bool = at("outcome.unit_assumed")
    resolution_mm: float = at("outcome.resolution_mm")
    status: Literal["value"] = "value"
    warning: Annotated[str | None, made(lambda words: words or None)] = at("outcome.warning")


class FaultReport(Report):
    """``indicator read --json``: why there is no value."""

    schema_id: Literal["glidecal.reading/1"] = schema("glidecal.reading/1")
    profile: str = at("profile")
    text: str = at("outcome.text", "as received")
    status: FaultKind = at("outcome.kind")
    words: str = at("outcome.words")


def outcome_report(profile: str, outcome: Outcome) -> ReadingReport | FaultReport:
    """The document of one outcome."""
    kind = FaultReport if isinstance(outcome, Fault) else ReadingReport
    return kind.of(profile=profile, outcome=outcome)


class FoundPort(Report):
    """A serial port of this computer."""

    port: str = at("device")
    description: str | None
    hardware: str | None = at("hwid")


class KnownProfile(Report):
    """A profile of an indicator."""

    name: str
    title: str
    verified: Evidence
    source: str


class PortsReport(Report):
    """``ports --json``."""

    schema_id: Literal["glidecal.ports/1"] = schema("glidecal.ports/1")
    ports: tuple[FoundPort, ...]
    profiles: tuple[KnownProfile, ...]
