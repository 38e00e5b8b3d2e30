"""Is the machine good enough, where is it worst, and are the stated uncertainties true?"""

from __future__ import annotations

from dataclasses import dataclass

from app.evaluating.solution import SessionSolution, indicator_figures
from calib.errors import UsageError
from calib.identify.accuracy import Decision, ToolMap, decide, tool_map
from calib.identify.monte_carlo import Campaign, MonteCarlo, simulate_and_identify
from calib.identify.subset_choice import left_after

PLANES = ((0, 1), (1, 2), (0, 2))
POINTS = 5


@dataclass(frozen=True)
class Judgement:
    """The tool's expected error against a tolerance, before and after, with guard bands."""

    tolerance_mm: float
    before: Decision
    after: Decision


def judge(solved: SessionSolution, tolerance_mm: float) -> Judgement:
    """Pass, fail or undecided, now and with the solution entered (ISO 14253-1).

    Raises UsageError for a tolerance that is no positive length.
    """
    if not tolerance_mm > 0.0:
        raise UsageError("--tolerance", f"{tolerance_mm:g} mm", "a positive length in mm")
    factor = solved.tool_factor
    return Judgement(
        tolerance_mm,
        decide(solved.tool_before, tolerance_mm, factor),
        decide(solved.tool_after, tolerance_mm, factor),
    )


def maps(solved: SessionSolution) -> tuple[ToolMap, ...]:
    """Expected error of the tool with the solution entered, on the three planes through Zero."""
    geometry = solved.solution.model.geometry
    bias, covariance = left_after(solved.choice.solutions, solved.solution.subset)
    return tuple(tool_map(geometry, bias, covariance, plane, POINTS) for plane in PLANES)


def monte_carlo(solved: SessionSolution, sessions: int, seed: int) -> MonteCarlo:
    """Sessions like this one on machines like this one, identified as this one was.

    All indicators scatter alike there; with a coarse display the machines differ by some steps. A
    stated noise is simulated as stated. Raises UsageError where the noise is what the fit left, and
    for the set held by tolerances.
    """
    solution = solved.solution
    if solution.noise.source == "residuals" or solution.subset == "with-tolerances":
        raise UsageError(
            "--monte-carlo",
            f"noise from {solution.noise.source}, set {solution.subset}",
            "a session with repeats or a stated indicator, and one of the plain sets",
        )
    campaign = Campaign.like(solution, solved.observed, indicator_figures(solved.sessions))
    return simulate_and_identify(campaign, sessions, seed)
