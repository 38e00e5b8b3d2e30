"""What is claimed and what is not: rivals, single readings, monsters, large effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import FloatArray
from calib.diagnosis.attribution import Attribution
from calib.diagnosis.diagnose import diagnose, sentence
from calib.diagnosis.hypotheses import hypotheses_of, log_choices, losses
from calib.diagnosis.model_selection import ModelSelection
from calib.diagnosis.problem import Problem
from calib.diagnosis.results import Named
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.candidates import Candidate
from calib.tripod.effects.effect import EffectInstance
from tests.calib.diagnosis.diagnosed_sessions import (
    LAWS,
    SHORT,
    SWEEP,
    TWO_STATION,
    case,
    names,
    problem,
)


@pytest.mark.parametrize("seed", range(4))
def test_two_indicators_are_a_rival_of_one_bar(seed: int) -> None:
    """Both indicators of a leg askew do what the shape of one bar does."""
    tilts = [
        EffectInstance(LAWS["gauge_tilt"], place, (v,))
        for place, v in (("yx", 30.0), ("yz", -40.0))
    ]
    found = diagnose([case(SWEEP, *tilts, seed=seed)], CATALOGUE)
    possible = {one.id for one in found.effects}
    possible |= {rival.id for one in found.effects for rival in one.indistinguishable_from}
    assert "gauge_tilt" in possible


def test_six_indicators_that_all_differ_are_one_name() -> None:
    gains = (7.0, -2.6, -3.7, -3.6, 3.2, 7.0)
    places = ("xy", "xz", "yx", "yz", "zx", "zy")
    effects = [
        EffectInstance(LAWS["gauge_gain"], p, (g,)) for p, g in zip(places, gains, strict=True)
    ]
    found = diagnose([case(TWO_STATION, *effects, seed=2, scatter_mm=0.0002)], CATALOGUE)
    assert found.verdict == "explained"
    assert names(found) == [("gauge_gain", "x,y,z")]
    assert found.gap_after.p_value > 0.01
    # All six together are a longer machine: only the tolerance of the lengths tells how much.
    said = found.effects[0].parameters
    assert all(one.standard_uncertainty > 3.0 for one in said)
    off = np.array([one.value for one in said]) - gains
    assert np.ptp(off) < 0.2 * said[0].standard_uncertainty


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_a_large_effect_is_followed_beyond_its_derivatives(seed: int) -> None:
    """Six milliradians beside 0.2 µm of noise: squares of the lean are many times that."""
    lean = EffectInstance(LAWS["axis_squareness"], "xz", (6.0,))
    found = diagnose([case(TWO_STATION, lean, seed=seed, scatter_mm=0.0002)], CATALOGUE)
    assert names(found) == [("axis_squareness", "xz")]
    assert found.verdict == "explained"
    (value,) = found.effects[0].parameters
    assert abs(value.value - 6.0) < 4.0 * value.standard_uncertainty
    assert found.gap_after.p_value > 0.01


def test_sizes_that_only_each_other_call_for_cost() -> None:
    """Two columns that nearly cancel: small alone, huge together."""
    made = problem(TWO_STATION, 0)
    entries = [e for e in hypotheses_of(made, CATALOGUE) if (e.id, e.where) == ("backlash", "x")]
    entries = [entries[0], entries[0]]
    other = np.cos(np.arange(len(made.y)))[:, None]
    nearly = replace(entries[1], columns=entries[0].columns + 1e-6 * other)
    pair = [entries[0], nearly]
    odd = made.root_weight[:, None] * other
    y = 100.0 * odd[:, 0] / np.linalg.norm(odd)
    moved = replace(made, y=made.whitening(y))
    blocks = moved.blocks([e.columns for e in pair])
    selection = ModelSelection(moved, pair, blocks, log_choices(pair))
    assert losses(moved, [pair[:1], pair[1:]]).max() < 1.0
    assert selection.far_together((0, 1)) > 10.0
    assert selection.far_together((0,)) == 0.0


def attributed(made: Problem, one: Candidate) -> Attribution:
    """With a single candidate, that is kept."""
    selection = ModelSelection(made, [one], made.blocks([one.columns]), np.zeros(1))
    found = Attribution(selection, selection.run())
    assert found.outcome.members == (0,)
    return found


def without_a_row(one: Problem, columns: FloatArray, row: int) -> float:
    """Squares that columns explain where a row is really taken out, by generalised least squares.

    The covariance is noise and what lengths of their tolerance do.
    """
    keep = np.arange(len(one.y)) != row
    held = one.bars[keep]
    root = np.linalg.cholesky(np.eye(len(held)) + held @ held.T)

    def left(design: FloatArray) -> float:
        white, y = np.linalg.solve(root, design[keep]), np.linalg.solve(root, one.residual[keep])
        x = np.linalg.lstsq(white, y, rcond=1e-10)[0]
        return float(((y - white @ x) ** 2).sum())

    base = np.hstack([one.zeros, one.offsets])
    base = base / np.linalg.norm(base, axis=0)
    return left(base) - left(np.hstack([base, columns / np.linalg.norm(columns, axis=0)]))


def with_more(one: Problem, white: FloatArray) -> Problem:
    """More in its readings."""
    return replace(one, y=one.y + one.whitening(white), residual=one.residual + white)


def test_evidence_without_any_one_reading_is_that_of_fits_without_it() -> None:
    made = case(SWEEP, EffectInstance(LAWS["backlash"], "y", (0.006,)), seed=8)
    one = Problem.of([made.fitted()])
    entries = [e for e in hypotheses_of(one, CATALOGUE) if (e.id, e.where) == ("backlash", "y")]
    naming = attributed(one, entries[0])
    columns = one.root_weight[:, None] * entries[0].columns
    least = min(without_a_row(one, columns, row) for row in range(len(one.y)))
    assert naming.without_any_one(0) == pytest.approx(least - 1.0, rel=1e-6)
    assert naming.without_any_one(0) < naming.evidence(0)


def test_one_reading_gives_no_name() -> None:
    """Evidence of an effect that only one reading shows is gone without it."""
    one = problem(SWEEP, 3)
    row = int(np.argmax(one.whitening.seen_alone))
    spike = np.zeros((len(one.y), 1))
    spike[row] = 1.0
    moved = with_more(one, 9.0 * spike[:, 0])
    entry = replace(hypotheses_of(one, CATALOGUE)[0], columns=spike / one.root_weight[row])
    naming = attributed(moved, entry)
    assert naming.evidence(0) > 25.0
    assert naming.without_any_one(0) < 0.0
    assert naming.doubt == "the evidence depends on a single reading"


def test_the_first_sentence_stays_a_sentence() -> None:
    found = diagnose(
        [case(SWEEP, EffectInstance(LAWS["gauge_tilt"], "xy", (9.0,)), seed=1)], CATALOGUE
    )
    many = tuple(Named(f"name_{k}", "x") for k in range(9))
    finding = replace(found.effects[0], indistinguishable_from=many)
    said = sentence("ambiguous", [finding], "", "")
    assert "name_0, name_1, name_2, name_3, 5 others. These readings cannot decide." in said
    plain = replace(finding, indistinguishable_from=())
    assert sentence("ambiguous", [plain], "", "the evidence is weak").endswith("is weak.")


def test_one_direction_that_one_reading_carries_is_not_the_whole_evidence() -> None:
    """Of two directions one stands on a single reading, the other on all of them."""
    one = problem(SWEEP, 3)
    row = int(np.argmax(one.whitening.seen_alone))
    columns = np.zeros((len(one.y), 2))
    columns[row, 0] = 1.0
    columns[:, 1] = np.cos(1.7 * np.arange(len(one.y)))
    moved = with_more(one, columns @ np.array([3.0, 2.5]))
    entry = replace(hypotheses_of(one, CATALOGUE)[0], columns=columns / one.root_weight[:, None])
    naming = attributed(moved, entry)
    least = min(without_a_row(moved, columns, k) for k in range(len(one.y)))
    assert least > 100.0
    assert naming.without_any_one(0) == pytest.approx(least - 2.0, rel=1e-4)


def test_own_errors_of_postures_explain_any_shape_and_cost_their_freedom() -> None:
    """Liang et al. (2008), equation 5, written out: one mean for each posture of each mounting."""
    made = case(SHORT, EffectInstance(LAWS["backlash"], "y", (0.05,)), seed=8)
    one = Problem.of([made.fitted()])
    keys = one.mount * 100 + one.conditions("level")
    columns = one.root_weight[:, None] * np.equal.outer(keys, np.unique(keys))
    rank = columns.shape[1] - one.whitening.free.shape[1]
    white = one.whitening(columns)
    s = float(one.y @ white @ np.linalg.lstsq(white, one.y, rcond=1e-9)[0])
    t, f = one.gap(one.y) + one.noise_df, one.structure_df + one.noise_df
    ratio = (s / rank) / ((t - s) / (f - rank))
    shrunk = 1.0 + (ratio - 1.0) * (1.0 - s / t)
    expected = 0.5 * (f - rank) * np.log(ratio) - 0.5 * f * np.log(shrunk)
    selection = ModelSelection(one, [], [], np.zeros(0))
    assert selection.own_errors("level") == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("ahead", "claimed"), [(7.1, True), (6.9, False)])
def test_a_name_must_be_far_ahead_of_own_errors(ahead: float, claimed: bool) -> None:
    made = case(TWO_STATION, EffectInstance(LAWS["backlash"], "y", (0.006,)), seed=8)
    one = Problem.of([made.fitted()])
    entries = [e for e in hypotheses_of(one, CATALOGUE) if (e.id, e.where) == ("backlash", "y")]
    naming = attributed(one, entries[0])
    assert naming.outcome.kept is not None
    weight = naming.selection.own_errors("level") + ahead
    kept = replace(naming.outcome.kept, log_weight=weight)
    moved = Attribution(naming.selection, replace(naming.outcome, kept=kept))
    assert (moved.verdict(mistakes_found=False) == "explained") == claimed
    assert moved.doubt.startswith("" if claimed else "an unknown error")
