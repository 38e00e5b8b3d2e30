"""Plates that are not flat, probes beside the nozzle: laws and exports beside six bars.

`python -m tests.blind.probes` has all rows.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.arrays import Conditions, tool_conditions
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.gauges import SHAPES, PlatformTilt
from calib.tripod.pipeline import Model
from tests.blind.printers import (
    BELIEVED,
    CASES,
    RINGS,
    FloatArray,
    Hidden,
    Parts,
    any_printer,
    calibrated,
    errors,
    machine,
)
from tests.blind.probes import APART_MM, BESIDE_MM, BOWED, EDGE_MM, Probed, stated
from tests.conftest import LONG, first_quick

PERFECT = Parts.perfect()


def heights(hidden: Hidden) -> FloatArray:
    heights = np.array([hidden.met(BELIEVED, across)[2] for across in RINGS])
    return np.asarray(heights - heights[0])


def probed() -> Conditions:
    conditions = tool_conditions([[x, y, 0.0] for x, y in RINGS])
    beside = np.tile([*BESIDE_MM, 0.0], (len(RINGS), 1))
    return replace(conditions, contact=np.ones(len(RINGS), dtype=np.bool_), beside_mm=beside)


def of_laws(*laws: EffectInstance) -> FloatArray:
    """Heights at which the firmware is as the probe meets the plate, by the program's laws."""
    over = Model(machine().geometry()).with_effects(laws).readings(probed())
    return np.asarray(over[0] - over)


def test_six_equal_bars_and_a_flat_plate_are_three_spheres() -> None:
    parts = any_printer(np.random.default_rng(3))
    assert heights(Probed(parts)) == pytest.approx(heights(parts), abs=1e-9)
    assert errors(Probed(parts), BELIEVED) == pytest.approx(errors(parts, BELIEVED), abs=1e-9)


def test_the_law_of_a_bowed_plate_is_that_of_the_simulation() -> None:
    bow_mm = np.array([0.1, 0.05, -0.03])
    laws = [
        EffectInstance(law, "tz", (float(-bow * (100.0 / EDGE_MM) ** 2),))
        for law, bow in zip(SHAPES, bow_mm, strict=True)
    ]
    readings = heights(Probed(PERFECT, bow_mm, BESIDE_MM))
    assert np.ptp(readings) > 0.15
    assert readings == pytest.approx(of_laws(*laws), abs=2e-4)


@pytest.mark.parametrize("leg", first_quick(range(3)))
def test_unequal_bars_tilt_the_probe_as_the_law_says(leg: int) -> None:
    """Beside the nozzle, which goes elsewhere, too: that is what a tower elsewhere does."""
    unequal_mm = 0.1 * np.eye(3)[leg]
    with_probe = heights(Probed(PERFECT, np.zeros(3), BESIDE_MM, unequal_mm))
    with_nozzle = heights(Probed(PERFECT, unequal_mm=unequal_mm))
    law = EffectInstance(PlatformTilt(), "xyz"[leg], (1000.0 * 0.1 / APART_MM,))
    assert np.ptp(with_probe - with_nozzle) > 0.01
    assert with_probe - with_nozzle == pytest.approx(of_laws(law), abs=2e-4)


@LONG
@pytest.mark.parametrize(
    ("name", "plate"),
    first_quick(
        [
            ("switches", "0.1 mm, saddle"),
            ("switches, radius, angles", "0.1 mm, dome or dish"),
            ("any", "0.1 mm, dome or dish"),
            ("any", "0.1 mm, saddle"),
        ],
        several=True,
    ),
)
def test_a_bowed_plate_makes_no_export_worse_than_the_best_peer(
    name: str, plate: str, tmp_path: Path
) -> None:
    make = {**CASES, "any": any_printer}[name]
    results = []
    for seed in range(3):
        random = np.random.default_rng([seed, 4])
        hidden = Probed(make(random), BOWED[plate](random))
        results.append(calibrated(hidden, random, tmp_path, stated()))
    ours, six, nine = (
        np.sqrt(np.mean([getattr(result, export) ** 2 for result in results]))
        for export in ("ours", "six", "nine")
    )
    assert ours <= min(six, nine)
    assert all(result.touched <= result.bound for result in results)
