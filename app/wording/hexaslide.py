"""Optimum postures of a Hexa Slide in words."""

from __future__ import annotations

from statistics import median

from app.planning_hexaslide import UNITS, BoxedPostures
from app.wording.tables import new_table, table_text, wrapped

PUBLISHED_WORDS = {
    "log10_determinant": "log10 det(JᵀJ)",
    "geometric_mean": "geometric mean of σ / √postures",
    "inverse_condition": "σ_L / σ_1",
    "smallest_singular_value": "σ_L",
    "noise_amplification": "σ_L² / σ_1",
}
"""The criteria of papers/001, section 4, in its order; the larger the better."""


def boxed_text(found: BoxedPostures) -> str:
    """Before and after, then the postures and how they were found."""
    parts = [wrapped(_sentence(found)), _criteria(found), _postures(found.postures)]
    return "\n\n".join([*parts, wrapped(_search(found))])


def _sentence(found: BoxedPostures) -> str:
    best, procedure = found.best, found.procedure
    moved = bool(best.values)
    before = f" (start {best.refined.start_value:.4g})" if moved else ""
    condition = f"{best.condition_number:.4g}"
    condition += f", at the start {best.start_condition_number:.4g}" if moved else ""
    return (
        f"hexaslide, {procedure.kind.value}, reading {', '.join(procedure.read)}: "
        f"{len(found.postures)} postures for the {best.criterion.value} criterion, "
        f"{best.refined.value:.5g}{before}. "
        f"Condition number {condition} ({UNITS}; of the {best.rank} combinations that are "
        "seen)."
    )


def _criteria(found: BoxedPostures) -> str:
    best, moved = found.best, bool(found.best.values)
    table = new_table("criteria of papers/001", *(["start", "found"] if moved else ["value"]))
    sets = (best.start, best.found) if moved else (best.found,)
    for name, words in PUBLISHED_WORDS.items():
        table.add_row(words, *(f"{getattr(one, name):.4g}" for one in sets))
    return table_text(table)


def _postures(postures: tuple[dict[str, float], ...]) -> str:
    table = new_table(*postures[0], left=0)
    for posture in postures:
        table.add_row(*(f"{value + 0.0:.4f}" for value in posture.values()))
    return table_text(table)


def _search(found: BoxedPostures) -> str:
    best, size = found.best, found.best.refined.coordinates.size
    share = f"{100.0 * best.refined.on_bound / size:.0f} %"
    if not best.values:
        return f"{share} of the coordinates stand on a bound of the box. From {found.source}."
    return (
        f"{share} of the coordinates stand on a bound of the box, at the start "
        f"{100.0 * best.start_on_bound / size:.0f} %. {_starts(found)}, seed {found.seed}, "
        f"{found.seconds:.1f} s."
    )


def _starts(found: BoxedPostures) -> str:
    values, random = found.best.values, found.source == "random"
    if len(values) == 1:
        return f"One start, {'random' if random else found.source}"
    first = "" if random else f", the first of them {found.source}"
    return (
        f"Best of {len(values)} starts{first} ({min(values):.4g} to {max(values):.4g}, median "
        f"{median(values):.4g})"
    )
