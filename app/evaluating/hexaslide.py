"""What is missing in a Hexa Slide's model, from a session or a file of measured postures."""

from __future__ import annotations

from pathlib import Path

from calib.diagnosis.hexaslide import HexaSlideDiagnosis, diagnosed
from protocols.hexaslide_measured import measured_in


def diagnose_postures(path: Path) -> HexaSlideDiagnosis:
    """Raises RecordError for a file, CalibrationError where its postures give no result."""
    source = measured_in(path)
    readings, machine = source.readings(), source.machine
    tolerances = machine.tolerances.of(readings.procedure.parameters)
    lead_m = None if machine.lead_mm is None else machine.lead_mm / 1000.0
    return diagnosed(readings, machine.whole(), tolerances, lead_m)
