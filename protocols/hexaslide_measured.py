"""Measured postures of a Hexa Slide, from a session or from the file of older programs."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from protocols.files import RECORD_START
from protocols.hexaslide import HexaSlideMeasurements, read_measurements
from protocols.machine_files import beginning_of


@dataclass(frozen=True, eq=False)
class MeasuredFile:
    """Measured postures by the ``name`` of their file: ``warnings`` tell that its record was cut or
    is not closed, ``began`` when it was measured, None where no date is known.
    """

    name: str
    source: HexaSlideMeasurements
    warnings: tuple[str, ...] = ()
    began: datetime | None = None


def measured_in(path: Path) -> MeasuredFile:
    """Measured postures of a session, or of a file in metres and radians that older programs and
    ``simulate`` write. Raises RecordError.
    """
    if not beginning_of(path).startswith(RECORD_START):
        return MeasuredFile(path.name, read_measurements(path))
    # records load the machines that are read on their legs, which a file needs not
    from protocols.hexaslide_session import read_postures

    session, record = read_postures(path)
    opened = session.opened
    began = opened.measured_at if opened.is_dated else None
    warnings = (record.unfinished,) if record.unfinished else ()
    return MeasuredFile(path.name, session.measurements(), warnings, began)
