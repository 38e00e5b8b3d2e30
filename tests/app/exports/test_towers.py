"""Values for controllers of upright towers against machines and firmware of our own.

A true machine (towers, bars, switches that are off) is driven by what a firmware computes from
the exported file, both of `upright_towers`.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.tripod.pipeline import Model
from protocols.machine import Machine, load_machine
from protocols.model_file import model_file
from tests.app.cli import glidecal, refused
from tests.app.exports.upright_towers import (
    ANGLES,
    ANYTHING,
    BAR,
    BELIEVED,
    ENDSTOPS,
    GRID,
    OFF_IN_ALL,
    RADIUS,
    READ,
    READ_ALIKE,
    READ_ANY,
    STEPS,
    STRETCHED,
    TURN_MM,
    Hidden,
    carriages,
    comments,
    errors,
    exported,
    klipper,
    lineardeltakins,
    machine,
    outward,
    read_over_the_plate,
    rms,
)
from tests.conftest import LONG, first_quick


@pytest.mark.parametrize("kind", READ)
def test_bars_towers_and_switches_go_into_the_firmware_of_printers(
    kind: str, tmp_path: Path
) -> None:
    before = rms(errors(ANYTHING, BELIEVED))
    text = exported(ANYTHING, kind, tmp_path).read_text()
    after = errors(ANYTHING, READ[kind](text))
    assert before > 0.3
    assert np.abs(after).max() < 1e-5, "rounding of the numbers in the file"
    remarks = comments(text)
    assert f"{before:.4f} mm r.m.s. now, 0.0000 mm with these values" in remarks
    assert "tool error over the workspace, in the machine's own frame, if the model" in remarks
    assert "wholly in these values: d_rho, d_L, axis_offset" in remarks
    assert "not wholly" not in remarks
    zero = np.zeros(3)
    moved = ANYTHING.tool(READ[kind](text)(zero)) - ANYTHING.tool(BELIEVED(zero))
    assert abs(moved[2]) < 1e-5, "the height at the plate stays"
    x, y = (f"{part:+.4f}" for part in moved[:2])
    assert f"is then ({x}, {y}, " in remarks


@LONG
@pytest.mark.parametrize("kind", [*READ, "smoothieware"])
def test_travels_of_towers_go_into_the_firmware_with_the_height_kept(
    kind: str, tmp_path: Path
) -> None:
    hidden = replace(STRETCHED, bar_mm=(0.3, 0.3, 0.3)) if kind in READ_ALIKE else STRETCHED
    text = exported(hidden, kind, tmp_path).read_text()
    then = READ_ANY[kind](text)
    assert rms(errors(hidden, BELIEVED)) > 0.3
    assert np.abs(errors(hidden, then)).max() < 2e-5, "rounding of the numbers in the file"
    assert "wholly in these values: d_rho, d_L, axis_offset, actuator_scale" in comments(text)
    zero = np.zeros(3)
    raised = (hidden.tool(then(zero)) - hidden.tool(BELIEVED(zero)))[2]
    assert raised == pytest.approx(0.0, abs=2e-5)
    opposite = replace(hidden, wrong_sign=True)
    worse = READ_ANY[kind](exported(opposite, kind, tmp_path / "other").read_text())
    assert rms(errors(hidden, worse)) > 1.5 * rms(errors(hidden, BELIEVED))


@LONG
@pytest.mark.parametrize("kind", first_quick(READ))
def test_travels_that_nobody_stated_stay_and_the_file_says_so(kind: str, tmp_path: Path) -> None:
    silent = {"rotation_distance_mm": None, "steps_per_mm": None}
    text = exported(STRETCHED, kind, tmp_path, **silent).read_text()
    assert "rotation_distance:" not in text
    assert "M92" not in text
    assert "the travel of each tower is not changed" in comments(text)
    assert "no value for all of actuator_scale" in comments(text)
    current = str(TURN_MM if kind == "klipper" else STEPS)
    arguments = ("--steps", ",".join([current] * 3))
    content = exported(STRETCHED, kind, tmp_path / "told", *arguments, **silent).read_text()
    assert content == exported(STRETCHED, kind, tmp_path / "known").read_text()


def test_a_travel_that_is_shown_well_is_not_called_shown_poorly(tmp_path: Path) -> None:
    """Before: that was the reason, whatever the readings showed, where no entry takes a travel."""
    session = tmp_path / "s.jsonl"
    effect = ("--effect", "actuator_scale:y", "--seed", "2")
    words = ("simulate", "--machine", "linear-delta", "--protocol", "plate-rings", *effect)
    assert glidecal(*words, "-o", session).status == 0
    run = glidecal("export", session, "--format", "p-3z", "-o", tmp_path / "p.csv")
    assert run.status == 0, run.err
    assert "no value for the travel of a carriage is entered" in run.err
    assert "the readings show" not in run.err


def test_machines_whose_belts_are_sound_get_no_values_for_them(tmp_path: Path) -> None:
    for kind in READ:
        text = exported(ANYTHING, kind, tmp_path / kind).read_text()
        assert "rotation_distance:" not in text
        assert "\nM92" not in text


def test_steps_that_are_no_steps_are_refused(tmp_path: Path) -> None:
    model = tmp_path / "model.json"
    model.write_text(model_file(STRETCHED.model(), machine()).text(), encoding="utf-8")
    arguments = ("export", model, "--format", "klipper", "-o", tmp_path / "out", "--steps")
    assert "0, 40, 40" in refused(2, *arguments, "0,40,40")
    assert "'40'" in refused(2, *arguments, "40")


BARS_ALIKE = Hidden(
    (1.0, -0.6, 0.3), (0.3, 0.3, 0.3), out_mm=(0.4, -0.3, 0.6), round_mm=(0.5, 0.2, -0.4)
)


@pytest.mark.parametrize("kind", READ_ALIKE)
def test_towers_anywhere_and_one_length_go_into_controllers_with_one(
    kind: str, tmp_path: Path
) -> None:
    before = rms(errors(BARS_ALIKE, BELIEVED))
    text = exported(BARS_ALIKE, kind, tmp_path).read_text()
    assert before > 0.3
    assert np.abs(errors(BARS_ALIKE, READ_ALIKE[kind](text))).max() < 1e-5
    assert "wholly in these values: d_rho, d_L, axis_offset" in comments(text)
    zero = np.zeros(3)
    moved = BARS_ALIKE.tool(READ_ALIKE[kind](text)(zero)) - BARS_ALIKE.tool(BELIEVED(zero))
    assert np.abs(moved).max() < 1e-5, "nor is the place over the plate another"


@pytest.mark.parametrize("kind", READ_ALIKE)
def test_towers_that_are_held_at_unequal_distances_stay_so(kind: str, tmp_path: Path) -> None:
    """A machine file that has the places of its towers already, and nothing left to correct."""
    drives = machine().drive
    assert drives is not None
    feet = (RADIUS + np.array(BARS_ALIKE.out_mm))[:, None] * outward(ANGLES)
    moved = tuple(
        drive.model_copy(
            update={"origin_mm": (x + drive.platform_mm[0], y + drive.platform_mm[1], 0.0)}
        )
        for drive, (x, y) in zip(drives, feet.tolist(), strict=True)
    )
    printer = machine(drive=moved)
    model, out = tmp_path / "model.json", tmp_path / "out"
    model.write_text(model_file(Model(printer.geometry()), printer).text(), encoding="utf-8")
    arguments = ("export", model, "-o", out, "--format")
    assert "at one distance from it" in refused(2, *arguments, "klipper")
    run = glidecal(*arguments, kind)
    assert run.status == 0, run.err
    firmware = READ_ALIKE[kind](out.read_text())
    travel = [firmware(place) - firmware(np.zeros(3)) for place in GRID]
    expected_travel = [
        carriages(np.zeros(3), np.full(3, BAR), feet) - carriages(place, np.full(3, BAR), feet)
        for place in GRID
    ]
    assert np.abs(np.array(travel) - expected_travel).max() < 1e-5


@pytest.mark.parametrize("kind", READ_ALIKE)
def test_controllers_with_one_length_say_what_unequal_bars_leave(kind: str, tmp_path: Path) -> None:
    text = exported(ANYTHING, kind, tmp_path).read_text()
    after = rms(errors(ANYTHING, READ_ALIKE[kind](text)))
    assert 0.01 < after < 0.5 * rms(errors(ANYTHING, BELIEVED))
    assert f"{after:.4f} mm with these values" in comments(text)
    assert "no value for all of d_L. Alone d_L leaves 0." in comments(text)


@pytest.mark.parametrize("kind", READ_ALIKE)
def test_bars_that_are_held_unequal_now_are_refused_where_there_is_one_length(
    kind: str, tmp_path: Path
) -> None:
    drives = machine().drive
    assert drives is not None
    longer = drives[0].model_copy(update={"leg_length_mm": 251.0})
    unequal = machine(drive=(longer, *drives[1:]))
    model = tmp_path / "model.json"
    model.write_text(model_file(Model(unequal.geometry()), unequal).text(), encoding="utf-8")
    arguments = ("export", model, "--format", kind, "-o", tmp_path / "out")
    assert "unequal ones" in refused(2, *arguments)


@pytest.fixture(scope="module")
def plate_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return read_over_the_plate(OFF_IN_ALL, tmp_path_factory.mktemp("plate"))


@LONG
@pytest.mark.parametrize("kind", first_quick(READ_ANY))
def test_the_height_at_the_plate_is_kept(kind: str, plate_session: Path, tmp_path: Path) -> None:
    """The true machine, sent to the middle of the plate with the values that it had and the new."""
    out = tmp_path / kind
    run = glidecal("export", plate_session, "--format", kind, "-o", out)
    assert run.status == 0, run.err
    middle, firmware = np.zeros(3), READ_ANY[kind](out.read_text())
    now = OFF_IN_ALL.tool(BELIEVED(middle))[2]
    assert OFF_IN_ALL.tool(firmware(middle))[2] - now == pytest.approx(0.0, abs=0.05)
    assert rms(errors(OFF_IN_ALL, firmware)) < rms(errors(OFF_IN_ALL, BELIEVED))


def test_the_height_at_the_plate_is_kept_by_lineardeltakins(
    plate_session: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run = glidecal("export", plate_session, "--format", "lineardeltakins", "-o", out)
    assert run.status == 0, run.err
    middle = np.zeros(3)
    raised = OFF_IN_ALL.tool(lineardeltakins(out)(middle)) - OFF_IN_ALL.tool(BELIEVED(middle))
    assert raised[2] == pytest.approx(0.0, abs=0.05)


@LONG
@pytest.mark.parametrize("kind", READ)
@pytest.mark.parametrize("hidden", [ANYTHING, Hidden((-1.2, -0.9, -1.5)), Hidden()])
def test_the_first_line_says_to_touch_the_plate_again(
    kind: str, hidden: Hidden, tmp_path: Path
) -> None:
    """Where the machine file says nothing of the plate, how the height changes, too."""
    text = exported(hidden, kind, tmp_path).read_text()
    assert comments(text).startswith(
        "BEFORE THE FIRST MOVE: home, then touch the plate again; these values keep the present "
        "height of the tool in the middle of the plate"
    )
    absolute = exported(hidden, kind, tmp_path / "absolute", set_at_zero=False).read_text()
    zero = np.zeros(3)
    raised = (hidden.tool(READ[kind](absolute)(zero)) - hidden.tool(BELIEVED(zero)))[2]
    if hidden == Hidden():
        assert "keep the present height" in comments(absolute)
        return
    stated = re.search(r"is about ([\d.]+) mm (lower|higher) than now", comments(absolute))
    assert stated
    assert abs(raised) > 0.1, "else this test shows nothing"
    value = float(stated[1]) * {"lower": -1.0, "higher": 1.0}[stated[2]]
    assert value == pytest.approx(raised, abs=0.005)


@LONG
def test_the_bound_counts_what_the_firmware_has_no_value_for(tmp_path: Path) -> None:
    """Readings against a plate, of a machine whose towers lean, with the effect in the model."""
    leaning, session = tmp_path / "m.json", tmp_path / "s.jsonl"
    true = Hidden((0.2, -0.1, 0.3), lean_xy=0.002).model()
    leaning.write_text(model_file(true, machine()).text(), encoding="utf-8")
    assert glidecal("simulate", "--model", leaning, "-o", session).status == 0
    arguments = ("export", session, "--model", leaning, "--format")
    bounds: dict[str, float] = {}
    for kind in ("model", "klipper"):
        run = glidecal(*arguments, kind, "-o", tmp_path / kind)
        assert run.status == 0, run.err
        text = comments((tmp_path / kind).read_text()) if kind == "klipper" else run.err
        (bound,) = re.findall(r"at most ([\d.]+) mm with these values", text)
        bounds[kind] = float(bound)
    hidden = Hidden((0.2, -0.1, 0.3), lean_xy=0.002)
    off = errors(hidden, klipper((tmp_path / "klipper").read_text()))
    touched_off = rms(off - off.mean(axis=0))
    assert touched_off > 0.01, "else this test shows nothing"
    assert touched_off <= bounds["klipper"]
    assert bounds["model"] < bounds["klipper"]


@LONG
def test_the_bound_of_a_controller_with_one_length_counts_what_unequal_bars_leave(
    tmp_path: Path,
) -> None:
    hidden = Hidden((0.2, -0.1, 0.3), (0.9, -0.7, 0.2))
    session = read_over_the_plate(hidden, tmp_path)
    bounds: dict[str, float] = {}
    for kind in ("klipper", *READ_ALIKE):
        out = tmp_path / kind
        assert glidecal("export", session, "--format", kind, "-o", out).status == 0
        (bound,) = re.findall(r"at most ([\d.]+) mm with these values", comments(out.read_text()))
        off = errors(hidden, READ_ANY[kind](out.read_text()))
        assert rms(off - off.mean(axis=0)) <= float(bound)
        bounds[kind] = float(bound)
    assert bounds["smoothieware"] == bounds["p-3z"] > bounds["klipper"]


@pytest.mark.parametrize("kind", READ_ANY)
def test_the_other_sign_makes_it_worse(kind: str, tmp_path: Path) -> None:
    bars = (0.3, 0.3, 0.3) if kind in READ_ALIKE else (0.3, -0.2, 0.15)
    hidden = Hidden((0.8, -0.5, 0.3), bars)
    turned = Hidden(hidden.switch_mm, hidden.bar_mm, wrong_sign=True)
    text = exported(turned, kind, tmp_path).read_text()
    assert rms(errors(hidden, READ_ANY[kind](text))) > 1.9 * rms(errors(hidden, BELIEVED))


def test_what_klipper_has_no_value_for_is_named_with_what_it_leaves(tmp_path: Path) -> None:
    hidden = Hidden((0.2, -0.1, 0.3), lean_xy=0.002)
    text = exported(hidden, "klipper", tmp_path).read_text()
    after = rms(errors(hidden, klipper(text)))
    assert 0.01 < after < rms(errors(hidden, BELIEVED))
    remarks = comments(text)
    assert f"{after:.4f} mm with these values" in remarks
    zero = np.zeros(3)
    raised = hidden.tool(klipper(text)(zero))[2] - hidden.tool(BELIEVED(zero))[2]
    assert raised == pytest.approx(0.0, abs=0.001), "the height is no part of the bargain"
    assert "wholly in these values: d_rho" in remarks
    assert re.search(
        r"no value for all of axis_squareness\. Alone axis_squareness leaves 0\.", remarks
    )


ALIKE = Hidden((1.0, -0.6, 0.3), (0.3, 0.3, 0.3), out_mm=(0.4, 0.4, 0.4))


def test_lineardeltakins_takes_what_all_towers_share_and_the_joints(tmp_path: Path) -> None:
    """Joint 0 is the tower at 90°, whatever the order of the drives."""
    before = rms(errors(ALIKE, BELIEVED))
    out = exported(ALIKE, "lineardeltakins", tmp_path)
    assert np.abs(errors(ALIKE, lineardeltakins(out))).max() < 1e-5
    assert before > 0.3
    turned = Hidden(ALIKE.switch_mm, ALIKE.bar_mm, ALIKE.out_mm, wrong_sign=True)
    worse = exported(turned, "lineardeltakins", tmp_path / "turned")
    assert rms(errors(ALIKE, lineardeltakins(worse))) > before


def test_lineardeltakins_says_what_unequal_bars_leave(tmp_path: Path) -> None:
    hidden = Hidden((0.8, -0.5, 0.3), (0.3, -0.2, 0.15))
    out = exported(hidden, "lineardeltakins", tmp_path)
    after = rms(errors(hidden, lineardeltakins(out)))
    alone = Hidden(bar_mm=hidden.bar_mm)
    assert 0.02 < after < 0.2 * rms(errors(hidden, BELIEVED))
    text = comments((out / "calib.hal").read_text())
    assert f"{after:.4f} mm with these values" in text
    only = exported(alone, "lineardeltakins", tmp_path / "alone")
    residual = rms(errors(alone, lineardeltakins(only)))
    assert f"Alone d_L leaves {residual:.4f} mm" in text


@LONG
@pytest.mark.parametrize("kind", [*READ, "lineardeltakins"])
def test_what_the_firmware_holds_now_is_never_assumed(kind: str, tmp_path: Path) -> None:
    model, out = tmp_path / "model.json", tmp_path / "out"
    silent = machine(position_endstop_mm=None)
    model.write_text(model_file(ANYTHING.model(), silent).text(), encoding="utf-8")
    assert "none stated" in refused(2, "export", model, "--format", kind, "-o", out)
    assert not out.exists()
    stated = ",".join(map(str, ENDSTOPS))
    by_option = exported(ANYTHING, kind, tmp_path, "--endstops", stated, position_endstop_mm=None)
    by_machine = exported(ANYTHING, kind, tmp_path / "known")
    for first, second in zip(files(by_option), files(by_machine), strict=True):
        assert first == second


def files(path: Path) -> list[str]:
    paths = sorted(path.iterdir()) if path.is_dir() else [path]
    return [file.read_text() for file in paths]


def test_a_file_warns_of_values_that_do_not_help_whoever_states_the_switches(
    tmp_path: Path,
) -> None:
    """A sound machine, as `solve` warns. Before: silent where --endstops states the switches."""
    session = tmp_path / "s.jsonl"
    words = ("--machine", "linear-delta", "--protocol", "plate-rings", "--seed", "3")
    assert glidecal("simulate", *words, "-o", session).status == 0
    options = ("--endstops", "300,300,300", "-o", "-")
    run = glidecal("export", session, "--format", "klipper", *options)
    assert "WARNING: these values are not expected to make" in comments(run.out)


def test_what_is_not_upright_or_stands_elsewhere_is_refused(tmp_path: Path) -> None:
    def said(status: int, printer: Machine, kind: str = "klipper", *options: str) -> str:
        model = tmp_path / "model.json"
        model.write_text(model_file(Model(printer.geometry()), printer).text(), encoding="utf-8")
        return refused(status, "export", model, "--format", kind, "-o", tmp_path / "out", *options)

    orthoglide = load_machine(None)
    assert "drives along other lines" in said(2, orthoglide, "klipper", "--endstops", "1,1,1")
    assert "joints y, z, x" in said(2, machine(joints=("y", "z", "x")), "lineardeltakins")
    assert "count upwards" in said(2, machine(joints=("x", "-y", "z")), "reprapfirmware")
    assert "count upwards" in said(2, machine(joints=("x", "y", "z")), "lineardeltakins")
    assert "--endstops" in said(2, machine(), "klipper", "--ini", "machine.ini")
    drives = machine().drive
    assert drives is not None
    x, y, z = (
        drive.model_copy(update={"origin_mm": (*drive.origin_mm[:2], -280.0)}) for drive in drives
    )
    assert "found -280, -280, -280 mm" in said(2, machine(drive=(x, y, z)), "lineardeltakins")
    assert "'1,2'" in said(2, machine(), "klipper", "--endstops", "1,2")


def test_towers_are_known_by_where_they_stand(tmp_path: Path) -> None:
    """Drive x behind instead of z: the file of the same machine is the same but for the names."""
    usual = machine()
    assert usual.drive is not None
    x, y, z = usual.drive
    turned = machine(drive=(z, x, y), position_endstop_mm=(ENDSTOPS[2], *ENDSTOPS[:2]))
    model = Model(turned.geometry(), (0.3, 0.8, -0.5, 0.0, 0.0, 0.0))
    path, out = tmp_path / "model.json", tmp_path / "out.cfg"
    path.write_text(model_file(model, turned).text(), encoding="utf-8")
    assert glidecal("export", path, "--format", "klipper", "-o", out).status == 0
    plain = Hidden((0.8, -0.5, 0.3))
    reference = klipper(exported(plain, "klipper", tmp_path).read_text())
    assert np.abs(errors(plain, klipper(out.read_text())) - errors(plain, reference)).max() < 1e-5


def test_a_machine_file_states_its_switches_once() -> None:
    text = machine().model_copy(update={"home_offset_mm": (1.0, 1.0, 1.0)}).model_dump_json()
    with pytest.raises(ValueError, match="state one"):
        Machine.model_validate_json(text)
