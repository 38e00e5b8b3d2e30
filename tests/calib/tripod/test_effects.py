"""The catalogue of effects: signs, sizes, places, arrangements, derivatives."""

from __future__ import annotations

import pickle
from dataclasses import replace
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from app.measuring.simulated import simulated_session
from calib.arrays import Conditions, FloatArray, conditions, incidence, tool_conditions
from calib.errors import UnreachablePosture
from calib.tripod.effects import BESIDE_CATALOGUE, CATALOGUE, drives
from calib.tripod.effects.bars import pull_of_weight
from calib.tripod.effects.candidates import candidates
from calib.tripod.effects.contract import fault_of
from calib.tripod.effects.drives import (
    STANDARD_LEADS_MM,
    ActuatorCyclic,
    AxisDistance,
    AxisLean,
    AxisOffset,
    AxisSquareness,
    Backlash,
    Straightness,
    StraightnessOfFourthOrder,
    StraightnessOfThirdOrder,
    effects_of,
)
from calib.tripod.effects.effect import Acting, Effect, EffectInstance, remedies, travel_mm
from calib.tripod.geometry import Geometry, trilaterate
from calib.tripod.movements import TURNED_MM, last_movement
from calib.tripod.pipeline import Flow, Model, Stage, derivatives, simulate
from protocols.machine import Machine
from protocols.observations import to_observations
from protocols.procedure import load_procedure
from protocols.session import Event, fold
from tests.calib.tripod.laws import EVERY, OFF, TAKEN, effect
from tests.tripods import DELTA, TRIPODS

L = 310.25


def on_plate() -> Conditions:
    """The tool along z over two heights, with movements, times and temperatures."""
    angle = np.linspace(0.0, 2.0 * np.pi, 13)[:12]
    ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    place = np.vstack([[0.0, 0.0, 0.0], 40.0 * ring, 80.0 * ring, 60.0 * ring + [0.0, 0.0, 8.0]])
    rows = np.arange(len(place)).astype(np.float64)
    moved = np.random.default_rng(3).choice([-1.0, 1.0], (len(place), 3))
    plan = replace(tool_conditions(place), movement=moved)
    return replace(plan, time_s=rows * 20.0, temperature_c=21.0 + rows * 0.01)


PLATE = on_plate()
CONTACTS = replace(PLATE, contact=np.ones(len(PLATE), dtype=np.bool_))
PROBED = replace(CONTACTS, beside_mm=np.tile([25.0, -10.0, 0.0], (len(PLATE), 1)))

SETTINGS = [
    pytest.param(law, geometry, plan, id=f"{law.id}-{law.parameters[0].name}-{name}")
    for name, geometry, plan in (
        ("legs", Geometry(), TAKEN),
        ("plate", DELTA, PLATE),
        ("contacts", DELTA, PROBED),
    )
    for law in effects_of(EVERY, geometry)
    if law.places(plan)
]
"""Every law on a machine whose readings it may touch."""


def change(
    effect_id: str,
    place: str,
    value: float,
    plan: Conditions,
    geometry: Geometry | None = None,
    parameter: str = "",
) -> FloatArray:
    """What an effect changes in the readings of the nominal machine."""
    model = Model(geometry or Geometry())
    placed = EffectInstance(effect(effect_id, parameter), place, (value,))
    return replace(model, effects=(placed,)).readings(plan) - model.readings(plan)


def at(leg: int, axis: int, *displacements: float, approach: float = 1.0) -> Conditions:
    count = len(displacements)
    plan = conditions([leg] * count, [axis] * count, displacements)
    return replace(plan, approach=np.full(count, approach))


def test_the_catalogue_holds_the_ids_of_the_contract() -> None:
    contract = """axis_squareness axis_offset straightness actuator_scale actuator_cyclic backlash
        leg_length gravity_sag thermal_drift leg_taper leg_bow gauge_gain gauge_tilt"""
    beside = {"plate_tilt"}  # of contacts, which the contract did not know yet
    assert set(contract.split()) | beside == {law.id for law in CATALOGUE}
    assert not {law.id for law in CATALOGUE} & {law.id for law in BESIDE_CATALOGUE}
    for law in EVERY:
        assert law.title
        assert all(p.unit and p.tolerance > 0 for p in law.parameters)


