"""A session of postures: the machine that it gives, and whether a later one is in tolerance."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from app.evaluating.posture_history import Decision
from calib.arrays import FloatArray
from calib.diagnosis.hexaslide import (
    HexaSlideDiagnosis,
    WeighedCauses,
    diagnosed,
    diagnosis_from,
    weighed,
)
from calib.diagnosis.hexaslide_correction import HexaSlideCorrection, correction_of
from calib.errors import CalibrationError
from calib.hexaslide.calibration import calibrate
from calib.hexaslide.checked import Checked, checked_calibration
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.planning import fewest_postures
from calib.hexaslide.platform import PlatformError, platform_error
from calib.hexaslide.residuals import Readings
from protocols.hexaslide import HexaSlideMeasurements, read_truth
from protocols.hexaslide_measured import measured_in

LACK_OF_FIT_LEVEL = 0.01
"""Below this p-value more is left than noise."""

SHARE = 0.2
"""Of the postures, kept out as a check."""


@dataclass(frozen=True, eq=False)
class CalibratedMachine(Checked):
    """A calibration with its checks, what it means at the platform, and the file it is from.

    ``found`` is that of the parameters alone, ``entered`` the machine to enter: it counts what else
    may be missing. ``left_out`` are the numbers of postures that the diagnosis names as mistakes.
    """

    name: str
    source: HexaSlideMeasurements
    entered: HexaSlide
    platform: PlatformError
    left_out: tuple[int, ...] = ()


def calibrate_file(path: Path, truth: Path | None, share: float) -> CalibratedMachine:
    """Identify from a file of measured postures, about ``share`` of them kept out.

    Raises RecordError for a file, CalibrationError where the postures give no result.
    """
    return calibrated(path.name, measured_in(path), share, truth)


def calibrated(
    name: str, source: HexaSlideMeasurements, share: float, truth: Path | None = None
) -> CalibratedMachine:
    """The same from what was read. Raises CalibrationError, RecordError for the ``truth``."""
    true = None if truth is None else read_truth(truth, source).whole()
    nominal, readings = source.machine.whole(), source.readings()
    models = _weighed(source, readings)
    wrong = () if models is None else _mistakes(models, nominal)
    if wrong:  # one that is believed spoils all parameters, and the machine has nothing of it
        readings = readings.without(wrong)
        models = _weighed(source, readings)
    checked = checked_calibration(readings, nominal, true, share)
    correction = None if models is None else correction_of(models, nominal)
    if correction is None:
        full = checked.found if checked.held_out is None else calibrate(readings, nominal)
        correction = HexaSlideCorrection(full.machine, platform_error(nominal, full))
    return CalibratedMachine(
        **vars(checked),
        name=name,
        source=source,
        entered=correction.machine,
        platform=correction.platform,
        left_out=wrong,
    )


def diagnosis_of(source: HexaSlideMeasurements) -> HexaSlideDiagnosis:
    """What is missing in the model. Raises CalibrationError where postures give no result."""
    return diagnosed(source.readings(), source.machine.whole(), *_stated(source))


def _stated(source: HexaSlideMeasurements) -> tuple[FloatArray, float | None]:
    """Tolerances ``(k,)`` of the parameters, and the lead of the drives' screws in metres."""
    machine = source.machine
    tolerances = machine.tolerances.of(source.readings().procedure.parameters)
    return tolerances, None if machine.lead_mm is None else machine.lead_mm / 1000.0


def _weighed(source: HexaSlideMeasurements, readings: Readings) -> WeighedCauses | None:
    """What may be missing; None where that cannot be told."""
    try:
        return weighed(readings, source.machine.whole(), *_stated(source))
    except CalibrationError:
        return None


def _mistakes(models: WeighedCauses, nominal: HexaSlide) -> tuple[int, ...]:
    """Numbers of postures that are surely mistakes, where enough others remain."""
    wrong, readings = diagnosis_from(models).wrong_postures, models.readings
    enough = len(readings.sliders) - len(wrong) >= fewest_postures(readings.procedure, nominal)
    return wrong if enough else ()


def decided(solved: CalibratedMachine, tolerance_mm: float) -> Decision:
    """Whether the platform was in tolerance as measured: its error, give or take the bound."""
    off_mm, bound_m = 1000.0 * solved.platform.now.places_rms_m, solved.platform.bound_m
    if bound_m is None:
        return "undecided"
    # what the model does not have may do more at the platform than any bound of it counts
    fits = solved.p_value is None or solved.p_value >= LACK_OF_FIT_LEVEL
    if off_mm + 1000.0 * bound_m <= tolerance_mm and fits:
        return "pass"
    return "fail" if off_mm - 1000.0 * bound_m > tolerance_mm else "undecided"


@dataclass(frozen=True, eq=False)
class VerifiedMachine:
    """A session after the calibrated machine was entered, judged beside the one before.

    ``decision`` is None where no tolerance is known. ``same_machine`` tells that both sessions were
    measured with one machine file: nothing was entered.
    """

    before: CalibratedMachine
    after: CalibratedMachine
    tolerance_mm: float | None
    decision: Decision | None
    same_machine: bool


def verify_sessions(before: Path, after: Path, tolerance_mm: float | None) -> VerifiedMachine:
    """The platform is off by what the second session finds, give or take its bound.

    Raises RecordError for a file, CalibrationError where a session gives no result.
    """
    earlier, later = (calibrate_file(path, None, 0.0) for path in (before, after))
    tolerance = tolerance_mm or later.source.machine.platform_tolerance_mm
    decision = None if tolerance is None else decided(later, tolerance)
    is_same = earlier.source.machine == later.source.machine
    return VerifiedMachine(earlier, later, tolerance, decision, is_same)
