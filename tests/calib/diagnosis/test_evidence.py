"""How explanations are weighed: evidence, rivals, causes, place, aliases."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import squares_in, union
from calib.diagnosis.gap import locate
from calib.diagnosis.hypotheses import alias_map, causes_of, hypotheses_of
from calib.diagnosis.model_selection import ModelSelection
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import Problem
from calib.diagnosis.selection import (
    KNOWN,
    CandidateSearch,
    Spread,
    contained,
    credible_set,
    evidence,
)
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model
from tests.calib.diagnosis.diagnosed_sessions import LAWS, SHORT, TWO_STATION, case, problem


def test_evidence_and_sets() -> None:
    assert evidence(3.0, 4, KNOWN) == 0.0
    assert evidence(40.0, 1, KNOWN) == pytest.approx(0.5 * 39.0 - 0.5 * math.log(40.0))
    assert evidence(40.0, 1, Spread(92.0, 52.0)) < evidence(40.0, 1, KNOWN)
    assert evidence(3.0, 4, Spread(52.0, 52.0)) == 0.0
    assert evidence(3.0, 4, Spread(3.0, 4.0)) == 0.0
    generator = np.random.default_rng(1)
    blocks = tuple(np.linalg.qr(generator.normal(size=(50, 1)))[0] for _ in range(5))
    search = CandidateSearch(20.0 * blocks[2][:, 0], blocks, KNOWN, np.zeros(5))
    best = credible_set(search.singles)
    assert best[0].members == (2,)
    assert len(best) == 1
    twins = CandidateSearch(20.0 * blocks[2][:, 0], (*blocks, -blocks[2]), KNOWN, np.zeros(6))
    assert {m.members for m in credible_set(twins.singles)} == {(2,), (5,)}
    assert contained(blocks[2], -blocks[2]) == pytest.approx(1.0)
    assert union([blocks[0], blocks[0]]).shape[1] == 1


@pytest.mark.parametrize(("explained", "rank"), [(30.0, 1), (500.0, 2), (2000.0, 6)])
def test_evidence_with_unknown_noise_is_the_best_over_all_prior_widths(
    explained: float, rank: int
) -> None:
    """Zellner's g-prior integrated over the variance, g tried on a grid (Liang et al. 2008)."""
    spread = Spread(explained + 120.0, 126.0)
    width = np.geomspace(1e-3, 1e5, 200_001)
    free = spread.freedom - rank
    tried = 0.5 * free * np.log1p(width) - 0.5 * spread.freedom * np.log1p(
        width * 120.0 / spread.total
    )
    assert evidence(explained, rank, spread) == pytest.approx(tried.max(), abs=1e-6)


def test_a_rival_pays_for_what_it_leaves_however_large_the_effect() -> None:
    """What counts is how much more is left, not its share of what is explained."""
    for explained in (100.0, 1000.0, 10000.0):
        spread = Spread(explained + 120.0, 126.0)
        less, more = (evidence(s, 1, spread) for s in (explained - 30.0, explained))
        assert more - less == pytest.approx(spread.log_ratio(explained, explained - 30.0), abs=0.5)
        assert more - less > 10.0


def test_the_fewest_causes_are_kept() -> None:
    """One place before three with values of their own, whichever fits better by chance."""
    made = problem(TWO_STATION, 0)
    entries = {(e.id, e.where): e for e in hypotheses_of(made, CATALOGUE)}
    one, every = (entries["axis_offset", where] for where in ("x", "xy,yz,zx"))
    few, many = made.blocks([one.columns, every.columns])
    further = many @ np.linalg.svd(few.T @ many)[2][-1]
    assert np.abs(few.T @ further).max() < 1e-6
    moved = replace(made, y=made.y + 30.0 * few[:, 0] + (3.2 - further @ made.y) * further)
    shared = replace(every, arrangement="same")
    kept = [
        ModelSelection(moved, [one, other], [few, many], np.zeros(2)).run().kept
        for other in (every, shared)
    ]
    assert [model.members for model in kept if model] == [(0,), (1,)]


def test_one_and_many_at_once_are_weighed_alike() -> None:
    made = problem(TWO_STATION, 0)
    selection = ModelSelection.of(made, hypotheses_of(made, CATALOGUE))
    search = selection.search
    assert len({block.shape[1] for block in search.blocks}) > 2
    for one in search.singles:
        assert search.weighed(one.members).log_weight == pytest.approx(one.log_weight)
    columns = np.hstack([one.columns for one in selection.candidates[:20]])
    (block,) = made.blocks([columns])
    explained, rank = made.explained_by(columns)
    assert rank == block.shape[1] < columns.shape[1]
    assert explained == pytest.approx(squares_in(block, made.y))


def test_the_limit_of_a_chance_spares_draws_and_decides_alike() -> None:
    made = problem(TWO_STATION, 1)
    selection = ModelSelection.of(made, hypotheses_of(made, CATALOGUE))
    limit, local = selection.step(())
    drawn, again = selection.step((), drawn=True)
    assert limit == pytest.approx(math.exp(float(local.min())))
    assert POLICY.naming_level < limit < drawn
    assert local.tolist() == again.tolist()
    strong = replace(made, y=made.y + 8.0 * selection.blocks[0][:, 0])
    found = ModelSelection.of(strong, selection.candidates)
    assert found.step(())[0] == found.step((), drawn=True)[0]
    assert found.step(())[0] <= POLICY.naming_level


def test_causes_of_an_entry() -> None:
    made = problem(TWO_STATION, 0)
    causes = {(e.id, e.where): causes_of(e) for e in hypotheses_of(made, CATALOGUE)}
    assert causes["gauge_gain", "x"] == 2
    assert causes["gauge_gain", "x,y,z"] == 6
    assert causes["leg_taper", "x,y,z"] == causes["axis_squareness", "xy,yz,xz"] == 3
    assert causes["gauge_gain", "xy"] == causes["leg_taper", "x"] == 1
    assert causes["thermal_drift", "x,y,z"] == causes["leg_taper", "all"] == 1


def test_where_points_at_the_leg_and_the_direction() -> None:
    made = case(TWO_STATION, EffectInstance(LAWS["leg_bow"], "xy", (0.15,)), seed=6)
    shares = locate(Problem.of([made.fitted()]))
    first = next(s for s in shares if s.leg and s.axis)
    assert (first.leg, first.axis) == ("x", "y")
    assert sum(s.share for s in shares if s.leg and s.axis) == pytest.approx(1.0)


def test_aliases_need_no_data() -> None:
    short, long = (
        alias_map(Model(parameters_mm=(1.0, -0.8, 0.6, 0.03, -0.02, 0.01)), taken, CATALOGUE)
        for taken in (SHORT, TWO_STATION)
    )
    assert len(short.imitations) > len(long.imitations)
    assert any(one.distinguishable < 9.0 for one in short.imitations)
