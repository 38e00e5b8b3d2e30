"""A Hexa Slide calibrated from a file of measured postures, or simulated into one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from app.planning.hexaslide import inside_box, procedure_on
from app.version import program
from calib.errors import RecordError, UsageError
from calib.hexaslide.checked import Checked, checked_calibration
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.residuals import measured_names
from calib.hexaslide.simulation import simulate
from calib.observations import FloatArray
from protocols.files import write_files
from protocols.hexaslide_machine import load_hexaslide
from protocols.hexaslide_measurements import (
    SCHEMA,
    TRUTH_SCHEMA,
    HexaSlideMeasurements,
    HexaSlideTruth,
    MeasuredPosture,
    MeasuringNoise,
    Units,
    machine_like,
    read_measurements,
    read_truth,
)
from protocols.hexaslide_postures import load_postures

EXAMPLE = "hexaslide-h60.toml"


@dataclass(frozen=True)
class Asked:
    """What is to be simulated; ``angle_noise_mrad`` None: as many mrad as ``noise_mm`` has mm.

    ``postures`` are so many random ones, or a file of them.
    """

    procedure: str
    postures: int | Path
    noise_mm: float
    angle_noise_mrad: float | None = None
    errors_mm: float = 1.0
    seed: int = 1
    measured: tuple[str, ...] = ()
    machine_file: Path | None = None


def simulated(asked: Asked) -> tuple[HexaSlideMeasurements, HexaSlideTruth]:
    """Measurements on a machine that differs from its file, and that machine.

    Raises UsageError for a procedure or noise, RecordError for the machine file, CalibrationError
    for postures or machines that cannot be.
    """
    own = load_hexaslide(asked.machine_file)
    procedure, noise = procedure_on(own, asked.procedure, asked.measured), _noise(asked)
    nominal = own.whole()
    readings, truth = simulate(
        procedure,
        nominal,
        _postures(asked.postures, nominal),
        asked.seed,
        errors_m=asked.errors_mm / 1000.0,
        length_noise_m=noise.length_mm / 1000.0,
        angle_noise_rad=noise.angle_mrad / 1000.0,
    )
    rows = zip(readings.sliders.tolist(), readings.measured.tolist(), strict=True)
    measured = HexaSlideMeasurements(
        schema=SCHEMA,
        program=program(),
        origin="simulated",
        seed=asked.seed,
        procedure=procedure.kind,
        measured=measured_names(procedure),
        units=Units(),
        noise=noise,
        machine_file=asked.machine_file.name if asked.machine_file else EXAMPLE,
        machine=own,
        postures=tuple(MeasuredPosture(sliders=tuple(s), values=tuple(v)) for s, v in rows),
    )
    true = machine_like(own, f"{own.name}, as it truly is", truth.geometry, truth.link)
    return measured, HexaSlideTruth(
        schema=TRUTH_SCHEMA, measurements_sha256=measured.digest(), machine=true
    )


def _postures(asked: int | Path, nominal: HexaSlide) -> FloatArray | int:
    if isinstance(asked, int):
        return asked
    return inside_box(load_postures(asked), nominal)


def _noise(asked: Asked) -> MeasuringNoise:
    angle = asked.noise_mm if asked.angle_noise_mrad is None else asked.angle_noise_mrad
    if (angle == 0.0) != (asked.noise_mm == 0.0):
        raise UsageError(
            "--noise and --angle-noise", f"{asked.noise_mm:g} and {angle:g}", "both 0, or neither"
        )
    return MeasuringNoise(length_mm=asked.noise_mm, angle_mrad=angle)


def write_simulated(asked: Asked, output: Path, truth: Path | None) -> HexaSlideMeasurements:
    """Simulate into new files. Raises as `simulated`, RecordError for a file that exists."""
    if truth is not None and truth.resolve() == output.resolve():
        raise UsageError("--truth and --output", f"{output} twice", "two files")
    for path in (output, truth):
        if path is not None and path.exists():
            raise RecordError(f"output {path}", "a file that exists already", "a new file")
    measured, true = simulated(asked)
    write_files(output, {"": measured.text()})
    if truth is not None:
        write_files(truth, {"": true.text()})
    return measured


@dataclass(frozen=True, eq=False)
class CalibratedMachine(Checked):
    """A calibration with its checks, and the file that it is from."""

    name: str
    source: HexaSlideMeasurements


def calibrate_file(path: Path, truth: Path | None, share: float) -> CalibratedMachine:
    """Identify from a file of measured postures, about ``share`` of them kept out.

    Raises RecordError for a file, CalibrationError where the postures give no result.
    """
    source = read_measurements(path)
    true = None if truth is None else read_truth(truth, source).whole()
    checked = checked_calibration(source.readings(), source.machine.whole(), true, share)
    return CalibratedMachine(**vars(checked), name=path.name, source=source)
