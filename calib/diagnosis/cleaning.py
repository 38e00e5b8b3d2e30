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

from calib.diagnosis.gross_errors import ODDS, GrossError, Suspicion, find_shift, suspicions
from calib.diagnosis.hypotheses import hypotheses_of
from calib.diagnosis.model_selection import ModelSelection
from calib.diagnosis.outliers import set_outliers_right
from calib.diagnosis.problem import Case, FittedSession, Problem
from calib.diagnosis.results import Finding, Named
from calib.diagnosis.selection import Search, Spread, WeighedModel, heaviest_first
from calib.errors import NotIdentifiable
from calib.linalg import without
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.candidates import Candidate
from calib.tripod.effects.effect import Kind, Law

MOST_MISTAKES = 3
LEAST_ROWS_BEYOND = 8
"""Readings beyond zeros and base parameters that a mistake must be seen against."""

DOUBTFUL_ODDS = 10.0
"""Odds of a mistake that is named together with what does almost as well."""

MOST_EFFECTS = 3
BEAM = 4
CLOSED = 0.001
"""With a mistake that is not clear, and effects, no gap of smaller chance may be left."""

LEAST_GAIN = 1e-6


def clean(
    cases: Sequence[Case], laws: Sequence[Law] = CATALOGUE
) -> tuple[list[Case], list[Finding]]:
    """Sessions without the mistakes found in them, and the mistakes. ``laws`` may act as well."""
    cleaned, mistakes = [], []
    for case in cases:
        errors = _errors_of(case, laws)
        stages = [case, *(case.with_readings(error.corrected) for error in errors)]
        gaps = [Problem.of([one.fitted()]).gap_rms_mm() for one in stages] if errors else []
        for error, before_mm, after_mm in zip(errors, gaps, gaps[1:], strict=False):
            what = error.id, str(Kind.BLUNDER), error.title, error.where
            mistakes.append(Finding(*what, (), 0.0, before_mm, after_mm, error.or_else))
        cleaned.append(stages[-1])
    return cleaned, mistakes


def _errors_of(case: Case, laws: Sequence[Law]) -> list[GrossError]:
    """One after the other, each in the data that the one before left."""
    found: list[GrossError] = []
    observed = case.observed
    while len(found) < MOST_MISTAKES and (shift := find_shift(observed)) is not None:
        found.append(shift)
        observed = shift.corrected
    spare = len(observed) - observed.mount_count - len(case.tolerance_mm)
    for _ in range(MOST_MISTAKES if spare >= LEAST_ROWS_BEYOND else 0):
        error = _error_in(case.with_readings(observed), laws)
        if error is None:
            break
        found.append(error)
        observed = error.corrected
    step_mm = max(case.indicator.resolution_mm or 0.0, case.indicator.step_mm or 0.0)
    return [*found, *set_outliers_right(observed, step_mm)]


def _error_in(case: Case, laws: Sequence[Law]) -> GrossError | None:
    suspected = suspicions(case.model, case.observed, case.tolerance_mm)
    if not suspected or suspected[0].proven:
        return suspected[0].error if suspected else None
    fitted = [(one, _fitted(case.with_readings(one.error.corrected))) for one in suspected]
    before = _fitted(case)
    if before is None:
        return next((one.error for one, after in fitted if one.clear and after), None)
    return _needed_given_effects(before, [(one, after) for one, after in fitted if after], laws)


def _fitted(case: Case) -> FittedSession | None:
    """None where these readings, wrong as they may be, fit no machine."""
    try:
        return case.fitted()
    except NotIdentifiable:
        return None


