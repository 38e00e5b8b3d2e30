"""Whether probabilities of names hold: of those stated as 0.3 three of ten are right."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tests.blind.scoring import Scored

EDGES = (0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
DRIFTS = {"thermal_drift", "stand_drift"}
"""Names that are neither right nor wrong where the noise wanders."""

SHOWN = 0.01
"""Probability from which a name is counted: below it there are hundreds a session."""


@dataclass(frozen=True)
class ReliabilityBin:
    """Names of probabilities in a range: how many, their mean, and the share that is right."""

    least: float
    most: float
    count: int
    mean: float
    right: float


def probabilities_and_truth(session: Scored) -> list[tuple[float, bool]]:
    """Every probability of a name beside whether it is true."""
    open_names = DRIFTS if session.truth["noise"] == "wander" else set()
    return [
        (probability, name in session.true_ids)
        for name, probability in session.row.get("probabilities", ())
        if name not in open_names
    ]


def reliability(sessions: Iterable[Scored]) -> list[ReliabilityBin]:
    """Bins of all probabilities of these sessions from `SHOWN` on."""
    pairs = [pair for session in sessions for pair in probabilities_and_truth(session)]
    stated, right = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
    bins = []
    for least, highest in pairwise(EDGES):
        inside = (stated >= least) & ((stated < highest) | (highest == EDGES[-1]))
        if inside.any():
            means = float(stated[inside].mean()), float(right[inside].mean())
            bins.append(ReliabilityBin(least, highest, int(inside.sum()), *means))
    return bins


def brier(sessions: Sequence[Scored]) -> float | None:
    """Mean over sessions of the summed squares of probability less truth; None of none.

    A true name that is not listed counts with probability 0.
    """
    total = 0.0
    for session in sessions:
        listed = {name for name, _ in session.row.get("probabilities", ())}
        missed_ids = session.true_ids - listed
        total += sum((p - right) ** 2 for p, right in probabilities_and_truth(session))
        total += len(missed_ids)
    return total / len(sessions) if sessions else None
