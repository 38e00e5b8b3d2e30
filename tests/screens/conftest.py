"""Habits of the screen tests; sessions that a diagnosis is shown of."""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.notifications import Notification

from tests import hidden_sessions
from tests.posteriors import same_readings_same_posterior

__all__ = ["same_readings_same_posterior"]


@pytest.fixture(autouse=True)
def _fast_fingers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pilot presses faster than a held key repeats."""
    monkeypatch.setattr("app.measuring.attended.HELD_KEY_S", 0.0)


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
