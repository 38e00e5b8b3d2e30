"""Where lines of drives lie, as parameters with tolerances: of an Orthoglide and of towers.

Machines are drawn as the machine file expects them, by `calib.tripod.pipeline`; what a printer's
contacts show has a simulation of its own in `tests.blind.printers`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import least_squares

from calib.arrays import FloatArray, observe, tool_conditions
from calib.posterior.cells import Cells, SessionCase
from calib.posterior.correction import ToolOff
from calib.posterior.entered import nothing_entered
from calib.posterior.posterior import posterior
from calib.posterior.problem import PosteriorProblem
from calib.posterior.readings import LENGTHS
from calib.posterior.statements import AS_STATED, NOTHING, Statement
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.drives import (
    ActuatorScale,
    AxisDistance,
    AxisLean,
    AxisOffset,
    AxisSquareness,
    geometry_tolerances,
)
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from protocols.machine import load_machine
from tests.blind.printers import BELIEVED, PERFECT, RINGS
from tests.calib.posterior.sessions import SWEEP, case
from tests.conftest import LONG

LINES = geometry_tolerances(Geometry(), 0.05, 0.2, 0.05)
NAMED = {statement.name: statement for statement in AS_STATED}
FIRMWARE = {statement for statement in AS_STATED if statement.of_firmware}


def of_lines(seed: int) -> tuple[SessionCase, dict[str, float]]:
    """A session of a machine whose lines are off as its file expects, and by how much."""
    generator = np.random.default_rng([7, seed])
    hidden = {law: float(generator.normal(0.0, size)) for law, size in LINES.items()}
    effects = [EffectInstance(*law, (value,)) for law, value in hidden.items()]
    session = replace(case(SWEEP, *effects, seed=seed), geometry=LINES)
    return session, {f"{law.id} {place}": value for (law, place), value in hidden.items()}


@pytest.mark.parametrize(
    ("geometry", "laws"),
    [
        (Geometry(), (AxisDistance, AxisSquareness, ActuatorScale)),
        (load_machine("linear-delta").geometry(), (AxisOffset, AxisLean, ActuatorScale)),
    ],
    ids=["legs", "towers"],
)
def test_parameters_of_lines_are_those_that_readings_can_see(
    geometry: Geometry, laws: tuple[type, ...]
) -> None:
    tolerances = geometry_tolerances(geometry, 0.3, 1.0, 2.0)
    assert {type(law) for law, _ in tolerances} == set(laws)
    assert len(tolerances) == (9 if geometry.common_zero else 14)
    assert geometry_tolerances(geometry, 0.0, 1.0, 0.0).keys() < tolerances.keys()
    assert not geometry_tolerances(geometry, 0.0, 0.0, 0.0)


@LONG
def test_lines_within_their_tolerance_are_measured_and_have_no_name() -> None:
    """Of 8 machines with 9 parameters each: 95 % within 2 u, and u less than the tolerance.

    Travel is not measured: readings are taken where the carriages believe to be.
    """
    distances, shares = [], []
    for seed in range(8):
        session, hidden = of_lines(seed)
        result = posterior([session])
        weight = sum(m.weight for m in result.models if m.members)
        shares.append(weight)
        for (law, place), tolerance in LINES.items():
            mean, deviation = result.value_of((law, place))
            assert deviation < (1.2 if law == ActuatorScale() else 0.75) * tolerance
            distances.append((mean - hidden[f"{law.id} {place}"]) / deviation)
    distance = np.abs(distances)
    assert (distance < 2.0).sum() >= 63, "72 of them: 95 %, less three standard deviations"
    assert math.sqrt(float((distance**2).mean())) < 1.3
    assert np.median(shares) < 0.5


def test_what_no_reading_shows_stays_at_its_tolerance_and_is_in_the_bound() -> None:
    """The tool on a sphere about a carriage that rests: nothing is seen of that one's travel."""
    x, y = np.meshgrid(np.linspace(-40.0, 40.0, 5), np.linspace(-40.0, 40.0, 5))
    length = Geometry().leg_length_mm[2]
    z = length - np.sqrt(length**2 - x**2 - y**2)
    places = np.tile(np.stack([x, y, z], axis=-1).reshape(-1, 3), (2, 1))
    observations = observe(tool_conditions(places), np.zeros(len(places)))
    resting = replace(case(observations, seed=4), geometry=LINES)
    result, reference = posterior([resting]), posterior([replace(resting, geometry={})])
    names = {(component.id, component.where) for component in result.components}
    assert ("actuator_scale", "x") in names
    assert ("actuator_scale", "z") not in names, "else the test shows nothing"
    assert result.value_of((ActuatorScale(), "z")) == pytest.approx((0.0, 0.05))
    less, larger = (
        outcome.tool_errors["touched-off"].bound_mm(nothing_entered(outcome))
        for outcome in (reference, result)
    )
    assert less < larger


