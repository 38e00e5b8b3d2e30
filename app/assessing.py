"""Is the machine good enough, where is it worst, and are the stated uncertainties true?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.solving import Solved
from calib.accuracy import Decision, ToolMap, decide, tool_map
from calib.monte_carlo import Campaign, MonteCarlo, simulate_and_identify
from calib.noise import visits
from calib.solution import SUBSETS
from calib.subset_choice import full_covariance, spread
from protocols.errors import UsageError
from protocols.observations import to_observations

PLANES = ((0, 1), (1, 2), (0, 2))
POINTS = 5


@dataclass(frozen=True)
class Judged:
    """The tool's expected error against a tolerance, before and after, with guard bands."""

    tolerance_mm: float
    before: Decision
    after: Decision


def judge(solved: Solved, tolerance_mm: float) -> Judged:
    """Pass, fail or undecided, now and with the solution entered (ISO 14253-1)."""
    factor = solved.solution.coverage_factor
    return Judged(
        tolerance_mm,
        decide(solved.tool_before, tolerance_mm, factor),
        decide(solved.tool_after, tolerance_mm, factor),
    )


def maps(solved: Solved) -> tuple[ToolMap, ...]:
    """Expected error of the tool with the solution entered, on the three planes through Zero."""
    solution = solved.solution
    covariance = spread(solution) * full_covariance(solution)
    return tuple(
        tool_map(solution.model.geometry, np.zeros(6), covariance, plane, POINTS)
        for plane in PLANES
    )


def monte_carlo(
    solved: Solved, sessions: int, seed: int, progress: Callable[[int], None]
) -> MonteCarlo:
    """Sessions like this one on machines like this one, identified as this one was.

    Raises UsageError for a session without repeats, whose noise cannot be simulated from them, and
    for the set held by tolerances.
    """
    solution = solved.solution
    if solution.noise.source != "repeats" or solution.subset == "with-tolerances":
        raise UsageError(
            "--monte-carlo",
            f"noise from {solution.noise.source}, set {solution.subset}",
            "a session with repeats and one of the plain sets",
        )
    shown = np.mean([one.shown_mm2 for one in solution.noise.indicators])
    campaign = Campaign(
        solution.model,
        visits(to_observations(solved.sessions)),
        SUBSETS[solution.subset],
        float(np.sqrt(shown)),
        0.0,
        np.zeros(6),
    )
    return simulate_and_identify(campaign, sessions, seed, progress)


def monte_carlo_document(found: MonteCarlo) -> dict[str, Any]:
    """Shares of 95 % intervals that held the truth, and true against stated uncertainty."""
    true = np.sqrt(found.error_covariance_mm2.diagonal())
    stated = np.sqrt(found.predicted_mm2)
    return {
        "sessions": found.sessions,
        "failed": found.failed,
        "parameters": {
            name: {"covered": float(c), "true_mm": float(t), "stated_mm": float(s)}
            for name, c, t, s in zip(found.names, found.covered, true, stated, strict=True)
        },
    }