@dataclass(frozen=True, eq=False)
class _Effects:
    """Every effect of the catalogue that shows in a session, beside a mistake or without it."""

    problem: Problem
    candidates: Sequence[Candidate]
    search: Search

    @classmethod
    def of(cls, fitted_session: FittedSession, laws: Sequence[Law]) -> _Effects:
        """All candidates that show, weighed by all readings, repeats included."""
        problem = Problem.of([fitted_session])
        every = [one for one in hypotheses_of(problem, laws) if one.kind != Kind.BLUNDER]
        shown = ModelSelection.of(problem, every)
        freedom = float(len(problem.y) - problem.nuisance.shape[1])
        spread = Spread(float(problem.y @ problem.y), freedom)
        search = Search(problem.y, shown.blocks, spread, shown.log_priors, _unit_information)
        return cls(problem, shown.candidates, search)

    def log_weight(self, model: WeighedModel) -> float:
        """Log likelihood (Student's) and prior, comparable between other readings of a session."""
        return model.log_weight - 0.5 * self.search.spread.freedom * math.log(
            self.search.spread.total
        )

    def best(self, most: int) -> WeighedModel:
        """The best model with so many effects or fewer; a few of the best are followed up."""
        best = self.search.weigh(())
        beam = [best]
        for _ in range(most):
            found = {m.members: m for one in beam for m in self.search.larger(one.members)}
            beam = heaviest_first(list(found.values()))[:BEAM]
            best = heaviest_first([best, *beam])[0]
        return self.exchanged(best)

    def exchanged(self, best: WeighedModel) -> WeighedModel:
        """One effect after the other left out or replaced, as long as that is better."""
        while True:
            fewer = [tuple(k for k in best.members if k != m) for m in best.members]
            others = [
                m for one in fewer for m in (self.search.weigh(one), *self.search.larger(one))
            ]
            better = heaviest_first([best, *others])[0]
            if better.log_weight <= best.log_weight + LEAST_GAIN:
                return best
            best = better

    def near(self, there: _Effects, model: WeighedModel) -> WeighedModel:
        """The effects of a model in other readings, or better ones near them."""
        known = {_key(one): k for k, one in enumerate(self.candidates)}
        keys = [_key(there.candidates[k]) for k in model.members]
        return self.exchanged(self.search.weigh([known[key] for key in keys if key in known]))


def _unit_information(explained: float, rank: int, spread: Spread) -> float:
    """Log likelihood above no effect, less what a prior as wide as the effects costs (fitted)."""
    width = 0.5 * rank * math.log(max(explained / max(rank, 1), 1.0))
    return spread.log_ratio(explained, 0.0) - width


def _key(one: Candidate) -> tuple[str, str, int]:
    return one.id, one.where, one.columns.shape[1]


def _needed_given_effects(
    before: FittedSession,
    suspected: Sequence[tuple[Suspicion, FittedSession]],
    laws: Sequence[Law],
) -> GrossError | None:
    """The mistake, of those suspected, that is needed whatever effects there are; or None.

    Each comes with its corrected session, fitted. One that is not clear must be beyond doubt and
    leave no gap. Effects that do almost as well are named with it.
    """
    alone = _Effects.of(before, laws)
    if not alone.problem.has_repeats() or alone.problem.structure_df < 1:
        return next((one.error for one, _ in suspected if one.clear), None)
    effects = alone.best(MOST_EFFECTS)
    for one, fitted_session in sorted(suspected, key=lambda each: not each[0].clear):
        corrected = _Effects.of(fitted_session, laws)
        model = corrected.best(MOST_EFFECTS if one.clear else MOST_EFFECTS - 1)
        # what was found beside a mistake must be tried without it, too
        effects = heaviest_first([effects, alone.near(corrected, model)])[0]
        likelier = corrected.log_weight(model) - alone.log_weight(effects) - one.log_tried
        if likelier > math.log(ODDS) and (one.clear or _closes(corrected, model)):
            return one.error
        if one.clear and likelier > math.log(DOUBTFUL_ODDS):
            named = [alone.candidates[k] for k in effects.members]
            return replace(one.error, or_else=tuple(Named(each.id, each.where) for each in named))
    return None


def _closes(effects: _Effects, model: WeighedModel) -> bool:
    """Whether no gap is left beyond chance."""
    problem = effects.problem
    basis = effects.search.basis(model.members)
    df = problem.structure_df - basis.shape[1]
    return df > 0 and problem.gap_p_value(problem.gap(without(basis, problem.y)), df) > CLOSED