def test_without_tolerances_the_same_machine_has_a_name() -> None:
    session, _ = of_lines(0)
    result = posterior([replace(session, geometry={})])
    assert sum(m.weight for m in result.models if m.members) > 0.99


def test_no_contact_shows_a_turn_of_all_towers() -> None:
    """From the last tower it is measured: one of six directions across the towers is no parameter.

    By a simulation of its own.
    """

    def heights_mm(*round_mm: float) -> FloatArray:
        parts = replace(PERFECT, round_mm=np.array(round_mm))
        return np.array([parts.met(BELIEVED, place)[2] for place in RINGS])

    single_mm = heights_mm(0.1, 0.0, 0.0) - heights_mm(0.0, 0.0, 0.0)
    turned_mm = heights_mm(0.1, 0.1, 0.1) - heights_mm(0.0, 0.0, 0.0)
    assert np.ptp(turned_mm) < 1e-3 * np.ptp(single_mm)
    towers = load_machine("linear-delta").geometry()
    places = [place for law, place in geometry_tolerances(towers, 0.3, 0.0, 0.0)]
    assert places == ["xr", "xt", "yr", "yt", "zr"]


def of_contacts() -> SessionCase:
    """Contacts of a sound printer, by nothing but noise of 0.01 mm."""
    towers = load_machine("linear-delta")
    places = [*product((-60.0, 0.0, 60.0), (-60.0, 0.0, 60.0), (0.0,))] * 2
    over_plate = tool_conditions(places)
    return replace(
        case(SWEEP),
        model=Model(towers.geometry()),
        observations=observe(over_plate, np.random.default_rng(3).normal(0.0, 0.01, len(places))),
        geometry=towers.geometry_tolerances(),
    )


@LONG
def test_a_bound_rests_on_no_case_of_firmware() -> None:
    result = posterior([of_contacts()])
    rest = result.for_bounds
    assert {model.as_stated for model in result.models} > FIRMWARE
    assert len(rest.models) == sum(m.as_stated not in FIRMWARE for m in result.models)
    assert math.fsum(model.weight for model in rest.models) == pytest.approx(1.0)
    off = ToolOff(result, nothing_entered(result))
    assert off.bound_mm == ToolOff(rest, off.values).bound_mm


@LONG
def test_a_bound_holds_a_turn_of_all_towers() -> None:
    """Of three towers off round the plate by s each: their mean is off by s / sqrt(3)."""
    session = of_contacts()
    result = posterior([session])
    radius_mm = np.hypot(*session.model.geometry.anchors[:, :2].T)
    across_mm = load_machine("linear-delta").across_tolerance_mm
    turned = across_mm / math.sqrt(3.0) / radius_mm.mean()
    for model, in_field in zip(result.models, result.models_in_field, strict=True):
        free = model.as_stated not in (NAMED["lines"], NAMED["lines, bars"])
        assert math.sqrt(in_field.variance(-1)) == pytest.approx(turned * free, rel=1e-9)


@LONG
def test_what_firmware_fits_is_a_case_of_towers_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    statements: list[Statement] = []
    work_out = Cells.of_all

    def note(cases: Sequence[SessionCase]) -> list[Cells]:
        statements.append(cases[0].as_stated)
        return work_out(cases)

    monkeypatch.setattr(Cells, "of_all", note)
    for session, kept in ((of_lines(0)[0], False), (of_contacts(), True)):
        statements.clear()
        posterior([session])
        assert statements[0] == NOTHING
        assert {*statements} >= {*AS_STATED} - FIRMWARE
        assert {*statements} & FIRMWARE == (FIRMWARE if kept else set())
    assert math.fsum(statement.prior for statement in AS_STATED) == pytest.approx(1.0)


