"""Optimum postures of a Hexa Slide in words."""

from __future__ import annotations

from app.planning_hexaslide import BoxedPostures, boxed_document
from app.wording.tables import new_table, table_text, wrapped


def boxed_text(found: BoxedPostures) -> str:
    """Before and after, then the postures and how they were found."""
    said, best = boxed_document(found), found.best
    words = wrapped(
        f"hexaslide, {said['procedure']}: {said['count']} postures for the {said['criterion']} "
        f"criterion, {best.refined.value:.5g} (start {best.refined.start_value:.4g}). Condition "
        f"number {best.condition_number:.4g}, at the start {best.start_condition_number:.4g} "
        f"({said['units']}; of the {best.rank} combinations that are seen)."
    )
    postures = said["postures"]
    table = new_table(*postures[0])
    for posture in postures:
        table.add_row(*(f"{value:.4f}" for value in posture.values()))
    share = 100.0 * best.refined.on_bound / (6 * len(postures))
    last = wrapped(
        f"{share:.0f} % of the coordinates stand on a bound of the box. Best of "
        f"{len(best.values)} starts ({min(best.values):.4g} to {max(best.values):.4g}), seed "
        f"{found.seed}, {found.seconds:.1f} s."
    )
    return "\n\n".join([words, table_text(table), last])
