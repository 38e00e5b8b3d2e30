"""Two sessions of postures side by side: whether their machine is the same."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from app.evaluating.hexaslide_calibration import (
    beside_effects,
    models_without_mistakes,
    sources_of_one_machine,
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
    """Two sessions of one machine, and how far that is apart between them."""

    before: ComparedSession
    after: ComparedSession
    apart: MachinesApart


def compare_postures(earlier_path: Path, later_path: Path) -> ComparedSessions:
    """Raises as `sources_of_one_machine`, CalibrationError where a session gives no result."""
    sources = sources_of_one_machine(earlier_path, later_path)
    # a scale about another middle would be other parameters of the same machine
    middle = sum(source.readings().sliders.mean(axis=0) for source in sources) / len(sources)
    first, second = (
        _session(path.name, source, middle)
        for path, source in zip((earlier_path, later_path), sources, strict=True)
    )
    return ComparedSessions(
        first, second, apart(sources[0].machine.whole(), first.machine, second.machine)
    )


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
