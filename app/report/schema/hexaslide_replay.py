"""What ``replay`` tells of a session of postures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.report.schema.document import Report, Source, schema
from protocols.hexaslide_session import PostureSession
from protocols.record import Record


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


class HexaSlideReplayReport(Report):
    """``replay --json`` of a session of postures."""

    of = Source[PostureSession, Record]()
    schema_id: Literal["glidecal.hexaslide-replay/1"] = schema("glidecal.hexaslide-replay/1")
    session: str = of(lambda r, _: r.name)
    machine: str = of(lambda r, _: r.opened.machine.full_name)
    procedure: str = of(lambda r, _: r.opened.procedure.name)
    measured: tuple[str, ...] = of(lambda r, _: r.opened.procedure.whole().measured)
    origin: Literal["measured", "simulated", "imported"] = of(lambda r, _: r.opened.origin)
    end: Literal["closed", "open", "torn"] = of(lambda _, record: record.end)
    readings: tuple[ReplayedPosture, ...] = of(lambda r, _: _replayed(r))
    skipped: dict[int, str] = of(lambda r, _: r.skipped)
    notes: tuple[str, ...] = of(lambda r, _: r.notes)
