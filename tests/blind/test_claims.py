"""A quick part of the page of claims: the tool keeps its bound on machines with hidden effects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.blind.claims import effect_cases, plain_cases, scored
from tests.blind.forward import Hidden
from tests.blind.tool import rms_mm, tool_errors_mm

SEED = 6


def test_the_true_tool_of_the_bench_is_that_of_its_own_kinematics() -> None:
    """A perfect machine is where it was sent; 0.1 mm on every joint moves it by about as much."""
    nothing = np.zeros(3)
    assert rms_mm(tool_errors_mm(Hidden(), nothing, nothing)) < 1e-9
    off = Hidden().plus([(("offset", (leg,)), 0.1) for leg in range(3)])
    assert rms_mm(tool_errors_mm(off, nothing + 0.1, nothing)) < 1e-9
    assert 0.15 < rms_mm(tool_errors_mm(off, nothing, nothing)) < 0.2


def test_the_tool_keeps_its_bound(tmp_path: Path) -> None:
    """28 sessions at 93 %: fewer than 23 happens in 1.3 % of runs."""
    found = [scored(case, SEED, tmp_path) for case in list(effect_cases(1))[::6]]
    assert sum(one.holds for one in found) >= 23
    assert np.median([one.bound_mm / one.true_mm for one in found]) <= 3.0


def test_offsets_are_claimed_with_the_tolerance_of_the_bars(tmp_path: Path) -> None:
    """54 intervals at 95 %: fewer than 47 happens in 1 % of runs.

    Noise alone holds few where the bars are held as they are, of which the difference is told; a
    set with lengths, or held by tolerances, has their share in its own figures.
    """
    found = [scored(case, SEED, tmp_path, 0.1) for case in plain_cases(6)]
    off = np.abs([one.off_mm for one in found])
    assert (off <= [one.expanded_mm for one in found]).sum() >= 47
    told = [one for one in found if one.difference_mm is not None]
    assert told
    noise_only = [np.abs(one.off_mm) <= one.noise_only_mm for one in told]
    assert np.sum(noise_only) <= 0.25 * np.size(noise_only)
    for one in found:
        if one.difference_mm is None:
            assert one.noise_only_mm == pytest.approx(one.expanded_mm, rel=1e-6)
    kept = [np.abs(one.difference_off_mm) <= one.difference_mm for one in told]
    assert np.sum(kept) >= 0.85 * np.size(kept)
