"""Two sessions of postures side by side: whether their machine is the same."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from app.evaluating.hexaslide_calibration import (
    beside_effects,
    files_of_one_machine,
    models_without_mistakes,
)
from calib.arrays import FloatArray
from calib.errors import NotIdentifiable
from calib.hexaslide.calibration import calibrate
from calib.hexaslide.comparison import MachinesApart, MeasuredMachine, apart
from calib.hexaslide.diagnosis import HexaSlideDiagnosis, diagnosis_from
from protocols.hexaslide import HexaSlideMeasurements


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
        calibrated = calibrate(source.readings(), source.machine.whole())
        return ComparedSession(name, MeasuredMachine(calibrated, None), None, ())
    diagnosis = diagnosis_from(models)
    models = models_without_mistakes(source, models)
    left_out = diagnosis.wrong_postures if models.readings.numbers else ()
    machine = MeasuredMachine(models.calibration, models if models.entries else None)
    return ComparedSession(name, machine, diagnosis, left_out)
