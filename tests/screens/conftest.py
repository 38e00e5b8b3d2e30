"""Habits of the screen tests; sessions that a diagnosis is shown of."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from pathlib import Path

import pytest
from textual.notifications import Notification

from calib.posterior.cells import SessionCase
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.tripod.effects.effect import Effect
from tests import hidden_sessions

POSTERIORS: dict[bytes, Posterior] = {}
"""By what they were worked out from, as bytes."""


@pytest.fixture(autouse=True)
def _same_readings_same_posterior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Worked out once a process: screens show it, and many tests open the same session."""

    def known(cases: Sequence[SessionCase], effects: Sequence[Effect] | None = None) -> Posterior:
        key = pickle.dumps((cases, effects))
        if key not in POSTERIORS:
            POSTERIORS[key] = posterior(cases, effects)
        return POSTERIORS[key]

    monkeypatch.setattr("app.evaluating.correction.posterior", known)


@pytest.fixture(autouse=True)
def _fast_fingers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pilot presses faster than a held key repeats."""
    monkeypatch.setattr("app.screens.measure.HELD_KEY_S", 0.0)


@pytest.fixture(autouse=True)
def _what_was_said_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine the time of a notification is over before a test looks."""
    monkeypatch.setattr(Notification, "has_expired", False)


@pytest.fixture
def bowed(tmp_path: Path) -> Path:
    return hidden_sessions.bowed_session(tmp_path)


@pytest.fixture
def doubtful(tmp_path: Path) -> Path:
    return hidden_sessions.doubtful_session(tmp_path)


@pytest.fixture
def nameless(tmp_path: Path) -> Path:
    return hidden_sessions.nameless_session(tmp_path)
