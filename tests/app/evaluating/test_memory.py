"""What a session's evaluation holds goes with it, without waiting for the collector of cycles.

Arrays of a hundred megabytes count as a few objects there: it would come after some gigabytes.
"""

from __future__ import annotations

import gc
import weakref

import pytest

from app.evaluating.solution import solve_files
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from tests.conftest import SAMPLES

SESSIONS = {
    "simulated_zero-max-min.jsonl": "every set of parameters is determined",
    "every_schema/11/contacts.jsonl": "sets are refused, cases of towers are weighed",
}


def posterior_of(name: str) -> weakref.ref[Posterior]:
    corrections = solve_files([SAMPLES / name]).corrections
    assert corrections.of("offsets").bound_mm > 0.0
    return weakref.ref(corrections.posterior)


@pytest.mark.parametrize("name", SESSIONS)
def test_a_posterior_goes_with_its_last_reference(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.evaluating.correction.posterior", posterior)  # tests remember some
    gc.collect()
    gc.disable()
    try:
        assert posterior_of(name)() is None
    finally:
        gc.enable()
