"""What offsets, zeros and leg lengths may absorb: covariances written out, published sessions."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.diagnosis import diagnose_files
from calib.arrays import Observations, observe
from calib.diagnosis.gap import Leftover
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import Cells, SessionCase
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model, measure
from tests.calib.diagnosis.diagnosed_sessions import (
    LAWS,
    SHORT,
    SWEEP,
    TOLERANCE_MM,
    TWO_STATION,
    diagnose,
    names,
    possible,
)
from tests.conftest import LONG, first_quick

SAMPLES = Path(__file__).parents[3] / "sample_sessions"
USUAL = (0.5, -1.0, 1.2)
Triple = tuple[float, float, float]


def session(
    observations: Observations,
    lengths_mm: Triple,
    *effects: EffectInstance,
    offsets_mm: Triple = USUAL,
    seed: int = 0,
) -> SessionCase:
    """Of a machine with these bars, noise 2 µm."""
    truth = Model(parameters_mm=(*offsets_mm, *lengths_mm), effects=effects)
    value = measure(truth, observations, scatter_mm=0.002, resolution_mm=0.0, generator=seed)
    figures = IndicatorFigures(repeatability_mm=0.002)
    return SessionCase(Model(), observe(observations, value), figures, TOLERANCE_MM)


def test_with_bars_of_their_tolerance_nothing_is_missing() -> None:
    generator = np.random.default_rng(5)
    ratio = []
    for seed in range(40):
        x, y, z = (0.1 * generator.standard_normal(3)).tolist()
        gap = Leftover.of([Cells.of(session(TWO_STATION, (x, y, z), seed=seed))]).gap()
        ratio.append(gap.chi_square / gap.degrees_of_freedom)
    spread = np.sqrt(2.0 / gap.degrees_of_freedom)
    assert np.mean(ratio) == pytest.approx(1.0, abs=4.0 * spread / np.sqrt(40))


@pytest.mark.parametrize(
    ("name", "freedom", "least_mm"),
    first_quick(
        [
            ("experiment_1_six", 3, 0.3),
            ("experiment_2_six", 3, 0.08),
            ("experiment_3_six", 3, 0.08),
            ("experiment_2_twelve", 9, 0.08),
            ("experiment_3_twelve", 9, 0.08),
        ],
        several=True,
    ),
)
def test_published_gaps_are_not_closed_by_bars_of_metres(
    name: str, freedom: int, least_mm: float
) -> None:
    gap = diagnose_files([SAMPLES / f"{name}.jsonl"]).diagnosis.gap_before
    assert gap.degrees_of_freedom == freedom
    assert gap.rms_mm > least_mm
    assert gap.p_value < 1e-6


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_bars_off_by_three_tolerances_make_no_other_name(seed: int) -> None:
    for observations in (SWEEP, TWO_STATION):
        diagnosis = diagnose([session(observations, (0.3, -0.3, 0.3), seed=seed)], CATALOGUE)
        assert {name for name, _ in names(diagnosis)} <= {"leg_length"}


def test_a_bar_of_another_length_is_named_with_its_size() -> None:
    diagnosis = diagnose([session(TWO_STATION, (1.5, 0.02, -0.05), seed=1)], CATALOGUE)
    assert names(diagnosis) == [("leg_length", "x")]
    (length,) = diagnosis.effects[0].parameters
    assert abs(length.value - 1.5) < 4.0 * length.standard_uncertainty


@LONG
@pytest.mark.parametrize("place", ["x", "y", "z"])
def test_a_wrong_scale_is_seen_beside_bars_of_their_tolerance(place: str) -> None:
    scale = EffectInstance(LAWS["actuator_scale"], place, (0.5,))
    diagnosis = diagnose([session(TWO_STATION, (0.05, -0.05, 0.02), scale, seed=7)], CATALOGUE)
    assert ("actuator_scale", place) in possible(diagnosis)


def test_all_scales_alike_are_another_size_of_machine() -> None:
    """Lengths free they agree: a similar machine. Bars of their tolerance cannot follow."""
    scales = [EffectInstance(LAWS["actuator_scale"], place, (3.0,)) for place in "xyz"]
    diagnosis = diagnose([session(TWO_STATION, (0.05, -0.05, 0.02), *scales)], CATALOGUE)
    assert diagnosis.verdict == "ambiguous"
    assert {("actuator_scale", "all"), ("leg_length", "all")} <= possible(diagnosis)


def test_lengths_found_in_two_sessions_serve_a_third() -> None:
    bars = (0.25, -0.2, 0.3)
    several = [session(SHORT, bars, offsets_mm=(k, -k, 0.5 * k), seed=k) for k in range(3)]
    cells = [Cells.of(item) for item in several]
    alone, former = Leftover.of(cells[2:]), Leftover.of(cells[:2])
    with_bars = Leftover.of(cells[2:], bars=former.bars())
    assert with_bars.gap().chi_square < alone.gap().chi_square
    # as much less as the three have in common beyond the two, but for squares of 0.3 mm
    together = Leftover.of(cells).gap().chi_square
    total = former.gap().chi_square + with_bars.gap().chi_square
    assert together == pytest.approx(total, rel=2e-4)


@LONG
def test_sessions_of_different_bars_are_told() -> None:
    bars: tuple[Triple, ...] = ((0.1, -0.1, 0.05), (-0.6, -0.5, 0.7))
    sessions = [session(TWO_STATION, bar, seed=k) for k, bar in enumerate(bars)]
    diagnosis = diagnose(sessions, CATALOGUE)
    assert names(diagnosis) == [("other_bars", "session 2")]
    assert "diagnose the sessions one at a time" in diagnosis.effects[0].title


def test_an_offset_entered_wrong_by_centimetres_is_no_effect() -> None:
    diagnosis = diagnose(
        [session(SWEEP, (0.1, -0.1, 0.05), offsets_mm=(31.0, 1.0, -0.5))], CATALOGUE
    )
    assert diagnosis.verdict == "agrees"
    (remark,) = diagnosis.remarks
    assert remark.startswith("the joint offset of x comes out +3")
    assert "the machine file allows 2 mm" in remark


def test_one_posture_tells_nothing() -> None:
    at_zero = SHORT.take(np.flatnonzero(SHORT.displacement_mm == 0.0))
    diagnosis = diagnose([session(at_zero, (0.1, -0.1, 0.05))], CATALOGUE)
    assert diagnosis.verdict == "cannot-tell"
    assert any("measure others too" in remark for remark in diagnosis.remarks)


def driven_again(observations: Observations, times: int) -> Observations:
    """The same session, every cycle of it driven so many times."""
    many = observations.take(np.tile(np.arange(len(observations)), times))
    turn = np.repeat(np.arange(times), len(observations))
    later = turn * (observations.time_s.max() + 20.0)
    cycle = many.cycle + turn * observations.cycle.max()
    many = replace(many, cycle=cycle, time_s=many.time_s + later)
    return many.take(np.argsort(many.mount, kind="stable"))


def test_ten_times_the_readings_take_about_ten_times_as_long() -> None:
    seconds = []
    for times in (4, 12):
        data = session(driven_again(TWO_STATION, times), (0.1, -0.1, 0.05))
        start = time.process_time()
        assert diagnose([data], CATALOGUE).verdict == "agrees"
        seconds.append(time.process_time() - start)
    assert seconds[1] < 5.0 * seconds[0]  # three times the readings


@pytest.mark.parametrize("tolerance_mm", [1e-9, 100.0])
def test_lengths_without_tolerance_and_with_decimetres_stay_finite(tolerance_mm: float) -> None:
    """The smallest and the largest that a machine file may state; bars are as they should be."""
    data = session(SWEEP, (0.0, 0.0, 0.0))
    with_limits = replace(data, tolerance_mm=np.array([2.0] * 3 + [tolerance_mm] * 3))
    diagnosis = diagnose([with_limits], CATALOGUE)
    assert diagnosis.verdict == "agrees"
    assert np.isfinite(
        [diagnosis.gap_before.rms_mm, *(effect.size for effect in diagnosis.smallest_detectable)]
    ).all()