@pytest.mark.parametrize(("law", "geometry", "plan"), SETTINGS)
def test_zero_changes_nothing_and_columns_are_central_differences(
    law: Effect, geometry: Geometry, plan: Conditions
) -> None:
    """Complex steps against differences of the nonlinear simulation, at a machine that is off."""
    model = Model(geometry, OFF)
    plain = model.readings(plan)
    for place in law.places(plan):
        model_of_zeros = replace(
            model, effects=(EffectInstance(law, place, (0.0,) * len(law.parameters)),)
        )
        assert model_of_zeros.readings(plan) == pytest.approx(plain, abs=1e-13)
    causes = [c for c in candidates(model, plan, [law]) if c.arrangement != "each"]
    assert causes
    for candidate in causes:
        for number, parameter in enumerate(candidate.parameters):
            step = np.zeros(len(candidate.parameters))
            step[number] = parameter.tolerance
            high = replace(model, effects=candidate.effects(step)).readings(plan)
            low = replace(model, effects=candidate.effects(-step)).readings(plan)
            central = (high - low) / (2 * parameter.tolerance)
            scale = float(np.abs(central).max())
            assert candidate.columns[:, number] == pytest.approx(central, abs=1e-4 * scale + 1e-11)


@pytest.mark.parametrize(("law", "geometry", "plan"), SETTINGS)
def test_base_derivatives_pass_through_every_effect(
    law: Effect, geometry: Geometry, plan: Conditions
) -> None:
    """A batch of complex machines with the effect adopted equals differences of single ones."""
    sizes = tuple(p.tolerance for p in law.parameters)
    effects = tuple(EffectInstance(law, place, sizes) for place in law.places(plan))
    exact = derivatives(geometry, OFF, plan, effects)
    for number in range(6):
        step = 1e-3 * np.eye(6)[number]
        high = simulate(geometry, np.array(OFF) + step, plan, effects)
        low = simulate(geometry, np.array(OFF) - step, plan, effects)
        assert exact[:, number] == pytest.approx((high - low) / 2e-3, abs=1e-7)


@pytest.mark.parametrize(("displacement", "per_rad"), [(60.0, -41.6035), (-100.0, 17.7679)])
def test_squareness_changes_both_readings_alike(displacement: float, per_rad: float) -> None:
    """Theory section 4; the value is the sum of both leans in mrad."""
    for leg, axis in ((0, 1), (1, 0)):
        change_mm = change("axis_squareness", "xy", 0.01, at(leg, axis, displacement))
        assert change_mm[0] / 1e-5 == pytest.approx(per_rad, abs=2e-3)
    assert change("axis_squareness", "xy", 0.01, at(2, 0, displacement))[0] == pytest.approx(
        0.0, abs=1e-7
    )


@pytest.mark.parametrize(("effect_id", "place"), [("axis_squareness", "xy"), ("axis_lean", "xt")])
def test_a_lean_is_the_same_wherever_joints_count_from(effect_id: str, place: str) -> None:
    """One machine in two files: joints of the second read 700 mm more in every posture."""
    of_pair = effect_id == "axis_squareness"
    here, plan = (Geometry(), TAKEN) if of_pair else (DELTA, PLATE)
    origins = here.origins - 700.0 * here.directions
    x, y, z = ((a, b, c) for a, b, c in origins.tolist())
    elsewhere = replace(here, origin_mm=(x, y, z))
    law = AxisSquareness() if of_pair else AxisLean(tuple(DELTA.across))
    placed = EffectInstance(law, place, (2.0,))
    one, other = (Model(each, effects=(placed,)).readings(plan) for each in (here, elsewhere))
    assert np.ptp(one - Model(here).readings(plan)) > 0.02
    assert other == pytest.approx(one, abs=1e-9)


@pytest.mark.parametrize(
    ("leg", "axis", "displacement", "expected"),
    [(1, 0, 60.0, -0.1367), (0, 1, 60.0, -0.1934), (1, 0, -100.0, 0.0605), (0, 1, -100.0, 0.3223)],
)
def test_offset(leg: int, axis: int, displacement: float, expected: float) -> None:
    """Theory section 4: axis x shifted towards y, differences to Zero."""
    plan = at(leg, axis, displacement, 0.0)
    far, zero = change("axis_offset", "xy", 1e-3, plan)
    assert (far - zero) / 1e-3 == pytest.approx(expected, abs=1e-4)


