"""Posteriors that many tests ask for, worked out once: a test opens the same session again."""

from __future__ import annotations

import hashlib
import os
import pickle
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path

import pytest

from calib.posterior.cells import SessionCase
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import Effect

IN_MEMORY, ON_DISK = 12, 6
"""So many, the ones that were asked for last; each has up to 30 MB."""

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


def posterior_on_disk(
    folder: Path, cases: Sequence[SessionCase], effects: Sequence[Effect] | None = None
) -> Posterior:
    """As `posterior`, of processes that follow each other: the commands of a test."""
    key = _key(cases, effects)
    if key is None:
        return posterior(cases, effects)
    path = folder / hashlib.sha256(key).hexdigest()
    if path.exists():
        known = pickle.loads(path.read_bytes())
        assert isinstance(known, Posterior)
        return known
    result = posterior(cases, effects)
    part = folder / f"part-{os.getpid()}"
    part.write_bytes(pickle.dumps(result))
    part.replace(path)
    files = sorted(folder.iterdir(), key=lambda file: file.stat().st_mtime_ns)
    for file in files[:-ON_DISK]:
        file.unlink(missing_ok=True)
    return result


@pytest.fixture(autouse=True)
def same_readings_same_posterior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Imported by the ``conftest`` of a folder whose tests open the same sessions again."""
    monkeypatch.setattr("app.evaluating.correction.posterior", known_posterior)
