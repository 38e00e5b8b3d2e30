"""A session of postures: the machine that it gives, and whether a later one is in tolerance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from app.evaluating.tolerance import check_tolerance
from calib.arrays import FloatArray
from calib.errors import CalibrationError, NotIdentifiable, RecordError, UsageError
from calib.hexaslide.calibration import calibrate
from calib.hexaslide.causes import AdoptedEffect, causes_of_machine, with_effects
from calib.hexaslide.checked import (
    CheckedCalibration,
    KnownValues,
    checked_calibration,
    lengths_alone,
    parameters_alone,
)
from calib.hexaslide.correction import HexaSlideCorrection, correction_of
from calib.hexaslide.diagnosis import (
    FEWEST_SPARE,
    CauseSize,
    HexaSlideDiagnosis,
    WeighedCauses,
    diagnosis_from,
    weighed,
)
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.planning import fewest_postures
from calib.hexaslide.platform import PlatformError, platform_error
from calib.hexaslide.residuals import Readings, postures_of
from calib.identify.accuracy import Decision, decide
from calib.stats import UNLIKELY
from protocols.hexaslide import HexaSlideMeasurements, read_truth
from protocols.hexaslide_measured import MeasuredFile, measured_in
from protocols.hexaslide_model import HexaSlideModel, read_hexaslide_model

SHARE = 0.2
"""Of the postures, kept out as a check."""


@dataclass(frozen=True, eq=False)
class CalibratedMachine(CheckedCalibration):
    """A calibration with its checks, what it means at the platform, and the file it is from.

    ``found`` is that of the parameters alone, ``entered`` the machine to enter: it counts what else
    may be missing; so do its ``parameters`` and ``lengths_m``, but where that cannot be determined:
    then they are by the noise alone. ``left_out`` are the numbers of postures that the diagnosis
    names as mistakes, ``adopted`` effects of a model, with sizes that were fitted again: ``sizes``.
    ``p_beside`` is the p-value of what the likeliest causes leave, which `platform` counts; None
    where no causes could be weighed. ``warnings`` are those of the session file.
    """

    name: str
    source: HexaSlideMeasurements
    entered: HexaSlide
    platform: PlatformError
    parameters: KnownValues
    lengths_m: KnownValues
    left_out: tuple[int, ...] = ()
    adopted: tuple[AdoptedEffect, ...] = ()
    sizes: tuple[CauseSize, ...] = ()
    p_beside: float | None = None
    warnings: tuple[str, ...] = ()

    @property
    def fits(self) -> bool:
        """Whether what parameters and causes leave may be noise; also where none is stated."""
        p_value = self.fit.p_value if self.p_beside is None else self.p_beside
        return p_value is None or p_value >= UNLIKELY


def calibrate_file(
    path: Path, truth: Path | None, share: float, model: Path | None = None
) -> CalibratedMachine:
    """Identify from a file of measured postures, about ``share`` of them kept out, beside the
    effects of a ``model``.

    Raises RecordError for a file, CalibrationError where the postures give no result, UsageError
    for the model of another machine.
    """
    file = measured_in(path)
    effects: tuple[AdoptedEffect, ...] = ()
    if model is not None:
        effects = effects_of(read_hexaslide_model(model), file.source, f"model {model}")
    result = calibrated(file.name, file.source, share, truth, effects)
    return replace(result, warnings=file.warnings)


def calibrated(
    name: str,
    source: HexaSlideMeasurements,
    share: float,
    truth: Path | None = None,
    effects: Sequence[AdoptedEffect] = (),
) -> CalibratedMachine:
    """Calibrate from measurements. Raises CalibrationError, RecordError for the ``truth``."""
    (machine,) = calibrated_for((share,), name, source, truth, effects)
    return machine


def calibrated_for(
    shares: Sequence[float],
    name: str,
    source: HexaSlideMeasurements,
    truth: Path | None = None,
    effects: Sequence[AdoptedEffect] = (),
    models: WeighedCauses | None = None,
) -> list[CalibratedMachine]:
    """Calibrate with each share of postures kept out; ``models`` as `beside_effects` has them,
    where known.
    """
    true = None if truth is None else read_truth(truth, source).whole()
    nominal, readings = source.machine.whole(), source.readings()
    models = models or _weighed(source, readings, effects)
    wrong = () if models is None else _mistakes(models, nominal)
    if wrong:  # one that is believed spoils all parameters, and the machine has nothing of it
        readings = readings.without(wrong)
        models = _weighed(source, readings, effects)
    adopted = () if models is None else models.resized()
    readings = with_effects(readings, nominal, _lead_m(source), adopted)
    calibrations = [checked_calibration(readings, nominal, true, share) for share in shares]
    common, p_beside = None, None
    if models is not None and models.entries:
        common = correction_of(models, nominal)
        p_beside = models.mean_square(models.entries[0])[1]
    machines = []
    for checked in calibrations:
        correction = common
        if correction is None:  # from all postures, like what the models say
            full = checked.fit if checked.held_out is None else calibrate(readings, nominal)
            correction = HexaSlideCorrection(
                full.machine,
                platform_error(nominal, full),
                parameters_alone(full),
                lengths_alone(full),
            )
        machines.append(
            CalibratedMachine(
                **vars(checked),
                name=name,
                source=source,
                entered=correction.machine,
                platform=correction.platform,
                parameters=correction.parameters,
                lengths_m=correction.lengths_m,
                left_out=wrong,
                adopted=adopted,
                sizes=() if models is None else tuple(_sizes(models, adopted)),
                p_beside=p_beside,
            )
        )
    return machines


def _sizes(models: WeighedCauses, adopted: Sequence[AdoptedEffect]) -> Iterator[CauseSize]:
    """Values of effects that were fitted, not of those that are held."""
    causes = {(cause.id, cause.where): cause for cause in models.causes}
    for effect in adopted:
        cause = causes[effect.id, effect.where]
        rows = zip(cause.names, effect.values, effect.deviations, strict=bool(effect.deviations))
        for name, value, deviation in rows:
            yield CauseSize(f"{effect.where}, {name}", value, deviation, cause.unit)


def diagnosis_of(source: HexaSlideMeasurements) -> HexaSlideDiagnosis:
    """What is missing in the model. Raises CalibrationError where postures give no result."""
    return diagnosis_from(beside_effects(source, source.readings(), ()))


def _lead_m(source: HexaSlideMeasurements) -> float | None:
    """Lead of the drives' screws."""
    return None if source.machine.lead_mm is None else source.machine.lead_mm / 1000.0