def reads(
    leg: int,
    axis: int,
    displacement: float,
    along_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    sideways_mm: float = 0.0,
) -> float:
    """A second model of one reading: carriages off along their axes, foot x off towards y.

    Three spheres by Newton's method; at Zero nothing is off, so the indicator stands at L / 2.
    """
    carriage = np.full(3, np.sqrt(L**2 - displacement**2))
    carriage[leg] = L + displacement
    feet = np.diag(carriage + np.array(along_mm))
    feet[0, 1] += sideways_mm
    tool = np.eye(3)[leg] * displacement
    for _ in range(20):
        bars = tool - feet
        tool = tool - np.linalg.solve(2 * bars, (bars**2).sum(axis=1) - L**2)
    part = (L / 2 - tool[leg]) / (feet[leg, leg] - tool[leg])
    return float(tool[axis] + part * (feet[leg, axis] - tool[axis]))


@pytest.mark.parametrize("displacement", [60.0, -100.0])
def test_straightness_moves_the_foot_by_the_square_of_travel(displacement: float) -> None:
    part = (displacement / 100.0) ** 2
    change_mm = change("straightness", "xy", 0.02, at(0, 1, displacement, 0.0))
    moved = reads(0, 1, displacement, sideways_mm=0.02 * part) - reads(0, 1, displacement)
    assert change_mm == pytest.approx([moved, 0.0], abs=1e-11)


@pytest.mark.parametrize("displacement", [60.0, -100.0])
def test_scale_and_cyclic_are_errors_of_the_carriage(displacement: float) -> None:
    """On legs x and y; there carriage x stands at sqrt(L² - s²)."""
    for leg, axis in ((0, 1), (1, 0)):
        plan = at(leg, axis, displacement)
        travel = displacement if leg == 0 else np.sqrt(L**2 - displacement**2) - L
        plain = reads(leg, axis, displacement)
        scaled = reads(leg, axis, displacement, (5e-4 * travel, 0.0, 0.0)) - plain
        assert change("actuator_scale", "x", 0.5, plan)[0] == pytest.approx(scaled, abs=1e-11)
        turn = 2 * np.pi * travel / 4.0
        error = 1e-3 * (3.0 * np.sin(turn) + 5.0 * (np.cos(turn) - 1.0))
        cyclic = EffectInstance(effect("actuator_cyclic", "sine_4mm"), "x", (3.0, 5.0))
        reading_mm = Model(effects=(cyclic,)).readings(plan)[0]
        assert reading_mm == pytest.approx(
            reads(leg, axis, displacement, (error, 0.0, 0.0)), abs=1e-11
        )


@pytest.mark.parametrize("name", ["orthoglide", "unequal-bars", "platform", "tilted", "star"])
def test_last_movement_of_every_carriage_over_a_path(name: str) -> None:
    """Against the commands themselves, walked in small steps from level to level.

    Each carriage is where a sphere about the end of its bar meets its line, further along.
    """
    geometry = TRIPODS[name]
    levels = [0.0, 60.0, 20.0, -30.0, -100.0, -40.0, 30.0, 0.0, -50.0, 0.0]
    for leg in range(3):
        for before, after in pairwise(levels):
            tool = np.linspace(before, after, 2001)[:, None] * geometry.direction[leg]
            command = []
            for k in range(3):
                end = tool + geometry.platform_mm[k] - np.array(geometry.origin_mm[k])
                line = np.array(geometry.direction[k])
                square = (end**2).sum(axis=1) - geometry.leg_length_mm[k] ** 2
                command.append(end @ line + np.sqrt((end @ line) ** 2 - square))
            plan = at(leg, (leg + 1) % 3, after, approach=float(np.sign(after - before)))
            back_mm = np.max(command, axis=1) - np.array(command)[:, -1]  # none ever turns upwards
            ways = np.where(back_mm < TURNED_MM, 1.0, -1.0)
            assert last_movement(geometry, plan)[0] == pytest.approx(ways), (leg, before, after)
    assert not last_movement(geometry, at(0, 1, 30.0, approach=0.0)).any()


