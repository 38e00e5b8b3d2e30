"""The steps of the diagnosis one by one; `tests/blind` judges the whole on data of its own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import f as f_distribution

from calib.diagnosis.aliases import alias_map
from calib.diagnosis.cleaning import Case
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.entries import entries_of
from calib.diagnosis.locate import locate
from calib.diagnosis.problem import Problem, Sitting
from calib.diagnosis.race import Race
from calib.diagnosis.results import Diagnosis
from calib.diagnosis.scan import Reference, gap_p_value, null_scores, scores
from calib.diagnosis.selection import (
    KNOWN,
    Search,
    Spread,
    contained,
    credible_set,
    log_bayes_factor,
    union,
)
from calib.diagnosis.slips import find_slip
from calib.noise import IndicatorFigures
from calib.observations import Observations, observe
from calib.orthoglide.effects import CATALOGUE
from calib.orthoglide.effects.actuators import ActuatorCyclic
from calib.orthoglide.effects.law import Placed
from calib.orthoglide.geometry import Geometry
from calib.orthoglide.model import Model
from calib.simulation import measure
from protocols.events import Opened, Reading
from protocols.machine import Instrument, Machine
from protocols.observations import to_observations
from protocols.procedure import default_mount, load_procedure
from protocols.session import fold

TOLERANCE_MM = np.array([2.0] * 3 + [0.1] * 3)
LAWS = {law.id: law for law in reversed(CATALOGUE)}


def conditions_of(name: str) -> Observations:
    procedure = load_procedure(name, Geometry())
    opened = Opened(
        program="test",
        origin="simulated",
        machine=Machine(),
        procedure=procedure,
        instruments=(Instrument(profile="a"), Instrument(profile="b")),
    )
    readings = [
        Reading(
            reading=k,
            step=step.number,
            leg=step.leg,
            axis=axis,
            displacement_mm=step.displacement_mm,
            value_mm=0.0,
            text="0",
            cycle=step.cycle,
            mount=default_mount(step.leg, axis, step.station),
            station=step.station,
            time_s=20.0 * step.number,
        )
        for k, (step, axis) in enumerate(
            ((s, a) for s in procedure.steps(Geometry()) for a in s.axes), start=1
        )
    ]
    return to_observations([fold([opened, *readings])])


SWEEP, TWO_STATION, SHORT = map(conditions_of, ("sweep", "two-station", "zero-max-min"))


def case(
    taken: Observations,
    *effects: Placed,
    seed: int = 0,
    scatter_mm: float = 0.002,
    model: Model | None = None,
) -> Case:
    generator = np.random.default_rng(seed)
    offsets = np.concatenate([generator.uniform(-2, 2, 3), generator.normal(0, 0.03, 3)])
    truth = Model(parameters_mm=tuple(offsets.tolist()), effects=effects)
    value = measure(truth, taken, scatter_mm=scatter_mm, resolution_mm=0.0, generator=generator)
    return Case(model or Model(), observe(taken, value), IndicatorFigures(), TOLERANCE_MM)


def names(found: Diagnosis) -> list[tuple[str, str]]:
    return [(one.id, one.where) for one in found.effects]


@pytest.mark.parametrize("taken", [SHORT, SWEEP, TWO_STATION])
def test_nothing_missing_agrees_and_says_what_would_have_been_seen(taken: Observations) -> None:
    verdicts = [diagnose([case(taken, seed=seed)], CATALOGUE) for seed in range(6)]
    assert sum(one.verdict == "agrees" for one in verdicts) >= 5
    quiet = next(one for one in verdicts if one.verdict == "agrees")
    assert quiet.effects == ()
    sizes = {one.id: one.size for one in quiet.smallest_detectable}
    assert 0.0 < sizes["backlash"] < 0.1


@pytest.mark.parametrize(
    ("name", "place", "value", "where"),
    [
        ("axis_squareness", "xy", 0.6, "xy"),
        ("backlash", "y", 0.03, "y"),
        ("leg_bow", "xz", 0.05, "xz"),
        ("thermal_drift", "z", 300.0, "z"),
    ],
)
def test_one_effect_is_named_with_place_and_size(
    name: str, place: str, value: float, where: str
) -> None:
    found = diagnose([case(TWO_STATION, Placed(LAWS[name], place, (value,)), seed=3)], CATALOGUE)
    assert found.verdict == "explained"
    assert names(found) == [(name, where)]
    (parameter,) = found.effects[0].parameters
    assert abs(parameter.value - value) < 4.0 * parameter.standard_uncertainty
    assert found.gap_after.rms_mm < 0.7 * found.gap_before.rms_mm
    assert found.gap_after.p_value > 0.01
    assert found.held_out is not None
    assert found.held_out.after_rms_mm < 0.8 * found.held_out.before_rms_mm


def test_look_alikes_are_not_told_apart() -> None:
    """With Zero, Max and Min an offset axis and a tapered bar can be one and the same."""
    found = diagnose([case(SHORT, Placed(LAWS["leg_taper"], "xy", (0.4,)), seed=1)], CATALOGUE)
    assert found.verdict == "ambiguous"
    every = {found.effects[0].id} | {r.id for r in found.effects[0].indistinguishable_from}
    assert "leg_taper" in every
    assert len(every) > 1
    assert found.next_measurement is not None
    assert found.next_measurement.protocol.startswith("schema")


def test_two_effects() -> None:
    both = (Placed(LAWS["axis_squareness"], "xy", (0.8,)), Placed(LAWS["backlash"], "z", (0.03,)))
    found = diagnose([case(TWO_STATION, *both, seed=5)], CATALOGUE)
    assert sorted(names(found)) == [("axis_squareness", "xy"), ("backlash", "z")]
    assert found.verdict == "explained"


def test_sessions_share_effects_and_keep_their_own_offsets() -> None:
    effect = Placed(LAWS["axis_squareness"], "yz", (0.4,))
    sessions = [case(SWEEP, effect, seed=seed) for seed in (1, 2)]
    found = diagnose(sessions, CATALOGUE, held_out=[case(SWEEP, effect, seed=9)])
    assert names(found) == [("axis_squareness", "yz")]
    assert found.held_out is not None
    assert found.held_out.how == "sessions that were not used"
    assert found.held_out.after_rms_mm < 1.3 * found.held_out.noise_rms_mm
    assert found.held_out.before_rms_mm > 2.0 * found.held_out.noise_rms_mm


def test_a_model_that_has_the_effect_agrees() -> None:
    effect = Placed(LAWS["backlash"], "x", (0.05,))
    known = Model(effects=(effect,))
    found = diagnose([case(SWEEP, effect, seed=2, model=known)], CATALOGUE)
    assert found.verdict == "agrees"


def test_an_effect_out_of_the_catalogue_is_not_given_a_name_with_confidence() -> None:
    others = [law for law in CATALOGUE if law.id not in ("backlash",)]
    found = diagnose([case(TWO_STATION, Placed(LAWS["backlash"], "x", (0.05,)))], others)
    assert found.verdict in ("unexplained", "partly-explained")


def test_without_repeats_and_noise_nothing_is_judged() -> None:
    first = SWEEP.take(np.unique(SWEEP.displacement_mm * 10 + SWEEP.mount, return_index=True)[1])
    found = diagnose([case(first, Placed(LAWS["axis_squareness"], "xy", (1.0,)))], CATALOGUE)
    assert found.verdict == "cannot-tell"
    assert found.effects == ()
    assert found.next_measurement is not None


@pytest.mark.parametrize("seed", range(3))
def test_slip_drift_and_wild_readings_are_told_apart(seed: int) -> None:
    clean = case(SWEEP, seed=seed).observed
    rows = np.flatnonzero(clean.mount == 2)
    slipped = clean.value_mm.copy()
    slipped[rows[9:]] += 0.05
    slip = find_slip(replace(clean, value_mm=slipped))
    assert slip is not None
    assert slip.rows[0] == rows[9]
    assert slip.shift_mm == pytest.approx(0.05, abs=0.006)
    wandering = clean.value_mm.copy()
    wandering[rows] += np.linspace(0.0, 0.1, len(rows))
    assert find_slip(replace(clean, value_mm=wandering)) is None
    wild = clean.value_mm.copy()
    wild[rows[9]] += 0.2
    assert find_slip(replace(clean, value_mm=wild)) is None
    assert find_slip(clean) is None


@pytest.mark.parametrize(
    ("change", "name", "where"),
    [
        (lambda v, o: np.where((o.leg == 0) & (o.axis == 1), -v, v), "gauge_sign", "xy"),
        (lambda v, o: np.where((o.leg == 2) & (o.axis == 0), v / 25.4, v), "unit_mixup", "zx"),
    ],
)
def test_blunders_are_named_and_the_data_left_alone(change: object, name: str, where: str) -> None:
    assert callable(change)
    one = case(SWEEP, seed=4)
    wrong = replace(one.observed, value_mm=change(one.observed.value_mm, one.observed))
    before = wrong.value_mm.copy()
    found = diagnose([replace(one, observed=wrong)], CATALOGUE)
    assert (found.effects[0].id, found.effects[0].where) == (name, where)
    assert found.effects[0].gap_rms_after_mm < 0.1 * found.effects[0].gap_rms_before_mm
    assert np.array_equal(wrong.value_mm, before)


def problem(taken: Observations, seed: int) -> Problem:
    one = case(taken, seed=seed)
    return Problem.of([Sitting.of(one.model, one.observed, one.indicator, one.tolerance_mm)])


def test_gap_of_pure_noise_is_chi_squared() -> None:
    """Mean of gap / freedom over many sessions is 1 within its own scatter."""
    ratio = []
    for seed in range(60):
        made = problem(SWEEP, seed)
        ratio.append(made.gap(made.y) / made.structure_df)
    free = problem(SWEEP, 0).structure_df
    spread = math.sqrt((2.0 / free + 2.0 / 48.0) / len(ratio))
    assert np.mean(ratio) == pytest.approx(1.0, abs=4.0 * spread + 0.05)


@pytest.mark.parametrize("rank", [1, 2, 6])
@pytest.mark.parametrize("noise_df", [12.0, 144.0, math.inf])
def test_log_scores_against_scipy(rank: int, noise_df: float) -> None:
    squares = np.geomspace(0.01, 400.0, 40)[None, :]
    found = scores(squares, [rank], Reference(noise_df, 60), np.full(40, 1e9))[0]
    df2 = 1e9 if math.isinf(noise_df) else noise_df
    expected = f_distribution.logsf(squares[0] / rank, rank, df2)
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=0.02)


@pytest.mark.parametrize("uneven", [False, True])
def test_global_p_value_is_uniform_on_noise(*, uneven: bool) -> None:
    """Also where half of the readings scatter three times as much as the others."""
    generator = np.random.default_rng(0)
    blocks = [np.linalg.qr(generator.normal(size=(40, r)))[0] for r in (1, 1, 2, 3, 1, 6)]
    deviation = np.where(np.arange(40) < 20, 0.45, 1.34) if uneven else np.ones(40)
    reference = Reference(30.0, 40)
    null = null_scores(blocks, reference, 1, deviation)
    found = []
    for _ in range(400):
        y = deviation * generator.normal(size=40)
        square = np.array([((b.T @ y) ** 2).sum() for b in blocks])[:, None]
        square = square / (generator.chisquare(30.0) / 30.0)
        local = scores(square, [b.shape[1] for b in blocks], reference, np.array([1e9]))
        found.append(null.p_value(float(local.min())))
    assert np.mean(np.array(found) <= 0.1) == pytest.approx(0.1, abs=0.06)
    assert np.mean(np.array(found) <= 0.5) == pytest.approx(0.5, abs=0.1)


def test_unevenness_is_seen_where_stands_scatter_differently() -> None:
    assert (problem(SWEEP, 3).unevenness() == 1.0).all()
    one = case(SWEEP, seed=3)
    scatter = np.array([0.0, 0.0, 0.0, 0.01, 0.01, 0.01])[one.observed.mount]
    value = one.observed.value_mm + scatter * np.random.default_rng(3).normal(size=len(scatter))
    uneven = replace(one.observed, value_mm=value)
    own = Problem.of([Sitting.of(one.model, uneven, one.indicator, one.tolerance_mm)])
    seen = own.unevenness()
    assert seen[own.mount >= 3].min() > 1.3 * seen[own.mount < 3].max()


def test_evidence_and_sets() -> None:
    assert log_bayes_factor(3.0, 4, KNOWN) == 0.0
    assert log_bayes_factor(40.0, 1, KNOWN) == pytest.approx(0.5 * 39.0 - 0.5 * math.log(40.0))
    assert log_bayes_factor(40.0, 1, Spread(92.0, 52.0)) < log_bayes_factor(40.0, 1, KNOWN)
    assert log_bayes_factor(3.0, 4, Spread(52.0, 52.0)) == 0.0
    assert log_bayes_factor(3.0, 4, Spread(3.0, 4.0)) == 0.0
    generator = np.random.default_rng(1)
    blocks = tuple(np.linalg.qr(generator.normal(size=(50, 1)))[0] for _ in range(5))
    search = Search(20.0 * blocks[2][:, 0], blocks, KNOWN, np.zeros(5), (1,) * 5)
    best = credible_set(search.singles())
    assert best[0].members == (2,)
    assert sum(m.share for m in best) >= 0.95
    twins = Search(20.0 * blocks[2][:, 0], (*blocks, -blocks[2]), KNOWN, np.zeros(6), (1,) * 6)
    assert {m.members for m in credible_set(twins.singles())} == {(2,), (5,)}
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
    assert log_bayes_factor(explained, rank, spread) == pytest.approx(tried.max(), abs=1e-6)


def test_a_rival_pays_for_what_it_leaves_however_large_the_effect() -> None:
    """What counts is how much more is left, not its share of what is explained."""
    for explained in (100.0, 1000.0, 10000.0):
        spread = Spread(explained + 120.0, 126.0)
        less, more = (log_bayes_factor(s, 1, spread) for s in (explained - 30.0, explained))
        assert more - less == pytest.approx(spread.log_ratio(explained, explained - 30.0), abs=0.5)
        assert more - less > 10.0


def test_a_near_alias_is_a_rival_of_a_small_effect_and_none_of_a_large_one() -> None:
    """Sag has 99 % of the direction of scale: a matter of size, not of the procedure alone."""

    def with_scale(value: float) -> Diagnosis:
        effect = Placed(LAWS["actuator_scale"], "x", (value,))
        return diagnose([case(TWO_STATION, effect, seed=1)], CATALOGUE)

    small, large = with_scale(0.3), with_scale(6.0)
    (doubtful,) = small.effects
    every = {doubtful.id} | {rival.id for rival in doubtful.indistinguishable_from}
    assert small.verdict == "ambiguous"
    assert {"actuator_scale", "gravity_sag"} <= every
    assert large.verdict == "explained"
    assert names(large) == [("actuator_scale", "x")]


def test_the_fewest_causes_are_kept() -> None:
    """One place before three with values of their own, whichever fits better by chance."""
    made = problem(TWO_STATION, 0)
    entries = {(e.id, e.where): e for e in entries_of(made, CATALOGUE)}
    one, every = (entries["axis_offset", where] for where in ("x", "x,y,z"))
    few, many = made.block(one.columns), made.block(every.columns)
    further = many @ np.linalg.svd(few.T @ many)[2][-1]
    assert np.abs(few.T @ further).max() < 1e-6
    moved = replace(made, y=made.y + 30.0 * few[:, 0] + (3.2 - further @ made.y) * further)
    kept = [
        Race(moved, (few, many), np.zeros(2), causes, 1).run().kept
        for causes in ((one.causes, every.causes), (1, 1))
    ]
    assert [model.members for model in kept if model] == [(0,), (1,)]


def test_two_effects_do_not_pass_for_one_in_every_place() -> None:
    """Six tapers can imitate nearly every pair of effects on the bars."""
    pair = Placed(LAWS["gauge_gain"], "yx", (2.0,)), Placed(LAWS["axis_squareness"], "xy", (0.7,))
    found = diagnose([case(SWEEP, *pair, seed=1)], CATALOGUE)
    named = {name for name, _ in names(found)}
    rivals = {r.id for one in found.effects for r in one.indistinguishable_from}
    assert {"gauge_gain", "axis_squareness"} <= named | rivals
    assert ("leg_taper", "x,y,z") not in names(found)


def test_two_leads_of_one_screw_are_terms_of_a_series() -> None:
    both = [
        Placed(law, "y", (0.0, 30.0))
        for law in CATALOGUE
        if isinstance(law, ActuatorCyclic) and law.lead_mm in (5.0, 20.0)
    ]
    one, two = (diagnose([case(SWEEP, *some, seed=2)], CATALOGUE) for some in (both[:1], both))
    assert (one.verdict, names(one)) == ("explained", [("actuator_cyclic", "y")])
    assert (two.verdict, names(two)) == ("ambiguous", [("actuator_cyclic", "y")] * 2)


def test_causes_of_an_entry() -> None:
    made = problem(TWO_STATION, 0)
    causes = {(e.id, e.where): e.causes for e in entries_of(made, CATALOGUE)}
    assert causes["gauge_gain", "x"] == 2
    assert causes["gauge_gain", "x,y,z"] == 6
    assert causes["leg_taper", "x,y,z"] == causes["axis_squareness", "xy,yz,xz"] == 3
    assert causes["gauge_gain", "xy"] == causes["leg_taper", "x"] == 1
    assert causes["thermal_drift", "x,y,z"] == causes["leg_taper", "all"] == 1


def test_chance_of_a_gap() -> None:
    assert gap_p_value(10.0, 0, 12.0) == 1.0
    assert gap_p_value(100.0, 10, math.inf) < 1e-10
    assert gap_p_value(10.0, 10, 40.0) == pytest.approx(f_distribution.sf(1.0, 10, 40))


def test_where_points_at_the_leg_and_the_direction() -> None:
    made = case(TWO_STATION, Placed(LAWS["leg_bow"], "xy", (0.15,)), seed=6)
    shares = locate(
        Problem.of([Sitting.of(made.model, made.observed, made.indicator, made.tolerance_mm)])
    )
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


def test_ten_thousand_readings_stay_near_linear() -> None:
    """Many cycles: the work is done on arrays; no step grows with the square of the readings."""
    cycles = 36
    many = TWO_STATION.take(np.tile(np.arange(len(TWO_STATION)), cycles))
    many = replace(many, cycle=np.repeat(np.arange(cycles), len(TWO_STATION)))
    assert len(many) == 9936
    found = diagnose([case(many, scatter_mm=0.002)], CATALOGUE)
    assert found.verdict == "agrees"
