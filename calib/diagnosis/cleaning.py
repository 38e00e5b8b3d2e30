"""Mistakes in the data are found first, named, and set right for the diagnosis only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from calib.diagnosis.gross_errors import GrossError, place_of, suspect_blunders
from calib.diagnosis.gross_errors_given_effects import needed_beside_effects
from calib.diagnosis.outliers import set_strays_right
from calib.diagnosis.problem import FittedSession, Problem
from calib.diagnosis.setup_shifts import find_slip
from calib.diagnosis.verify import structure_rms_mm
from calib.errors import NotIdentifiable
from calib.noise.reading import IndicatorFigures
from calib.observations import FloatArray, Observations
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import Law
from calib.tripod.pipeline import Model

MOST_BLUNDERS = 3
LEAST_ROWS_BEYOND = 8
"""Readings beyond zeros and base parameters that a mistake must be seen against."""


@dataclass(frozen=True, eq=False)
class Case:
    """One session to diagnose: the model it was measured against and what is known of it."""

    model: Model
    observed: Observations
    indicator: IndicatorFigures
    tolerance_mm: FloatArray

    def sit(self) -> FittedSession:
        """Fit the base parameters. Raises NotIdentifiable."""
        return FittedSession.of(self.model, self.observed, self.indicator, self.tolerance_mm)

    def with_readings(self, observed: Observations) -> Case:
        """The same session with other readings."""
        return replace(self, observed=observed)


@dataclass(frozen=True)
class Mistake:
    """A mistake in one session, and the gap (r.m.s., mm) with it and without."""

    blunder: GrossError
    before_rms_mm: float
    after_rms_mm: float


def clean(
    cases: Sequence[Case], laws: Sequence[Law] = CATALOGUE
) -> tuple[list[Case], list[Mistake]]:
    """Sessions without the mistakes found in them, and the mistakes. ``laws`` may stand beside."""
    cleaned, mistakes = [], []
    for case in cases:
        present = case
        for blunder in _blunders_of(case, laws):
            corrected = case.with_readings(blunder.corrected)
            mistakes.append(Mistake(blunder, _gap_rms_mm(present), _gap_rms_mm(corrected)))
            present = corrected
        cleaned.append(present)
    return cleaned, mistakes


def _blunders_of(case: Case, laws: Sequence[Law]) -> list[GrossError]:
    """One after the other, each in the data that the one before left."""
    found = _slips(case.observed)
    observed = found[-1].corrected if found else case.observed
    spare = len(observed) - observed.mount_count - len(case.tolerance_mm)
    for _ in range(MOST_BLUNDERS if spare >= LEAST_ROWS_BEYOND else 0):
        blunder = _blunder_in(case.with_readings(observed), laws)
        if blunder is None:
            break
        found.append(blunder)
        observed = blunder.corrected
    return [*found, *set_strays_right(observed, _step_mm(case.indicator))]


def _blunder_in(case: Case, laws: Sequence[Law]) -> GrossError | None:
    suspicions = suspect_blunders(case.model, case.observed, case.tolerance_mm)
    if not suspicions or suspicions[0].proven:
        return suspicions[0].blunder if suspicions else None
    fitted = [(one, _fitted(case.with_readings(one.blunder.corrected))) for one in suspicions]
    before = _fitted(case)
    if before is None:
        return next((one.blunder for one, after in fitted if one.clear and after), None)
    return needed_beside_effects(before, [(one, after) for one, after in fitted if after], laws)


def _fitted(case: Case) -> FittedSession | None:
    """None where these readings, wrong as they may be, fit no machine."""
    try:
        return case.sit()
    except NotIdentifiable:
        return None


def _step_mm(indicator: IndicatorFigures) -> float:
    return max(indicator.resolution_mm or 0.0, indicator.step_mm or 0.0)


def _slips(observed: Observations) -> list[GrossError]:
    """Slips of stands that the repeats show clearly."""
    found: list[GrossError] = []
    while len(found) < MOST_BLUNDERS and (slip := find_slip(observed)) is not None:
        first = slip.rows[0]
        where = place_of(observed, slip.rows)
        title = (
            f"the stand moved by {slip.shift_mm:+.4f} mm before the reading at "
            f"{observed.posture_words(first)}, cycle {observed.cycle[first]}"
        )
        found.append(GrossError("stand_slip", where, title, slip.rows, slip.corrected))
        observed = slip.corrected
    return found


def _gap_rms_mm(case: Case) -> float:
    return structure_rms_mm(Problem.of([case.sit()]))
