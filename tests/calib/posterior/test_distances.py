"""Distances between marks, judged by a delta of the test's own: towers upright, solved in z."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from calib.arrays import FloatArray, observe, tool_conditions
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import Cells, SessionCase
from calib.posterior.distances import Distances
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.posterior.readings import rows_of
from calib.tripod.effects.drives import AxisOffset
from calib.tripod.effects.effect import Effect, EffectInstance
from calib.tripod.effects.gauges import GaugeGain
from calib.tripod.pipeline import Model
from protocols.machine import load_machine
from tests.conftest import LONG

MACHINE = load_machine("linear-delta")
DELTA = MACHINE.geometry()
BAR = 250.0
STAND = np.array([[-107.387, -62.0], [107.387, -62.0], [0.0, 124.0]])
OUT = STAND / np.hypot(*STAND.T)[:, None]

CONTACT_MM, CALIPER_MM, CYCLES = 0.01, 0.03, 2
OUTWARDS = AxisOffset(tuple(DELTA.across))
RADIUS_LAWS = tuple((OUTWARDS, f"{leg}r") for leg in "xyz")


@dataclass(frozen=True)
class Truth:
    """What is off, for three towers: switch, bar, distance from the middle, mm."""

    switch: tuple[float, ...] = (0.0, 0.0, 0.0)
    bar: tuple[float, ...] = (0.0, 0.0, 0.0)
    out: tuple[float, ...] = (0.0, 0.0, 0.0)

    def tool(self, sent: FloatArray) -> FloatArray:
        """Where the tool is: two differences of spheres are planes, so x and y follow from z."""
        height_reading = sent[2] + np.sqrt(BAR**2 - ((sent[:2] - STAND) ** 2).sum(axis=1))
        height = height_reading + self.switch
        stand = STAND + np.array(self.out)[:, None] * OUT
        bar = BAR + np.array(self.bar)
        square = (stand**2).sum(axis=1) + height**2 - bar**2
        planes = np.linalg.inv(2.0 * (stand[1:] - stand[0]))
        start = planes @ (square[1:] - square[0])
        slope = -planes @ (2.0 * (height[1:] - height[0]))
        ahead = start - stand[0]
        a = float(slope @ slope) + 1.0
        b = 2.0 * (float(ahead @ slope) - height[0])
        c = float(ahead @ ahead) + height[0] ** 2 - bar[0] ** 2
        z = (-b - math.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
        return np.array([*(start + slope * z), z])

    def apart(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """How far marks ``(n, 3)`` are apart that were made there."""
        return np.array(
            [math.dist(self.tool(a), self.tool(b)) for a, b in zip(first, second, strict=True)]
        )

    def met(self, x: float, y: float) -> float:
        """The height at which the tool that is sent there meets the plate."""
        z = 0.0
        for _ in range(20):
            z -= float(self.tool(np.array([x, y, z]))[2])
        return z


def ring(radius: float, count: int) -> FloatArray:
    angle = 2.0 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)


CORNERS = ring(70.0, 6)
FIRST = np.vstack([CORNERS[:3], CORNERS])
SECOND = np.vstack([-CORNERS[:3], np.roll(CORNERS, -2, axis=0)])
PLACES = np.vstack([np.zeros((1, 3)), ring(40.0, 6), ring(80.0, 12)])


def touched(true: Truth, generator: np.random.Generator, model: Model | None = None) -> SessionCase:
    """Contacts over the plate, each place twice; the radius may be off where a model says so."""
    height = np.array([true.met(x, y) for x, y, _ in PLACES])
    noisy = height + generator.normal(0.0, CONTACT_MM, (CYCLES, len(PLACES)))
    mean = noisy.mean(axis=0)
    contacts = tool_conditions(np.tile(np.column_stack([PLACES[:, :2], mean]), (CYCLES, 1)))
    contacts = replace(
        contacts,
        contact=np.ones(len(contacts), dtype=np.bool_),
        movement=-np.ones((len(contacts), 3)),
        cycle=np.repeat(np.arange(CYCLES) + 1, len(PLACES)),
    )
    observations = observe(contacts, -(noisy - mean).ravel())
    laws: tuple[tuple[Effect, str], ...] = RADIUS_LAWS if model else ()
    free = {law: (number, "") for number, law in enumerate(laws)}
    tolerance = MACHINE.tolerances_mm()
    return SessionCase(
        model or Model(DELTA), observations, IndicatorFigures(), tolerance, free=free
    )


def measured(true: Truth, generator: np.random.Generator) -> Distances:
    value = true.apart(FIRST, SECOND) + generator.normal(0.0, CALIPER_MM, len(FIRST))
    return Distances(FIRST, SECOND, value, np.full(len(FIRST), CALIPER_MM))


WITH_RADIUS = Model(DELTA).with_effects(
    tuple(EffectInstance(law, place, (0.0,)) for law, place in RADIUS_LAWS)
)


def true_machine(seed: int) -> Truth:
    """As the program expects one: its tolerances, and four times 0.1 mm of each tower outwards."""
    generator = np.random.default_rng(seed)
    sizes = [generator.normal(0.0, spread, 3).tolist() for spread in (1.0, 0.3, 0.4)]
    return Truth(*(tuple(size) for size in sizes))


def common_bar(result: Posterior) -> tuple[float, float]:
    """Mean of the three bars, and its standard deviation over all models."""
    mean = [float(model.mean[:3].mean()) for model in result.models]
    square = [float(model.covariance[:3, :3].sum()) / 9.0 for model in result.models]
    weight = [model.weight for model in result.models]
    middle = float(np.dot(weight, mean))
    spread = np.array(square) + (np.array(mean) - middle) ** 2
    return middle, math.sqrt(float(np.dot(weight, spread)))


OFF = Truth((0.7, -0.4, 0.2), (0.3, -0.2, 0.5), (0.25, 0.1, -0.3))


def distances_of(value: FloatArray | float = 0.0) -> Distances:
    return Distances(FIRST, SECOND, np.zeros(9) + value, np.full(9, 0.5))


def model_of(true: Truth) -> Model:
    effects = (
        EffectInstance(law, place, (true.out["xyz".index(place[0])],)) for law, place in RADIUS_LAWS
    )
    return Model(DELTA, (*true.switch, *true.bar), tuple(effects))


def test_marks_are_apart_as_the_machine_of_the_test_has_them() -> None:
    assert distances_of().expected_mm(Model(DELTA)) == pytest.approx(
        np.linalg.norm(FIRST - SECOND, axis=1), abs=1e-9
    )
    want = OFF.apart(FIRST, SECOND)
    assert np.abs(want - np.linalg.norm(FIRST - SECOND, axis=1)).max() > 0.1
    assert distances_of().expected_mm(model_of(OFF)) == pytest.approx(want, abs=1e-9)
    assert distances_of(want + 0.25).residual(model_of(OFF)) == pytest.approx(0.5)


def test_derivatives_are_those_of_the_machine_of_the_test() -> None:
    step = 1e-4
    by_base = distances_of().by_base(model_of(OFF))
    by_laws = distances_of().by_laws(model_of(OFF), RADIUS_LAWS)
    for kind, name in enumerate(("switch", "bar", "out")):
        for tower in range(3):
            sides = []
            for sign in (1.0, -1.0):
                sizes = list(getattr(OFF, name))
                sizes[tower] += sign * step
                sides.append(replace(OFF, **{name: tuple(sizes)}).apart(FIRST, SECOND))
            want = (sides[0] - sides[1]) / (2.0 * step) / 0.5
            if name == "out":
                assert by_laws[RADIUS_LAWS[tower]][:, 0] == pytest.approx(want, abs=1e-6)
            else:
                assert by_base[:, 3 * kind + tower] == pytest.approx(want, abs=1e-6)


def test_what_an_indicator_does_is_not_in_a_distance() -> None:
    gain = EffectInstance(GaugeGain(), "tz", (50.0,))
    with_gain = Model(DELTA).with_effects((gain,))
    plain = distances_of().expected_mm(Model(DELTA))
    assert distances_of().expected_mm(with_gain) == pytest.approx(plain, abs=1e-12)
    assert not distances_of().by_laws(with_gain, [(gain.effect, "tz")])


@cache
def solved(seed: int, *, with_distances: bool) -> tuple[float, float]:
    """How far the common size of the bars is from the truth, and its standard deviation, mm."""
    generator, true = np.random.default_rng(1000 + seed), true_machine(seed)
    case = touched(true, generator, WITH_RADIUS)
    if with_distances:
        case = replace(case, distances=measured(true, generator))
    mean, deviation = common_bar(posterior([case]))
    return mean - float(np.mean(true.bar)), deviation


MACHINES = range(24)


@LONG
def test_distances_tell_the_common_size_that_contacts_leave_open() -> None:
    """Bars and radius that are larger alike keep a plate flat: within tolerances, nothing is told.

    A tolerance of 0.3 mm for each bar is 0.173 mm for the mean of three.
    """
    contacts = np.array([solved(seed, with_distances=False) for seed in MACHINES])
    results = np.array([solved(seed, with_distances=True) for seed in MACHINES])
    assert np.median(contacts[:, 1]) > 0.7 * 0.173
    assert np.median(results[:, 1]) < 0.6 * np.median(contacts[:, 1])
    assert np.sqrt((results[:, 0] ** 2).mean()) < 0.6 * np.sqrt((contacts[:, 0] ** 2).mean())


@LONG
def test_the_interval_covers() -> None:
    """Of 24 machines 95 % would be 22.8; fewer than 20 come once in a hundred times."""
    results = np.array([solved(seed, with_distances=True) for seed in MACHINES])
    assert (np.abs(results[:, 0]) < 1.96 * results[:, 1]).sum() >= 20


def test_each_distance_counts_by_its_own_deviation() -> None:
    """A wild distance of ten times the deviation moves the result by less than a sound one."""
    generator, true = np.random.default_rng(1), OFF
    case = touched(true, generator, WITH_RADIUS)
    sound = measured(true, generator)
    wild = replace(sound, value_mm=sound.value_mm + np.array([1.0, *[0.0] * 8]))
    loose = replace(wild, deviation_mm=np.array([10.0, *[CALIPER_MM] * 8]))
    results = [
        common_bar(posterior([replace(case, distances=distances)]))[0]
        for distances in (sound, loose, wild)
    ]
    assert abs(results[1] - results[0]) < 0.2 * abs(results[2] - results[0])


def test_a_distance_is_one_value_more() -> None:
    """Student's t of all values has one degree of freedom for each, whatever was measured."""
    case = touched(OFF, np.random.default_rng(1), WITH_RADIUS)
    distances = measured(OFF, np.random.default_rng(2))
    contacts, both = (
        rows_of([Cells.of(session)], [session.model], [{}])
        for session in (case, replace(case, distances=distances))
    )
    assert both.free - contacts.free == len(both.residual) - len(contacts.residual) == len(FIRST)


def test_what_a_wild_distance_leaves_is_its_own() -> None:
    case = touched(OFF, np.random.default_rng(1), WITH_RADIUS)
    sound = measured(OFF, np.random.default_rng(2))
    residual = posterior([replace(case, distances=sound)]).distances_left
    assert np.abs(residual).max() < 4.0
    value_mm = sound.value_mm.copy()
    value_mm[4] += 1.0
    residual = posterior(
        [replace(case, distances=replace(sound, value_mm=value_mm))]
    ).distances_left
    assert np.abs(residual).argmax() == 4
    assert residual[4] > 10.0
    assert posterior([case]).distances_left.shape == (0,)


def test_a_second_session_may_have_the_distances() -> None:
    """Bars are those of one machine: what one session says of them holds in the other."""
    true = true_machine(3)
    first, second = (touched(true, np.random.default_rng(seed), WITH_RADIUS) for seed in (1, 2))
    alone = common_bar(posterior([first, second]))
    beside = replace(second, distances=measured(true, np.random.default_rng(3)))
    bar_together = common_bar(posterior([first, beside]))
    assert bar_together[1] < 0.7 * alone[1]
    assert abs(bar_together[0] - float(np.mean(true.bar))) < 2.5 * bar_together[1]
