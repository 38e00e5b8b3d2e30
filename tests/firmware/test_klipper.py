"""Files for and from a printer judged by Klipper's own kinematics, on a true machine of our own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from protocols.printers.imported import imported_printer
from tests.app.cli import glidecal
from tests.app.exports import upright_towers as true
from tests.blind import printers
from tests.conftest import LONG
from tests.firmware.klipper import (
    STEP_MM,
    calibrated,
    configuration_of,
    kinematics_of,
    need_klipper,
)
from tests.protocols.printers.printers import (
    NOW,
    PRINTER,
    arms_saved,
    printer_cfg,
    rings,
    saved,
    superseded,
)

pytestmark = LONG

MIDDLE = np.zeros(3)


@pytest.fixture(autouse=True)
def _present() -> None:
    need_klipper()


def by_klipper(text: str) -> true.Firmware:
    """Travel below each switch as Klipper's own calibration counts the steps from it."""
    calibration = kinematics_of(text).get_calibration()

    def travel_mm(place: true.FloatArray) -> true.FloatArray:
        return STEP_MM * np.array(calibration.calc_stable_position(place))

    return travel_mm


def test_klipper_reads_the_file_as_the_formulas_of_the_tests_do(tmp_path: Path) -> None:
    """Appended to what the printer holds: of each key the last one wins."""
    text = true.exported(true.ANYTHING, "klipper", tmp_path).read_text()
    ours, theirs = true.klipper(text), by_klipper(NOW + text)
    for place in (MIDDLE, np.array([40.0, -30.0, 10.0]), np.array([-50.0, 20.0, 150.0])):
        assert theirs(place) == pytest.approx(ours(place), abs=1e-9)
    home = kinematics_of(NOW + text).home_position
    assert theirs(np.array(home)) == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_klipper_moves_the_true_machine_nearer_with_the_height_kept(tmp_path: Path) -> None:
    session, out = true.read_over_the_plate(true.OFF_IN_ALL, tmp_path), tmp_path / "calib.cfg"
    run = glidecal("export", session, "--format", "klipper", "-o", out)
    assert run.status == 0, run.err
    now, after = by_klipper(NOW), by_klipper(NOW + out.read_text())
    assert now(MIDDLE) == pytest.approx(true.BELIEVED(MIDDLE), abs=1e-9)
    raised = true.OFF_IN_ALL.tool(after(MIDDLE))[2] - true.OFF_IN_ALL.tool(now(MIDDLE))[2]
    assert raised == pytest.approx(0.0, abs=0.05)
    assert true.rms(true.errors(true.OFF_IN_ALL, after)) < true.rms(
        true.errors(true.OFF_IN_ALL, now)
    )


def test_klipper_turns_the_motors_of_stretched_belts_by_what_the_file_says(tmp_path: Path) -> None:
    text = true.exported(true.STRETCHED, "klipper", tmp_path).read_text()
    after = by_klipper(NOW + text)
    off = true.errors(true.STRETCHED, after)
    assert true.rms(true.errors(true.STRETCHED, by_klipper(NOW))) > 0.3
    assert np.abs(off).max() < 2e-5, "rounding of the numbers in the file"
    raised = true.STRETCHED.tool(after(MIDDLE)) - true.STRETCHED.tool(true.BELIEVED(MIDDLE))
    assert raised[2] == pytest.approx(0.0, abs=2e-5)


