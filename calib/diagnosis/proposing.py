"""What to measure next, as a sentence and as a procedure that can be run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.diagnosis.fitting import Fitting
from calib.diagnosis.following import ENOUGH, Rival, best_addition
from calib.diagnosis.naming import Naming
from calib.diagnosis.results import Named, NextMeasurement, Verdict
from calib.diagnosis.selection import Weighed
from calib.observations import Conditions, FloatArray
from calib.orthoglide.effects.candidates import candidates

REPEATS_FIRST = NextMeasurement(
    "without repeats and without a stated noise nothing can be judged: measure every posture at "
    "least twice, leaving it in between",
    "zero-max-min",
    0.0,
)


def propose(
    verdict: Verdict, kept: Weighed | None, naming: Naming, fitting: Fitting
) -> NextMeasurement | None:
    """The measurement that would separate the first pair that stayed ambiguous, if any."""
    if verdict == "cannot-tell" and fitting.problem.noise_df <= 0.0:
        return REPEATS_FIRST
    if kept is None or verdict not in ("ambiguous", "cannot-tell"):
        return None
    for member in kept.members:
        for rival in naming.rivals(kept, member):
            other = next(k for k, e in enumerate(fitting.entries) if Named(e.id, e.where) == rival)
            proposed = _separate(fitting, member, other)
            if proposed is not None:
                return proposed
    return None


def _separate(fitting: Fitting, member: int, other: int) -> NextMeasurement | None:
    first, second = fitting.entries[member], fitting.entries[other]
    if first.candidate is None or second.candidate is None:
        return None
    geometry = fitting.problem.sittings[0].model.geometry
    added, separation = best_addition(
        fitting.problem, geometry, _rival(fitting, member), _rival(fitting, other)
    )
    enough = "settles it" if separation >= ENOUGH else "helps"
    return NextMeasurement(
        f"{added.words}; it {enough} between {first.id} ({first.where}) and "
        f"{second.id} ({second.where})",
        _procedure_text(added.leg, added.station, added.levels_mm),
        separation,
    )


def _rival(fitting: Fitting, member: int) -> Rival:
    candidate = fitting.entries[member].candidate
    assert candidate is not None
    model = fitting.problem.sittings[0].model
    value = np.array([v.value for v in fitting.values((member,))[member][0]])
    laws = [placed.law for placed in candidate.effects(value)][:1]

    def columns(taken: Conditions) -> FloatArray:
        found = np.zeros((len(taken), len(value)))
        for other in candidates(model, taken, laws):
            if (other.where, other.arrangement, other.parameters) == (
                candidate.where,
                candidate.arrangement,
                candidate.parameters,
            ):
                found = other.columns
        return found

    return Rival(columns, value)


def _procedure_text(leg: str, station: float, levels_mm: Sequence[float]) -> str:
    levels = ", ".join(['"zero"', *(f"{level:.1f}" for level in levels_mm)])
    return (
        'schema = "glidecal.procedure/1"\n'
        f'name = "next-{leg}"\n'
        'title = "The measurement that separates what stayed ambiguous"\n'
        f'legs = ["{leg}"]\n'
        f"stations = [{station}]\n"
        "cycles = 3\n"
        f"levels = [{levels}]\n"
    )
