"""A session of postures diagnosed beside a model, and models with what was named there."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from app.evaluating.hexaslide_calibration import beside_effects, effects_of, models_without_mistakes
from calib.diagnosis.thresholds import OPEN
from calib.errors import NotIdentifiable, UsageError
from calib.hexaslide.causes import MISTAKE, OF_READINGS, AdoptedEffect
from calib.hexaslide.correction import correction_of
from calib.hexaslide.diagnosis import (
    FEWEST_SPARE,
    HexaSlideDiagnosis,
    LeftOutGap,
    Names,
    WeighedCauses,
    diagnosis_from,
    left_out_gap,
)
from calib.hexaslide.platform import PlatformError
from protocols.effect_entries import (
    EffectEntry,
    ParameterEntry,
    Provenance,
    with_effect,
    with_sizes,
    without_effect,
)
from protocols.files import write_files
from protocols.hexaslide import HexaSlideMeasurements, machine_like
from protocols.hexaslide_measured import measured_in
from protocols.hexaslide_model import HexaSlideModel, read_hexaslide_model

MOST_OFFERED = 8


@dataclass(frozen=True, eq=False)
class DiagnosedPostures:
    """A diagnosis with the name of its session, and with the model that it was made beside;
    ``warnings`` are those of the session file.
    """

    name: str
    source: HexaSlideMeasurements
    models: WeighedCauses
    diagnosis: HexaSlideDiagnosis
    model: HexaSlideModel | None = None
    warnings: tuple[str, ...] = ()

    @property
    def beside(self) -> tuple[AdoptedEffect, ...]:
        """Effects of the model with sizes that these readings, too, have been asked for."""
        return self.models.resized()


@dataclass(frozen=True, eq=False)
class Adoption:
    """What follows if the adopted ``effects`` act: the ``platform`` with values entered, before
    that all models counted; what is left of the readings, mean squares in variances of the noise,
    with the p-value after, and of postures that were left out, None where they are too few.
    """

    effects: tuple[AdoptedEffect, ...]
    platform_before: PlatformError
    platform: PlatformError
    gap_before: float
    gap_after: float
    p_after: float
    left_out: LeftOutGap | None
    model: HexaSlideModel


def diagnose_postures(path: Path, model: Path | None = None) -> DiagnosedPostures:
    """Beside the effects of a ``model`` where one is given.

    Raises RecordError for a file, CalibrationError where postures give no result, UsageError for
    the model of another machine.
    """
    file = measured_in(path)
    source = file.source
    model_file = None if model is None else read_hexaslide_model(model)
    effects = () if model_file is None else effects_of(model_file, source, f"model {model}")
    models = beside_effects(source, source.readings(), effects)
    diagnosis = diagnosis_from(models)
    return DiagnosedPostures(file.name, source, models, diagnosis, model_file, file.warnings)


def adopted(diagnosed: DiagnosedPostures, candidate: str | None) -> Adoption:
    """The names of a diagnosis, or one ``candidate``, ``id`` or ``id:where``, as established.

    Postures that are named as mistakes are left out. Raises UsageError where nothing of that is
    supported by the readings, with what is.
    """
    names = _chosen(diagnosed, candidate)
    source, nominal = diagnosed.source, diagnosed.source.machine.whole()
    models = models_without_mistakes(source, diagnosed.models)
    with_names = models.given(names)
    nominal_correction = correction_of(models, nominal)
    if nominal_correction is None or not with_names.entries:
        raise _refused(diagnosed, "the readings without the mistakes no longer show it")
    effects = (*models.resized(), *with_names.sizes_of(names))
    stated_readings = models.readings.noisier(1.0 / models.noise_times)
    adopted_models = beside_effects(source, stated_readings, effects)
    correction = correction_of(adopted_models, nominal)
    if correction is None:
        raise NotIdentifiable(
            "--adopt",
            f"{adopted_models.spare} readings beyond parameters and sizes",
            f"{FEWEST_SPARE}",
        )
    gap_after, p_after = adopted_models.mean_square(adopted_models.free)
    return Adoption(
        effects=effects[len(models.adopted) :],
        platform_before=nominal_correction.platform,
        platform=correction.platform,
        gap_before=models.mean_square(models.free)[0],
        gap_after=gap_after,
        p_after=p_after,
        left_out=left_out_gap(with_names, names),
        model=_model(diagnosed, adopted_models, effects),
    )


def _model(
    diagnosed: DiagnosedPostures, adopted_models: WeighedCauses, effects: tuple[AdoptedEffect, ...]
) -> HexaSlideModel:
    """The known model, else a new one, with the parameters and sizes that were fitted."""
    source = diagnosed.source
    machine = machine_like(source.machine, source.machine.name, adopted_models.calibration.machine)
    model = (diagnosed.model or HexaSlideModel(machine=machine)).model_copy(
        update={"machine": machine}
    )
    provenance = Provenance(
        sessions=(diagnosed.name,),
        digests=(source.digest(),),
        found=datetime.now(UTC),
        verdict=diagnosed.diagnosis.verdict,
    )
    names = {(entry.id, entry.where) for entry in model.effects}
    why = f"{diagnosed.name}: {diagnosed.diagnosis.verdict}"
    for effect in effects:
        entry = _entry(effect, adopted_models, provenance)
        if (effect.id, effect.where) not in names:
            model = with_effect(model, entry, why)
        elif not effect.held:
            model = with_sizes(model, entry, f"{why}; fitted again")
    return model


def _entry(effect: AdoptedEffect, models: WeighedCauses, provenance: Provenance) -> EffectEntry:
    """An effect with its sizes as a model file has it."""
    name = effect.id, effect.where
    cause = next(cause for cause in models.causes if (cause.id, cause.where) == name)
    deviations = effect.deviations or (None,) * len(effect.values)
    parameters = {
        part: ParameterEntry(value=value, unit=cause.unit, standard_uncertainty=deviation)
        for part, value, deviation in zip(cause.names, effect.values, deviations, strict=True)
    }
    return EffectEntry(
        id=effect.id, where=effect.where, parameters=parameters, provenance=provenance
    )


def remove(path: Path, effect: str, why: str) -> HexaSlideModel:
    """Take an effect, ``id`` or ``id:where``, out of a model; the history keeps it.

    Raises RecordError for the file, UsageError where it has none such.
    """
    model = read_hexaslide_model(path)
    places = [(entry.id, entry.where) for entry in model.effects]
    name, where = next(
        (place for place in places if _is_meant(effect, place)),
        (effect.partition(":")[0], effect.partition(":")[2] or None),
    )
    model = without_effect(model, name, where, why)
    write_files(path, {"": model.text()}, replace=True)
    return model


def short_name(name: tuple[str, str]) -> str:
    """An effect as it may be typed: ``rail_scale:3``, ``thermal_growth``."""
    cause, where = name
    part, _, number = where.rpartition(" ")
    return cause if part == "all" else f"{cause}:{number}"


def _is_meant(typed: str, name: tuple[str, str]) -> bool:
    return typed in (name[0], ":".join(name), short_name(name))


def _chosen(diagnosed: DiagnosedPostures, candidate: str | None) -> Names:
    """Raises UsageError where the readings do not support it."""
    diagnosis, likely = diagnosed.diagnosis, _likely(diagnosed)
    if diagnosis.verdict == "agrees":
        raise UsageError(
            "--adopt",
            "readings that agree with the calibrated machine: nothing is missing",
            "an effect that the readings show",
        )
    if candidate is None:
        named_causes = tuple(cause for claim in diagnosis.named for cause in claim.causes)
        effects = tuple(cause for cause in named_causes if cause[0] not in OF_READINGS)
        if effects:
            return effects
        mistakes = ", ".join(where for cause, where in named_causes if cause == MISTAKE)
        verdict = f"the verdict '{diagnosis.verdict}' names no effect"
        raise _refused(
            diagnosed, f"{verdict}, but a mistake: {mistakes}" if named_causes else verdict
        )
    fitting = [name for name in likely if _is_meant(candidate, name)]
    if fitting and likely[fitting[0]] >= OPEN:
        return (fitting[0],)
    adopted_names = {(effect.id, effect.where) for effect in diagnosed.models.adopted}
    if any(_is_meant(candidate, name) for name in adopted_names):
        raise UsageError("--candidate", candidate, "an effect that the model does not have yet")
    causes = {(cause.id, cause.where) for cause in diagnosed.models.causes}
    of_mistake = any(_is_meant(candidate, name) for name in causes if name[0] == MISTAKE)
    of_machine = any(_is_meant(candidate, name) for name in causes)
    reason = (
        "a mistake of the readings, not an effect; solve leaves such a posture out"
        if of_mistake
        else f"its probability is below {100.0 * OPEN:g} %"
        if of_machine
        else "this machine has no such effect"
    )
    raise _refused(diagnosed, reason, f"--candidate {candidate}")


def _likely(diagnosed: DiagnosedPostures) -> dict[tuple[str, str], float]:
    """Effects with their weights, the likeliest first; without mistakes."""
    likely = diagnosed.models.likely().items()
    return {name: weight for name, weight in likely if name[0] not in OF_READINGS}


def _refused(diagnosed: DiagnosedPostures, reason: str, thing: str = "--adopt") -> UsageError:
    """The refusal, with what can be adopted instead."""
    if not diagnosed.models.entries:
        spare = f"{diagnosed.models.spare} readings beyond the parameters"
        return UsageError(thing, spare, f"{FEWEST_SPARE} or more", "Measure more postures.")
    names = [
        f"{short_name(name)} ({100.0 * weight:.0f} %)"
        for name, weight in _likely(diagnosed).items()
        if weight >= OPEN
    ]
    listed = f"--candidate with one of {', '.join(names[:MOST_OFFERED])}" if names else "none"
    return UsageError(thing, reason, listed)
