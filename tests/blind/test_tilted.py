"""The blind cells of drives that are not square: hidden by a simulation of its own, then diagnosed.

`python -m tests.blind.tilted` counts more of them; docs/diagnosis.md has the rates.
"""

from __future__ import annotations

from tests.blind.tilted import SHAPES, scores
from tests.conftest import LONG


@LONG
def test_what_is_hidden_is_among_the_names() -> None:
    """Five shapes, nothing and six effects, each once; where anything is named.

    Never another name alone, and nothing is called nothing.
    """
    all_scores = list(scores(35, seed=30))
    for shape in SHAPES:
        assert sum(score.names for score in all_scores if score.shape == shape) >= 5
    assert [score for score in all_scores if score.names and not score.right] == []
    assert [score for score in all_scores if not score.effect and not score.right] == []
