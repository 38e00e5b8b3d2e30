"""The verdict as a sentence, and what can be said of a left-over that has no name."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.diagnosis.entries import Entry
from calib.diagnosis.problem import Problem
from calib.diagnosis.race import LEVEL, Race
from calib.diagnosis.results import Detectable, Finding, LeftOver, Verdict

NO_LAW = "what is left follows no simple law of displacement, approach, time or temperature"
MOST_RIVALS = 5
FOUND_9_OF_10 = 1.28
"""Standard normal quantile of 90 %."""


def sentence(verdict: Verdict, findings: Sequence[Finding], where: str, doubt: str) -> str:
    """The verdict in one sentence that a machinist understands.

    ``where`` tells where something is left, ``doubt`` why names without rivals are not claimed.
    """
    names = " and ".join(f"{f.title} ({f.where})" for f in findings)
    rivals = sorted({r.id for f in findings for r in f.indistinguishable_from})
    if len(rivals) > MOST_RIVALS:
        rivals = [*rivals[: MOST_RIVALS - 1], f"{len(rivals) - MOST_RIVALS + 1} others"]
    return {
        "agrees": "The model explains the readings within their noise; nothing is missing.",
        "explained": f"What was missing is: {names}.",
        "ambiguous": f"Something is missing: {names}"
        + (f", or else {', '.join(rivals)}; these data cannot tell." if rivals else f"; {doubt}."),
        "partly-explained": f"Part of what is missing is {names}; more is left, {where}.",
        "unexplained": f"Something real is missing, {where}, and no known effect explains it.",
        "cannot-tell": "The readings are too few to tell what is missing"
        + (f"; the best guess is {names}." if names else "."),
    }[verdict]


def remarks(problem: Problem, verdict: Verdict, left_over: LeftOver | None) -> tuple[str, ...]:
    """What else a person must know."""
    said = []
    if problem.noise_df <= 0.0:
        said.append("no repeats and no stated noise: nothing can be judged against chance")
    if verdict == "unexplained":
        said.append("either the effect is not in the catalogue, or the repeats are not independent")
    if verdict in ("unexplained", "partly-explained"):
        said += [] if left_over else [NO_LAW]
    return tuple(said)


def smallest_detectable(
    problem: Problem, entries: Sequence[Entry], race: Race
) -> tuple[Detectable, ...]:
    """Size of each single-parameter effect that would have been found nine times of ten."""
    found: dict[str, Detectable] = {}
    threshold = math.sqrt(2.0 * math.log(max(len(entries), 2) / LEVEL)) + FOUND_9_OF_10
    for entry, block in zip(entries, race.blocks, strict=True):
        if entry.columns.shape[1] != 1 or entry.kind == "blunder":
            continue
        slope = float(np.linalg.norm(block.T @ (problem.root_weight * entry.columns[:, 0])))
        size = threshold / slope if slope else math.inf
        if math.isfinite(size) and (entry.id not in found or size < found[entry.id].size):
            found[entry.id] = Detectable(entry.id, size, entry.names[0][1])
    return tuple(found.values())
