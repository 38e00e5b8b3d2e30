"""Mistakes in the data are found first, named, and set right for the diagnosis only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from calib.diagnosis.blunders import Blunder, find_blunder, set_wild_aside
from calib.diagnosis.problem import Problem, Sitting
from calib.diagnosis.slips import find_slip
from calib.diagnosis.verify import structure_rms_mm
from calib.noise import IndicatorFigures
from calib.observations import LEG_NAMES, FloatArray, Observations
from calib.orthoglide.model import Model

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

    def sit(self) -> Sitting:
        """Fit the base parameters. Raises NotIdentifiable."""
        return Sitting.of(self.model, self.observed, self.indicator, self.tolerance_mm)

    def with_readings(self, observed: Observations) -> Case:
        """The same session with other readings."""
        return replace(self, observed=observed)


@dataclass(frozen=True)
class Mistake:
    """A mistake in one session, and the gap (r.m.s., mm) with it and without."""

    blunder: Blunder
    before_rms_mm: float
    after_rms_mm: float


def clean(cases: Sequence[Case]) -> tuple[list[Case], list[Mistake]]:
    """Sessions without the mistakes found in them, and the mistakes."""
    cleaned, mistakes = [], []
    for case in cases:
        present = case
        for blunder in _blunders_of(case):
            corrected = case.with_readings(blunder.corrected)
            mistakes.append(Mistake(blunder, _gap_rms_mm(present), _gap_rms_mm(corrected)))
            present = corrected
        cleaned.append(present)
    return cleaned, mistakes


def cleaned(cases: Sequence[Case]) -> list[Case]:
    """The sessions as they are diagnosed: mistakes corrected or set aside."""
    return clean(cases)[0]


def _blunders_of(case: Case) -> list[Blunder]:
    """One after the other, each in the data that the one before left."""
    found = _slips(case.observed)
    observed = found[-1].corrected if found else case.observed
    spare = len(observed) - observed.mount_count - len(case.tolerance_mm)
    for _ in range(MOST_BLUNDERS if spare >= LEAST_ROWS_BEYOND else 0):
        blunder = find_blunder(case.model, observed, case.tolerance_mm)
        if blunder is None:
            break
        found.append(blunder)
        observed = blunder.corrected
    return [*found, *set_wild_aside(observed)[1]]


def _slips(observed: Observations) -> list[Blunder]:
    """Slips of stands that the repeats show clearly."""
    found: list[Blunder] = []
    while len(found) < MOST_BLUNDERS and (slip := find_slip(observed)) is not None:
        first = slip.rows[0]
        where = LEG_NAMES[observed.leg[first]] + LEG_NAMES[observed.axis[first]]
        title = (
            f"the stand moved by {slip.shift_mm:+.4f} mm before the reading at "
            f"{observed.displacement_mm[first]:+g} mm, cycle {observed.cycle[first]}"
        )
        found.append(Blunder("stand_slip", where, title, slip.rows, slip.corrected))
        observed = slip.corrected
    return found


def _gap_rms_mm(case: Case) -> float:
    return structure_rms_mm(Problem.of([case.sit()]))
