"""What may be true, and how likely each is before any reading."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import FloatArray
from calib.posterior.library import SHARES, SIDED, Component, library, something_else
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.empirical import EMPIRICAL
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from tests.calib.diagnosis.diagnosed_sessions import SWEEP

COMPONENTS = library([(Model(), SWEEP)])


@pytest.mark.parametrize("kind", ["named", "beside", "nameless"])
def test_priors_of_a_kind_are_its_share(kind: str) -> None:
    total = math.fsum(
        math.exp(component.log_prior) for component in COMPONENTS if component.kind == kind
    )
    assert total == pytest.approx(SHARES[kind])


def test_names_of_one_kind_are_equally_likely() -> None:
    ids = {component.id for component in COMPONENTS if component.kind == "named"}
    sums = [math.fsum(math.exp(o.log_prior) for o in COMPONENTS if o.id == name) for name in ids]
    assert sums == pytest.approx([SHARES["named"] / len(ids)] * len(ids))


def test_what_is_left_out_of_the_effects_is_not_known_at_all() -> None:
    fewer = tuple(effect for effect in CATALOGUE if effect.id != "leg_bow")
    ids = {component.id for component in library([(Model(), SWEEP)], fewer)}
    assert "leg_bow" not in ids
    assert {"leg_taper", "joint_clearance"} <= ids


def test_a_guide_may_be_bent_one_way_only() -> None:
    """Both ways of a drive together, and each alone with the same derivatives."""
    bent = {
        component.where: component.candidate
        for component in COMPONENTS
        if component.id == "straightness"
    }
    assert {"x", "xy", "xz"} <= set(bent)
    total, first, second = bent["x"], bent["xy"], bent["xz"]
    assert total is not None
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(total.columns, np.hstack([first.columns, second.columns]))
    (effect,) = first.effects([0.3])
    assert (effect.place, effect.values) == ("xy", (0.3,))


def test_laws_without_a_name_do_no_more_on_a_machine_ten_times_as_large() -> None:
    """Derivatives times units at the same places of both: alike, as of two similar figures."""
    large = Geometry((3102.5,) * 3, 600.0, -1000.0, 800.0, 310.0)
    farther = replace(SWEEP, displacement_mm=10.0 * SWEEP.displacement_mm)

    def unremarkable_mm(components: Sequence[Component]) -> dict[tuple[str, ...], FloatArray]:
        return {
            (c.id, c.where, *(p.name for p in c.candidate.parameters)): c.candidate.columns * c.unit
            for c in components
            if c.candidate and c.id == EMPIRICAL
        }

    small_mm, large_mm = map(unremarkable_mm, (COMPONENTS, library([(Model(large), farther)])))
    assert len(small_mm) == 24
    assert small_mm.keys() == large_mm.keys()
    for name, column_mm in small_mm.items():
        np.testing.assert_allclose(large_mm[name], column_mm, atol=1e-9, err_msg=str(name))


def test_something_else_is_smooth_within_a_mounting_and_differs_between_sides() -> None:
    columns = something_else(SWEEP)
    alike = columns @ columns.T
    known_rows = SWEEP.approach_known
    assert np.diagonal(alike)[known_rows] == pytest.approx(1.0, abs=0.05)
    place = np.column_stack([SWEEP.leg, SWEEP.axis])
    different = (place[:, None] != place).any(axis=2)
    assert np.abs(alike[different]).max() < 1e-9
    same_posture = ~different & (SWEEP.displacement_mm[:, None] == SWEEP.displacement_mm)
    sides = same_posture & (SWEEP.approach[:, None] * SWEEP.approach < 0)
    assert sides.any()
    assert alike[sides] == pytest.approx(1.0 - SIDED, abs=0.05)


def test_something_else_has_a_first_take_half_way_between_its_sides() -> None:
    """It has no direction of its own, which would explain away every first take."""
    columns = something_else(SWEEP)
    known_rows = SWEEP.approach_known
    for row in np.flatnonzero(~known_rows):
        alike = (SWEEP.leg == SWEEP.leg[row]) & (SWEEP.axis == SWEEP.axis[row])
        there = known_rows & alike & (SWEEP.displacement_mm == SWEEP.displacement_mm[row])
        up, down = (columns[there & (SWEEP.approach * way > 0)][0] for way in (1.0, -1.0))
        np.testing.assert_allclose(columns[row], (up + down) / 2.0)
        assert columns[row] @ columns[row] == pytest.approx(1.0 - SIDED / 2.0, abs=0.01)