def test_bars_of_one_jig_may_be_off_together_alone() -> None:
    tolerance_mm = np.repeat([1.0, 0.4], 3)
    session = replace(case(SWEEP), tolerance_mm=tolerance_mm, length_correlation=0.7)
    alike = np.ones((3, 3))
    stated_mm2 = 0.01**2 * np.eye(3)
    expected = {
        "lines": 0.4**2 * (0.3 * np.eye(3) + 0.7 * alike),
        "directions, plate, single bars": stated_mm2 + 0.7 * 0.4**2 * alike,
        "directions, plate, bars": stated_mm2,
        "directions, bars": stated_mm2,
        "lines, bars": stated_mm2,
    }
    for name, bars_mm2 in expected.items():
        root = replace(session, as_stated=NAMED[name]).base_root
        assert (root @ root.T)[3:, 3:] == pytest.approx(bars_mm2, rel=1e-9, abs=1e-12)


def _log_determinant(columns: FloatArray) -> float:
    return float(np.linalg.slogdet(np.eye(len(columns)) + columns @ columns.T)[1])


def test_ways_are_weighed_with_what_their_freedom_costs() -> None:
    """The matrix determinant lemma backwards: of rows as they are, no triangle, no basis."""
    session, _ = of_lines(1)
    for statement in AS_STATED:
        cells = Cells.of(replace(session, as_stated=statement))
        problem = PosteriorProblem((cells,), CATALOGUE)
        columns = problem.rows.base * problem.rows.spread
        blocks = [columns[:, LENGTHS:], columns[:, :LENGTHS], problem.base[:, columns.shape[1] :]]
        cost = -0.5 * (_log_determinant(np.hstack(blocks)) - _log_determinant(blocks[0]))
        assert problem.log_of_lines == pytest.approx(cost, abs=1e-6)


def test_towers_are_off_alike() -> None:
    delta = load_machine("linear-delta")
    geometry = delta.geometry()
    session = replace(case(SWEEP), geometry=geometry_tolerances(geometry, 0.4, 1.0, 2.0))
    covariance = session.lines_root @ session.lines_root.T
    assert np.sqrt(covariance.diagonal()) == pytest.approx([*session.geometry.values()])
    names = [place if law.id == "axis_offset" else "" for law, place in session.geometry]
    xr, yr, xt = (names.index(place) for place in ("xr", "yr", "xt"))
    assert covariance[xr, yr] == pytest.approx(0.8 * 0.4**2)
    assert covariance[xr, xt] == 0.0


def test_the_fit_beside_lines_is_the_likeliest_machine() -> None:
    """Against one least-squares fit of all there is: parameters, lines as effects, and zeros."""
    session, _ = of_lines(1)
    cells = Cells.of(session)
    assert cells.serial == 0.0
    means, laws = cells.means, list(LINES)

    def residuals(unknown: FloatArray) -> FloatArray:
        effects = tuple(
            EffectInstance(*law, (value,)) for law, value in zip(laws, unknown[6:15], strict=True)
        )
        machine = session.model.with_parameters(unknown[:6]).with_effects(effects)
        off_mm = means.value_mm - machine.readings(means) - unknown[15:][means.mount]
        expected = unknown[:15] / np.concatenate([session.spread_mm, [*LINES.values()]])
        return np.concatenate([off_mm / np.sqrt(cells.variance_mm2), expected])

    start = np.zeros(15 + means.mount_count)
    fit = least_squares(residuals, start, x_scale="jac", xtol=1e-12, ftol=1e-12)
    slopes: FloatArray = np.asarray(fit.jac, dtype=np.float64)
    deviation = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))[:6]
    away = (np.array(cells.model.parameters_mm) - fit.x[:6]) / deviation
    assert np.abs(away).max() < 0.1
    assert np.abs(fit.x[:6] / deviation).max() > 3.0
