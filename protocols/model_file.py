"""Effects as they stand in a model file, and as the simulation takes them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AwareDatetime, Field

from calib.arrays import TOOL, conditions
from calib.errors import RecordError, UsageError
from calib.identify.fit import Size
from calib.identify.solution import Solution
from calib.tripod.effects import BESIDE_CATALOGUE, CATALOGUE
from calib.tripod.effects.drives import AxisLean, cyclic_of, effects_of
from calib.tripod.effects.effect import Effect, EffectInstance
from calib.tripod.effects.empirical import BASES, EMPIRICAL, empirical_effect
from calib.tripod.geometry import PARAMETER_NAMES, Geometry
from calib.tripod.pipeline import Model
from protocols.documents import (
    MOST_BYTES,
    Document,
    LengthMm,
    Name,
    read_json,
    unreadable,
)
from protocols.files import open_to_read
from protocols.machine import Machine

OF_CORRECTIONS: tuple[Effect, ...] = (AxisLean(),)
"""What a controller is told of one axis; readings show pairs of them, which have the names."""

Value = Annotated[float, Field(ge=-1e9, le=1e9)]


class ParameterEntry(Document):
    """One value, and the places that share it.

    ``of`` is the name of the parameter in the catalogue where the key is another; without
    ``places`` it acts where the effect does, with ``where = "all"`` at every place. A value that is
    ``held`` is a person's: no fit changes it.
    """

    value: Value
    unit: Name
    standard_uncertainty: Annotated[Value, Field(ge=0.0)] | None = None
    of: Name | None = None
    places: tuple[Name, ...] = ()
    held: Literal[True] | None = None


class Provenance(Document):
    """Which sessions an effect was found in: names, digests, when the last of them began (and when
    the effect was found), and the verdict on it.
    """

    sessions: tuple[Name, ...]
    digests: tuple[Name, ...] = ()
    measured: AwareDatetime | None = None
    found: AwareDatetime | None = None
    verdict: Name = ""


class EffectEntry(Document):
    """One adopted effect: its name in the catalogue, where it acts, its parameters."""

    id: Name
    where: Name
    title: Name = ""
    parameters: dict[Name, ParameterEntry]
    provenance: Provenance | None = None

    def held_at(self, values: Sequence[float]) -> EffectEntry:
        """The same with these values, one for each parameter, held."""
        stated = {
            name: one.model_copy(
                update={"value": float(value), "standard_uncertainty": None, "held": True}
            )
            for (name, one), value in zip(self.parameters.items(), values, strict=True)
        }
        return self.model_copy(update={"parameters": stated})

    def freed(self) -> EffectEntry:
        """The same with values that a fit may change."""
        parameters = self.parameters.items()
        free = {name: one.model_copy(update={"held": None}) for name, one in parameters}
        return self.model_copy(update={"parameters": free})


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
    effect, known = placed[0].effect, uncertainties or {}
    found: dict[str, ParameterEntry] = {}
    for one in placed:
        for parameter, value in zip(effect.parameters, one.values, strict=True):
            if isinstance(value, complex):
                said = f"the value {value}"
                raise RecordError(f"effect {effect.id}", said, "real numbers in a model file")
            base, own = parameter.name, f"{parameter.name}_{one.place}"
            stated = [
                name
                for name, (known_value, _) in known.items()
                if (name == base or name.startswith(base + "_")) and known_value == value
            ]
            name = own if len(placed) > 1 else base
            if stated and own not in stated:
                name = stated[0]
            places = (*found[name].places, one.place) if name in found else (one.place,)
            found[name] = ParameterEntry(
                value=float(value),
                unit=parameter.unit,
                standard_uncertainty=known[name][1] if name in known else None,
                of=base,
                places=places,
            )
    return EffectEntry(
        id=effect.id, where=where, title=effect.title, parameters=found, provenance=provenance
    )


def placed_effects(
    entry: EffectEntry, effects: Sequence[Effect], geometry: Geometry, thing: str
) -> tuple[EffectInstance, ...]:
    """The entry for the simulation; ``thing`` begins the message of an error.

    Raises RecordError for an effect, parameter, unit or place that is not known.
    """
    effect = _effect_of(entry, effects, geometry, thing)
    units = {parameter.name: parameter.unit for parameter in effect.parameters}
    values: dict[str, dict[str, float]] = {}
    for name, parameter in entry.parameters.items():
        base = parameter.of or name
        if parameter.unit != units[base]:
            where = f"{thing}, {entry.id}, {name}, unit"
            raise RecordError(where, repr(parameter.unit), units[base])
        for place in _places(entry, parameter, effect, geometry, thing):
            values.setdefault(place, {})[base] = parameter.value
    for place, given in values.items():
        if set(given) != set(units):
            raise RecordError(
                f"{thing}, {entry.id} at {place}", ", ".join(given), " and ".join(units)
            )
    return tuple(
        EffectInstance(effect, place, tuple(given[name] for name in units))
        for place, given in values.items()
    )


def _effect_of(
    entry: EffectEntry, effects: Sequence[Effect], geometry: Geometry, thing: str
) -> Effect:
    """The variant of the effect that has these parameters."""
    named = [parameter.of or name for name, parameter in entry.parameters.items()]
    if entry.id == EMPIRICAL:  # not in the catalogue, for it is the name of nothing
        if unnamed := empirical_effect(named):
            return unnamed
        found = ", ".join(dict.fromkeys(named)) or "none"
        raise RecordError(f"{thing}, parameters of {EMPIRICAL}", found, ", ".join(BASES))
    every = (*effects, *BESIDE_CATALOGUE, *OF_CORRECTIONS)
    known = (*effects_of(every, geometry), *effects)
    variants = [effect for effect in known if effect.id == entry.id]
    if not variants:
        raise RecordError(
            f"{thing}, effect",
            repr(entry.id),
            ", ".join(dict.fromkeys(effect.id for effect in effects)),
            "An effect of your own must be in the folder of own effects, see docs/effects.md.",
        )
    fitting = [effect for effect in variants if set(named) == {p.name for p in effect.parameters}]
    searched = cyclic_of(set(named))
    if not fitting and searched and searched.id == entry.id:
        return searched
    if not fitting:
        allowed = [" and ".join(p.name for p in effect.parameters) for effect in variants]
        raise RecordError(
            f"{thing}, parameters of {entry.id}",
            ", ".join(sorted(set(named))) or "none",
            ", or ".join(dict.fromkeys(allowed)),
        )
    return fitting[0]


def _places(
    entry: EffectEntry, parameter: ParameterEntry, effect: Effect, geometry: Geometry, thing: str
) -> tuple[str, ...]:
    legs = ([0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]) if geometry.orthogonal else ([], [])
    at = [*legs[0], TOOL, TOOL, TOOL], [*legs[1], 0, 1, 2]
    known = effect.places(conditions(*at, [0.0] * len(at[0])))
    every = known if entry.where == "all" else (entry.where,)
    wanted = parameter.places or every
    unknown = [place for place in wanted if place not in known]
    if unknown:
        raise RecordError(f"{thing}, place of {entry.id}", ", ".join(unknown), ", ".join(known))
    return wanted


class HistoryEntry(Document):
    """An effect was added to the model or removed from it: when and why."""

    action: Literal["added", "removed"]
    at: AwareDatetime
    why: Name
    effect: EffectEntry


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


def with_effect(known: ModelFile, entry: EffectEntry, why: str) -> ModelFile:
    """The model with one more effect. Raises UsageError where it has it there already."""
    if any((e.id, e.where) == (entry.id, entry.where) for e in known.effects):
        raise UsageError(
            f"effect {entry.id} at {entry.where}",
            "in the model already",
            "each effect once at a place",
            "Remove the old one first.",
        )
    return _changed(known, (*known.effects, entry), "added", [entry], why)


def without_effect(known: ModelFile, effect_id: str, where: str | None, why: str) -> ModelFile:
    """The model without an effect; without ``where`` at every place of it.

    What was removed stays in the history. Raises UsageError where the model has no such effect.
    """
    gone = [e for e in known.effects if e.id == effect_id and where in (None, e.where)]
    if not gone:
        present = ", ".join(f"{e.id} at {e.where}" for e in known.effects)
        named = effect_id if where is None else f"{effect_id} at {where}"
        raise UsageError("effect to remove", named, present or "no effect: the model has none")
    return _changed(known, tuple(e for e in known.effects if e not in gone), "removed", gone, why)


def with_sizes(known: ModelFile, entry: EffectEntry, why: str) -> ModelFile:
    """The model with an effect that it has as ``entry`` has it; the history tells of both.

    Raises UsageError where it has no such effect.
    """
    without = without_effect(known, entry.id, entry.where, why)
    old = without.history[-1].effect
    return with_effect(without, entry.model_copy(update={"provenance": old.provenance}), why)


def _changed(
    known: ModelFile,
    effects: tuple[EffectEntry, ...],
    action: Literal["added", "removed"],
    entries: Sequence[EffectEntry],
    why: str,
) -> ModelFile:
    """With these effects; the history tells of the entries that came or went."""
    now = datetime.now(UTC)
    noted = [HistoryEntry(action=action, at=now, why=why, effect=entry) for entry in entries]
    return known.model_copy(update={"effects": effects, "history": (*known.history, *noted)})


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
    return read_json(path, ModelFile, "model", "schema glidecal.model/1")


def read_model(path: Path, effects: Sequence[Effect] = CATALOGUE) -> tuple[Model, Machine]:
    """A model and its machine from a JSON file; ``effects`` are the effects known.

    Raises RecordError naming the file and the fault.
    """
    found = read_model_file(path)
    return to_model(found, f"model {path}", effects), found.machine


def to_model(found: ModelFile, thing: str, effects: Sequence[Effect] = CATALOGUE) -> Model:
    """The model of a file; ``thing`` names it in errors. Raises RecordError."""
    geometry = found.machine.geometry()
    longest = min(geometry.leg_length_mm)
    for name, value in found.parameters_mm.items():
        if name not in PARAMETER_NAMES:
            raise RecordError(thing, name, ", ".join(PARAMETER_NAMES))
        if abs(value) >= longest:
            allowed = f"less than the leg length {longest:g} mm"
            raise RecordError(f"{thing}, {name}", f"{value:g} mm", allowed)
    values = tuple(found.parameters_mm.get(name, 0.0) for name in PARAMETER_NAMES)
    placed = [placed_effects(entry, effects, geometry, thing) for entry in found.effects]
    return Model(geometry, values, tuple(effect for each in placed for effect in each))


def sizes_of(found: ModelFile, effects: Sequence[Effect] = CATALOGUE) -> tuple[Size, ...]:
    """The values of a model's effects that a fit may free: one for each parameter not held.

    Places that share an entry share the value. Raises RecordError as `to_model` does.
    """
    geometry, sizes, first = found.machine.geometry(), [], 0
    for entry in found.effects:
        placed = placed_effects(entry, effects, geometry, "model")
        kind = placed[0].effect
        bases = [parameter.name for parameter in kind.parameters]
        for name, parameter in entry.parameters.items():
            if parameter.held:
                continue
            base = bases.index(parameter.of or name)
            places = _places(entry, parameter, kind, geometry, "model")
            at = [first + k for k, one in enumerate(placed) if one.place in places]
            known = kind.parameters[base]
            sizes.append(
                Size(
                    f"{entry.id} {entry.where}: {name}",
                    known.unit,
                    known.tolerance,
                    tuple((effect, base) for effect in at),
                )
            )
        first += len(placed)
    return tuple(sizes)


def with_solution(found: ModelFile, solution: Solution) -> ModelFile:
    """The model with parameters and sizes as they were fitted together, and how well each is known.

    ``solution`` was fitted with `sizes_of` this model.
    """
    sizes = (
        {"value": size.value, "standard_uncertainty": size.standard_uncertainty}
        for size in solution.sizes
    )
    effects = []
    for entry in found.effects:
        known = {
            name: one if one.held else one.model_copy(update=next(sizes))
            for name, one in entry.parameters.items()
        }
        effects.append(entry.model_copy(update={"parameters": known}))
    values = dict(zip(PARAMETER_NAMES, solution.model.parameters_mm, strict=True))
    return found.model_copy(update={"parameters_mm": values, "effects": tuple(effects)})


def held_sizes(found: ModelFile) -> tuple[str, ...]:
    """Sizes of the model that a person stated: ``backlash (x): play = +0.02 mm``."""
    return tuple(
        f"{one.id} ({one.where}): {name} = {value.value:+.6g} {value.unit}"
        for one in found.effects
        for name, value in one.parameters.items()
        if value.held
    )


def ambiguous_effects(found: ModelFile) -> tuple[str, ...]:
    """Effects that stand for a set of which any would do: ``backlash (x)``."""
    return tuple(
        f"{one.id} ({one.where})"
        for one in found.effects
        if one.provenance and one.provenance.verdict == "ambiguous"
    )


def ambiguity(names: Sequence[str]) -> str:
    """What must be said wherever a model with such effects is used; empty if nothing."""
    if not names:
        return ""
    return (
        f"The model holds {', '.join(names)}, adopted as one of several effects that would do: "
        "its name and what follows from it are not certain."
    )
