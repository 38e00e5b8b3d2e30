"""Offsets and sizes of effects fitted together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import Conditions, Observations, conditions, observe
from calib.errors import NotIdentifiable
from calib.identify.fit import Size
from calib.noise.reading import IndicatorFigures
from calib.tripod.effects.drives import ActuatorScale, AxisSquareness, Backlash
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model, measure
from tests.calib.identify.identified import identify
from tests.conftest import LONG

LEAN_AND_PLAY = (
    Size("lean", "mrad", 0.5, ((0, 0),)),
    Size("play", "mm", 0.01, ((1, 0), (2, 0))),
)
FINE = IndicatorFigures(resolution_mm=0.001)


def machine(lean_mrad: float, play_mm: float, *parameters_mm: float) -> Model:
    """Axes x and y lean together; carriages x and z have the same play."""
    return Model(
        Geometry(),
        parameters_mm,
        (
            EffectInstance(AxisSquareness(), "xy", (lean_mrad,)),
            EffectInstance(Backlash(), "x", (play_mm,)),
            EffectInstance(Backlash(), "z", (play_mm,)),
        ),
    )


def visited(stations: tuple[float, ...] = (0.3, 0.7)) -> Conditions:
    """Each leg along both others: Zero, Max, Min three times, both sides of Zero."""
    rows = []
    for station in stations:
        for leg in range(3):
            before, side = 0.0, 0.0
            for cycle in range(3):
                for level in (0.0, 60.0, 0.0, -100.0):
                    side = float(np.sign(level - before)) or side
                    before = level
                    rows += [
                        (leg, axis, level, station, side, cycle) for axis in range(3) if axis != leg
                    ]
    legs, axes, levels, touched, sides, cycles = zip(*rows, strict=True)
    plan = conditions(legs, axes, levels, station=touched)
    return replace(plan, approach=np.array(sides), cycle=np.array(cycles, dtype=np.intp))


def measured(truth: Model, scatter_mm: float, seed: int) -> Observations:
    plan = visited()
    values = measure(truth, plan, scatter_mm=scatter_mm, resolution_mm=0.0, generator=seed)
    return observe(plan, values)


def test_a_lean_no_longer_goes_into_the_offsets() -> None:
    truth = machine(2.0, 0.05, 1.0, -0.5, 0.3, 0.0, 0.0, 0.0)
    data = measured(truth, 1e-7, 1)
    alone = identify(Model(Geometry()), data, "joint-offsets", indicator=FINE)
    start = machine(1.0, 0.01, *(0.0,) * 6)
    together = identify(start, data, "joint-offsets", indicator=FINE, sizes=LEAN_AND_PLAY)
    assert np.abs(alone.values_mm - truth.parameters_mm[:3]).max() > 0.05
    assert together.values_mm == pytest.approx(truth.parameters_mm[:3], abs=1e-5)
    assert [size.value for size in together.sizes] == pytest.approx([2.0, 0.05], abs=1e-5)
    assert LEAN_AND_PLAY[1].value(together.model) == together.sizes[1].value


@LONG
def test_stated_uncertainties_of_sizes_and_offsets_hold() -> None:
    """z-scores of 60 sessions with known noise: mean square 1 ± 4 standard deviations."""
    truth = machine(1.5, 0.04, 0.6, 0.2, -0.4, 0.0, 0.0, 0.0)
    scores = []
    for seed in range(60):
        solution = identify(
            truth, measured(truth, 0.003, seed), "joint-offsets", sizes=LEAN_AND_PLAY
        )
        off = np.append(solution.values_mm, [size.value for size in solution.sizes])
        off -= np.append(truth.parameters_mm[:3], [1.5, 0.04])
        uncertainty = np.append(
            solution.uncertainty_mm, [s.standard_uncertainty for s in solution.sizes]
        )
        scores.append(off / uncertainty)
    square = float((np.array(scores) ** 2).mean())
    assert square == pytest.approx(1.0, abs=4.0 * (2.0 / 60) ** 0.5)


def test_all_six_held_by_tolerances_beside_free_sizes() -> None:
    truth = machine(2.0, 0.05, 1.0, -0.5, 0.3, 0.05, -0.02, 0.0)
    solution = identify(
        machine(1.0, 0.01, *(0.0,) * 6),
        measured(truth, 0.001, 2),
        "with-tolerances",
        tolerance_mm=np.repeat([2.0, 0.1], 3),
        sizes=LEAN_AND_PLAY,
    )
    assert solution.covariance_mm2.shape == (6, 6)
    for size, value in zip(solution.sizes, (2.0, 0.05), strict=True):
        assert size.value == pytest.approx(value, abs=4.0 * size.standard_uncertainty)


def test_a_size_that_nothing_shows_is_refused_by_name() -> None:
    truth = Model(Geometry(), (1.0, -0.5, 0.3, 0.0, 0.0, 0.0))
    plan = visited()
    still = replace(plan, approach=np.zeros(len(plan)))  # from where is not known
    values = measure(truth, still, scatter_mm=0.002, resolution_mm=0.0, generator=3)
    start = replace(truth, effects=(EffectInstance(Backlash(), "x", (0.02,)),))
    play = Size("play", "mm", 0.01, ((0, 0),))
    scale = replace(truth, effects=(EffectInstance(ActuatorScale(), "x", (0.1,)),))
    scaled = Size("scale", "mm/m", 0.1, ((0, 0),))
    identify(scale, observe(still, values), "joint-offsets", sizes=(scaled,))
    for subset in ("joint-offsets", "with-tolerances"):
        with pytest.raises(NotIdentifiable, match="play"):
            identify(
                start,
                observe(still, values),
                subset,
                tolerance_mm=np.repeat([2.0, 0.1], 3),
                sizes=(play,),
            )
