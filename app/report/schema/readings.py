"""What ``replay``, ``indicator read`` and ``ports`` tell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from app.report.schema.document import Report, Source, schema
from drivers.port import ListPortInfo
from drivers.profile import Evidence, Fault, FaultKind, IndicatorReading, Outcome, Profile, Unit
from protocols.record import Record
from protocols.session import Reading, Session


class ReplayedReading(Report):
    """A reading as recorded; ``superseded`` is the reason why it does not count, or null."""

    of = Source[Reading, str | None]()
    reading: int = of(lambda r, _: r.reading)
    leg: str = of(lambda r, _: r.leg)
    axis: str = of(lambda r, _: r.axis)
    displacement_mm: float = of(lambda r, _: r.displacement_mm)
    position_mm: tuple[float, ...] | None = of(lambda r, _: r.position_mm, asked=True)
    """of a reading of the tool, from Zero"""
    value_mm: float = of(lambda r, _: r.value_mm)
    text: str = of(lambda r, _: r.text)
    cycle: int = of(lambda r, _: r.cycle)
    mount: str = of(lambda r, _: r.mount)
    station: float = of(lambda r, _: r.station)
    time_s: float | None = of(lambda r, _: r.time_s)
    temperature_c: float | None = of(lambda r, _: r.temperature_c)
    averaged: int = of(lambda r, _: r.averaged)
    superseded: str | None = of(lambda _, superseded: superseded)
    extra: dict[str, str] = of(lambda r, _: r.extra)


class Average(Report):
    """Mean of the readings that count along one axis in one posture."""

    of = Source[Sequence[Reading]]()
    leg: str = of(lambda r: r[0].leg)
    axis: str = of(lambda r: r[0].axis)
    station: float = of(lambda r: r[0].station)
    displacement_mm: float = of(lambda r: r[0].displacement_mm)
    position_mm: tuple[float, ...] | None = of(lambda r: r[0].position_mm, asked=True)
    """of a reading of the tool, from Zero"""
    mean_mm: float = of(
        lambda readings: sum(r.value_mm * r.averaged for r in readings) / _count(readings)
    )
    readings: int = of(lambda r: _count(r))


def _count(readings: Sequence[Reading]) -> int:
    return sum(reading.averaged for reading in readings)


def _by_posture(session: Session) -> dict[tuple[object, ...], list[Reading]]:
    """The readings that count, by where they were taken."""
    groups: dict[tuple[object, ...], list[Reading]] = {}
    for r in session.readings:
        place = (r.leg, r.axis, r.station, r.displacement_mm, r.position_mm, r.over_plane)
        groups.setdefault(place, []).append(r)
    return groups


class ReplayReport(Report):
    """``replay --json``: every reading, and the averages of those that count."""

    of = Source[Record]()
    schema_id: Literal["glidecal.replay/1"] = schema("glidecal.replay/1")
    session: str = of(lambda r: r.session.name)
    end: str = of(lambda r: r.end)
    """closed, or how the record ends"""
    remarks: tuple[str, ...] = of(lambda r: r.session.opened.remarks)
    readings: tuple[ReplayedReading, ...] = of(
        lambda r: tuple(
            ReplayedReading.of(reading, r.session.superseded.get(reading.reading))
            for reading in r.session.all_readings
        )
    )
    averages: tuple[Average, ...] = of(
        lambda r: tuple(map(Average.of, _by_posture(r.session).values()))
    )


class ReadingReport(Report):
    """``indicator read --json``: one value."""

    of = Source[str, IndicatorReading]()
    schema_id: Literal["glidecal.reading/1"] = schema("glidecal.reading/1")
    profile: str = of(lambda profile, _: profile)
    text: str = of(lambda _, r: r.text)
    """as received"""
    value_mm: float = of(lambda _, r: r.value_mm)
    unit: Unit = of(lambda _, r: r.unit)
    unit_assumed: bool = of(lambda _, r: r.unit_assumed)
    resolution_mm: float = of(lambda _, r: r.resolution_mm)
    status: Literal["value"] = "value"
    warning: str | None = of(lambda _, r: r.warning or None)


class FaultReport(Report):
    """``indicator read --json``: why there is no value."""

    of = Source[str, Fault]()
    schema_id: Literal["glidecal.reading/1"] = schema("glidecal.reading/1")
    profile: str = of(lambda profile, _: profile)
    text: str = of(lambda _, r: r.text)
    """as received"""
    status: FaultKind = of(lambda _, r: r.kind)
    words: str = of(lambda _, r: r.words)


def outcome_report(profile: str, outcome: Outcome) -> ReadingReport | FaultReport:
    """The document of one outcome."""
    if isinstance(outcome, Fault):
        return FaultReport.of(profile, outcome)
    return ReadingReport.of(profile, outcome)


class FoundPort(Report):
    """A serial port of this computer."""

    of = Source[ListPortInfo]()
    port: str = of(lambda r: r.device)
    description: str | None = of(lambda r: r.description)
    hardware: str | None = of(lambda r: r.hwid)


class KnownProfile(Report):
    """A profile of an indicator."""

    of = Source[Profile]()
    name: str = of(lambda r: r.name)
    title: str = of(lambda r: r.title)
    verified: Evidence = of(lambda r: r.verified)
    source: str = of(lambda r: r.source)


class PortsReport(Report):
    """``ports --json``."""

    of = Source[Sequence[ListPortInfo], Sequence[Profile]]()
    schema_id: Literal["glidecal.ports/1"] = schema("glidecal.ports/1")
    ports: tuple[FoundPort, ...] = of(lambda ports, _: tuple(map(FoundPort.of, ports)))
    profiles: tuple[KnownProfile, ...] = of(
        lambda _, profiles: tuple(map(KnownProfile.of, profiles))
    )
