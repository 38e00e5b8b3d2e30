"""A model in words."""

from __future__ import annotations

from app.report.text.tables import new_table, signed, table_text, wrapped
from protocols.model_file import EffectEntry, ModelFile


def model_text(model: ModelFile) -> str:
    """Parameters, effects with their provenance, and how they came and went."""
    table = new_table("parameter", "value, mm")
    for name, value in model.parameters_mm.items():
        table.add_row(name, signed(value, 4))
    parts = [f"Model of {model.machine.name}", table_text(table)]
    parts += [effect_words(effect) for effect in model.effects] or ["No effects."]
    if model.history:
        lines = [
            wrapped(f"{h.at:%Y-%m-%d %H:%M} {h.action} {h.effect.id} ({h.effect.where}): {h.why}")
            for h in model.history
        ]
        parts.append("History\n" + "\n".join(lines))
    return "\n\n".join(parts)


def effect_words(effect: EffectEntry) -> str:
    """One effect, its sizes, and where it was found."""
    lines = [f"{effect.id} ({effect.where}): {effect.title}"]
    for name, value in effect.parameters.items():
        spread = value.standard_uncertainty
        about = "" if spread is None else f" ± {spread:.2g}"
        lines.append(f"    {name} = {value.value:+.4g}{about} {value.unit}")
    if effect.provenance:
        sessions = ", ".join(effect.provenance.sessions)
        lines.append(wrapped(f"    found in {sessions}, verdict {effect.provenance.verdict}"))
    return "\n".join(lines)
