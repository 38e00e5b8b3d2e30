"""Tables of what corrections leave at the tool: `tests.blind.corrections` makes their lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.blind.scoring import Rate

Json = dict[str, Any]

INTRODUCTION = """# What a correction leaves at the tool

Each simulated machine (`tests/blind/`) has joint offsets, wrong bars and the hidden effects of its
row. After its readings are solved, nothing is entered (before), joint offsets alone, or what a
controller with tables or kinematics takes too ([export](export.md)). For `law` the hidden effects
and places are given and only sizes are fitted.
`ideal` knows the simulation, the shares of its effects and sizes, the noise, how many effects act
and all gross mistakes, but not which effects. Its bound is that of 95 of 100 machines that it
draws.

Frames: touched off, the best shift is removed; aligned, the best shift and turn; machine, nothing;
near, errors near Zero relative to that at Zero. [Bound](theory.md#uncertainty-at-the-tool) of 95 %.
Made by `python -m tests.blind.corrections --count 36 --ideal -o docs/corrections.md`.
"""

BEFORE, LAW, IDEAL, OFFSETS = "before", "law", "ideal", "offsets"
IDEAL_BOUND = "offsets, ideal bound"
"""Joint offsets of the program, with the bound that the ideal judge states for them."""
LEFT_OUT = ("play", IDEAL_BOUND)
"""Answers whose r.m.s. is that of joint offsets within 0.2 µm."""
ALL = "all"
FRAMES = {"touched_off": "touched off", "aligned": "aligned", "machine": "machine", "near": "near"}
STATED = ("touched_off", "machine")
"""Frames of errors and bounds. Aligned errors are smaller, those near Zero two thirds as large."""
WORSE, WORSE_MM = 1.1, 0.005
"""A correction is worse than offsets alone where it leaves so many times, and so many mm more."""

Groups = dict[str, list[Json]]


def beside(lines: Sequence[Json], reference_lines: Sequence[Json]) -> list[Json]:
    """The sessions that both have, with the other answers under ``was NAME``."""
    by_key, joint = {line["key"]: line for line in reference_lines}, []
    for line in lines:
        if (partner := by_key.get(line["key"])) is None:
            continue
        if not np.isclose(line["errors"][BEFORE]["machine"], partner["errors"][BEFORE]["machine"]):
            raise ValueError(
                f"session {line['key']} is another one: made with another seed or strength"
            )
        joint_line = line | {"failure": line["failure"] or partner["failure"]}
        for part in ("errors", "bounds"):
            was = {
                f"was {name}": v
                for name, v in partner[part].items()
                if name not in (BEFORE, LAW, IDEAL)
            }
            joint_line[part] = line[part] | was
        joint.append(joint_line)
    return joint


def page(lines: Sequence[Json]) -> str:
    """What is left in each frame, then how far promises are kept."""
    failed = [line for line in lines if line["failure"]]
    complete = [line for line in lines if not line["failure"]]
    groups: Groups = {}
    for line in complete:
        groups.setdefault(line["cell"], []).append(line)
    groups[ALL] = complete
    names = list(dict.fromkeys(name for line in complete for name in line["errors"]))
    simulated = [name for name in (IDEAL, LAW) if name in names]
    asked = [name for name in names if name not in (BEFORE, *simulated, *LEFT_OUT)]
    names = [BEFORE, *asked, *simulated]
    text = [
        f"{len(lines)} sessions, {len(failed)} without an answer; "
        f"{np.mean([line['cpu_s'] for line in lines]):.2f} s CPU for an answer.",
        *(f"- {line['key']}: {line['failure']}" for line in failed),
        "",
        "## True error of the tool",
        "",
        "R.m.s. over the workspace and the sessions, and [median of the sessions], mm.",
    ]
    by_cell = {title: group for title, group in groups.items() if title != ALL}
    for frame in STATED:
        text += ["", *_left(by_cell, names, frame, FRAMES[frame])]
    text += [
        "",
        "## The bound",
        "",
        "Sessions whose true error is within the bound, and the median of bound over truth.",
    ]
    bounded = [name for name in names if any(line["bounds"].get(name) for line in complete)]
    for frame in STATED:
        if any(frame in bounds for line in complete for bounds in line["bounds"].values()):
            ideal = [IDEAL_BOUND] if IDEAL in names and frame == STATED[0] else []
            text += ["", *_kept(groups, [*bounded, *ideal], frame, FRAMES[frame])]
    worse = f"more than {WORSE - 1:.0%} and {WORSE_MM * 1e3:g} µm"
    text += [
        "",
        "## Worse than joint offsets alone",
        "",
        f"Sessions where an answer leaves {worse} more than joint offsets alone (of all sessions:",
        "with the 95 % interval of their share).",
        "",
    ]
    candidates = [name for name in names if name not in (BEFORE, LAW, IDEAL, OFFSETS)]
    return "\n".join([*text, *_worse(groups, candidates)])


def _left(groups: Groups, names: Sequence[str], frame: str, title: str) -> list[str]:
    rows = _head(f"hidden; {title}", *names)
    for group, lines in groups.items():
        cells = []
        for name in names:
            if any(name not in line["errors"] for line in lines):
                cells.append("–")
                continue
            true = np.array([line["errors"][name][frame] for line in lines])
            cells.append(f"{float(np.sqrt(np.mean(true**2))):.4f} [{np.median(true):.4f}]")
        rows.append(_row(group, *cells))
    return rows


def _kept(groups: Groups, names: Sequence[str], frame: str, title: str) -> list[str]:
    rows = _head(f"hidden; {title}", *names)
    for group, lines in groups.items():
        cells = []
        for name in names:
            pairs = [
                (line["errors"][name][frame], bound)
                for line in lines
                if (bound := line["bounds"].get(name, {}).get(frame)) is not None
            ]
            within_bound = sum(true <= bound for true, bound in pairs)
            ratio = float(np.median([bound / true for true, bound in pairs])) if pairs else 0.0
            cells.append(f"{within_bound}/{len(pairs)}, {ratio:.1f} ×" if pairs else "–")
        rows.append(_row(group, *cells))
    return rows


def _worse(groups: Groups, names: Sequence[str]) -> list[str]:
    rows = _head("hidden", "answer", *FRAMES.values())
    for title, lines in groups.items():
        for name in names:
            cells, total = [], 0
            for frame in FRAMES:
                pairs = [
                    (line["errors"][name][frame], line["errors"][OFFSETS][frame]) for line in lines
                ]
                count = sum(a > WORSE * b and a > b + WORSE_MM for a, b in pairs)
                low, high = Rate(count, len(pairs)).bounds
                bounds = f" ({low:.0%} … {high:.0%})" if title == ALL else ""
                cells.append(f"{count}/{len(pairs)}{bounds}")
                total += count
            if total or title == ALL:
                rows.append(_row(title, name, *cells))
    return rows


def _head(*cells: str) -> list[str]:
    return [_row(*cells), "|---" * len(cells) + "|"]


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"
