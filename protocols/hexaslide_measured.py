"""Measured postures of a Hexa Slide, from a session or from the file of older programs."""

from __future__ import annotations

from pathlib import Path

from protocols.files import RECORD_START
from protocols.hexaslide import HexaSlideMeasurements, read_measurements
from protocols.machine_files import beginning_of


def is_record(path: Path) -> bool:
    """Whether a file begins as a record; False where it cannot be read."""
    return beginning_of(path).startswith(RECORD_START)


def measured_in(path: Path) -> HexaSlideMeasurements:
    """Measured postures of a session, or of a file in metres and radians that older programs and
    ``simulate`` write. Raises RecordError.
    """
    if not is_record(path):
        return read_measurements(path)
    # records load the machines that are read on their legs, which a file needs not
    from protocols.hexaslide_session import read_postures

    return read_postures(path)[0].measurements()