def beside_effects(
    source: HexaSlideMeasurements,
    readings: Readings,
    effects: Sequence[AdoptedEffect],
    middle: FloatArray | None = None,
) -> WeighedCauses:
    """What may be missing beside these effects; ``middle`` as `weighed` takes it.

    Raises CalibrationError where that cannot be told; with effects also for too few readings.
    """
    tolerances = source.machine.tolerances.of(readings.procedure.parameters)
    models = weighed(readings, source.machine.whole(), tolerances, _lead_m(source), effects, middle)
    if effects and not models.entries:
        raise NotIdentifiable(
            "sizes of effects of the model",
            f"{models.spare} readings beyond parameters and sizes",
            f"{FEWEST_SPARE} or more",
            "Measure more postures.",
        )
    return models


def _weighed(
    source: HexaSlideMeasurements, readings: Readings, effects: Sequence[AdoptedEffect]
) -> WeighedCauses | None:
    """The causes and their weights; None where they cannot be weighed and no effects need it."""
    try:
        return beside_effects(source, readings, effects)
    except CalibrationError:
        if effects:
            raise
        return None


def models_without_mistakes(source: HexaSlideMeasurements, models: WeighedCauses) -> WeighedCauses:
    """Models of readings without postures that are named as mistakes, where enough remain."""
    wrong = _mistakes(models, source.machine.whole())
    if not wrong:
        return models
    readings = source.readings().without(wrong)
    return beside_effects(source, readings, models.adopted, models.middle)


