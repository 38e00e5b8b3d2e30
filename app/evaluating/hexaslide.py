"""A session of postures: its machine and what is missing there, its line of a history, another
session beside it, and causes to try.
"""

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
    files_of_one_machine,
    models_without_mistakes,
)
from app.evaluating.posture_history import PostureEntry
from calib.arrays import FloatArray
from calib.errors import CalibrationError, GlidecalError, NotIdentifiable
from calib.hexaslide.calibration import calibrate
from calib.hexaslide.causes import OF_READINGS
from calib.hexaslide.comparison import MachinesApart, MeasuredMachine, apart
from calib.hexaslide.diagnosis import HexaSlideDiagnosis, WeighedCauses, diagnosis_from
from calib.hexaslide.what_if import PostureTrial
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
        began=opened.measured_at,
        dated=opened.is_dated,
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


@dataclass(frozen=True, eq=False)
class ComparedSession:
    """A session with its machine; ``diagnosis`` is None where its noise is not stated."""

    name: str
    machine: MeasuredMachine
    diagnosis: HexaSlideDiagnosis | None
    left_out: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class ComparedSessions:
    """Two sessions of one machine, and how far that is apart between them; ``warnings`` are those
    of the session files.
    """

    before: ComparedSession
    after: ComparedSession
    apart: MachinesApart
    warnings: tuple[str, ...]


def compare_postures(earlier_path: Path, later_path: Path) -> ComparedSessions:
    """Raises as `files_of_one_machine`, CalibrationError where a session gives no result."""
    files = files_of_one_machine(earlier_path, later_path)
    sources = [file.source for file in files]
    # a scale about another middle would be other parameters of the same machine
    middle = sum(source.readings().sliders.mean(axis=0) for source in sources) / len(sources)
    first, second = (_session(file.name, file.source, middle) for file in files)
    distance = apart(sources[0].machine.whole(), first.machine, second.machine)
    return ComparedSessions(first, second, distance, files[0].warnings + files[1].warnings)


def _session(name: str, source: HexaSlideMeasurements, middle: FloatArray) -> ComparedSession:
    try:
        models = beside_effects(source, source.readings(), (), middle)
    except NotIdentifiable:
        fit = calibrate(source.readings(), source.machine.whole())
        return ComparedSession(name, MeasuredMachine(fit, None), None, ())
    diagnosis = diagnosis_from(models)
    models = models_without_mistakes(source, models)
    left_out = diagnosis.wrong_postures if models.readings.numbers else ()
    machine = MeasuredMachine(models.calibration, models if models.entries else None)
    return ComparedSession(name, machine, diagnosis, left_out)


@dataclass(frozen=True, eq=False)
class CausesToTry:
    """Causes of a machine, the likeliest first, with the weight of all models that have them."""

    source: HexaSlideMeasurements
    models: WeighedCauses
    likely: dict[tuple[str, str], float]

    def trial(self, name: tuple[str, str]) -> PostureTrial:
        """The trial of one cause. Raises CalibrationError."""
        return PostureTrial.of(self.models, name, self.source.machine.whole())


def causes_to_try(source: HexaSlideMeasurements) -> CausesToTry:
    """Beside the parameters; postures that are named as mistakes are left out.

    Raises CalibrationError where that cannot be told.
    """
    models = models_without_mistakes(source, beside_effects(source, source.readings(), ()))
    likely = models.likely()
    names = [(cause.id, cause.where) for cause in models.causes if cause.id not in OF_READINGS]
    ordered = sorted(names, key=lambda name: (-likely.get(name, 0.0), name))
    return CausesToTry(source, models, {name: likely.get(name, 0.0) for name in ordered})
