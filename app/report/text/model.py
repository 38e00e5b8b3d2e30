"""A model in words."""

from __future__ import annotations

from app.evaluating.own_effects import known_effects
from app.report.text.tables import hanging, new_table, paragraphs, signed, wrapped
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
    history = [
        f"{h.at:%Y-%m-%d %H:%M} {h.action} {h.effect.id} ({h.effect.where}): {h.why}"
        for h in model.history
    ]
    return paragraphs(
        [f"Model of {model.machine.name}"],
        table,
        *([effect_words(effect, model.machine)] for effect in model.effects),
        "" if model.effects else "No effects.",
        f"WARNING: {unsure}" if unsure else "",
        "\n".join(["History", *history]) if history else "",
    )


def effect_words(effect: EffectEntry, machine: Machine) -> str:
    """One effect, its sizes, what to do against it, and where it was found."""
    lines = [f"{effect.id} ({effect.where}): {effect.title}"]
    for name, value in effect.parameters.items():
        spread = value.standard_uncertainty
        about = "" if spread is None else f" ± {spread:.2g}"
        held_words = ", held" if value.held else ""
        lines.append(f"    {name} = {value.value:+.4g}{about} {value.unit}{held_words}")
    lines += [hanging(f"    {remedy}", "    ") for remedy in _remedies(effect, machine)]
    if effect.provenance:
        sessions = ", ".join(effect.provenance.sessions)
        lines.append(wrapped(f"    found in {sessions}, verdict {effect.provenance.verdict}"))
    return "\n".join(lines)


def _remedies(effect: EffectEntry, machine: Machine) -> tuple[str, ...]:
    try:
        return remedies(placed_effects(effect, known_effects(), machine.geometry(), "model"))
    except RecordError:  # an effect of somebody else: what it is shall be seen all the same
        return ()
