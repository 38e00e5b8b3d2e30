"""Habits of the screen tests."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _fast_fingers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pilot presses faster than a held key repeats."""
    monkeypatch.setattr("app.screens.measure.HELD_KEY_S", 0.0)