def effects_of(
    model: HexaSlideModel, source: HexaSlideMeasurements, subject: str
) -> tuple[AdoptedEffect, ...]:
    """The effects of a model for readings of its machine; ``subject`` names it in errors.

    Raises UsageError for another machine, RecordError for an effect that it cannot have.
    """
    if model.machine.title != source.machine.title:
        raise UsageError(
            "--model",
            f"the model of another machine, {model.machine.title}",
            f"one of {source.machine.title}",
        )
    readings, machine = source.readings(), source.machine.whole()
    postures, middle = postures_of(readings, machine), readings.sliders.mean(axis=0)
    causes = list(causes_of_machine(readings, machine, postures, _lead_m(source), middle))
    effects = []
    for entry in model.effects:
        places = [cause for cause in causes if cause.id == entry.id]
        cause = next((cause for cause in places if cause.where == entry.where), None)
        if cause is None:
            allowed = [cause.where for cause in places] or [cause.id for cause in causes]
            raise RecordError(
                f"{subject}, effect",
                f"{entry.id} at {entry.where}",
                ", ".join(dict.fromkeys(allowed)),
                "" if places else "A wave needs lead_mm in the machine file.",
            )
        sizes = {name: size.unit for name, size in entry.parameters.items()}
        if sizes != dict.fromkeys(cause.names, cause.unit):
            raise RecordError(
                f"{subject}, parameters of {entry.id}",
                ", ".join(f"{name} in {unit}" for name, unit in sizes.items()) or "none",
                ", ".join(f"{name} in {cause.unit}" for name in cause.names),
            )
        effects.append(
            AdoptedEffect(
                *(entry.id, entry.where),
                tuple(entry.parameters[name].value for name in cause.names),
                held=any(size.held for size in entry.parameters.values()),
            )
        )
    return tuple(effects)


def _mistakes(models: WeighedCauses, nominal: HexaSlide) -> tuple[int, ...]:
    """Numbers of postures that are surely mistakes, where enough others remain."""
    wrong, readings = diagnosis_from(models).wrong_postures, models.readings
    enough = len(readings.sliders) - len(wrong) >= fewest_postures(readings.procedure, nominal)
    return wrong if enough else ()


def decided(result: CalibratedMachine, tolerance_mm: float) -> Decision:
    """Whether the platform was in tolerance as measured: its error, give or take the bound."""
    off_mm, bound_m = 1000.0 * result.platform.now.places_rms_m, result.platform.bound_m
    if bound_m is None:
        return "undecided"
    # what neither parameters nor causes explain may do more at the platform than the bound counts
    bound_mm = 1000.0 * bound_m
    decision = decide(off_mm - bound_mm, off_mm + bound_mm, tolerance_mm)
    return "undecided" if decision == "pass" and not result.fits else decision


@dataclass(frozen=True, eq=False)
class VerifiedMachine:
    """A session after the calibrated machine was entered, judged beside the one before.

    ``decision`` is None where no tolerance is known. ``same_machine`` tells that both sessions were
    measured with one machine file: nothing was entered. ``remarks`` doubt their order, ``warnings``
    are those of the session files.
    """

    before: CalibratedMachine
    after: CalibratedMachine
    tolerance_mm: float | None
    decision: Decision | None
    same_machine: bool
    remarks: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def files_of_one_machine(earlier_path: Path, later_path: Path) -> tuple[MeasuredFile, MeasuredFile]:
    """What was read in two sessions.

    Raises RecordError for a file and for the same session twice, CalibrationError for sessions of
    different machines.
    """
    files = measured_in(earlier_path), measured_in(later_path)
    sources = [file.source for file in files]
    subject = f"sessions {earlier_path} and {later_path}"
    if sources[0].digest() == sources[1].digest():
        raise RecordError(subject, "the same postures", "two different sessions")
    names = [source.machine.title for source in sources]
    telescopic = [source.machine.whole().geometry.telescopic for source in sources]
    if names[0] != names[1] or telescopic[0] != telescopic[1]:
        raise CalibrationError(
            subject, f"different machines, {names[0]} and {names[1]}", "two sessions of one machine"
        )
    return files


def verify_sessions(
    earlier_path: Path, later_path: Path, tolerance_mm: float | None
) -> VerifiedMachine:
    """The platform is off by what the second session finds, give or take its bound.

    The tolerance is the stated one, else that of the later machine file, else of the earlier.

    Raises UsageError for a tolerance that is no positive length, as `files_of_one_machine`, and
    CalibrationError where a session gives no result.
    """
    check_tolerance(tolerance_mm)
    files = files_of_one_machine(earlier_path, later_path)
    earlier, later = (calibrated(file.name, file.source, 0.0) for file in files)
    tolerances_mm = (session.source.machine.platform_tolerance_mm for session in (later, earlier))
    tolerance = tolerance_mm or next(filter(None, tolerances_mm), None)
    decision = None if tolerance is None else decided(later, tolerance)
    is_same = earlier.source.machine == later.source.machine
    began = [file.began for file in files if file.began is not None]
    remarks: tuple[str, ...] = ()
    if began != sorted(began):
        remarks = (f"{later.name} is older than {earlier.name}: is the order right?",)
    warnings = files[0].warnings + files[1].warnings
    return VerifiedMachine(earlier, later, tolerance, decision, is_same, remarks, warnings)
