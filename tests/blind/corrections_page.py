"""Tables of what corrections leave at the tool: `tests.blind.corrections` makes their lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.blind.scoring import Rate

Json = dict[str, Any]

INTRODUCTION = """# What a correction leaves at the tool

Machines of the bench's own simulation (`tests/blind/`) with offsets, bars and hidden effects;
their tables are imported, solved, and what the program shows for each controller is entered. Then
the tool of the hidden machine is measured over the workspace. `offsets`, `play`, `tables` and
`kinematics` are what a controller holds; `law` is who knows which effects are hidden, and where,
and fits their sizes to the same readings; `was today` is the most that commit 84cc33a exported
without a warning against it. Made by `python -m tests.blind.corrections -o docs/corrections.md`;
never edited by hand.
"""

BEFORE, LAW, OFFSETS = "before", "law", "offsets"
FRAMES = {
    "touched_off": "touched off (best shift removed)",
    "aligned": "aligned (best shift and turn removed)",
    "machine": "the machine's own frame",
    "near": "near Zero, relative to Zero",
}
BOUNDED = ("touched_off", "aligned", "machine", "near")
WORSE, WORSE_MM = 1.1, 0.005
"""A correction is worse than offsets alone where it leaves so many times, and so many mm more."""

Groups = dict[str, list[Json]]


def beside(lines: Sequence[Json], others: Sequence[Json]) -> list[Json]:
    """The sessions that both have, with the other answers under ``was NAME``."""
    known, joint = {line["key"]: line for line in others}, []
    for line in lines:
        if (other := known.get(line["key"])) is None:
            continue
        if not np.isclose(line["errors"][BEFORE]["machine"], other["errors"][BEFORE]["machine"]):
            raise ValueError(
                f"session {line['key']} is another one: made with another seed or strength"
            )
        both = line | {"failure": line["failure"] or other["failure"]}
        for part in ("errors", "bounds"):
            was = {f"was {name}": v for name, v in other[part].items() if name not in (BEFORE, LAW)}
            both[part] = line[part] | was
        joint.append(both)
    return joint


def page(lines: Sequence[Json]) -> str:
    """What is left in each frame, then how far promises are kept."""
    failed = [line for line in lines if line["failure"]]
    kept = [line for line in lines if not line["failure"]]
    groups: Groups = {}
    for line in kept:
        groups.setdefault(line["cell"], []).append(line)
        if line["cell"] in ("one effect", "two effects"):
            groups.setdefault("one and two effects", []).append(line)
    groups["all"] = kept
    names = list(dict.fromkeys(name for line in kept for name in line["errors"]))
    names = [BEFORE, *(name for name in names if name not in (BEFORE, LAW)), LAW]
    text = [
        f"{len(lines)} sessions, {len(failed)} without an answer; "
        f"{np.mean([line['cpu_s'] for line in lines]):.2f} s CPU for an answer.",
        *(f"- {line['key']}: {line['failure']}" for line in failed),
    ]
    for frame, title in FRAMES.items():
        text += [
            "",
            f"True tool error, {title}: r.m.s. [median], mm",
            "",
            *_left(groups, names, frame),
        ]
    bounded = [name for name in names if any(line["bounds"].get(name) for line in kept)]
    text += ["", "True ≤ bound (95 % bounds of the share), and bound / true, median", ""]
    text += _kept(groups, bounded)
    others = [name for name in names if name not in (BEFORE, LAW, OFFSETS)]
    text += ["", f"Worse than offsets alone by > {WORSE - 1:.0%} and > {WORSE_MM * 1e3:g} µm", ""]
    return "\n".join([*text, *_worse(groups, others)])


def _left(groups: Groups, names: Sequence[str], frame: str) -> list[str]:
    rows = [_row("hidden", "sessions", *names), _row(*["---"] * (len(names) + 2))]
    for title, lines in groups.items():
        cells = []
        for name in names:
            true, best = (
                np.array([line["errors"][one][frame] for line in lines]) for one in (name, LAW)
            )
            rms, least = (float(np.sqrt(np.mean(mm**2))) for mm in (true, best))
            times = "" if name in (BEFORE, LAW) else f" {rms / least:.1f} ×"
            cells.append(f"{rms:.4f} [{np.median(true):.4f}]{times}")
        rows.append(_row(title, str(len(lines)), *cells))
    return rows


def _kept(groups: Groups, names: Sequence[str]) -> list[str]:
    rows = [_row("hidden", "answer", *BOUNDED), _row(*["---"] * (len(BOUNDED) + 2))]
    for title, lines in groups.items():
        for name in names:
            cells = []
            for frame in BOUNDED:
                both = [
                    (line["errors"][name][frame], bound)
                    for line in lines
                    if (bound := line["bounds"].get(name, {}).get(frame)) is not None
                ]
                share = Rate(sum(true <= bound for true, bound in both), len(both))
                ratio = float(np.median([bound / true for true, bound in both])) if both else 0.0
                low, high = share.bounds
                told = f"{share.hits}/{share.count} {share.share:.0%} ({low:.0%} … {high:.0%})"
                cells.append(f"{told}, {ratio:.1f} ×" if both else "–")
            rows.append(_row(title, name, *cells))
    return rows


def _worse(groups: Groups, names: Sequence[str]) -> list[str]:
    rows = [_row("hidden", "answer", *FRAMES), _row(*["---"] * (len(FRAMES) + 2))]
    for title, lines in groups.items():
        for name in names:
            cells = []
            for frame in FRAMES:
                pairs = [
                    (one["errors"][name][frame], one["errors"][OFFSETS][frame]) for one in lines
                ]
                count = sum(a > WORSE * b and a > b + WORSE_MM for a, b in pairs)
                low, high = Rate(count, len(pairs)).bounds
                cells.append(f"{count}/{len(pairs)} ({low:.0%} … {high:.0%})")
            rows.append(_row(title, name, *cells))
    return rows


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"