def test_backlash_leaves_the_foot_at_the_larger_coordinate() -> None:
    late = (0.03, 0.0, 0.0)
    moved = reads(0, 1, 20.0, late) - reads(0, 1, 20.0)
    assert abs(moved) > 1e-3
    down, up, unknown = (
        change("backlash", "x", 0.03, at(0, 1, 20.0, approach=sign))[0] for sign in (-1, 1, 0)
    )
    assert down == pytest.approx(moved, abs=1e-11)
    assert (up, unknown) == (0.0, 0.0)
    # on the way out to Max of leg y carriage x comes down, and goes up on the way back
    crossed = reads(1, 0, 60.0, late) - reads(1, 0, 60.0)
    out, back = (
        change("backlash", "x", 0.03, at(1, 0, 60.0, approach=sign))[0] for sign in (1, -1)
    )
    assert out == pytest.approx(crossed, abs=1e-11)
    assert back == 0.0


def test_backlash_over_the_steps_of_the_procedures() -> None:
    """Reading by reading against directions followed along the record by hand."""
    machine = Machine()
    for name in ("zero-max-min", "zero-min-max", "sweep"):
        observations = to_observations([fold(planned(name, machine))])
        change_mm = change("backlash", "x", 0.02, observations)
        stood = dict.fromkeys(range(observations.mount_count), (0.0, 0.0))
        lagging = 0
        for row in range(len(observations)):
            mount, now = int(observations.mount[row]), float(observations.displacement_mm[row])
            before, moved = stood[mount]
            moved = float(np.sign(now - before)) or moved
            stood[mount] = now, moved
            same_leg = int(observations.leg[row]) == 0
            lags = moved < 0 if same_leg else moved * now > 0
            late = 0.02 if lags else 0.0
            leg, axis = int(observations.leg[row]), int(observations.axis[row])
            expected = reads(leg, axis, now, (late, 0.0, 0.0)) - reads(leg, axis, now)
            assert change_mm[row] == pytest.approx(expected, abs=1e-11)
            lagging += lags
        assert lagging > 6


def planned(name: str, machine: Machine) -> list[Event]:
    """Events of a session whose values are without meaning."""
    session = simulated_session(
        load_procedure(name, machine.geometry()),
        machine,
        Model(),
        seed=0,
        scatter_mm=0.0,
        resolution_mm=0.0,
    )
    return [session.opened, *session.readings]


def test_weight_hangs_on_the_vertical_bar_and_presses_when_turned_over() -> None:
    feet, lengths = np.diag([L] * 3), np.full(3, L)
    turned = Geometry(gravity=(0.0, 0.0, 1.0))
    assert pull_of_weight(Geometry(), feet, lengths) == pytest.approx([0, 0, 1], abs=1e-12)
    assert pull_of_weight(turned, feet, lengths) == pytest.approx([0, 0, -1], abs=1e-12)


def test_forces_balance_at_any_posture() -> None:
    feet, lengths = np.diag([340.0, 290.0, 280.0]), np.array([L, L + 1, L - 1])
    gravity = np.array([0.6, 0.0, -0.8])
    tool = trilaterate(feet, lengths, Geometry().side)
    pull = pull_of_weight(Geometry(gravity=tuple(gravity)), feet, lengths)
    towards_feet = (feet - tool) / lengths[:, None]
    assert pull @ towards_feet + gravity == pytest.approx(np.zeros(3), abs=1e-12)


def test_sag_lengthens_the_hanging_bar_and_follows_gravity() -> None:
    """At Zero leg z carries all: z gets longer by the value, so the tool goes down by it."""
    plan = at(0, 2, 0.0, 60.0)
    hanging = change("gravity_sag", "z", 0.05, plan)
    longer = Model(parameters_mm=(0, 0, 0, 0, 0, 0.05)).readings(plan) - Model().readings(plan)
    assert change("gravity_sag", "x", 0.05, at(0, 2, 0.0))[0] == pytest.approx(0.0, abs=1e-12)
    assert hanging[0] == pytest.approx(longer[0], abs=1e-12)
    turned = change("gravity_sag", "z", 0.05, plan, Geometry(gravity=(0.0, 0.0, 1.0)))
    assert turned == pytest.approx(-hanging, abs=1e-4)
    assert abs(hanging[1]) > 0.01


