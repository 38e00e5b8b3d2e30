"""Effects of model files in words, whichever kind of machine they are of."""

from __future__ import annotations

from collections.abc import Sequence

from app.report.text.tables import expanded, wrapped
from protocols.effect_entries import EffectEntry, HistoryEntry


def size_lines(effect: EffectEntry) -> list[str]:
    """The values of an effect, with their expanded uncertainties."""
    lines = []
    for name, size in effect.parameters.items():
        spread = size.standard_uncertainty
        value_words = expanded(size.value, spread) if spread else f"{size.value:+.4g}"
        more_words = f"{' (95 %)' if spread else ''}{', held' if size.held else ''}"
        lines.append(f"    {name} = {value_words} {size.unit}{more_words}")
    return lines


def origin_lines(effect: EffectEntry) -> list[str]:
    """In which sessions it was found; none where that is not stated."""
    if effect.provenance is None:
        return []
    sessions = ", ".join(effect.provenance.sessions)
    return [wrapped(f"    found in {sessions}, verdict {effect.provenance.verdict}")]


def history_words(history: Sequence[HistoryEntry]) -> str:
    """How effects came and went; empty where none did."""
    lines = [
        f"{entry.at:%Y-%m-%d %H:%M} {entry.action} {entry.effect.id} ({entry.effect.where}): "
        f"{entry.why}"
        for entry in history
    ]
    return "\n".join(["History", *lines]) if lines else ""
