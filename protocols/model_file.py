"""Effects as they stand in a model file, and as the simulation takes them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from calib.arrays import TOOL, FloatArray, conditions
from calib.errors import RecordError
from calib.identify.fit import Size
from calib.tripod.effects import BESIDE_CATALOGUE, CATALOGUE
from calib.tripod.effects.candidates import AXES
from calib.tripod.effects.drives import (
    AxisDistance,
    AxisLean,
    AxisSquareness,
    StraightnessOfFourthOrder,
    cyclic_of,
    effects_of,
)
from calib.tripod.effects.effect import AdoptedLaws, AdoptedSize, Effect, EffectInstance, Placed
from calib.tripod.effects.empirical import BASES, EMPIRICAL, empirical_effect
from calib.tripod.geometry import PARAMETER_NAMES, Geometry
from calib.tripod.pipeline import Model
from protocols.documents import MOST_BYTES, Document, LengthMm, Name, read_json, refuse_empty
from protocols.effect_entries import EffectEntry, HistoryEntry, ParameterEntry, Provenance
from protocols.files import open_to_read, unreadable
from protocols.machine import Machine

OF_MODELS: tuple[Effect, ...] = (AxisLean(), StraightnessOfFourthOrder())
"""What models may have and no diagnosis calls by name: one axis of a pair, a law of a guide."""


def effect_entry(
    where: str,
    placed: Sequence[EffectInstance],
    uncertainties: Mapping[str, tuple[float, float | None]] | None = None,
    provenance: Provenance | None = None,
) -> EffectEntry:
    """The entry of one effect that acts at several places.

    ``uncertainties`` gives for each parameter its value and standard uncertainty, under names such
    as ``shift_xy`` that begin with the catalogue's. Places of equal value share one parameter.
    Raises RecordError for a complex value.
    """
    effect, stated_sizes = placed[0].effect, uncertainties or {}
    parameters: dict[str, ParameterEntry] = {}
    for instance in placed:
        for parameter, value in zip(instance.effect.parameters, instance.values, strict=True):
            if isinstance(value, complex):
                value_text = f"the value {value}"
                raise RecordError(f"effect {effect.id}", value_text, "real numbers in a model file")
            base, placed_name = parameter.name, f"{parameter.name}_{instance.place}"
            matching = [
                name
                for name, (stated_value, _) in stated_sizes.items()
                if (name == base or name.startswith(base + "_")) and stated_value == value
            ]
            name = placed_name if len(placed) > 1 else base
            if matching and placed_name not in matching:
                name = matching[0]
            places = (
                (*parameters[name].places, instance.place)
                if name in parameters
                else (instance.place,)
            )
            parameters[name] = ParameterEntry(
                value=float(value),
                unit=parameter.unit,
                standard_uncertainty=stated_sizes[name][1] if name in stated_sizes else None,
                of=base,
                places=places,
            )
    titles = dict.fromkeys(instance.effect.title for instance in placed)
    return EffectEntry(
        id=effect.id,
        where=where,
        title=" and ".join(titles),
        parameters=parameters,
        provenance=provenance,
    )


def entries_of_laws(entry: EffectEntry) -> tuple[EffectEntry, ...]:
    """The entry as a model file has it: two where axes are out of square and miss each other."""
    if entry.where != AXES:
        return (entry,)
    leans = {parameter.name for parameter in AxisSquareness.parameters}
    entries = []
    for law, of_squareness in ((AxisSquareness, True), (AxisDistance, False)):
        parameters = {
            name: parameter
            for name, parameter in entry.parameters.items()
            if (parameter.of in leans) == of_squareness
        }
        places = ",".join(place for parameter in parameters.values() for place in parameter.places)
        update = {"id": law.id, "title": law.title, "where": places, "parameters": parameters}
        entries.append(entry.model_copy(update=update))
    return tuple(entries)


def placed_effects(
    entry: EffectEntry, effects: Sequence[Effect], geometry: Geometry, subject: str
) -> tuple[EffectInstance, ...]:
    """The entry for the simulation; ``subject`` begins the message of an error.

    Raises RecordError for an effect, parameter, unit or place that is not known.
    """
    effect = _effect_of(entry, effects, geometry, subject)
    units = {parameter.name: parameter.unit for parameter in effect.parameters}
    values: dict[str, dict[str, ParameterEntry]] = {}
    for name, parameter in entry.parameters.items():
        base = parameter.of or name
        if parameter.unit != units[base]:
            where = f"{subject}, {entry.id}, {name}, unit"
            raise RecordError(where, repr(parameter.unit), units[base])
        for place in _places(entry, parameter, effect, geometry, subject):
            values.setdefault(place, {})[base] = parameter
    for place, sizes in values.items():
        if set(sizes) != set(units):
            raise RecordError(
                f"{subject}, {entry.id} at {place}", ", ".join(sizes), " and ".join(units)
            )
    return tuple(
        EffectInstance(
            effect,
            place,
            tuple(sizes[name].value for name in units),
            tuple(sizes[name].standard_uncertainty or 0.0 for name in units),
        )
        for place, sizes in values.items()
    )


def _effect_of(
    entry: EffectEntry, effects: Sequence[Effect], geometry: Geometry, subject: str
) -> Effect:
    """The variant of the effect that has these parameters."""
    parameter_names = [parameter.of or name for name, parameter in entry.parameters.items()]
    if entry.id == EMPIRICAL:  # not in the catalogue, for it is the name of nothing
        if unnamed := empirical_effect(parameter_names):
            return unnamed
        value = ", ".join(dict.fromkeys(parameter_names)) or "none"
        raise RecordError(f"{subject}, parameters of {EMPIRICAL}", value, ", ".join(BASES))
    all_effects = (*effects, *BESIDE_CATALOGUE, *OF_MODELS)
    candidates = (*effects_of(all_effects, geometry), *effects)
    variants = [effect for effect in candidates if effect.id == entry.id]
    if not variants:
        raise RecordError(
            f"{subject}, effect",
            repr(entry.id),
            ", ".join(dict.fromkeys(effect.id for effect in candidates)),
            "An effect of your own must be in the folder of own effects, see docs/effects.md.",
        )
    fitting = [
        effect for effect in variants if set(parameter_names) == {p.name for p in effect.parameters}
    ]
    searched = cyclic_of(set(parameter_names))
    if not fitting and searched and searched.id == entry.id:
        return searched
    if not fitting:
        choices = [" and ".join(p.name for p in effect.parameters) for effect in variants]
        raise RecordError(
            f"{subject}, parameters of {entry.id}",
            ", ".join(sorted(set(parameter_names))) or "none",
            ", or ".join(dict.fromkeys(choices)),
        )
    return fitting[0]


def _places(
    entry: EffectEntry, parameter: ParameterEntry, effect: Effect, geometry: Geometry, subject: str
) -> tuple[str, ...]:
    legs = ([0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]) if geometry.reads_legs else ([], [])
    at = [*legs[0], TOOL, TOOL, TOOL], [*legs[1], 0, 1, 2]
    readings = conditions(*at, [0.0] * len(at[0]))
    of_tool = readings.leg == TOOL
    contacts = replace(readings, contact=of_tool, beside_mm=np.outer(of_tool, np.ones(3)))
    possible_places = tuple(dict.fromkeys((*effect.places(readings), *effect.places(contacts))))
    default_places = possible_places if entry.where == "all" else (entry.where,)
    places = parameter.places or default_places
    unknown = [place for place in places if place not in possible_places]
    if unknown:
        raise RecordError(
            f"{subject}, place of {entry.id}", ", ".join(unknown), ", ".join(possible_places)
        )
    return places


class ModelFile(Document):
    """A machine with identified parameters in mm, adopted effects, and how they came and went.

    ``cautions`` are those of the result that the parameters are from.
    """

    schema_id: Literal["glidecal.model/1"] = Field(alias="schema", default="glidecal.model/1")
    machine: Machine = Machine()
    parameters_mm: dict[Name, LengthMm] = Field(default_factory=dict)
    effects: tuple[EffectEntry, ...] = ()
    history: tuple[HistoryEntry, ...] = ()
    cautions: tuple[Name, ...] | None = None

    def text(self) -> str:
        """The file's content."""
        return self.model_dump_json(indent=1, exclude_none=True) + "\n"


