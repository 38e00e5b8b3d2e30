"""Posteriors that many tests ask for, worked out once: a test opens the same session again."""

from __future__ import annotations

import pickle
from collections import OrderedDict
from collections.abc import Sequence

import pytest

from calib.arrays import FloatArray
from calib.diagnosis.hexaslide import WeighedCauses, weighed
from calib.diagnosis.hexaslide_causes import AdoptedEffect
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.residuals import Readings
from calib.posterior.cells import SessionCase
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import Effect

IN_MEMORY = 4
"""So many, the ones that were asked for last; with all that is worked out from it one may have
hundreds of MB."""

POSTERIORS: OrderedDict[bytes, Posterior] = OrderedDict()
"""By what they were worked out from, as bytes."""


def _key(cases: Sequence[SessionCase], effects: Sequence[Effect] | None) -> bytes | None:
    """None where an effect is of a file of the user's, which pickle cannot import."""
    try:
        return pickle.dumps((tuple(cases), tuple(CATALOGUE if effects is None else effects)))
    except pickle.PicklingError:
        return None


def known_posterior(
    cases: Sequence[SessionCase], effects: Sequence[Effect] | None = None
) -> Posterior:
    """As `posterior`, of this process."""
    key = _key(cases, effects)
    if key is None:
        return posterior(cases, effects)
    if key not in POSTERIORS:
        POSTERIORS[key] = posterior(cases, effects)
    POSTERIORS.move_to_end(key)
    while len(POSTERIORS) > IN_MEMORY:
        POSTERIORS.popitem(last=False)
    return POSTERIORS[key]


CAUSES: OrderedDict[bytes, WeighedCauses] = OrderedDict()


def known_causes(
    readings: Readings,
    nominal: HexaSlide,
    tolerances: FloatArray,
    lead_m: float | None = None,
    adopted: Sequence[AdoptedEffect] = (),
    middle: FloatArray | None = None,
) -> WeighedCauses:
    """As `weighed`, of this process."""
    asked = readings, nominal, tolerances, lead_m, tuple(adopted), middle
    key = pickle.dumps(asked)
    if key not in CAUSES:
        CAUSES[key] = weighed(*asked)
    CAUSES.move_to_end(key)
    while len(CAUSES) > IN_MEMORY:
        CAUSES.popitem(last=False)
    return CAUSES[key]


@pytest.fixture(autouse=True)
def same_readings_same_posterior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Imported by the ``conftest`` of a folder whose tests open the same sessions again."""
    monkeypatch.setattr("app.evaluating.correction.posterior", known_posterior)
    monkeypatch.setattr("app.evaluating.hexaslide_calibration.weighed", known_causes)
