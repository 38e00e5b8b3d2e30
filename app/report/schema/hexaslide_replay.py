"""What ``replay`` tells of a session of postures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.report.schema.document import Report, Source, schema
from protocols.hexaslide_session import PostureSession


@dataclass(frozen=True)
class ReplayedPosture:
    """One reading; millimetres and degrees."""

    reading: int
    posture: int
    sliders_mm: tuple[float, ...]
    values: tuple[float, ...]
    superseded: str | None


def _replayed(session: PostureSession) -> tuple[ReplayedPosture, ...]:
    return tuple(
        ReplayedPosture(
            reading.reading,
            reading.posture,
            reading.sliders_mm,
            reading.values,
            session.superseded.get(reading.reading),
        )
        for reading in session.all_readings
    )


@dataclass(frozen=True)
class ReplayedPostures:
    """A session of postures, and how its record ends."""

    session: PostureSession
    end: Literal["closed", "open", "torn"]


class HexaSlideReplayReport(Report):
    """``replay --json`` of a session of postures."""

    of = Source[ReplayedPostures]()
    schema_id: Literal["glidecal.hexaslide-replay/1"] = schema("glidecal.hexaslide-replay/1")
    session: str = of(lambda r: r.session.name)
    machine: str = of(lambda r: r.session.opened.machine.full_name)
    procedure: str = of(lambda r: r.session.opened.procedure.name)
    measured: tuple[str, ...] = of(lambda r: r.session.opened.procedure.whole().measured)
    origin: Literal["measured", "simulated", "imported"] = of(lambda r: r.session.opened.origin)
    end: Literal["closed", "open", "torn"] = of(lambda r: r.end)
    readings: tuple[ReplayedPosture, ...] = of(lambda r: _replayed(r.session))
    skipped: dict[int, str] = of(lambda r: r.session.skipped)
    notes: tuple[str, ...] = of(lambda r: r.session.notes)
