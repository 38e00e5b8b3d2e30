"""Adopted effects as model files of every kind of machine have them, and how they come and go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, Protocol, Self, TypeVar

from pydantic import AwareDatetime, Field

from calib.errors import UsageError
from protocols.documents import Document, Name

LARGEST_SIZE = 1e9
Value = Annotated[float, Field(ge=-LARGEST_SIZE, le=LARGEST_SIZE)]


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
        """The effect with these values, one for each parameter, held."""
        parameters = {
            name: parameter.model_copy(
                update={"value": float(value), "standard_uncertainty": None, "held": True}
            )
            for (name, parameter), value in zip(self.parameters.items(), values, strict=True)
        }
        return self.model_copy(update={"parameters": parameters})

    def freed(self) -> EffectEntry:
        """The effect with values that a fit may change."""
        parameters = self.parameters.items()
        free = {name: parameter.model_copy(update={"held": None}) for name, parameter in parameters}
        return self.model_copy(update={"parameters": free})


class HistoryEntry(Document):
    """An effect was added to the model or removed from it: when and why."""

    action: Literal["added", "removed"]
    at: AwareDatetime
    why: Name
    effect: EffectEntry


class HasEffects(Protocol):
    """A model file: its effects, and how they came and went."""

    @property
    def effects(self) -> tuple[EffectEntry, ...]:
        """What it has now."""

    @property
    def history(self) -> tuple[HistoryEntry, ...]:
        """What was added and removed, in this order."""

    def model_copy(self, *, update: Mapping[str, Any] | None = None) -> Self:
        """A copy with other values of these fields."""


M = TypeVar("M", bound=HasEffects)


def with_effect(model: M, entry: EffectEntry, why: str) -> M:
    """The model with one more effect. Raises UsageError where it has it there already."""
    if any((e.id, e.where) == (entry.id, entry.where) for e in model.effects):
        raise UsageError(
            f"effect {entry.id} at {entry.where}",
            "in the model already",
            "each effect once at a place",
            "Remove the old one first.",
        )
    return _changed(model, (*model.effects, entry), "added", [entry], why)


def without_effect(model: M, effect_id: str, where: str | None, why: str) -> M:
    """The model without an effect; without ``where`` at every place of it.

    What was removed stays in the history. Raises UsageError where the model has no such effect.
    """
    removed = [e for e in model.effects if e.id == effect_id and where in (None, e.where)]
    if not removed:
        present = ", ".join(f"{e.id} at {e.where}" for e in model.effects)
        name = effect_id if where is None else f"{effect_id} at {where}"
        raise UsageError("effect to remove", name, present or "no effect: the model has none")
    return _changed(
        model, tuple(e for e in model.effects if e not in removed), "removed", removed, why
    )


def with_sizes(model: M, entry: EffectEntry, why: str) -> M:
    """The model with an effect that it has as ``entry`` has it; the history tells of both.

    Raises UsageError where it has no such effect.
    """
    without = without_effect(model, entry.id, entry.where, why)
    old = without.history[-1].effect
    return with_effect(without, entry.model_copy(update={"provenance": old.provenance}), why)


def _changed(
    model: M,
    effects: tuple[EffectEntry, ...],
    action: Literal["added", "removed"],
    entries: Sequence[EffectEntry],
    why: str,
) -> M:
    """The model with these effects; the history tells of the entries that came or went."""
    now = datetime.now(UTC)
    noted = [HistoryEntry(action=action, at=now, why=why, effect=entry) for entry in entries]
    return model.model_copy(update={"effects": effects, "history": (*model.history, *noted)})
