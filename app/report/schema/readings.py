"""What ``replay``, ``indicator read`` and ``ports`` tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from serial.tools.list_ports_common import ListPortInfo

from app.report.schema.document import Report, Source, schema
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
    reading: int = of(lambda taken: taken.reading.reading)
    leg: str = of(lambda taken: taken.reading.leg)
    axis: str = of(lambda taken: taken.reading.axis)
    displacement_mm: float = of(lambda taken: taken.reading.displacement_mm)
    position_mm: tuple[float, ...] | None = of(
        lambda taken: taken.reading.position_mm, POSITION, asked=True
    )
    value_mm: float = of(lambda taken: taken.reading.value_mm)
    text: str = of(lambda taken: taken.reading.text)
    cycle: int = of(lambda taken: taken.reading.cycle)
    mount: str = of(lambda taken: taken.reading.mount)
    station: float = of(lambda taken: taken.reading.station)
    time_s: float | None = of(lambda taken: taken.reading.time_s)
    temperature_c: float | None = of(lambda taken: taken.reading.temperature_c)
    averaged: int = of(lambda taken: taken.reading.averaged)
    superseded: str | None = of(lambda taken: taken.superseded)
    extra: dict[str, str] = of(lambda taken: taken.reading.extra)


class Average(Report):
    """Mean of the readings that count along one axis in one posture."""

    of = Source[Sequence[Reading]]()
    leg: str = of(lambda readings: readings[0].leg)
    axis: str = of(lambda readings: readings[0].axis)
    station: float = of(lambda readings: readings[0].station)
    displacement_mm: float = of(lambda readings: readings[0].displacement_mm)
    position_mm: tuple[float, ...] | None = of(
        lambda readings: readings[0].position_mm, POSITION, asked=True
    )
    mean_mm: float = of(
        lambda readings: sum(r.value_mm * r.averaged for r in readings) / _count(readings)
    )
    readings: int = of(lambda readings: _count(readings))


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
    session: str = of(lambda replayed: replayed.session.name)
    end: str = of(lambda replayed: replayed.end, "closed, or how the record ends")
    remarks: tuple[str, ...] = of(lambda replayed: replayed.session.opened.remarks)
    readings: tuple[ReplayedReading, ...] = of(
        lambda replayed: tuple(
            ReplayedReading.of(
                TakenReading(reading, replayed.session.superseded.get(reading.reading))
            )
            for reading in replayed.session.all_readings
        )
    )
    averages: tuple[Average, ...] = of(
        lambda replayed: tuple(map(Average.of, _by_posture(replayed.session).values()))
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
    profile: str = of(lambda outcome: outcome.profile)
    text: str = of(lambda outcome: outcome.reading.text, "as received")
    value_mm: float = of(lambda outcome: outcome.reading.value_mm)
    unit: Unit = of(lambda outcome: outcome.reading.unit)
    unit_assumed: bool = of(lambda outcome: outcome.reading.unit_assumed)
    resolution_mm: float = of(lambda outcome: outcome.reading.resolution_mm)
    status: Literal["value"] = "value"
    warning: str | None = of(lambda outcome: outcome.reading.warning or None)


@dataclass(frozen=True)
class ProfiledFault:
    """A fault, and the name of the profile that read it."""

    profile: str
    fault: Fault


class FaultReport(Report):
    """``indicator read --json``: why there is no value."""

    of = Source[ProfiledFault]()
    schema_id: Literal["glidecal.reading/1"] = schema("glidecal.reading/1")
    profile: str = of(lambda outcome: outcome.profile)
    text: str = of(lambda outcome: outcome.fault.text, "as received")
    status: FaultKind = of(lambda outcome: outcome.fault.kind)
    words: str = of(lambda outcome: outcome.fault.words)


def outcome_report(profile: str, outcome: Outcome) -> ReadingReport | FaultReport:
    """The document of one outcome."""
    if isinstance(outcome, Fault):
        return FaultReport.of(ProfiledFault(profile, outcome))
    return ReadingReport.of(ProfiledReading(profile, outcome))


class FoundPort(Report):
    """A serial port of this computer."""

    of = Source[ListPortInfo]()
    port: str = of(lambda port: port.device)
    description: str | None = of(lambda port: port.description)
    hardware: str | None = of(lambda port: port.hwid)


class KnownProfile(Report):
    """A profile of an indicator."""

    of = Source[Profile]()
    name: str = of(lambda profile: profile.name)
    title: str = of(lambda profile: profile.title)
    verified: Evidence = of(lambda profile: profile.verified)
    source: str = of(lambda profile: profile.source)


@dataclass(frozen=True)
class SerialPorts:
    """Ports of this computer, and profiles for what may be there."""

    ports: Sequence[ListPortInfo]
    profiles: Sequence[Profile]


class PortsReport(Report):
    """``ports --json``."""

    of = Source[SerialPorts]()
    schema_id: Literal["glidecal.ports/1"] = schema("glidecal.ports/1")
    ports: tuple[FoundPort, ...] = of(lambda computer: tuple(map(FoundPort.of, computer.ports)))
    profiles: tuple[KnownProfile, ...] = of(
        lambda computer: tuple(map(KnownProfile.of, computer.profiles))
    )
