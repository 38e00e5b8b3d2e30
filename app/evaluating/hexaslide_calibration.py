"""A session of postures: the machine that it gives, and whether a later one is in tolerance."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from app.evaluating.posture_history import Decision
from calib.diagnosis.hexaslide import HexaSlideDiagnosis, diagnosed
from calib.errors import CalibrationError
from calib.hexaslide.checked import Checked, checked_calibration
from calib.hexaslide.planning import fewest_postures
from calib.hexaslide.platform import PlatformError, platform_error
from protocols.hexaslide import HexaSlideMeasurements, read_truth
from protocols.hexaslide_measured import measured_in

LACK_OF_FIT_LEVEL = 0.01
"""Below this p-value more is left than noise."""

SHARE = 0.2
"""Of the postures, kept out as a check."""


@dataclass(frozen=True, eq=False)
class CalibratedMachine(Checked):
    """A calibration with its checks, what it means at the platform, and the file it is from.

    ``left_out`` are the numbers of postures that the diagnosis names as mistakes.
    """

    name: str
    source: HexaSlideMeasurements
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
    wrong = wrong_postures(source)
    checked = checked_calibration(readings.without(wrong), nominal, true, share)
    platform = platform_error(nominal, checked.found)
    return CalibratedMachine(
        **vars(checked), name=name, source=source, platform=platform, left_out=wrong
    )


def diagnosis_of(source: HexaSlideMeasurements) -> HexaSlideDiagnosis:
    """What is missing in the model. Raises CalibrationError where postures give no result."""
    readings, machine = source.readings(), source.machine
    tolerances = machine.tolerances.of(readings.procedure.parameters)
    lead_m = None if machine.lead_mm is None else machine.lead_mm / 1000.0
    return diagnosed(readings, machine.whole(), tolerances, lead_m)


def wrong_postures(source: HexaSlideMeasurements) -> tuple[int, ...]:
    """Numbers of postures that are surely mistakes; none where that cannot be told.

    One that is believed would spoil all parameters: it is not missing from the machine, so what is
    entered must not make up for it.
    """
    try:
        wrong = diagnosis_of(source).wrong_postures
        readings, nominal = source.readings(), source.machine.whole()
    except CalibrationError:
        return ()
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