def test_taper_and_bow_follow_the_place_on_the_bar() -> None:
    """At +60 mm the point moved 60 mm towards the tool along a bar of 310.25 mm, and turned."""
    part = 0.5 - 60.0 / (L * np.cos(0.0))
    plan = at(0, 1, 60.0, 0.0)
    taper = change("leg_taper", "xy", 1.0, plan)
    assert taper[0] - taper[1] == pytest.approx(-0.060, abs=1e-3)
    bow = change("leg_bow", "xy", 0.2, plan)
    assert bow[1] == pytest.approx(0.2, abs=1e-12)
    assert bow[0] == pytest.approx(0.2 * 4 * part * (1 - part), abs=2e-3)
    assert change("leg_taper", "xz", 1.0, plan) == pytest.approx([0.0, 0.0])


def test_gain_and_tilt() -> None:
    plan = conditions([0, 0, 1], [1, 2, 0], [60.0] * 3)
    model = Model(parameters_mm=OFF)
    plain = model.readings(plan)
    gain = replace(model, effects=(EffectInstance(effect("gauge_gain"), "xy", (2.0,)),)).readings(
        plan
    )
    assert gain == pytest.approx(plain * [1.02, 1.0, 1.0])
    pairs = conditions([0] * 4, [1, 2, 1, 2], [60.0, 60.0, 0.0, 0.0])
    plain = model.readings(pairs)
    tilt = replace(model, effects=(EffectInstance(effect("gauge_tilt"), "xy", (10.0,)),)).readings(
        pairs
    )
    moved = tilt - plain
    assert moved[[1, 3]] == pytest.approx([0.0, 0.0])
    along, across = plain[[0, 1]] - plain[[2, 3]]
    expected = np.sin(0.010) * across + (np.cos(0.010) - 1.0) * along
    assert moved[0] - moved[2] == pytest.approx(expected, abs=1e-12)


def test_three_distances_are_what_six_shifts_show() -> None:
    """Shifts that move all axes alike are joint offsets; one is worked out by hand.

    Axis x shifted towards y by 1 is y of z to x: zx -1; its change of the readings in proportion.
    """
    plan = at(0, 1, 0.0, 60.0, -100.0)
    model = Model()
    shifts = {
        place: change("axis_offset", place, 1e-3, plan)
        for place in ("xy", "xz", "yx", "yz", "zx", "zy")
    }
    base = derivatives(model.geometry, model.parameters_mm, TAKEN)
    free = np.hstack([base[:, :3], incidence(TAKEN.mount)])
    for first, second in (("xy", "zy"), ("xz", "yz"), ("yx", "zx")):
        sum_of_shifts = change("axis_offset", first, 1e-3, TAKEN) + change(
            "axis_offset", second, 1e-3, TAKEN
        )
        fitted = free @ np.linalg.lstsq(free, sum_of_shifts, rcond=1e-9)[0]
        assert fitted == pytest.approx(sum_of_shifts, abs=1e-7)
    assert (shifts["xy"][1:] - shifts["xy"][0]) / 1e-3 == pytest.approx([-0.1934, 0.3223], abs=1e-4)
    for pair, plus, minus in (("xy", "xz", "yz"), ("yz", "yx", "zx"), ("zx", "zy", "xy")):
        distance = change("axis_offset", pair, 1e-3, plan, parameter="distance")
        half = (shifts[plus] - shifts[minus]) / 2
        assert distance == pytest.approx(half, abs=1e-9)


def test_a_single_shifted_axis_is_two_distances() -> None:
    """What shifts of axis x leave beside offsets is in the span of its two distances, and alone."""
    model = Model(parameters_mm=OFF)
    free = np.hstack(
        [
            derivatives(model.geometry, model.parameters_mm, TAKEN)[:, :3],
            incidence(TAKEN.mount),
        ]
    )
    by_place = {c.where: c for c in candidates(model, TAKEN) if c.id == "axis_offset"}
    shift = replace(model, effects=(EffectInstance(AxisOffset(), "xz", (1e-4,)),))
    slope = (shift.readings(TAKEN) - model.readings(TAKEN)) / 1e-4
    value = np.linalg.lstsq(np.hstack([by_place["xy"].columns, free]), slope, rcond=1e-10)[0]
    assert value[0] == pytest.approx(1.0, abs=1e-4)
    value = np.linalg.lstsq(np.hstack([by_place["x"].columns, free]), slope, rcond=1e-10)[0]
    assert value[:2] == pytest.approx([1.0, 0.0], abs=1e-4)


