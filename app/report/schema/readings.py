"""What ``replay``, ``indicator read`` and ``ports`` tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from app.report.schema.document import Report, Source, schema
from drivers.port import ListPortInfo
from drivers.profile import Evidence, Fault, FaultKind, IndicatorReading, Outcome, Profile, Unit
from protocols.session import Reading, Session

POSITION = "of a reading of the tool, from Zero"


@dataclass(frozen=True)
class TakenReading:
    """A reading, and why it does not count; None: it counts."""

    reading: Reading
    superseded: str | None


class ReplayedReading(Report):
    """A reading as recorded; ``superseded`` is the reason why it does not count, or null."""

    of = Source[TakenReading]()
    reading: int = of(lambda r: r.reading.reading)
    leg: str = of(lambda r: r.reading.leg)
    axis: str = of(lambda r: r.reading.axis)
    displacement_mm: float = of(lambda r: r.reading.displacement_mm)
    position_mm: tuple[float, ...] | None = of(
        lambda r: r.reading.position_mm, POSITION, asked=True
    )
    value_mm: float = of(lambda r: r.reading.value_mm)
    text: str = of(lambda r: r.reading.text)
    cycle: int = of(lambda r: r.reading.cycle)
    mount: str = of(lambda r: r.reading.mount)
    station: float = of(lambda r: r.reading.station)
    time_s: float | None = of(lambda r: r.reading.time_s)
    temperature_c: float | None = of(lambda r: r.reading.temperature_c)
    averaged: int = of(lambda r: r.reading.averaged)
    superseded: str | None = of(lambda r: r.superseded)
    extra: dict[str, str] = of(lambda r: r.reading.extra)


class Average(Report):
    """Mean of the readings that count along one axis in one posture."""

    of = Source[Sequence[Reading]]()
    leg: str = of(lambda r: r[0].leg)
    axis: str = of(lambda r: r[0].axis)
    station: float = of(lambda r: r[0].station)
    displacement_mm: float = of(lambda r: r[0].displacement_mm)
    position_mm: tuple[float, ...] | None = of(lambda r: r[0].position_mm, POSITION, asked=True)
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


@dataclass(frozen=True, eq=False)
class ReplayedSession:
    """A session, and how its record ends."""

    session: Session
    end: Literal["closed", "open", "torn"]


class ReplayReport(Report):
    """``replay --json``: every reading, and the averages of those that count."""

    of = Source[ReplayedSession]()
    schema_id: Literal["glidecal.replay/1"] = schema("glidecal.replay/1")
    session: str = of(lambda r: r.session.name)
    end: str = of(lambda r: r.end, "closed, or how the record ends")
    remarks: tuple[str, ...] = of(lambda r: r.session.opened.remarks)
    readings: tuple[ReplayedReading, ...] = of(
        lambda r: tuple(
            ReplayedReading.of(TakenReading(reading, r.session.superseded.get(reading.reading)))
            for reading in r.session.all_readings
        )
    )
    averages: tuple[Average, ...] = of(
        lambda r: tuple(map(Average.of, _by_posture(r.session).values()))
    )


@dataclass(frozen=True)
class ProfiledReading:
    """A reading, and the name of the profile that read it."""

    profile: str
    reading: IndicatorReading


class ReadingReport(Report):
    """``indicator read --json``: one value."""

    of = Source[ProfiledReading]()
    schema_id: Literal["glidecal.reading/1"] = schema("glidecal.reading/1")
    profile: str = of(lambda r: r.profile)
    text: str = of(lambda r: r.reading.text, "as received")
    value_mm: float = of(lambda r: r.reading.value_mm)
    unit: Unit = of(lambda r: r.reading.unit)
    unit_assumed: bool = of(lambda r: r.reading.unit_assumed)
    resolution_mm: float = of(lambda r: r.reading.resolution_mm)
    status: Literal["value"] = "value"
    warning: str | None = of(lambda r: r.reading.warning or None)


@dataclass(frozen=True)
class ProfiledFault:
    """A fault, and the name of the profile that read it."""

    profile: str
    fault: Fault


class FaultReport(Report):
    """``indicator read --json``: why there is no value."""

    of = Source[ProfiledFault]()
    schema_id: Literal["glidecal.reading/1"] = schema("glidecal.reading/1")
    profile: str = of(lambda r: r.profile)
    text: str = of(lambda r: r.fault.text, "as received")
    status: FaultKind = of(lambda r: r.fault.kind)
    words: str = of(lambda r: r.fault.words)


def outcome_report(profile: str, outcome: Outcome) -> ReadingReport | FaultReport:
    """The document of one outcome."""
    if isinstance(outcome, Fault):
        return FaultReport.of(ProfiledFault(profile, outcome))
    return ReadingReport.of(ProfiledReading(profile, outcome))


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


@dataclass(frozen=True)
class SerialPorts:
    """Ports of this computer, and profiles for what may be there."""

    ports: Sequence[ListPortInfo]
    profiles: Sequence[Profile]


class PortsReport(Report):
    """``ports --json``."""

    of = Source[SerialPorts]()
    schema_id: Literal["glidecal.ports/1"] = schema("glidecal.ports/1")
    ports: tuple[FoundPort, ...] = of(lambda r: tuple(map(FoundPort.of, r.ports)))
    profiles: tuple[KnownProfile, ...] = of(lambda r: tuple(map(KnownProfile.of, r.profiles)))
