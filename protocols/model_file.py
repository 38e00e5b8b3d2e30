"""Models as JSON files with a schema number."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from calib.orthoglide.geometry import PARAMETER_NAMES
from calib.orthoglide.model import Model
from protocols.documents import Document, describe, read_text
from protocols.errors import RecordError
from protocols.machine import Machine


class EffectEntry(Document):
    """One adopted effect: its name in the catalogue, where it acts, its parameters."""

    id: str
    where: str
    parameters: dict[str, float]


class ModelFile(Document):
    """A machine with identified parameters in mm, and adopted effects (none known yet)."""

    schema_id: Literal["glidecal.model/1"] = Field(alias="schema", default="glidecal.model/1")
    machine: Machine = Machine()
    parameters_mm: dict[str, float] = Field(default_factory=dict)
    effects: tuple[EffectEntry, ...] = ()


def model_to_json(model: Model, machine: Machine) -> str:
    """The model as JSON text."""
    if model.effects:
        raise RecordError("model", f"{len(model.effects)} effects", "a model without effects")
    values = dict(zip(PARAMETER_NAMES, model.parameters_mm, strict=True))
    return ModelFile(machine=machine, parameters_mm=values).model_dump_json(indent=1) + "\n"


def is_model(text: str) -> bool:
    """Whether a JSON text is a model rather than a session or something else."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return False
    return isinstance(content, dict) and "event" not in content


def read_model(path: Path) -> tuple[Model, Machine]:
    """A model and its machine from a JSON file.

    Raises RecordError naming the file and the fault.
    """
    text = read_text(path, "model")
    try:
        found = ModelFile.model_validate_json(text)
    except ValidationError as problem:
        raise RecordError(
            f"model {path}", describe(problem), "schema glidecal.model/1"
        ) from problem
    unknown = [name for name in found.parameters_mm if name not in PARAMETER_NAMES]
    unknown += [effect.id for effect in found.effects]
    if unknown:
        raise RecordError(
            f"model {path}",
            ", ".join(unknown),
            ", ".join(PARAMETER_NAMES) + "; no effects in this version",
        )
    longest = found.machine.leg_length_mm
    for name, value in found.parameters_mm.items():
        if abs(value) >= longest:
            raise RecordError(
                f"model {path}, {name}", f"{value:g} mm", f"less than the leg length {longest:g} mm"
            )
    values = tuple(found.parameters_mm.get(name, 0.0) for name in PARAMETER_NAMES)
    return Model(found.machine.geometry(), values), found.machine
