"""Candidates of the catalogue: their places and arrangements, derivatives, what nothing shows."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from calib.tripod.effects.candidates import Candidate, candidates, invisible
from calib.tripod.effects.drives import (
    STANDARD_LEADS_MM,
    Straightness,
)
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from tests.builders import postures
from tests.calib.tripod.laws import OFF, TAKEN, effect, walked


def named(library: tuple[Candidate, ...], effect_id: str) -> list[tuple[str, str, int]]:
    return [(c.where, c.arrangement, len(c.parameters)) for c in library if c.id == effect_id]


def test_places_and_arrangements() -> None:
    library = candidates(Model(parameters_mm=OFF), TAKEN)
    assert named(library, "axis_squareness") == [
        *((pair, "one", 1) for pair in ("xy", "yz", "xz")),
        *(("all", "same", 1), ("xy,yz,xz", "each", 3)),
    ]
    lateral = [
        *((leg, "each", 2) for leg in "xyz"),
        *(("all", "same", 1), ("all", "mirror", 2), ("all", "turning", 2), ("x,y,z", "each", 6)),
    ]
    assert named(library, "axis_offset") == [
        *((pair, "one", 1) for pair in ("xy", "yz", "zx")),
        *((axis, "each", 2) for axis in "xyz"),
        *(("all", "same", 1), ("xy,yz,zx", "each", 3)),
    ]
    mounts = [(place, "one", 1) for place in ("xy", "xz", "yx", "yz", "zx", "zy")]
    assert named(library, "straightness") == lateral
    assert named(library, "leg_taper") == mounts + lateral
    assert len(named(library, "actuator_cyclic")) == len(STANDARD_LEADS_MM) * 5
    assert len(named(library, "thermal_drift")) == 2 * 5
    turning = next(c for c in library if (c.id, c.arrangement) == ("leg_bow", "turning"))
    assert [p.name for p in turning.parameters] == ["middle_next", "middle_before"]
    placed = {p.place: p.values for p in turning.effects(np.array([1.0, 2.0]))}
    assert placed == {
        **dict.fromkeys(("xy", "yz", "zx"), (1.0,)),
        **dict.fromkeys(("xz", "yx", "zy"), (2.0,)),
    }


def test_a_known_lead_leaves_one_cyclic_error() -> None:
    model = Model(Geometry(screw_lead_mm=7.5))
    names = {
        p.name for c in candidates(model, TAKEN) if c.id == "actuator_cyclic" for p in c.parameters
    }
    assert {name.split("_")[1] for name in names} == {"7.5mm"}


def test_what_nothing_shows_is_listed() -> None:
    """Of leg x alone: no time, no temperature, no direction of approach."""
    plan = postures()
    leg_x = plan.take(plan.leg == 0)
    silent = replace(leg_x, time_s=np.full(len(leg_x), np.nan))
    hidden = invisible(Model(), silent)
    assert {("backlash", leg) for leg in "xyz"} <= set(hidden)
    assert ("thermal_drift", "y") in hidden
    assert ("axis_squareness", "xy") not in hidden
    places = {(c.id, c.where) for c in candidates(Model(), silent)}
    assert not places & set(hidden)
    assert not {c.id for c in candidates(Model(), silent)} & {"backlash", "thermal_drift"}
    assert not invisible(Model(parameters_mm=OFF), TAKEN)


def test_candidates_of_a_model_that_has_effects() -> None:
    """Derivatives are taken with the adopted effects acting."""
    gain = EffectInstance(effect("gauge_gain"), "xy", (50.0,))
    squareness = [effect("axis_squareness")]
    plain = candidates(Model(parameters_mm=OFF), TAKEN, squareness)[0].columns
    model = Model(parameters_mm=OFF, effects=(gain,))
    scaled = candidates(model, TAKEN, squareness)[0].columns
    gained = (TAKEN.leg == 0) & (TAKEN.axis == 1)
    assert scaled[:, 0] == pytest.approx(plain[:, 0] * np.where(gained, 1.5, 1.0))


def test_a_large_session_takes_milliseconds() -> None:
    """350 readings at two stations; 60 ms is the aim, the limit leaves room for a busy machine."""
    single = walked((0, 22, 60, 41, 22, 0, -37, -71, -100, -71, -37, 0, 22, 60))
    two = single.take(np.concatenate([np.arange(len(single)), np.arange(len(single))]))
    second = np.arange(len(two)) >= len(single)
    plan = replace(
        two,
        station=np.where(second, 0.35, 0.5),
        mount=two.mount + second * single.mount_count,
    )
    assert len(plan) >= 330
    spans = []
    for _ in range(5):
        start = time.perf_counter()
        candidates(Model(parameters_mm=OFF), plan)
        spans.append(time.perf_counter() - start)
    assert min(spans) < 0.3


def test_where_one_leg_was_read_both_ways_of_its_guide_are_one_name_still() -> None:
    """As of a whole session; of other guides one way is seen, with the name of the drive and it."""
    every = walked()
    names = {
        (candidate.where, candidate.arrangement)
        for rows in (every, every.take(np.flatnonzero(every.leg == 0)))
        for candidate in candidates(Model(), rows, [Straightness()])
    }
    assert ("x", "each") in names
    assert not {("xy", "one"), ("xz", "one")} & names
