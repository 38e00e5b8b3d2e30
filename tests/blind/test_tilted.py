"""The blind cells of drives that are not square: hidden by a simulation of its own, then diagnosed.

`python -m tests.blind.tilted` counts more of them; docs/diagnosis.md has the rates.
"""

from __future__ import annotations

import pytest

from tests.blind.tilted import SHAPES, Score, scores


@pytest.fixture(scope="module")
def every() -> list[Score]:
    """Three shapes, nothing and six effects, each once."""
    return list(scores(21, seed=30))


@pytest.mark.parametrize("shape", SHAPES)
def test_what_is_hidden_is_among_the_names(every: list[Score], shape: str) -> None:
    """Where anything is named; never another name alone, and nothing is called nothing."""
    mine = [score for score in every if score.shape == shape]
    assert sum(score.names for score in mine) >= 5
    assert all(score.right for score in mine if score.names)
    assert all(score.right for score in mine if not score.effect)
