"""The alias map in words."""

from __future__ import annotations

from app.wording.tables import wrapped
from calib.diagnosis.aliases import AliasMap


def alias_text(found: AliasMap) -> str:
    """For each effect the ones that imitate it; what no reading shows."""
    by_effect: dict[tuple[str, str], list[str]] = {}
    for one in found.imitations:
        by_effect.setdefault(one.effect, []).append(f"{one.by[0]} ({one.by[1]})")
    lines = [
        wrapped(
            f"{len(found.effects)} effects and places; {len(by_effect)} of them can be imitated by "
            "another effect, base parameters and zeros free:"
        )
    ]
    lines += [
        wrapped(f"{name} ({where}): {', '.join(dict.fromkeys(others))}")
        for (name, where), others in by_effect.items()
    ]
    if found.invisible:
        shown = ", ".join(f"{name} ({where})" for name, where in found.invisible)
        lines.append(wrapped(f"No reading shows: {shown}"))
    return "\n".join(lines)