def test_drift_with_time_and_temperature() -> None:
    rate = change("thermal_drift", "y", 5.0, TAKEN)
    assert rate == pytest.approx(np.where(TAKEN.axis == 1, 5e-3 * TAKEN.time_s / 3600, 0.0))
    warm = change("thermal_drift", "y", 5.0, TAKEN, parameter="per_kelvin")
    assert warm == pytest.approx(
        np.where(TAKEN.axis == 1, 5e-3 * (TAKEN.temperature_c - 20.0), 0.0)
    )
    untold = replace(TAKEN, time_s=np.where(TAKEN.mount == 0, np.nan, TAKEN.time_s))
    assert change("thermal_drift", "y", 5.0, untold)[untold.mount == 0] == pytest.approx(0.0)


def test_a_stand_drifts_alone() -> None:
    rate = change("stand_drift", "yx", 5.0, TAKEN)
    there = (TAKEN.leg == 1) & (TAKEN.axis == 0)
    assert rate == pytest.approx(np.where(there, 5e-3 * TAKEN.time_s / 3600, 0.0))


@pytest.mark.parametrize("displacement", [60.0, -100.0])
def test_a_guide_bent_like_an_s(displacement: float) -> None:
    """By hand: 0.02 mm at 100 mm is 0.02 · 0.6³ = 0.00432 mm at 60 mm, -0.02 at -100 mm."""
    sideways = {60.0: 0.00432, -100.0: -0.02}[displacement]
    change_mm = change("straightness_cubic", "xy", 0.02, at(0, 1, displacement))[0]
    expected = reads(0, 1, displacement, sideways_mm=sideways) - reads(0, 1, displacement)
    assert change_mm == pytest.approx(expected, abs=1e-9)


def test_a_tip_on_a_round_bar() -> None:
    """By hand: across by z on a radius of 10 mm, 100 / m, it reads z² / 20 mm less."""
    model = Model(parameters_mm=(0.0, 0.0, 9.0, 0.0, 0.0, 0.0))
    plan, across = at(0, 1, 60.0), at(0, 2, 60.0)
    z = float(model.readings(across)[0])
    assert abs(z) > 0.9
    reading_mm = model.with_effects((EffectInstance(effect("tip_on_round_bar"), "xy", (100.0,)),))
    change_mm = reading_mm.readings(plan)[0] - model.readings(plan)[0]
    assert change_mm == pytest.approx(-(z**2) / 20.0, rel=1e-9)
    assert reading_mm.readings(at(0, 1, 0.0)) == pytest.approx(
        model.readings(at(0, 1, 0.0)), abs=1e-12
    )


def test_an_indicator_lags_by_half_either_way() -> None:
    for approach, expected in ((1.0, -0.002), (-1.0, 0.002), (0.0, 0.0)):
        change_mm = change("gauge_hysteresis", "xy", 4.0, at(0, 1, 22.0, approach=approach))
        assert change_mm[0] == pytest.approx(expected, abs=1e-12)
        assert change("gauge_hysteresis", "xy", 4.0, at(0, 2, 22.0))[0] == 0.0


def warm(kelvins: float, plan: Conditions) -> Conditions:
    return replace(plan, temperature_c=np.full(len(plan), 20.0 + kelvins))


def test_a_bar_grows_with_temperature() -> None:
    """System (11): a longer bar x reads -b along y on itself, b = (0.5 + sin a) tan a = 0.1367."""
    plan = warm(2.0, at(0, 1, 60.0, 0.0))
    far, zero = change("thermal_growth", "x", 3.0, plan, parameter="bar_per_kelvin")
    assert (far - zero) / 0.006 == pytest.approx(-0.1367, abs=2e-4)
    cold = at(0, 1, 60.0, 0.0)
    assert change("thermal_growth", "x", 3.0, cold, parameter="bar_per_kelvin") == pytest.approx(0)


