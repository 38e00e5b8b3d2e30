"""Models as JSON files with a schema number."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from pydantic import AwareDatetime, Field, ValidationError

from calib.orthoglide.effects import CATALOGUE
from calib.orthoglide.effects.law import Law, Placed
from calib.orthoglide.geometry import PARAMETER_NAMES
from calib.orthoglide.model import Model
from protocols.documents import (
    MOST_BYTES,
    Document,
    LengthMm,
    Name,
    describe,
    read_text,
)
from protocols.effect_entries import EffectEntry, effect_entry, placed_effects
from protocols.errors import RecordError, UsageError
from protocols.machine import Machine
from protocols.own_files import open_to_read


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


def model_file(model: Model, machine: Machine) -> ModelFile:
    """A file of this model, each of its effects at one place, without a history.

    Raises RecordError for an effect that is not of the catalogue's kind.
    """
    strangers = [effect.id for effect in model.effects if not isinstance(effect, Placed)]
    if strangers:
        raise RecordError("model", ", ".join(strangers), "effects that are laws with values")
    return ModelFile(
        machine=machine,
        parameters_mm=dict(zip(PARAMETER_NAMES, model.parameters_mm, strict=True)),
        effects=tuple(
            effect_entry(effect.place, [effect])
            for effect in model.effects
            if isinstance(effect, Placed)
        ),
    )


def model_to_json(model: Model, machine: Machine, cautions: Sequence[str] = ()) -> str:
    """The model as JSON text. Raises RecordError as `model_file` does."""
    held = {"cautions": tuple(cautions) or None}
    return model_file(model, machine).model_copy(update=held).text()


def with_effect(
    known: ModelFile, entry: EffectEntry, why: str, at: datetime | None = None
) -> ModelFile:
    """The model with one more effect. Raises UsageError where it has it there already."""
    if any((e.id, e.where) == (entry.id, entry.where) for e in known.effects):
        raise UsageError(
            f"effect {entry.id} at {entry.where}",
            "in the model already",
            "each effect once at a place",
            "Remove the old one first.",
        )
    return known.model_copy(
        update={
            "effects": (*known.effects, entry),
            "history": (*known.history, _noted("added", entry, why, at)),
        }
    )


def without_effect(
    known: ModelFile, effect_id: str, where: str | None, why: str, at: datetime | None = None
) -> ModelFile:
    """The model without an effect; without ``where`` at every place of it.

    What was removed stays in the history. Raises UsageError where the model has no such effect.
    """
    gone = [e for e in known.effects if e.id == effect_id and where in (None, e.where)]
    if not gone:
        present = ", ".join(f"{e.id} at {e.where}" for e in known.effects)
        named = effect_id if where is None else f"{effect_id} at {where}"
        raise UsageError("effect to remove", named, present or "no effect: the model has none")
    return known.model_copy(
        update={
            "effects": tuple(e for e in known.effects if e not in gone),
            "history": (*known.history, *(_noted("removed", e, why, at) for e in gone)),
        }
    )


def _noted(
    action: Literal["added", "removed"], entry: EffectEntry, why: str, at: datetime | None
) -> HistoryEntry:
    return HistoryEntry(action=action, at=at or datetime.now(UTC), why=why, effect=entry)


def is_model(path: Path) -> bool:
    """Whether a file is a model rather than a session or something else.

    False for what is too large for a model. Raises RecordError where it cannot be read.
    """
    try:
        with open_to_read(path) as file:
            content = json.loads(file.read(MOST_BYTES))
    except OSError as problem:
        raise RecordError(
            f"file {path}", problem.strerror or str(problem), "a session or model file"
        ) from problem
    except (ValueError, RecursionError):
        return False
    return isinstance(content, dict) and "event" not in content


def read_model_file(path: Path) -> ModelFile:
    """A model file as it stands. Raises RecordError naming the file and the fault."""
    text = read_text(path, "model")
    try:
        return ModelFile.model_validate_json(text)
    except ValidationError as problem:
        raise RecordError(
            f"model {path}", describe(problem), "schema glidecal.model/1"
        ) from problem


def read_model(path: Path, laws: Sequence[Law] = CATALOGUE) -> tuple[Model, Machine]:
    """A model and its machine from a JSON file; ``laws`` are the effects known.

    Raises RecordError naming the file and the fault.
    """
    found = read_model_file(path)
    return to_model(found, f"model {path}", laws), found.machine


def to_model(found: ModelFile, thing: str, laws: Sequence[Law] = CATALOGUE) -> Model:
    """The model of a file; ``thing`` names it in errors. Raises RecordError."""
    _check_parameters(found, thing)
    geometry = found.machine.geometry()
    values = tuple(found.parameters_mm.get(name, 0.0) for name in PARAMETER_NAMES)
    placed = [placed_effects(entry, laws, geometry, thing) for entry in found.effects]
    return Model(geometry, values, tuple(effect for each in placed for effect in each))


def _check_parameters(found: ModelFile, thing: str) -> None:
    longest = min(found.machine.geometry().leg_length_mm)
    for name, value in found.parameters_mm.items():
        if name not in PARAMETER_NAMES:
            raise RecordError(thing, name, ", ".join(PARAMETER_NAMES))
        if abs(value) >= longest:
            raise RecordError(
                f"{thing}, {name}", f"{value:g} mm", f"less than the leg length {longest:g} mm"
            )
