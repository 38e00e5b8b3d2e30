"""Habits of the screen tests; sessions that a diagnosis is shown of."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import hidden_sessions


@pytest.fixture(autouse=True)
def _fast_fingers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pilot presses faster than a held key repeats."""
    monkeypatch.setattr("app.screens.measure.HELD_KEY_S", 0.0)


@pytest.fixture
def bowed(tmp_path: Path) -> Path:
    return hidden_sessions.bowed_session(tmp_path)


@pytest.fixture
def doubtful(tmp_path: Path) -> Path:
    return hidden_sessions.doubtful_session(tmp_path)


@pytest.fixture
def nameless(tmp_path: Path) -> Path:
    return hidden_sessions.nameless_session(tmp_path)