def test_a_screw_grows_from_its_bearing() -> None:
    """By hand: 11.5 µm/m K, 2 K, carriage x at sqrt(L² - 60²) = 304.39 mm: 0.0070 mm further."""
    further = 11.5e-6 * 2.0 * np.sqrt(L**2 - 60.0**2)
    assert further == pytest.approx(0.0070, abs=1e-5)
    plan = warm(2.0, at(1, 0, 60.0))
    change_mm = change("thermal_growth", "x", 11.5, plan, parameter="screw_per_kelvin")[0]
    expected = reads(1, 0, 60.0, along_mm=(further, 0.0, 0.0)) - reads(1, 0, 60.0)
    assert change_mm == pytest.approx(expected, abs=1e-9)


def test_clearance_follows_the_pull() -> None:
    """By hand: at +60 mm bar z holds the weight, leans and pulls bar x with tan a = 0.1971.

    Bar x is then longer by half the clearance, but for 0.5 % of floating; it reads -b of it.
    """
    far, zero = change("joint_clearance", "x", 0.01, at(0, 1, 60.0, 0.0))
    longer = 0.005 * 0.1971 / np.hypot(0.1971, 0.02)
    assert (far - zero) / longer == pytest.approx(-0.1367, abs=2e-4)
    back, _ = change("joint_clearance", "x", 0.01, at(0, 1, -60.0, 0.0))
    pressed = change("leg_length", "x", -longer, at(0, 1, -60.0, 0.0))
    shorter = replace(Model(), parameters_mm=(0, 0, 0, -longer, 0, 0)).readings(at(0, 1, -60.0))
    assert back == pytest.approx(shorter[0] - Model().readings(at(0, 1, -60.0))[0], abs=2e-6)
    assert pressed[0] == pytest.approx(back, abs=2e-6)


def test_remedies_tell_what_to_enter_and_at_which_joints() -> None:
    """Once for places of equal values; a shim goes against the shift."""
    play = [EffectInstance(Backlash(), leg, (0.06,)) for leg in "xz"]
    assert remedies([*play, EffectInstance(Backlash(), "y", (0.02,))]) == (
        "joint x, z: BACKLASH = +0.06 mm",
        "joint y: BACKLASH = +0.02 mm",
    )
    assert remedies([EffectInstance(Backlash(), "y", (-0.02,))]) == (
        "nothing to enter: no machine has -0.02 mm of this",
    )
    (remedy,) = remedies([EffectInstance(AxisOffset(), "zy", (-0.12,))])
    assert remedy.startswith("axis z: the kinematics of export --format linuxcnc-kins")
    assert remedy.endswith("or shim it by -0.12 mm against y")
    (remedy,) = remedies([EffectInstance(AxisDistance(), "zx", (0.2,))])
    assert remedy.endswith("or shim axis z against y by +0.2 mm")


@pytest.mark.parametrize(
    ("deviation", "words"), [(0.0, "-7.146 %"), (11.0, "-7 %"), (0.12, "-7.15 %"), (90.0, "-10 %")]
)
def test_a_remedy_has_no_more_digits_than_its_uncertainty(deviation: float, words: str) -> None:
    """Before: -7.146 % beside a gain of -7 ± 22 %; the last digit is the second one of ±."""
    law = next(law for law in EVERY if law.id == "gauge_gain")
    (remedy,) = remedies([EffectInstance(law, "xy", (-7.146,), (deviation,))])
    assert remedy.endswith(f"it is {words} off")


def test_every_effect_says_what_to_do() -> None:
    for law in EVERY:
        place = "xy" if law.stage != Stage.ACTUATOR else "x"
        (remedy,) = remedies([EffectInstance(law, place, (1.0,) * len(law.parameters))])
        assert "{" not in remedy, law.id


def test_an_indicator_has_no_law_for_contacts_and_changes_none() -> None:
    """A gain of 100 % leaves the height of a contact as it is; with an indicator it doubles."""
    ids = {law.id for law in effects_of(EVERY, DELTA) if law.places(CONTACTS)}
    assert "plate_tilt" in ids
    assert not ids & {"gauge_gain", "gauge_tilt", "gauge_hysteresis", "stand_drift"}
    gain = EffectInstance(effect("gauge_gain"), "tz", (100.0,))
    model = Model(DELTA, OFF)
    with_gain = replace(model, effects=(gain,))
    assert with_gain.readings(CONTACTS) == pytest.approx(model.readings(CONTACTS), abs=1e-12)
    assert with_gain.readings(PLATE) == pytest.approx(2.0 * model.readings(PLATE), abs=1e-9)


