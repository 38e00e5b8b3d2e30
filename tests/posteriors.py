"""Posteriors that many tests ask for, worked out once a process."""

from __future__ import annotations

import pickle
from collections import OrderedDict
from collections.abc import Sequence

import pytest

from calib.posterior.cells import SessionCase
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import Effect

KEPT = 12
"""So many, the ones that were asked for last; each has up to 30 MB."""

POSTERIORS: OrderedDict[bytes, Posterior] = OrderedDict()
"""By what they were worked out from, as bytes."""


def known_posterior(
    cases: Sequence[SessionCase], effects: Sequence[Effect] | None = None
) -> Posterior:
    """As `posterior`: the same readings have the same."""
    key = pickle.dumps((tuple(cases), tuple(CATALOGUE if effects is None else effects)))
    if key not in POSTERIORS:
        POSTERIORS[key] = posterior(cases, effects)
    POSTERIORS.move_to_end(key)
    while len(POSTERIORS) > KEPT:
        POSTERIORS.popitem(last=False)
    return POSTERIORS[key]


@pytest.fixture(autouse=True)
def same_readings_same_posterior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Imported by the ``conftest`` of a folder whose tests open the same sessions again."""
    monkeypatch.setattr("app.evaluating.correction.posterior", known_posterior)
