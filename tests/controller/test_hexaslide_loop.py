"""A Hexa Slide behind LinuxCNC: measured, calibrated, its kinematics module loaded, moved again.

Where the platform stands follows from the joints by geometry that is written out in
`tests.app.exports.test_hexaslide_files`; no code of the program takes part.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.evaluating.hexaslide_calibration import calibrate_file
from app.exports.hexaslide import calibrated_files, pins
from app.planning.hexaslide import Request, write_simulated
from protocols.hexaslide import load_hexaslide, read_measurements, read_truth
from tests.app.exports.test_hexaslide_files import Array, Plain, plain
from tests.conftest import LONG
from tests.controller.running import SimulatedJoint, need_linuxcnc, run

pytestmark = LONG

CENTRE = np.array([0.0, -0.8, -1.15, 0.0, 0.0, 0.0])
PLACES = 10


def of_file(chains: tuple[object, ...]) -> Plain:
    return plain([chain.model_dump() for chain in chains])  # type: ignore[attr-defined]


def reached(folder: Path, hal: str, true: Plain, postures: Array, model: Plain) -> Array:
    """Where the true platform stands ``(n, 6)``, metres and degrees, sent to ``postures``;
    the controller is homed in the middle of the box, where its own geometry ``model`` puts the
    sliders.
    """
    start = 1000.0 * model.sliders(CENTRE)
    joints = [SimulatedJoint({"mounting": place}) for place in start]
    entries = [
        {"HOME": place, "HOME_OFFSET": place, "MIN_LIMIT": -100, "MAX_LIMIT": 2000}
        for place in start
    ]
    lines = []
    for x, y, z, theta, psi, phi in postures.tolist():
        place = "X{:.4f} Y{:.4f} Z{:.4f}".format(*(1000.0 * v for v in (x, y, z)))
        lines.append(f"G21 G90 G53 G1 F30000 {place} A{psi:.4f} B{theta:.4f} C{phi:.4f}")
    stops = run(
        folder, joints, entries, hal, ["home", *lines], kinematics="hexaslidekins", axes="XYZABC"
    )[1:]
    for stop, (x, y, z, theta, psi, phi) in zip(stops, postures.tolist(), strict=True):
        pose = [1000.0 * x, 1000.0 * y, 1000.0 * z, psi, theta, phi]
        assert stop.tool == pytest.approx(pose, abs=1e-4), "and back, by its forward kinematics"
    return np.array(
        [
            true.stands(np.array(stop.joint) / 1000.0, place)
            for stop, place in zip(stops, postures, strict=True)
        ]
    )


@pytest.mark.parametrize("procedure", ["pose-inverse", "position"])
def test_the_compiled_module_brings_the_true_platform_to_its_places(
    procedure: str, tmp_path: Path
) -> None:
    """Errors of 1 mm, noise of 0.01 mm; before and after, at places that were not measured."""
    need_linuxcnc()
    measured, hidden = tmp_path / "m.json", tmp_path / "t.json"
    write_simulated(Request(procedure, postures=48, seed=6), measured, hidden, noise_mm=0.01)
    result = calibrate_file(measured, None, 0.0)
    true = of_file(read_truth(hidden, read_measurements(measured)).chain)
    nominal = load_hexaslide()
    box = nominal.whole().box
    postures = np.random.default_rng(9).uniform(box.lower, box.upper, (PLACES, 6))
    postures = np.hstack([postures[:, :3], np.degrees(postures[:, 3:])]).round(4)
    files = calibrated_files(result, None)
    (tmp_path / "machine.toml").write_text(str(files["machine.toml"]), encoding="utf-8")
    calibrated = of_file(load_hexaslide(tmp_path / "machine.toml").chain)
    before = reached(
        tmp_path / "before", pins(nominal.whole()), true, postures, of_file(nominal.chain)
    )
    after = reached(tmp_path / "after", str(files["calib.hal"]), true, postures, calibrated)
    off_mm = [
        1000.0 * np.linalg.norm((places - postures)[:, :3], axis=1) for places in (before, after)
    ]
    rms_mm = [float(np.sqrt((distances**2).mean())) for distances in off_mm]
    assert rms_mm[0] > 0.8
    assert rms_mm[1] < 0.01 * rms_mm[0]