def test_stable_positions_are_imported_as_klipper_reads_them(tmp_path: Path) -> None:
    """Its own steps for places near the plate, written as it saves them, come back as the places.

    A wrong arm that was made a comment stands above: what Klipper itself computes with decides.
    """
    calibration = kinematics_of(NOW).get_calibration()
    places = [(x, y, 0.1 * k - 0.3) for k, (x, y) in enumerate(rings(7))]
    lines = [*arms_saved(), "[delta_calibrate]"]
    for number, place in enumerate(places):
        steps = "%.3f,%.3f,%.3f" % tuple(calibration.calc_stable_position(place))  # noqa: UP031
        lines += [f"height{number} = 0.25", f"height{number}_pos = {steps}"]
    path = tmp_path / "printer.cfg"
    path.write_text(PRINTER + superseded() + saved(lines), encoding="utf-8")
    printer = imported_printer([path], "test")
    for contact, place in zip(printer.contacts, places, strict=True):
        (steps_text,) = [line.split("= ")[1] for line in lines if _of(contact.text, line)]
        by_klipper_mm = calibration.get_position_from_stable(
            [float(step) for step in steps_text.split(",")]
        )
        assert contact.position_mm == pytest.approx(by_klipper_mm, abs=1e-9)
        assert contact.position_mm == pytest.approx(place, abs=1e-4)
        assert contact.value_mm == 0.25


@pytest.mark.parametrize(
    ("line", "instead"),
    [
        ("", ""),
        ("#arm_length: 249.0", "arm_length: 251.0"),
        ("\n#*# <", "\n[include calib.cfg]\n\n#*# <"),
        (
            "\n[delta_calibrate]",
            "\n[include calib.cfg]\n[stepper_b]\nangle: 329\n[delta_calibrate]",
        ),
    ],
    ids=["saved", "above", "included", "included before"],
)
def test_of_two_values_klipper_and_the_import_take_the_same(
    tmp_path: Path, line: str, instead: str
) -> None:
    values = "[stepper_b]\narm_length: 250.5\nangle: 331\n[printer]\ndelta_radius: 124.5\n"
    (tmp_path / "calib.cfg").write_text(values, encoding="utf-8")
    path = tmp_path / "printer.cfg"
    path.write_text(printer_cfg(true.Hidden(), 7).replace(line, instead, 1), encoding="utf-8")
    theirs = configuration_of(path)
    machine = imported_printer([path], "test").opened.machine
    assert machine.drive is not None
    for drive, name in zip(machine.drive, "abc", strict=True):
        of = f"stepper_{name}"
        radius, angle = theirs.getfloat("printer", "delta_radius"), theirs.getfloat(of, "angle")
        foot = radius * true.outward(np.array([angle]))[0]
        assert drive.origin_mm[:2] == pytest.approx(foot, abs=1e-5)
        length = drive.leg_length_mm or machine.leg_length_mm
        assert length == theirs.getfloat(of, "arm_length")


def _of(text: str, line: str) -> bool:
    """Whether a line of the saved block is that of a contact's steps."""
    return line.startswith(text.split(":")[0] + "_pos")


BLIND = f"[printer]\nkinematics: delta\ndelta_radius: {printers.RADIUS}\n" + "".join(
    f"[stepper_{letter}]\narm_length: {printers.BAR}\nangle: {angle}\n"
    f"position_endstop: {printers.STOP}\nrotation_distance: 40\n"
    for letter, angle in zip("abc", printers.ANGLES.tolist(), strict=True)
)


@pytest.mark.parametrize("name", printers.CASES)
def test_the_six_factors_of_the_comparison_are_the_fit_of_klipper(name: str) -> None:
    """Column "six factors" of docs/benchmarks.md: `DELTA_CALIBRATE` itself leaves as much."""
    random = np.random.default_rng([7, len(name)])
    parts = printers.CASES[name](random)
    contacts = printers.contacts(parts, random)
    means = np.array(contacts).reshape(printers.CYCLES, -1, 3).mean(axis=0)
    by_us = true.rms(printers.errors(parts, printers.fitted(contacts, 6)))
    calibration = calibrated(BLIND, means.tolist())

    def firmware(place: true.FloatArray) -> true.FloatArray:
        return STEP_MM * np.array(calibration.calc_stable_position(place.tolist()))

    by_klipper = true.rms(printers.errors(parts, firmware))
    assert by_klipper == pytest.approx(by_us, rel=0.02, abs=5e-4)
