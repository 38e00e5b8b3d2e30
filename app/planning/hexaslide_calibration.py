"""A Hexa Slide calibrated from a file of measured postures, or simulated into one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.planning.hexaslide import inside_box
from app.version import program
from calib.errors import CalibrationError
from calib.hexaslide.calibration import Calibration, Machine, calibrate, left_of
from calib.hexaslide.frames import FramesApart, frames_apart, inner_lengths, inner_slopes
from calib.hexaslide.geometry import NAMES
from calib.hexaslide.kinematics import forward
from calib.hexaslide.planning import HexaSlide, fewest_postures
from calib.hexaslide.procedures import Kind, Procedure
from calib.hexaslide.residuals import Left, Readings, measured_names, shares
from calib.hexaslide.simulation import disturbed, measure
from calib.observations import FloatArray
from calib.stats import coverage_factor, variance_ratio_p_value
from protocols.errors import RecordError, UsageError
from protocols.files import write_files
from protocols.hexaslide_machine import HexaSlideMachine, load_hexaslide
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

SPARE = 1.5
"""A fit keeps so many times the fewest postures before any is kept out of it."""


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
    procedure, noise = _procedure(asked, own), _noise(asked)
    nominal = machine_of(own)
    generator = np.random.default_rng(asked.seed)
    truth = disturbed(nominal, procedure, asked.errors_mm / 1000.0, generator)
    readings = measure(
        procedure,
        nominal,
        truth,
        _postures(asked.postures, nominal),
        generator,
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


def _postures(asked: int | Path, nominal: Machine) -> FloatArray | int:
    if isinstance(asked, int):
        return asked
    return inside_box(load_postures(asked), nominal.box)


def _procedure(asked: Asked, machine: HexaSlideMachine) -> Procedure:
    try:
        procedure = Procedure.of(asked.procedure, asked.measured)
    except CalibrationError as problem:
        raise UsageError(
            problem.thing, problem.found, problem.allowed, problem.next_step
        ) from problem
    if procedure.kind is Kind.CONSTRAINT_LINK and machine.constraint_link is None:
        raise UsageError("machine file", "no [constraint_link]", "one for constraint-link")
    return procedure


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


def machine_of(own: HexaSlideMachine) -> Machine:
    """A machine file as the mathematics takes it."""
    return Machine(own.geometry(), own.posture_box(), own.link())


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Postures kept out of the fit, by their numbers, and what each machine leaves of them."""

    numbers: tuple[int, ...]
    before: Left
    after: Left


@dataclass(frozen=True, eq=False)
class AgainstTruth:
    """Nominal and identified machine against the true one, at the same sliders.

    ``kept_out`` tells whether at postures kept out of the fit, else at all. ``misses`` ``(k,)``
    are the errors of the individually known parameters, ``held`` counts those within their 95 %
    interval, None without uncertainties. ``inner_m`` ``(26,)`` are errors of lengths that no frame
    changes.
    """

    kept_out: bool
    before: FramesApart
    after: FramesApart
    misses: FloatArray
    held: int | None
    inner_m: FloatArray


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A calibration from a file. ``factor`` is the coverage factor of 95 %; ``p_value`` None where
    no noise is stated. ``by_column`` and ``by_posture`` share what is left; ``numbers`` are the
    fitted postures.
    """

    name: str
    source: HexaSlideMeasurements
    start: FloatArray
    found: Calibration
    fewest: int
    numbers: tuple[int, ...]
    by_column: FloatArray
    by_posture: FloatArray
    factor: float | None
    p_value: float | None
    held_out: HeldOut | None
    truth: AgainstTruth | None

    @property
    def uncertainty(self) -> FloatArray | None:
        """Standard uncertainty ``(k,)``; it means something for the individually known only."""
        if self.found.covariance is None:
            return None
        return np.asarray(np.sqrt(self.found.covariance.diagonal()))

    @property
    def inner_uncertainty_m(self) -> FloatArray | None:
        """Standard uncertainty ``(26,)`` of lengths that no frame changes."""
        if self.found.covariance is None:
            return None
        slopes = inner_slopes(self.found.machine.geometry)
        own = self.found.covariance[: len(NAMES), : len(NAMES)]
        return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", slopes, own, slopes)))


def calibrate_file(path: Path, truth: Path | None, share: float) -> Calibrated:
    """Identify from a file of measured postures, about ``share`` of them kept out.

    Raises RecordError for a file, CalibrationError where the postures give no result.
    """
    source = read_measurements(path)
    true = None if truth is None else machine_of(read_truth(truth, source))
    nominal, readings = machine_of(source.machine), source.readings()
    planned = HexaSlide(nominal.geometry, nominal.box, nominal.link)
    fewest = fewest_postures(readings.procedure, planned)
    out = _kept_out(len(readings.sliders), fewest, share)
    fitted = readings.take(~out)
    found = calibrate(fitted, nominal, fewest=fewest)
    by_column, by_posture = shares(fitted, found.machine.geometry, found.after)
    checked = readings.take(out) if out.any() else None
    dof = found.degrees_of_freedom
    result = Calibrated(
        name=path.name,
        source=source,
        start=nominal.parameters(found.names),
        found=found,
        fewest=fewest,
        numbers=fitted.numbers,
        by_column=by_column,
        by_posture=by_posture,
        factor=None if found.covariance is None else coverage_factor(dof),
        p_value=_p_value(found),
        held_out=None if checked is None else _held_out(checked, nominal, found),
        truth=None,
    )
    if true is None:
        return result
    against = _against(result, checked or readings, nominal, true, kept_out=checked is not None)
    return Calibrated(**(vars(result) | {"truth": against}))


def _kept_out(count: int, fewest: int, share: float) -> NDArray[np.bool_]:
    """Which postures ``(p,)`` stay out of the fit: evenly spread, none where all are needed."""
    most = max(count - int(np.ceil(SPARE * fewest)), 0)
    chosen = min(int(share * count), most)
    out = np.zeros(count, dtype=np.bool_)
    out[[int((k + 0.5) * count / chosen) for k in range(chosen)]] = True
    return out


def _p_value(found: Calibration) -> float | None:
    if found.square_sum is None or not found.free_values:
        return None
    return variance_ratio_p_value(found.square_sum / found.free_values, found.free_values, np.inf)


def _held_out(readings: Readings, nominal: Machine, found: Calibration) -> HeldOut:
    return HeldOut(readings.numbers, left_of(readings, nominal), left_of(readings, found.machine))


def _against(
    result: Calibrated, readings: Readings, nominal: Machine, true: Machine, *, kept_out: bool
) -> AgainstTruth:
    """Everything that is known better than the measurements tell."""
    found, sliders = result.found, readings.sliders
    stand = [
        np.asarray(forward(machine.geometry, sliders, machine.box))
        for machine in (nominal, found.machine, true)
    ]
    known = [found.names.index(name) for name in found.known]
    misses = (found.parameters - true.parameters(found.names))[known]
    held = None
    if result.uncertainty is not None and result.factor is not None:
        held = int((np.abs(misses) <= result.factor * result.uncertainty[known]).sum())
    lengths = inner_lengths(found.machine.geometry) - inner_lengths(true.geometry)
    return AgainstTruth(
        kept_out=kept_out,
        before=frames_apart(stand[0], stand[2], found.lost),
        after=frames_apart(stand[1], stand[2], found.lost),
        misses=misses,
        held=held,
        inner_m=np.asarray(lengths),
    )