def model_file(model: Model, machine: Machine, cautions: Sequence[str] = ()) -> ModelFile:
    """A file of this model, each of its effects at one place, without a history.

    Raises RecordError for an effect that is not of the catalogue's kind.
    """
    strangers = [effect.id for effect in model.effects if not isinstance(effect, EffectInstance)]
    if strangers:
        raise RecordError("model", ", ".join(strangers), "effects that are laws with values")
    return ModelFile(
        machine=machine,
        parameters_mm=dict(zip(PARAMETER_NAMES, model.parameters_mm, strict=True)),
        effects=tuple(
            effect_entry(effect.place, [effect])
            for effect in model.effects
            if isinstance(effect, EffectInstance)
        ),
        cautions=tuple(cautions) or None,
    )


def is_model(path: Path) -> bool:
    """Whether a file is a model rather than a session or something else.

    False for what is too large for a model. Raises RecordError where it cannot be read.
    """
    try:
        with open_to_read(path) as file:
            content = json.loads(file.read(MOST_BYTES))
    except OSError as problem:
        raise unreadable(f"file {path}", problem) from problem
    except (ValueError, RecursionError):
        return False
    return isinstance(content, dict) and "event" not in content


def read_model_file(path: Path) -> ModelFile:
    """A model file as it stands. Raises RecordError naming the file and the fault."""
    model = read_json(path, ModelFile, "model", "schema glidecal.model/1")
    refuse_empty(
        model,
        f"model {path}",
        "a machine, parameters_mm or effects",
        "Write it again with glidecal export --format model, or leave it out.",
    )
    return model


