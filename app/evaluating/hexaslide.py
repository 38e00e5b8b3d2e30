"""A session of postures: its machine, what is missing there, and its line of a history."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from app.evaluating.hexaslide_calibration import (
    SHARE,
    CalibratedMachine,
    beside_effects,
    calibrated,
    calibrated_for,
    decided,
    diagnosis_of,
)
from app.evaluating.posture_history import PostureEntry
from calib.errors import CalibrationError, GlidecalError
from calib.hexaslide.diagnosis import HexaSlideDiagnosis, diagnosis_from
from protocols.dates import is_dated, measured_at
from protocols.hexaslide import HexaSlideMeasurements
from protocols.hexaslide_session import PostureSession, read_postures
from protocols.record import Record


@dataclass(frozen=True, eq=False)
class PostureResult:
    """All that a session gives: the machine from all of its postures, once more with some kept out
    as a check, and the diagnosis, None for the reason in ``not_diagnosed``.
    """

    session: PostureSession
    record: Record
    calibration: CalibratedMachine
    checked: CalibratedMachine
    diagnosis: HexaSlideDiagnosis | None
    not_diagnosed: str


def posture_result(path: Path) -> PostureResult:
    """Raises RecordError for a file that is no session, CalibrationError as `calibrate_file`."""
    session, record = read_postures(path)
    source = session.measurements()
    models, diagnosis, reason = None, None, ""
    try:
        models = beside_effects(source, source.readings(), ())
        diagnosis = diagnosis_from(models)
    except CalibrationError as problem:
        reason = f"{problem}"
    result, checked = calibrated_for((0.0, SHARE), path.name, source, models=models)
    return PostureResult(session, record, result, checked, diagnosis, reason)


def posture_entry(path: Path, effects: bool) -> PostureEntry:
    """What a record says. Raises RecordError for one that is altered."""
    session, record = read_postures(path)
    opened = session.opened
    entry = PostureEntry(
        began=measured_at(opened),
        dated=is_dated(opened),
        name=opened.machine.title,
        machine=opened.machine.model_dump(mode="json"),
        origin=opened.origin,
        unfinished=bool(record.unfinished),
        temperature_c=opened.temperature_c,
        procedure=opened.procedure.name,
        postures=len(session.readings),
    )
    try:
        source = session.measurements()
        table = source.digest() if opened.origin == "imported" else ""
        result = calibrated(path.name, source, 0.0)
        causes = _named(source) if effects else None
    except GlidecalError as problem:
        return entry.model_copy(update={"problem": f"{problem}"})
    bound_m, tolerance_mm = result.platform.bound_m, opened.machine.platform_tolerance_mm
    return entry.model_copy(
        update={
            "now_mm": 1000.0 * result.platform.now.places_rms_m,
            "bound_mm": None if bound_m is None else 1000.0 * bound_m,
            "decision": None if tolerance_mm is None else decided(result, tolerance_mm),
            "effects": causes,
            "table": table,
            "problem": record.unfinished.removeprefix(f"{path.name}: "),
        }
    )


def _named(source: HexaSlideMeasurements) -> tuple[str, ...]:
    claims = diagnosis_of(source).named
    return tuple(f"{cause}:{where}" for claim in claims for cause, where in claim.causes)
