"""What is missing in a Hexa Slide's model, named against hidden machines of the blind bench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.arrays import FloatArray
from calib.errors import NotIdentifiable
from calib.hexaslide.correction import correction_of
from calib.hexaslide.diagnosis import weighed
from calib.hexaslide.residuals import Readings
from protocols.hexaslide import load_hexaslide
from tests.blind.hexaslide import (
    LEAD_M,
    NOISE_RAD,
    POSTURES,
    Hidden,
    Plain,
    case,
    diagnosed,
    measured,
)
from tests.blind.hexaslide_correction import off_mm
from tests.conftest import LONG

FILE = load_hexaslide()
SEEN = (
    Hidden("rail_scale", 2, 1.5e-3),
    Hidden("backlash", 1, 8e-5),
    Hidden("rail_wave", 4, 8e-5, 1.0),
    Hidden("thermal_growth", 0, 3e-4),
    Hidden("wrong_posture", 7, 3e-3),
)
NOTHING = Hidden(None)


@LONG
@pytest.mark.parametrize("kind", POSTURES)
@pytest.mark.parametrize("what", SEEN, ids=lambda what: what.cause)
def test_what_shows_is_named_with_its_size(kind: str, what: Hidden) -> None:
    chance = np.random.default_rng(22)
    readings = measured(Plain(FILE, chance), FILE, kind, what, chance)
    tolerances = FILE.tolerances.of(readings.procedure.parameters)
    diagnosis = diagnosed(readings, FILE.whole(), tolerances, LEAD_M)
    assert tuple(cause for claim in diagnosis.named for cause in claim.causes) == what.truth
    assert diagnosis.verdict == "explained"
    assert diagnosis.p_before < 0.05
    assert diagnosis.p_after > 1e-3
    if what.cause in ("rail_scale", "backlash"):
        (size,) = diagnosis.sizes
        assert size.value == pytest.approx(1e3 * what.size, abs=4.0 * size.standard_uncertainty)
        assert 0.0 < size.standard_uncertainty < 0.5 * size.value
        assert diagnosis.platform_m > 1e-7
    if kind == "position":
        assert len(diagnosis.unidentifiable) == 3


SHIFT_MM, TURN_MRAD = (3.0, -2.0, 4.0), (0.0, 2.0, -1.5)


def moved_frame(
    readings: Readings, shift_mm: Sequence[float], turn_mrad: Sequence[float]
) -> FloatArray:
    """What a tracker reads whose frame is off by so much."""
    turn, values = Rotation.from_rotvec(1e-3 * np.array(turn_mrad)), readings.measured.copy()
    values[:, :3] = turn.apply(values[:, :3]) + 1e-3 * np.array(shift_mm)
    if values.shape[1] > 3:
        values[:, 3:] = (turn * Rotation.from_euler("YXZ", values[:, 3:])).as_euler("YXZ")
    return values


@LONG
@pytest.mark.parametrize("kind", ["position", "pose-forward"])
def test_another_frame_of_the_tracker_is_named_and_bends_no_parameter(kind: str) -> None:
    """Shifted and turned by so little that no posture alone departs from what is expected."""
    chance = np.random.default_rng(4)
    true = Plain(FILE, chance)
    readings = measured(true, FILE, kind, NOTHING, chance)
    tolerances = FILE.tolerances.of(readings.procedure.parameters)
    in_frame = replace(readings, measured=moved_frame(readings, SHIFT_MM, TURN_MRAD))
    diagnosis = diagnosed(in_frame, FILE.whole(), tolerances, LEAD_M)
    assert diagnosis.verdict == "explained"
    assert [claim.causes for claim in diagnosis.named] == [(("other_frame", "all postures"),)]
    assert diagnosis.wrong_postures == ()
    stated = (*SHIFT_MM, *TURN_MRAD[1:])
    for size, value in zip(diagnosis.sizes, stated, strict=True):
        assert size.unit == "mm"
        assert size.value == pytest.approx(value, abs=4.0 * size.standard_uncertainty)
    correction = correction_of(weighed(in_frame, FILE.whole(), tolerances, LEAD_M), FILE.whole())
    assert correction is not None
    assert correction.platform.bound_m is not None
    assert correction.platform.in_frame_of_tracker
    middle = readings.sliders.mean(axis=0)
    off = off_mm(correction.machine, true, NOTHING, middle, correction.platform.laid_over)
    assert off <= 1e3 * correction.platform.bound_m < 0.03


@LONG
@pytest.mark.parametrize("kind", ["position", "pose-forward"])
def test_a_frame_too_small_to_be_named_makes_no_bound_untrue(kind: str) -> None:
    """0.04 to 0.4 mm and mrad, as trackers are set up: the bound holds where it is laid over.

    In 95 of 100: of 24 machines 20 or more in all but six of a thousand such tests. In rails' own
    frame, which was judged before, one of these is within.
    """
    within_bound = 0
    for seed in range(24):
        chance, draw = np.random.default_rng(60_000 + seed), np.random.default_rng(seed)
        true = Plain(FILE, chance)
        readings = measured(true, FILE, kind, NOTHING, chance)
        size = 0.2 * float(np.exp(draw.uniform(np.log(0.2), np.log(2.0))))
        shift_mm, turn_mrad = size * draw.standard_normal((2, 3))
        tolerances = FILE.tolerances.of(readings.procedure.parameters)
        in_frame = replace(readings, measured=moved_frame(readings, shift_mm, turn_mrad))
        models = weighed(in_frame, FILE.whole(), tolerances, LEAD_M)
        correction = correction_of(models, FILE.whole())
        assert correction is not None
        bound_m, free = correction.platform.bound_m, correction.platform.laid_over
        assert bound_m is not None
        middle = readings.sliders.mean(axis=0)
        off = off_mm(correction.machine, true, NOTHING, middle, free)
        within_bound += off <= 1e3 * bound_m < 0.03
    assert within_bound >= 20


@LONG
def test_sound_machines_are_not_accused() -> None:
    """None is; chance may leave one or two open."""
    agreed = 0
    for seed in (22, 71, 72):
        for kind in POSTURES:
            chance = np.random.default_rng(seed)
            readings = measured(Plain(FILE, chance), FILE, kind, NOTHING, chance)
            tolerances = FILE.tolerances.of(readings.procedure.parameters)
            diagnosis = diagnosed(readings, FILE.whole(), tolerances, LEAD_M)
            assert diagnosis.named == ()
            assert sum(claim.weight for claim in diagnosis.claims) <= 1.0 + 1e-12
            agreed += diagnosis.verdict == "agrees"
            if diagnosis.verdict == "agrees":
                assert diagnosis.claims[0].causes == ()
                assert diagnosis.sizes == ()
                assert diagnosis.gap_after == diagnosis.gap_before
    assert agreed >= 7


@LONG
def test_hidden_machines_of_the_bench() -> None:
    """A part of it: nobody is accused wrongly, the truth is in the set."""
    inside = 0
    for seed in range(100, 112):
        what, diagnosis = case("position", seed)
        ids = {cause for claim in diagnosis.named for cause in claim.causes}
        assert ids <= set(what.truth)
        inside += what.truth in {claim.causes for claim in diagnosis.claims}
    assert inside >= 11


def test_one_mistyped_value_of_a_posture_is_named() -> None:
    """Eight deviations in one of six values: as six wrong values it had 80 %."""
    chance = np.random.default_rng(12)
    readings = measured(Plain(FILE, chance), FILE, "pose-forward", NOTHING, chance)
    readings.measured[9, 4] += 8.0 * NOISE_RAD
    tolerances = FILE.tolerances.of(readings.procedure.parameters)
    diagnosis = diagnosed(readings, FILE.whole(), tolerances, LEAD_M)
    assert [claim.causes for claim in diagnosis.named] == [(("wrong_posture", "posture 10"),)]
    assert diagnosis.wrong_postures == (10,)
    (size,) = diagnosis.sizes
    assert size.name == "posture 10, psi off"
    assert size.value == pytest.approx(8.0, abs=4.0 * size.standard_uncertainty)


def test_claims_hold_99_of_100_of_all_models_the_lightest_too() -> None:
    """A wave that hardly shows: without the thousands of light models 98.9 % end before it."""
    what, diagnosis = case("position", 1025)
    assert diagnosis.verdict == "agrees"
    assert 0.99 <= sum(claim.weight for claim in diagnosis.claims) <= 1.0
    (claim,) = (claim for claim in diagnosis.claims if claim.causes == what.truth)
    assert claim.weight < 2e-3


def test_too_few_readings_and_no_noise_tell_nothing() -> None:
    chance = np.random.default_rng(5)
    readings = measured(Plain(FILE, chance), FILE, "position", NOTHING, chance)
    few = readings.take(np.arange(len(readings.sliders)) < 17)
    tolerances = FILE.tolerances.of(readings.procedure.parameters)
    diagnosis = diagnosed(few, FILE.whole(), tolerances)
    assert (diagnosis.verdict, diagnosis.claims, diagnosis.spare) == ("cannot-tell", (), 5)
    with pytest.raises(NotIdentifiable, match="no stated noise"):
        diagnosed(replace(few, length_noise_m=0.0, angle_noise_rad=0.0), FILE.whole(), tolerances)


def test_a_larger_noise_is_a_rival_of_causes_that_would_explain_it() -> None:
    """Twice the stated one in 24 places: of eight such machines causes explain it in this one."""
    chance = np.random.default_rng(50_014)
    true = Plain(FILE, chance)
    readings = measured(true, FILE, "position", NOTHING, chance).take(np.arange(40) < 24)
    more = 1e-5 * np.sqrt(3.0) * chance.standard_normal(readings.measured.shape)
    noisy = replace(readings, measured=readings.measured + more)
    models = weighed(noisy, FILE.whole(), FILE.tolerances.of(readings.procedure.parameters))
    assert models.mean_square(models.free)[1] < 1e-3
    assert models.noise_times == pytest.approx(2.0, abs=0.6)