def read_model(path: Path, effects: Sequence[Effect] = CATALOGUE) -> tuple[Model, Machine]:
    """A model and its machine from a JSON file; ``effects`` are the effects known.

    Raises RecordError naming the file and the fault.
    """
    model = read_model_file(path)
    return to_model(model, f"model {path}", effects), model.machine


def to_model(model: ModelFile, subject: str, effects: Sequence[Effect]) -> Model:
    """The model of a file; ``subject`` names it in errors. Raises RecordError."""
    geometry = model.machine.geometry()
    longest = min(geometry.leg_length_mm)
    for name, value in model.parameters_mm.items():
        if name not in PARAMETER_NAMES:
            raise RecordError(subject, name, ", ".join(PARAMETER_NAMES))
        if abs(value) >= longest:
            requirement = f"less than the leg length {longest:g} mm"
            raise RecordError(f"{subject}, {name}", f"{value:g} mm", requirement)
    values = tuple(model.parameters_mm.get(name, 0.0) for name in PARAMETER_NAMES)
    placed = [placed_effects(entry, effects, geometry, subject) for entry in model.effects]
    return Model(geometry, values, tuple(effect for instances in placed for effect in instances))


def sizes_of(model: ModelFile, effects: Sequence[Effect] = CATALOGUE) -> tuple[Size, ...]:
    """The values of a model's effects that a fit may free: one for each parameter not held.

    Places that share an entry share the value. Raises RecordError as `to_model` does.
    """
    geometry, sizes, first = model.machine.geometry(), [], 0
    for entry in model.effects:
        placed = placed_effects(entry, effects, geometry, "model")
        for name, base, places in _placed_parameters(entry, placed[0].effect, geometry):
            if entry.parameters[name].held:
                continue
            at = [first + k for k, instance in enumerate(placed) if instance.place in places]
            definition = placed[0].effect.parameters[base]
            sizes.append(
                Size(
                    f"{entry.id} {entry.where}: {name}",
                    definition.unit,
                    definition.tolerance,
                    tuple((effect, base) for effect in at),
                )
            )
        first += len(placed)
    return tuple(sizes)