def test_a_plate_that_falls_towards_x_is_further_from_the_tool_there() -> None:
    tilt = EffectInstance(effect("plate_tilt"), "tz", (3.0, 0.0))
    place = [[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 50.0, 0.0]]
    plan = tool_conditions(place)
    plan = replace(plan, contact=np.ones(3, dtype=np.bool_))
    height = replace(Model(DELTA), effects=(tilt,)).readings(plan)
    assert height == pytest.approx([0.0, 0.150, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ("bow_first_at_100mm", [0.0, 0.025, 0.0, 0.016]),
        ("bow_second_at_100mm", [0.0, 0.0, 0.025, 0.009]),
        ("bow_twist_at_100mm", [0.0, 0.0, 0.0, 0.024]),
        ("bow_round_at_100mm", [0.0, 0.025, 0.025, 0.025]),
    ],
)
def test_the_tool_is_higher_over_a_plate_that_falls_outwards(
    shape: str, expected: list[float]
) -> None:
    """0.1 mm at 100 mm: 0.1 (x/100)^2, 0.1 (y/100)^2, 0.2 x y/100^2."""
    plan = tool_conditions([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 50.0, 0.0], [40.0, 30.0, 0.0]])
    plan = replace(plan, contact=np.ones(4, dtype=np.bool_))
    height = change("plate_bow", "tz", 0.1, plan, DELTA, shape)
    assert height == pytest.approx(expected, abs=1e-9)


def test_a_probe_at_the_tool_does_not_tilt() -> None:
    (tilt,) = [law for law in EVERY if law.id == "platform_tilt"]
    assert tilt.places(PROBED) == ("x", "y", "z")
    assert tilt.places(CONTACTS) == ()


@pytest.mark.parametrize("lead_mm", STANDARD_LEADS_MM)
def test_both_amplitudes_of_a_screw_are_as_usual_and_as_large_at_most(lead_mm: float) -> None:
    """Where its turn begins is by chance."""
    sine, cosine = ActuatorCyclic(lead_mm).parameters
    assert (sine.name, cosine.name) == (f"sine_{lead_mm:g}mm", f"cosine_{lead_mm:g}mm")
    assert replace(sine, name="") == replace(cosine, name="")


@pytest.mark.parametrize(
    ("law", "power"),
    [(Straightness(), 2), (StraightnessOfThirdOrder(), 3), (StraightnessOfFourthOrder(), 4)],
)
def test_a_bent_guide_is_off_by_its_value_at_100_mm(
    law: Straightness, power: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    travel = np.array([-100.0, -50.0, 0.0, 50.0, 100.0, 200.0])
    monkeypatch.setattr(drives, "travel_mm", lambda *_: travel)
    off = law.off(Acting(np.zeros(0), cast(Flow, None), "xy", (0.3,)))
    side = -1.0 if power == 3 else 1.0
    assert off == pytest.approx(
        [0.3 * side, off[3] * side, 0.0, 0.3 / 2**power, 0.3, 0.3 * 2**power]
    )


class OnOneSide(Straightness):
    """No number behind 80 mm on the negative side, where a machine goes, too."""

    id = "one_side"

    def off(self, at: Acting) -> NDArray[Any]:
        return np.asarray(at.values[0] * np.sqrt(travel_mm(at.flow, at.leg) + 80.0))


def test_a_law_without_a_number_at_one_end_of_the_travel_is_refused() -> None:
    assert fault_of(Straightness()) == ""
    with pytest.raises(UnreachablePosture, match="nan"):
        fault_of(OnOneSide())


@pytest.mark.parametrize("name", ["kind", "stage"])
def test_a_law_of_a_kind_or_stage_in_words_is_refused(name: str) -> None:
    law = type("Wordy", (Straightness,), {"id": "wordy", name: "machine"})
    assert fault_of(law()) == "wordy: kind or stage that is not a Kind or a Stage"


@pytest.mark.parametrize("law", [*CATALOGUE, *BESIDE_CATALOGUE], ids=lambda law: law.id)
def test_a_law_that_was_sent_to_another_process_is_the_same(law: Effect) -> None:
    """Columns and sizes are kept under a law and its place."""
    received = pickle.loads(pickle.dumps(law))
    assert received is not law
    assert {law: 1}[received] == 1
