"""Whether weak names may be repeats that are not independent.

Repeats read without driving away share the error of their approach. Their scatter is then too
small, and every posture seems to be off by an amount of its own. That is a model, too: one variance
for all postures. It has the evidence of a fitted prior on all of them (`selection`).
"""

from __future__ import annotations

from calib.diagnosis.naming import LEAST_EVIDENCE, Naming
from calib.diagnosis.problem import Problem
from calib.diagnosis.selection import log_bayes_factor
from calib.linalg import incidence, squares_in
from calib.observations import FloatArray, numbered

DOUBT = (
    "repeats read without driving away would explain as much as any name: drive away before each, "
    "or take the gap for real and measure more"
)


def repeats_explain_as_much(naming: Naming) -> bool:
    """Whether the names are weak and postures that vary by themselves do no worse."""
    kept = naming.outcome.kept
    if kept is None or not naming.problem.has_repeats() or not naming.problem.noise_df > 0.0:
        return False
    weak = kept.log_weight < 0.5 * LEAST_EVIDENCE  # as log likelihood
    return weak and evidence_of_postures(naming.problem) > max(kept.log_weight, 0.0)


def evidence_of_postures(problem: Problem) -> float:
    """Log Bayes factor for an error of each posture's own against none."""
    block = problem.block(_postures(problem))
    explained = squares_in(block, problem.y)
    return log_bayes_factor(explained, block.shape[1], problem.spread)


def _postures(problem: Problem) -> FloatArray:
    """One column for each posture and approach of each mounting."""
    return incidence(numbered(problem.mount, problem.conditions("cell")))