def _placed_parameters(
    entry: EffectEntry, effect: Effect, geometry: Geometry
) -> Iterator[tuple[str, int, tuple[str, ...]]]:
    """The key of each parameter of an entry, its number in the effect, and its places."""
    numbers = {parameter.name: number for number, parameter in enumerate(effect.parameters)}
    for key, parameter in entry.parameters.items():
        places = _places(entry, parameter, effect, geometry, "model")
        yield key, numbers[parameter.of or key], places


def free_effects(model: ModelFile, effects: Sequence[Effect] = CATALOGUE) -> AdoptedLaws:
    """Laws of a model at their places, with the number of their entry and the keys of their values.

    Without those of which a person holds any size. Raises RecordError as `to_model` does.
    """
    geometry = model.machine.geometry()
    laws: dict[bool, dict[Placed, AdoptedSize]] = {True: {}, False: {}}
    for number, entry in enumerate(model.effects):
        is_held = any(parameter.held for parameter in entry.parameters.values())
        placed = placed_effects(entry, effects, geometry, "model")
        parameters = [*_placed_parameters(entry, placed[0].effect, geometry)]
        for instance in placed:
            keys = " ".join(key for key, _, places in parameters if instance.place in places)
            laws[is_held][instance.effect, instance.place] = number, keys
    return {law: size for law, size in laws[False].items() if law not in laws[True]}


def with_expected(
    model: ModelFile,
    size_of: Callable[[Sequence[Placed]], tuple[FloatArray, FloatArray]],
    effects: Sequence[Effect],
) -> ModelFile:
    """The model with sizes as sessions let expect them, and how well each is known.

    ``size_of`` is that of their posterior with this model. An effect of which a person holds any
    size stays as it is. Raises RecordError as `to_model` does.
    """
    geometry, entries = model.machine.geometry(), []
    for entry in model.effects:
        parameters = dict(entry.parameters)
        if not any(parameter.held for parameter in parameters.values()):
            effect = placed_effects(entry, effects, geometry, "model")[0].effect
            for name, base, places in _placed_parameters(entry, effect, geometry):
                off, deviation = size_of([(effect, place) for place in places])
                value = parameters[name].value + float(off[base])
                update = {"value": value, "standard_uncertainty": float(deviation[base])}
                parameters[name] = parameters[name].model_copy(update=update)
        entries.append(entry.model_copy(update={"parameters": parameters}))
    return model.model_copy(update={"effects": tuple(entries)})


def held_sizes(model: ModelFile) -> tuple[str, ...]:
    """Sizes of the model that a person stated: ``backlash (x): play = +0.02 mm``."""
    return tuple(
        f"{effect.id} ({effect.where}): {name} = {value.value:+.6g} {value.unit}"
        for effect in model.effects
        for name, value in effect.parameters.items()
        if value.held
    )


def ambiguous_effects(model: ModelFile) -> tuple[str, ...]:
    """Effects that stand for a set of which any would do: ``backlash (x)``."""
    return tuple(
        f"{effect.id} ({effect.where})"
        for effect in model.effects
        if effect.provenance and effect.provenance.verdict == "ambiguous"
    )


def ambiguity(names: Sequence[str]) -> str:
    """What must be said wherever a model with such effects is used; empty if nothing."""
    if not names:
        return ""
    return (
        f"The model contains {', '.join(names)}, one of several effects that explain the "
        "readings: its name and its consequences are not certain."
    )
