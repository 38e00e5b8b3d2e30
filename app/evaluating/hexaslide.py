"""What is missing in a Hexa Slide's model, and what a session says of its machine in a history."""

from __future__ import annotations

from pathlib import Path

from app.evaluating.hexaslide_calibration import calibrate_file, decided
from app.evaluating.posture_history import PostureEntry
from calib.diagnosis.hexaslide import HexaSlideDiagnosis, diagnosed
from calib.errors import GlidecalError
from protocols.hexaslide_measured import measured_in
from protocols.hexaslide_session import read_postures


def diagnose_postures(path: Path) -> HexaSlideDiagnosis:
    """Raises RecordError for a file, CalibrationError where its postures give no result."""
    source = measured_in(path)
    readings, machine = source.readings(), source.machine
    tolerances = machine.tolerances.of(readings.procedure.parameters)
    lead_m = None if machine.lead_mm is None else machine.lead_mm / 1000.0
    return diagnosed(readings, machine.whole(), tolerances, lead_m)


def posture_entry(path: Path, effects: bool) -> PostureEntry:
    """What a record says. Raises RecordError for one that is altered."""
    session, record = read_postures(path)
    opened = session.opened
    entry = PostureEntry(
        began=opened.at,
        name=opened.machine.before_calibration,
        machine=opened.machine.model_dump(mode="json"),
        origin=opened.origin,
        unfinished=bool(record.unfinished),
        temperature_c=opened.temperature_c,
        procedure=opened.procedure.name,
        postures=len(session.readings),
    )
    try:
        solved = calibrate_file(path, None, 0.0)
        named = _named(path) if effects else None
    except GlidecalError as problem:
        return entry.model_copy(update={"problem": f"{path.name}: {problem}"})
    bound_m, tolerance_mm = solved.platform.bound_m, opened.machine.platform_tolerance_mm
    return entry.model_copy(
        update={
            "now_mm": 1000.0 * solved.platform.now.places_rms_m,
            "bound_mm": None if bound_m is None else 1000.0 * bound_m,
            "decision": None if tolerance_mm is None else decided(solved, tolerance_mm),
            "effects": named,
            "problem": record.unfinished,
        }
    )


def _named(path: Path) -> tuple[str, ...]:
    named = diagnose_postures(path).named
    return tuple(f"{cause}:{where}" for claim in named for cause, where in claim.causes)
