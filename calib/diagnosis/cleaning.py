"""Mistakes in the data are found first, named, and set right for the diagnosis only.

A turned or swapped indicator beside an effect: both at once must explain what effects cannot.
Beside a strong effect a mistake may take away only part of the disagreement, and an effect may
bend the slopes that tell it. Then the mistake with some effects is weighed against effects alone:
each side takes the effects that explain most, pays for each, and the variance of the noise is
taken from the residuals and the scatter of repeats (Student's likelihood).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Observations, without
from calib.diagnosis.gross_errors import GrossError, Suspicion, find_shift, suspicions
from calib.diagnosis.hypotheses import hypotheses_of, is_known
from calib.diagnosis.model_selection import ModelSelection
from calib.diagnosis.outliers import set_outliers_right
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import Case, FittedSession, Problem
from calib.diagnosis.results import CleanedReadings, Finding, Named
from calib.diagnosis.selection import CandidateSearch, Spread, WeighedModel, heaviest_first
from calib.errors import NotIdentifiable
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.candidates import Candidate
from calib.tripod.effects.effect import Effect, Kind

CLOSED = 0.001
"""With a mistake that is not clear, and effects, no gap of smaller chance may be left."""


def clean(
    cases: Sequence[Case], effects: Sequence[Effect] = CATALOGUE
) -> tuple[list[CleanedReadings], list[Finding]]:
    """Sessions without the mistakes found in them, and the mistakes; ``effects`` may act, too."""
    cleaned, mistakes = [], []
    for case in cases:
        errors = _errors_of(case, effects)
        stages = [case, *(case.with_readings(error.corrected) for error in errors)]
        gaps = [Problem.of([one.fitted()]).gap_rms_mm() for one in stages] if errors else []
        for error, before_mm, after_mm in zip(errors, gaps, gaps[1:], strict=False):
            what = error.id, str(Kind.GROSS_ERROR), error.title, error.where
            mistakes.append(Finding(*what, (), 0.0, before_mm, after_mm, error.or_else))
        cleaned.append(_cleaned(case.observed, errors))
    return cleaned, mistakes


def _cleaned(observed: Observations, errors: Sequence[GrossError]) -> CleanedReadings:
    rows = np.arange(len(observed))
    slips = np.zeros(len(observed), dtype=np.intp)
    for error in errors:
        if len(error.corrected) < len(rows):
            rows = np.delete(rows, error.rows)
        elif error.id == "stand_slip":
            slips[rows[error.rows]] += 1
        observed = error.corrected
    return CleanedReadings(observed, rows, slips[rows])


def _errors_of(case: Case, effects: Sequence[Effect]) -> list[GrossError]:
    """One after the other, each in the data that the one before left."""
    found: list[GrossError] = []
    observed = case.observed
    # shifts first: repeats alone tell them, whatever else is wrong with the readings
    while len(found) < POLICY.most_causes and (shift := find_shift(observed)) is not None:
        found.append(shift)
        observed = shift.corrected
    spare = len(observed) - observed.mount_count - len(case.tolerance_mm)
    for _ in range(POLICY.most_causes if spare >= POLICY.least_freedom else 0):
        error = _error_in(case.with_readings(observed), effects)
        if error is None:
            break
        found.append(error)
        observed = error.corrected
    return [*found, *set_outliers_right(observed, case.indicator.display_mm)]


def _error_in(case: Case, effects: Sequence[Effect]) -> GrossError | None:
    suspected = suspicions(case.model, case.observed, case.tolerance_mm)
    if not suspected or suspected[0].proven:
        return suspected[0].error if suspected else None
    fitted = [(one, _fitted(case.with_readings(one.error.corrected))) for one in suspected]
    before = _fitted(case)
    if before is None:
        return next((one.error for one, after in fitted if one.clear and after), None)
    return _needed_given_effects(before, [(one, after) for one, after in fitted if after], effects)


def _fitted(case: Case) -> FittedSession | None:
    """None where these readings, wrong as they may be, fit no machine."""
    try:
        return case.fitted()
    except NotIdentifiable:
        return None


@dataclass(frozen=True, eq=False)
class _Catalogue:
    """Every effect that may act beside a mistake, and how likely sets of them make the readings."""

    problem: Problem
    candidates: Sequence[Candidate]
    search: CandidateSearch

    @classmethod
    def of(cls, fitted_session: FittedSession, effects: Sequence[Effect]) -> _Catalogue:
        """All candidates of the catalogue that show in this session."""
        problem = Problem.of([fitted_session])
        every = [one for one in hypotheses_of(problem, effects) if is_known(one)]
        shown = ModelSelection.of(problem, every)
        freedom = len(problem.y) - problem.whitening.free.shape[1]
        spread = Spread(float(problem.y @ problem.y), float(freedom))
        search = CandidateSearch(problem.y, shown.blocks, spread, shown.log_priors)
        return cls(problem, shown.candidates, search)

    def log_evidence(self, model: WeighedModel) -> float:
        """Log likelihood of the readings, noise unknown, less what the effects cost."""
        spread = self.search.spread
        return model.log_weight - 0.5 * spread.freedom * math.log(spread.total)

    def best(self, most: int) -> WeighedModel:
        """The best set of so many effects or fewer."""
        each = [1] * len(self.candidates)
        sizes = self.search.by_causes(each, most)
        return heaviest_first([self.search.weighed(()), *(m for size in sizes for m in size)])[0]

    def alike(self, there: _Catalogue, model: WeighedModel) -> WeighedModel:
        """The effects that were found in other readings in these."""
        known = {_key(one): k for k, one in enumerate(self.candidates)}
        keys = [_key(there.candidates[k]) for k in model.members]
        return self.search.weighed(tuple(known[key] for key in keys if key in known))


def _key(one: Candidate) -> tuple[str, str, int]:
    return one.id, one.where, one.columns.shape[1]


def _needed_given_effects(
    before: FittedSession,
    suspected: Sequence[tuple[Suspicion, FittedSession]],
    effects: Sequence[Effect],
) -> GrossError | None:
    """The mistake, of those suspected, that is needed whatever effects there are; or None.

    Each comes with its corrected session, fitted. One that is not clear must be beyond doubt and
    leave no gap. Effects that do almost as well are named with it.
    """
    alone = _Catalogue.of(before, effects)
    if not alone.problem.has_repeats() or alone.problem.structure_df < 1:
        return next((one.error for one, _ in suspected if one.clear), None)
    explained = alone.best(POLICY.most_causes)
    for one, fitted_session in sorted(suspected, key=lambda each: not each[0].clear):
        corrected = _Catalogue.of(fitted_session, effects)
        beside = corrected.best(POLICY.most_causes if one.clear else POLICY.most_causes - 1)
        # what was found beside a mistake must be tried without it, too
        explained = heaviest_first([explained, alone.alike(corrected, beside)])[0]
        likelier = corrected.log_evidence(beside) - alone.log_evidence(explained) - one.log_tried
        if likelier > math.log(POLICY.odds) and (one.clear or _closes(corrected, beside)):
            return one.error
        if one.clear and likelier > math.log(POLICY.doubtful_odds):
            named = [alone.candidates[k] for k in explained.members]
            return replace(one.error, or_else=tuple(Named(each.id, each.where) for each in named))
    return None


def _closes(corrected: _Catalogue, beside: WeighedModel) -> bool:
    """Whether no gap is left beyond chance."""
    problem, basis = corrected.problem, corrected.search.basis(beside.members)
    df = problem.structure_df - basis.shape[1]
    return df > 0 and problem.gap_p_value(problem.gap(without(basis, problem.y)), df) > CLOSED
