"""What a Hexa Slide's procedure sees, in words."""

from __future__ import annotations

import math

from app.hexaslide_seen import HexaSlideSeen, PaperRule
from app.wording.tables import wrapped
from calib.hexaslide.differences import STEP

DECIDED = {
    "rows": "the number of rows",
    "parameters": "the number of parameters",
    "postures": "what so few postures show",
}

MOST_TOLD = 4
"""So many long sums are written out."""


def seen_text(found: HexaSlideSeen) -> str:
    """What is seen and lost, the condition number with its units, then the paper's rule."""
    examined = found.seen.examined
    head = (
        f"hexaslide, {examined.procedure}: {examined.posture_count} postures ({examined.source}) "
        f"reading {', '.join(examined.measured)}. Derivatives are exact; no noise decides."
    )
    parts = [head, _verdict(found), _lost(found), _known(found), _conditions(found), _rule(found)]
    return "\n\n".join(wrapped(part) for part in parts if part)


def _verdict(found: HexaSlideSeen) -> str:
    seen, examined = found.seen.found, found.seen.examined
    count, reachable = len(seen.names), examined.reachable_rank or seen.rank
    words = f"{seen.rank} of {count} combinations of the parameters are seen"
    words += ", all of them." if seen.rank == count else f", {count - seen.rank} not."
    if found.seen.limited_by == "nothing":
        words += f" Fewest postures that show so many: {examined.fewest_postures}."
    elif examined.posture_count < (examined.fewest_postures or 0):
        words += (
            f"\nToo few postures: {examined.fewest_postures} or more are needed to see the "
            f"{reachable} that this procedure can show. Measure more postures."
        )
    else:
        words += (
            f"\nThese postures are too much alike: others show {reachable}. Vary all six "
            "coordinates."
        )
    return words + (f"\n{examined.remark}" if examined.remark else "")


def _lost(found: HexaSlideSeen) -> str:
    always = [one.name for one in found.seen.lost if one.name in found.always]
    lines = [f"NOT SEEN ({len(axes)}): {_motion(axes)}." for axes in _grouped(always)]
    if lines:
        lines.append("  No posture shows this: nothing that is read depends on it.")
    others = [one for one in found.seen.lost if one.name not in found.always]
    lines += [f"NOT SEEN (1): {one.name}." for one in others[:MOST_TOLD]]
    if len(others) > MOST_TOLD:
        lines.append(f"NOT SEEN ({len(others) - MOST_TOLD}): more such sums; --json tells them.")
    if others:
        lines.append("  Other postures show this.")
    return "\n".join(lines)


def _grouped(names: list[str]) -> list[list[str]]:
    """Names that differ in their last word only, together."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(name.rsplit(" ", 1)[0], []).append(name)
    return list(groups.values())


def _motion(names: list[str]) -> str:
    motion, axis = names[0].rsplit(" ", 1)
    axes = [axis, *(name.rsplit(" ", 1)[1] for name in names[1:])]
    before = f"{', '.join(axes[:-1])} and " if len(axes) > 1 else ""
    return f"{motion} {before}{axes[-1]}"


def _known(found: HexaSlideSeen) -> str:
    known = found.seen.found.individually_known
    if len(known) == len(found.seen.found.names):
        return "Every parameter is known by itself."
    if not known:
        return "No parameter is known by itself: each has a share in what is not seen."
    return f"Known by themselves ({len(known)}): {', '.join(known)}."


def _conditions(found: HexaSlideSeen) -> str:
    own = found.seen.found.condition_number
    told = {
        units: value
        for k, (units, value) in enumerate(found.conditions.items())
        if k == 0 or not math.isclose(value, own)  # without angles their unit does nothing
    }
    figures = "; ".join(f"{value:.4g} in {units}" for units, value in told.items())
    return (
        f"Condition number of what is seen: {figures} (columns not scaled; 1 is the least "
        "possible). It depends on the units: compare only equal ones."
    )


def _rule(found: HexaSlideSeen) -> str:
    seen, qr = found.seen.found, found.seen.qr
    count = len(seen.names)
    counted = count - len(qr.flagged)
    lines = [
        f"Rule of papers/001, QR in the order of the parameters, |r_ii| ≤ {qr.tolerance:.2g}: "
        f"counts {counted} with exact derivatives, flags {', '.join(qr.flagged) or 'none'}."
    ]
    if counted != seen.rank:
        lines.append(
            f"WARNING: {counted} is wrong: without exchange of columns the rule needs more rows "
            f"than {seen.row_count}."
        )
    elif qr.flagged:
        lines.append(
            "Which ones it flags is a choice of frame and of their order, no fact about them."
        )
    return "\n".join([*lines, *(_on_differences(rule) for rule in found.rules)])


def _on_differences(rule: PaperRule) -> str:
    words = (
        f"With forward differences of {STEP:g} m, as in the paper, at {rule.posture_count} "
        f"postures it counts {rule.counted}"
    )
    if rule.decided_by == "geometry":
        return f"{words}."
    words += f". WARNING: that is {DECIDED[rule.decided_by]}, not what is identifiable"
    words += f" ({rule.reachable_rank})."
    if rule.errors is None or rule.counted <= rule.rank:
        return words
    low, high = (math.floor(math.log10(max(error, 1.0))) for error in rule.errors)
    orders = f"{low}" if low == high else f"{low} to {high}"
    return (
        f"{words} For the errors of such derivatives the rule is {orders} orders of magnitude too "
        "tight."
    )
