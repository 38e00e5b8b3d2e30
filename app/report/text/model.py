"""A model in words."""

from __future__ import annotations

from app.evaluating.own_effects import known_effects
from app.report.text.effect_entries import history_words, origin_lines, size_lines
from app.report.text.tables import hanging, new_table, paragraphs, signed
from calib.errors import RecordError
from calib.tripod.effects.effect import remedies
from protocols.effect_entries import EffectEntry
from protocols.machine import Machine
from protocols.model_file import ModelFile, ambiguity, ambiguous_effects, placed_effects


def model_text(model: ModelFile) -> str:
    """Parameters, effects with their provenance, and how they came and went."""
    table = new_table("parameter", "value, mm")
    for name, value in model.parameters_mm.items():
        table.add_row(name, signed(value, 4))
    unsure = ambiguity(ambiguous_effects(model))
    return paragraphs(
        [f"Model of {model.machine.name}"],
        table,
        *([effect_words(effect, model.machine)] for effect in model.effects),
        "" if model.effects else "No effects.",
        f"WARNING: {unsure}" if unsure else "",
        history_words(model.history),
    )


def effect_words(effect: EffectEntry, machine: Machine) -> str:
    """One effect, its sizes, what to do against it, and where it was found."""
    lines = [f"{effect.id} ({effect.where}): {effect.title}", *size_lines(effect)]
    lines += [hanging(f"    {remedy}", "    ") for remedy in _remedies(effect, machine)]
    return "\n".join([*lines, *origin_lines(effect)])


def _remedies(effect: EffectEntry, machine: Machine) -> tuple[str, ...]:
    try:
        return remedies(placed_effects(effect, known_effects(), machine.geometry(), "model"))
    except RecordError:  # an effect of somebody else: what it is shall be seen all the same
        return ()
