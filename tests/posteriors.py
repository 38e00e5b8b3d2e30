"""Posteriors that many tests ask for, worked out once: a test opens the same session again."""

from __future__ import annotations

import pickle
from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import pytest

from calib.hexaslide.diagnosis import weighed
from calib.posterior.cells import SessionCase
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import Effect

Answer = TypeVar("Answer")

IN_MEMORY = 4
"""So many, the ones that were asked for last; with all that is worked out from it one may have
hundreds of MB."""

KNOWN: OrderedDict[bytes, Any] = OrderedDict()
"""By what they were worked out from, as bytes."""


def known(work: Callable[..., Answer], *asked: object) -> Answer:
    """What ``work`` gives for these; worked out again for what cannot be told apart by bytes."""
    try:
        key = pickle.dumps((work.__name__, asked))
    except pickle.PicklingError:  # an effect of a file of the user's, which pickle cannot import
        return work(*asked)
    if key not in KNOWN:
        KNOWN[key] = work(*asked)
    KNOWN.move_to_end(key)
    while len(KNOWN) > IN_MEMORY:
        KNOWN.popitem(last=False)
    result: Answer = KNOWN[key]
    return result


def known_posterior(
    cases: Sequence[SessionCase], effects: Sequence[Effect] | None = None
) -> Posterior:
    """As `posterior`, of this process."""
    return known(posterior, tuple(cases), tuple(CATALOGUE if effects is None else effects))


known_causes = partial(known, weighed)
"""As `weighed`, of this process."""


@pytest.fixture(autouse=True)
def same_readings_same_posterior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Imported by the ``conftest`` of a folder whose tests open the same sessions again."""
    monkeypatch.setattr("app.evaluating.correction.posterior", known_posterior)
    monkeypatch.setattr("app.evaluating.hexaslide_calibration.weighed", known_causes)
