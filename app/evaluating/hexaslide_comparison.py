"""Two sessions of postures side by side: whether their machine is the same."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from app.evaluating.hexaslide_calibration import beside_effects, models_without_mistakes
from calib.arrays import FloatArray
from calib.diagnosis.hexaslide import HexaSlideDiagnosis, diagnosis_from
from calib.diagnosis.hexaslide_comparison import MachinesApart, MeasuredMachine, apart
from calib.errors import CalibrationError, NotIdentifiable, RecordError
from calib.hexaslide.calibration import calibrate
from protocols.hexaslide import HexaSlideMeasurements
from protocols.hexaslide_measured import measured_in


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


def compare_postures(before: Path, after: Path) -> ComparedSessions:
    """Raises RecordError for a file and for the same session twice, CalibrationError for sessions
    of different machines and where one gives no result.
    """
    sources = measured_in(before), measured_in(after)
    if sources[0].digest() == sources[1].digest():
        raise RecordError(
            f"sessions {before} and {after}", "the same postures", "two different sessions"
        )
    names = [source.machine.before_calibration for source in sources]
    machines = [source.machine.whole() for source in sources]
    if names[0] != names[1] or machines[0].geometry.telescopic != machines[1].geometry.telescopic:
        raise CalibrationError(
            f"sessions {before} and {after}",
            f"different machines, {names[0]} and {names[1]}",
            "two sessions of one machine",
        )
    # a scale about another middle would be other parameters of the same machine
    middle = sum(source.readings().sliders.mean(axis=0) for source in sources) / len(sources)
    first, second = (
        _session(path.name, source, middle)
        for path, source in zip((before, after), sources, strict=True)
    )
    return ComparedSessions(first, second, apart(machines[0], first.machine, second.machine))


def _session(name: str, source: HexaSlideMeasurements, middle: FloatArray) -> ComparedSession:
    try:
        models = beside_effects(source, source.readings(), (), middle)
    except NotIdentifiable:
        calibrated = calibrate(source.readings(), source.machine.whole())
        return ComparedSession(name, MeasuredMachine(calibrated, None), None, ())
    diagnosis = diagnosis_from(models)
    models = models_without_mistakes(source, models)
    left_out = diagnosis.wrong_postures if models.readings.numbers else ()
    machine = MeasuredMachine(models.calibrated, models if models.entries else None)
    return ComparedSession(name, machine, diagnosis, left_out)
