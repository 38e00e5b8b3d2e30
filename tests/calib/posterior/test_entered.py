"""What the tool keeps with values entered; an adopted model as the start; parts that are absent."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from calib.arrays import FloatArray, observe
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import SessionCase
from calib.posterior.correction import HOLDS, Holds, ToolOff, correction, projector_of
from calib.posterior.entered import (
    OFFSETS,
    nothing_entered,
    offset_uncertainties_mm,
    tower_values,
    values_of,
)
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.posterior.tool import FRAMES, Frame
from calib.tripod.effects.drives import ActuatorCyclic, AxisOffset, AxisSquareness, Backlash
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import direct, inverse
from calib.tripod.movements import with_first_movements
from calib.tripod.pipeline import Model
from calib.tripod.towers import ON_ONE_CIRCLE, entered
from calib.tripod.workspace import workspace_points
from tests.builders import conditions_of, observed
from tests.calib.tripod.test_linear_delta import rings
from tests.tripods import DELTA, ORTHOGLIDE

FIGURES = IndicatorFigures(repeatability_mm=0.002)
TOLERANCES = np.array([2.0, 2.0, 2.0, 0.1, 0.1, 0.1])
OFFSETS_MM = (0.8, -1.3, 0.4)
PLAY = EffectInstance(Backlash(), "y", (0.06,))


def case(*hidden: EffectInstance, in_model: tuple[EffectInstance, ...] = ()) -> SessionCase:
    """A session of a machine with offsets and these effects, against a model with others."""
    conditions = with_first_movements(ORTHOGLIDE, conditions_of("two-station"))
    truth = Model(ORTHOGLIDE, (*OFFSETS_MM, 0.0, 0.0, 0.0), hidden)
    noise = np.random.default_rng(5).normal(scale=0.002, size=len(conditions))
    data = observe(conditions, truth.readings(conditions) + noise)
    return SessionCase(Model(ORTHOGLIDE).with_effects(in_model), data, FIGURES, TOLERANCES)


@pytest.fixture(scope="module")
def plain() -> Posterior:
    return posterior([case(PLAY)])


def test_values_of_a_correction_are_those_of_its_model(plain: Posterior) -> None:
    entry = correction(plain, "tables")
    assert values_of(plain.field, entry.model) == pytest.approx(entry.off.values)


def test_a_correction_leaves_less_than_the_least_without_it(plain: Posterior) -> None:
    off = correction(plain, "play", "aligned").off
    now = ToolOff(plain, nothing_entered(plain))
    for frame in FRAMES:
        assert off.least_mm[frame] < off.bound_mm[frame] < now.least_mm[frame]
        assert now.least_mm[frame] < now.bound_mm[frame]


def test_what_is_not_known_is_no_failure(plain: Posterior) -> None:
    """With everything entered that is expected nothing is left that shows."""
    assert set(ToolOff(plain, plain.mean).least_mm.values()) == {0.0}


def test_parts_that_a_controller_does_not_take_are_left_out_with_the_reason(
    plain: Posterior,
) -> None:
    """All of a kind, or one; what they did goes into the others as far as it can."""
    entry = correction(plain, "play", absent={"play of y": "worn"})
    assert "worn" in [
        omission.reason for omission in entry.left_out if omission.part == "play of y"
    ]
    assert entry.off.values[plain.field.columns[Backlash(), "y"]] == pytest.approx([0.0])
    tables = correction(plain, "tables", absent={"table": "no tables here", "play": "no play"})
    reasons = {omission.part: omission.reason for omission in tables.left_out}
    assert {reasons[f"table of {leg}"] for leg in "xyz"} == {"no tables here"}
    assert tables.model.effects == ()
    alone = correction(plain, "offsets")
    assert tables.off.values == pytest.approx(alone.off.values)


def test_what_gains_nothing_is_left_out() -> None:
    """Where nothing but offsets is hidden, a controller that holds more is given no more."""
    reasons = {
        omission.part: omission.reason
        for omission in correction(posterior([case()]), "tables").left_out
    }
    assert reasons["play"].startswith("it lowers the expected square")


@pytest.mark.parametrize("holds", HOLDS[:2])
def test_an_effect_that_the_model_has_is_entered_as_far_as_it_can_be(
    plain: Posterior, holds: Holds
) -> None:
    """The same values whether the play is found or known: it is entered once."""
    with_adopted = posterior([case(PLAY, in_model=(PLAY,))])
    assert with_adopted.start[with_adopted.field.columns[Backlash(), "y"]] == pytest.approx([0.06])
    entries = correction(with_adopted, holds), correction(plain, holds)
    assert entries[0].off.values[:3] == pytest.approx(entries[1].off.values[:3], abs=0.003)
    play = [
        entry.off.values[result.field.columns[Backlash(), "y"]]
        for entry, result in zip(entries, (with_adopted, plain), strict=True)
    ]
    assert play[0] == pytest.approx(play[1], abs=0.003)


def test_a_lead_that_no_library_has_is_known_of_a_model() -> None:
    odd = EffectInstance(ActuatorCyclic(7.3), "x", (12.0, 0.0))
    with_adopted = posterior([case(odd, in_model=(odd,))])
    entry = correction(with_adopted, "tables")
    column = entry.off.values[with_adopted.field.columns[ActuatorCyclic(7.3), "x"]]
    assert column == pytest.approx([12.0, 0.0], abs=0.5)


def test_squareness_of_a_model_goes_into_the_axes() -> None:
    lean = EffectInstance(AxisSquareness(), "xy", (2.0,))
    with_adopted = posterior([case(lean, in_model=(lean,))])
    offsets, axes = (
        correction(with_adopted, holds, "aligned") for holds in ("offsets", "kinematics")
    )
    assert axes.off.bound_mm["aligned"] < 0.2 * offsets.off.bound_mm["aligned"]


def test_how_well_offsets_are_known_is_that_of_drawn_machines(plain: Posterior) -> None:
    """95 % half widths of the projected offsets against 200,000 draws."""
    into = projector_of(plain.field, OFFSETS, "touched-off")
    generator, drawn = np.random.default_rng(1), []
    for model in plain.models_in_field:
        count = round(200_000 * model.weight)
        covariance = model.inflated**2 * model.base + model.root @ model.root.T
        spread = np.linalg.cholesky(into @ covariance @ into.T)
        drawn.append(into @ model.mean + generator.normal(size=(count, 3)) @ spread.T)
    off = np.concatenate(drawn) - into @ plain.mean
    _, found_mm = offset_uncertainties_mm(plain, "touched-off")
    assert found_mm == pytest.approx(np.quantile(np.abs(off), 0.95, axis=0), rel=0.03)


def test_towers_of_firmware_stand_in_the_field_where_they_are() -> None:
    """Switches, bars and places that the firmware holds wholly: what it is told is the truth."""
    conditions = rings(repeats=2)
    moved = tuple(
        EffectInstance(AxisOffset(tuple(DELTA.across)), place, (mm,))
        for place, mm in (("xt", 0.2), ("yt", -0.1), ("zr", 0.3))
    )
    truth = Model(DELTA, (0.1, -0.2, 0.1, 0.05, -0.05, 0.02), moved)
    data = observe(conditions, Model(DELTA).readings(conditions))
    tolerance = np.array([1.0] * 3 + [0.3] * 3)
    result = posterior([SessionCase(Model(DELTA), data, FIGURES, tolerance)])
    rows = result.field.rows
    by_towers = rows @ tower_values(result, entered(truth, ON_ONE_CIRCLE))
    expected = rows @ values_of(result.field, truth)
    assert np.abs(expected).max() > 0.15
    assert np.abs(by_towers - expected).max() < 0.005


def test_a_map_shows_what_the_machine_does_at_each_place() -> None:
    """Against its exact kinematics, less what it does on average where the tool is touched off."""
    parameters_mm = np.array([0.3, -0.2, 0.1, 0.03, 0.0, -0.02])

    def moved_mm(places_mm: FloatArray) -> FloatArray:
        joint_mm = inverse(ORTHOGLIDE, places_mm) + parameters_mm[:3]
        return np.asarray(direct(ORTHOGLIDE, joint_mm, parameters_mm[3:]) - places_mm)

    readings = observed(
        parameters_mm.tolist(), conditions_of("two-station"), scatter_mm=1e-4, seed=1
    )
    figures = IndicatorFigures(repeatability_mm=1e-4)
    with_adopted = posterior(
        [SessionCase(Model(), readings, figures, np.array([2.0] * 3 + [0.1] * 3))]
    )
    off = ToolOff(with_adopted, nothing_entered(with_adopted))
    on_average = moved_mm(workspace_points(ORTHOGLIDE)).mean(axis=0)
    frames: dict[Frame, FloatArray] = {"machine": np.zeros(3), "touched-off": on_average}
    for frame, free_mm in frames.items():
        drawn = off.maps(frame)[0]
        for i, j in product(range(5), repeat=2):
            place = np.array([drawn.coordinate_mm[j], drawn.up_mm[i], 0.0])
            stands = bool(ORTHOGLIDE.stands(place))
            true_mm = float(np.linalg.norm(moved_mm(place) - free_mm)) if stands else np.nan
            assert drawn.value[i, j] == pytest.approx(true_mm, abs=0.004, nan_ok=True)


def test_the_mean_of_the_tool_over_the_workspace_is_that_of_its_places(plain: Posterior) -> None:
    field, values = plain.field, correction(plain, "offsets").off.values
    for frame in FRAMES:
        rows = field.rows_at(workspace_points(field.geometry), frame)
        errors = plain.tool_errors[frame]
        square = np.einsum("wpif,fg,wpig->wp", rows, errors.moment(values), rows).mean()
        assert square + errors.unplaced_mm2 == pytest.approx(errors.expected_mm(values) ** 2)
