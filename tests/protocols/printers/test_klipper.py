"""A printer.cfg as one import: machine file and contacts; what is odd or wrong in it."""

from __future__ import annotations

import configparser
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import RecordError
from protocols.machine import load_machine
from protocols.observations import to_observations
from protocols.printers import klipper
from protocols.printers.imported import ImportedPrinter, imported_printer
from protocols.record import read_record
from protocols.session import Session, fold
from tests.app.cli import glidecal, refused
from tests.app.exports import upright_towers as true
from tests.conftest import LONG, first_quick
from tests.protocols.printers.printers import (
    MOTOR,
    NOW,
    OLD_ARM,
    PERFECT,
    PRINTER,
    SAVED_HEAD,
    STEP_MM,
    arms_saved,
    height_lines,
    printer_cfg,
    rings,
    saved,
    stable,
    steppers,
    touched_at,
)


def read(folder: Path, text: str, *logs: str) -> ImportedPrinter:
    paths = [folder / "printer.cfg", *(folder / f"{k}.log" for k in range(len(logs)))]
    for path, content in zip(paths, (text, *logs), strict=True):
        path.write_text(content, encoding="utf-8")
    return imported_printer(paths, "test")


def test_the_machine_is_that_of_the_saved_block(tmp_path: Path) -> None:
    machine = read(tmp_path, printer_cfg(PERFECT)).opened.machine
    assert machine.leg_length_mm == true.BAR != OLD_ARM
    assert machine.position_endstop_mm == true.ENDSTOPS
    assert machine.screw_lead_mm == 40.0
    assert machine.drive is not None
    stand = np.array([drive.origin_mm[:2] for drive in machine.drive])
    assert np.hypot(*stand.T) == pytest.approx([true.RADIUS] * 3, abs=1e-5)
    turned = np.degrees(np.arctan2(stand[:, 1], stand[:, 0])) % 360.0
    assert turned == pytest.approx(true.ANGLES, abs=1e-5)


@pytest.mark.parametrize(
    "hidden", [PERFECT, true.OFF_IN_ALL, true.ANYTHING], ids=["none", "some", "all"]
)
def test_stable_positions_are_the_places_that_were_commanded(
    tmp_path: Path, hidden: true.Hidden
) -> None:
    """Carriages from steps, the tool from carriages; half a step of each is a step across."""
    observations = to_observations([session_of(read(tmp_path, printer_cfg(hidden)))])
    assert observations.contact.all()
    want = np.array([touched_at(hidden, x, y) for x, y in rings()])
    assert np.abs(observations.position_mm - want).max() < 2.0 * STEP_MM
    steps = np.array([true.BELIEVED(place) for place in observations.position_mm]) / STEP_MM
    assert steps == pytest.approx(np.array([stable(hidden, x, y) for x, y in rings()]), abs=1e-6)


def session_of(printer: ImportedPrinter) -> Session:
    return fold([printer.opened, *printer.contacts])


def test_heights_by_hand_have_a_zero_of_their_own(tmp_path: Path) -> None:
    steps = ",".join(f"{step:.3f}" for step in stable(PERFECT, 30.0, 0.0, 25.0))
    extra = ("manual_height0 = 25.0", f"manual_height0_pos = {steps}")
    printer = read(tmp_path, printer_cfg(PERFECT, 7, extra))
    assert len(printer.contacts) == 8
    by_hand = printer.contacts[-1]
    assert by_hand.value_mm == 25.0
    assert by_hand.mount != printer.contacts[0].mount
    assert by_hand.position_mm == pytest.approx((30.0, 0.0, 25.0), abs=STEP_MM)
    assert not printer.oddities


def test_probe_heights_are_heights_of_the_tool_as_it_trips(tmp_path: Path) -> None:
    """A probe that trips 2 mm before the nozzle would touch: the saved height says so."""
    steps = [",".join(f"{s:.3f}" for s in stable(PERFECT, x, y, 2.0)) for x, y in rings(7)]
    lines = ["[delta_calibrate]"]
    for number, text in enumerate(steps):
        lines += [f"height{number} = 2.0", f"height{number}_pos = {text}"]
    printer = read(tmp_path, PRINTER + steppers() + saved(lines))
    assert [contact.value_mm for contact in printer.contacts] == [2.0] * 7
    assert [contact.position_mm[2] for contact in printer.contacts] == pytest.approx(  # type: ignore[index]
        [2.0] * 7, abs=STEP_MM
    )


def test_what_is_not_used_is_named(tmp_path: Path) -> None:
    extra = (
        "distance1 = 60.0",
        "distance1_pos1 = 1,2,3",
        "distance1_pos2 = 3,2,1",
        "height9 = 0.0",
        "height9_pos = 1,2,3",
        "delta_a_angle = 210.0",
    )
    printer = read(tmp_path, printer_cfg(PERFECT, 7, extra) + "")
    remarks = " | ".join(printer.oddities)
    assert "distance1: a number before it is missing" in remarks
    assert "distance1_pos2: a number before it is missing" in remarks
    assert not printer.distances
    assert "height9: a number before it is missing" in remarks
    assert "height9_pos: a number before it is missing" in remarks
    assert "delta_a_angle: not known" in remarks
    assert len(printer.contacts) == 7


def distance_lines(hidden: true.Hidden, off_mm: float = 0.0) -> list[str]:
    """Marks 60 mm from the middle across it, and what a caliper shows on the true machine."""
    lines = []
    for number, (x, y) in enumerate([(60.0, 0.0), (30.0, 52.0), (-30.0, 52.0)]):
        ends = [true.BELIEVED(np.array([sign * x, sign * y, 0.0])) for sign in (1.0, -1.0)]
        steps = [np.round(travel_mm / STEP_MM) for travel_mm in ends]
        first, second = (hidden.tool(step_count * STEP_MM) for step_count in steps)
        lines.append(f"distance{number} = {np.linalg.norm(first - second) + off_mm:.5f}")
        for end, steps_of_end in enumerate(steps, start=1):
            lines.append(
                f"distance{number}_pos{end} = {','.join(f'{s:.3f}' for s in steps_of_end)}"
            )
    return lines


def test_distances_are_between_the_marks_as_they_were_commanded(tmp_path: Path) -> None:
    """Steps count from the switches, so the places are those of the controller, whatever is off."""
    printer = read(tmp_path, printer_cfg(true.OFF_IN_ALL, 7, distance_lines(true.OFF_IN_ALL)))
    assert not printer.oddities
    want = [(60.0, 0.0), (30.0, 52.0), (-30.0, 52.0)]
    assert [distance.from_mm[:2] for distance in printer.distances] == [
        pytest.approx(place, abs=2.0 * STEP_MM) for place in want
    ]
    for measured_distance in printer.distances:
        first, second = (
            true.BELIEVED(np.array(end))
            for end in (measured_distance.from_mm, measured_distance.to_mm)
        )
        indicated = [np.round(end / STEP_MM) * STEP_MM for end in (first, second)]
        ends = [true.OFF_IN_ALL.tool(travel_mm) for travel_mm in indicated]
        assert measured_distance.value_mm == pytest.approx(
            np.linalg.norm(ends[0] - ends[1]), abs=1e-4
        )


@LONG
def test_distances_go_with_the_contacts_into_record_and_result(tmp_path: Path) -> None:
    """A machine whose bars are longer alike: the tool is known better than by contacts alone.

    The probe's scatter is stated: these contacts have none, from which it would be estimated.
    """
    hidden = true.Hidden(switch_mm=(0.2, -0.1, 0.1), bar_mm=(0.5, 0.5, 0.5))
    bound_mm = []
    for name, extra in (("a", ()), ("b", distance_lines(hidden))):
        cfg, session = tmp_path / f"{name}.cfg", tmp_path / f"{name}.jsonl"
        cfg.write_text(printer_cfg(hidden, 19, extra), encoding="utf-8")
        deviation = ("--distance-deviation", "0.02") if extra else ()
        run = glidecal("import", cfg, "-o", session, "--repeatability", "0.005", *deviation)
        assert run.status == 0, run.err
        stated = [distance.deviation_mm for distance in read_record(session).session.distances]
        assert stated == [0.02] * (len(extra) // 3)
        assert glidecal("validate", session).status == 0
        run = glidecal("solve", session)
        assert ("3 distances between marks" in run.out) == (name == "b")
        result = json.loads(glidecal("solve", session, "--holds", "kinematics", "--json").out)
        bound_mm.append(result["correction"]["bound"]["touched_off_mm"])
    assert bound_mm[1] < bound_mm[0]


def test_includes_are_read_where_they_stand(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "towers.cfg").write_text(steppers(), encoding="utf-8")
    text = PRINTER + "[include parts/*.cfg]\n[include lost.cfg]\n" + saved(height_lines(PERFECT))
    printer = read(tmp_path, text)
    assert len(printer.contacts) == 19
    assert printer.oddities == ("[include lost.cfg] of printer.cfg: there is no such file",)


def test_a_fault_behind_an_include_or_in_the_saved_block_is_named_by_its_line(
    tmp_path: Path,
) -> None:
    (tmp_path / "towers.cfg").write_text(steppers(), encoding="utf-8")
    begun = PRINTER + "[include towers.cfg]\n"
    for text in (begun + "nonsense\n", begun + SAVED_HEAD + "#*# [delta_calibrate]\n#*# odd\n"):
        last = len(text.splitlines())
        with pytest.raises(RecordError, match=f"near line {last}: no section or key"):
            read(tmp_path, text)


def test_files_that_include_twice_as_many_each_end(tmp_path: Path) -> None:
    for number in range(30):
        text = f"[include {number + 1}.cfg]\n" * 2
        (tmp_path / f"{number}.cfg").write_text(text, encoding="utf-8")
    (tmp_path / "30.cfg").write_text("", encoding="utf-8")
    with pytest.raises(RecordError, match="200 files together"):
        read(tmp_path, PRINTER + "[include 0.cfg]\n" + steppers())


@pytest.mark.parametrize("end", ["\r\n", "\r"])
def test_marks_breaks_and_comments_of_other_editors(tmp_path: Path, end: str) -> None:
    """A byte order mark, breaks of other systems, and a comment without a space before it."""
    text = printer_cfg(PERFECT, 7).replace(f"{true.RADIUS}  #", f"{true.RADIUS}#")
    (tmp_path / "a.cfg").write_bytes(("\ufeff" + text.replace("\n", end)).encode())
    printer = imported_printer([tmp_path / "a.cfg"], "test")
    usual = read(tmp_path, printer_cfg(PERFECT, 7))
    assert [contact.text for contact in printer.contacts] == [
        contact.text for contact in usual.contacts
    ]
    assert printer.opened.machine.drive == usual.opened.machine.drive


def test_what_stands_above_the_saved_block_wins_or_is_included_there(tmp_path: Path) -> None:
    """As in the firmware (see `tests.firmware.test_klipper`): of both the last above the block."""
    config = printer_cfg(PERFECT, 7)
    above = config.replace("#arm_length: 249.0", f"arm_length: {true.BAR + 1.0}", 1)
    machine = read(tmp_path, above).opened.machine
    assert machine.drive is not None
    assert [drive.leg_length_mm for drive in machine.drive] == [251.0, 250.0, 250.0]
    (tmp_path / "calib.cfg").write_text(f"[printer]\ndelta_radius: {true.RADIUS + 0.25}\n")
    including = config.replace("\n#*# <", "\n[include calib.cfg]\n\n#*# <", 1)
    assert including != config
    drives = read(tmp_path, including).opened.machine.drive
    assert drives is not None
    assert np.hypot(*drives[0].origin_mm[:2]) == pytest.approx(true.RADIUS + 0.25, abs=1e-5)


@pytest.mark.parametrize("coding", ["utf-8", "cp1252", "utf-16"])
def test_a_configuration_of_an_editor_with_another_alphabet(tmp_path: Path, coding: str) -> None:
    text = printer_cfg(PERFECT, 7).replace("# measured", "# gemessen, Größe 5 µm bei 60 °C")
    assert "Größe" in text
    (tmp_path / "a.cfg").write_bytes(text.encode(coding))
    printer = imported_printer([tmp_path / "a.cfg"], "test")
    assert printer.opened.machine == read(
        tmp_path, printer_cfg(PERFECT, 7)
    ).opened.machine.model_copy(update={"name": "a"})
    assert len(printer.contacts) == 7


def test_gears_and_full_steps_make_a_step_shorter(tmp_path: Path) -> None:
    """80:16 and 400 full steps: a step is a tenth; steps of the file are ten times as many."""
    motor = "rotation_distance: 40\nmicrosteps: 16\ngear_ratio: 80:16\n"
    motor += "full_steps_per_rotation: 400\n"
    lines = [
        ",".join(f"{10.0 * float(part):.3f}" for part in line.split("= ")[1].split(","))
        if "_pos" in line
        else line
        for line in height_lines(PERFECT, 7)
    ]
    keys = [line.split(" =")[0] for line in height_lines(PERFECT, 7)]
    saved_lines = [
        f"{key} = {line}" if "_pos" in key else line for key, line in zip(keys, lines, strict=True)
    ]
    printer = read(tmp_path, PRINTER + steppers(motor=motor) + saved(saved_lines))
    places = np.array([contact.position_mm for contact in printer.contacts])
    assert places[:, :2] == pytest.approx(np.array(rings(7)), abs=STEP_MM)
    machine = printer.opened.machine
    assert machine.screw_lead_mm == 8.0
    assert machine.rotation_distance_mm == (40.0, 40.0, 40.0), "as it stands there"
    assert machine.steps_per_mm == pytest.approx((800.0, 800.0, 800.0))


ARM = steppers()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            PRINTER.replace("delta\n", "cartesian\n").replace("delta_radius", "size") + ARM,
            "[printer] kinematics: found cartesian. Allowed: delta: three upright towers",
        ),
        (
            PRINTER.replace("delta\n", "corexy\n") + ARM,  # a radius that was left there
            "[printer] kinematics: found corexy",
        ),
        (PRINTER + ARM.replace("arm_length", "arm"), "[stepper_a] arm_length: found nothing"),
        (
            PRINTER + ARM.replace("rotation_distance: 40", "step_distance: 0.0125"),
            "[stepper_a] rotation_distance: found step_distance: 0.0125, as Klipper had it before",
        ),
        (
            PRINTER + ARM.replace("rotation_distance: 40\n", ""),
            "[stepper_a] rotation_distance: found nothing. Allowed: the travel for one turn",
        ),
        (PRINTER + ARM.replace("microsteps: 16\n", ""), "[stepper_a] microsteps: found nothing"),
        (PRINTER + ARM.replace("250.0", "nan"), "[stepper_a] arm_length: found 'nan'"),
        (PRINTER + ARM.replace("250.0", "100"), "arm_length: found '100'. Allowed: a finite num"),
        (PRINTER + ARM.replace("250.0", "126"), "bars of 126 mm on a radius of 124 mm"),
        (
            PRINTER + ARM.replace("angle: 330", "angle: 569") + saved(height_lines(PERFECT)),
            "towers at 210, 569, 90°. Allowed: three towers around the plate, 30° or more",
        ),
        (PRINTER + ARM + "gear_ratio: 0:3\n", "[stepper_c] gear_ratio: found '0:3'"),
        (PRINTER + ARM, "no contact with the plate"),
        (PRINTER + "broken\n" + ARM, "no section or key"),
        (
            PRINTER + ARM + saved(["[delta_calibrate]", "height0 = 0"]),
            "height0_pos: found nothing. Allowed: three numbers of steps",
        ),
        (
            PRINTER + ARM + saved(["[delta_calibrate]", "height0 = 0", "height0_pos = 1,2"]),
            "height0_pos: found '1,2'. Allowed: three numbers of steps",
        ),
        (
            PRINTER + ARM + saved(["[delta_calibrate]", "height0 = 0", "height0_pos = 1,2,3"]),
            "a place within 5 mm of the plate. These contacts are of another geometry",
        ),
        (
            PRINTER + ARM + saved(["[delta_calibrate]", "height0 = 0", "height0_pos = 9,99999,3"]),
            "the bars do not meet there",
        ),
        (
            PRINTER + ARM.replace("_distance: 40", "_distance: 32") + saved(height_lines(PERFECT)),
            "These contacts are of another geometry",
        ),
        (
            printer_cfg(PERFECT, 7, distance_lines(PERFECT)[:2]),
            "distance0_pos2: found nothing. Allowed: three numbers of steps beside distance0",
        ),
        (
            printer_cfg(PERFECT, 7, distance_lines(PERFECT, -60.0)),
            "mm apart. Allowed: two marks, and a distance within 5 mm of that. Is it in mm",
        ),
        (
            printer_cfg(PERFECT, 7, ["distance0 = nan", *distance_lines(PERFECT)[1:]]),
            "distance0: found 'nan'. Allowed: a finite number above 0",
        ),
        (
            printer_cfg(PERFECT, 7, ["distance0 = 9", "distance0_pos1 = a", "distance0_pos2 = 1"]),
            "distance0_pos1: found 'a'. Allowed: three numbers of steps",
        ),
        (PRINTER + ARM + saved([]) + "height0 = 0\n", "below the SAVE_CONFIG line"),
        (PRINTER + "[include printer.cfg]\n" + ARM, "no file inside itself"),
        (PRINTER + ARM + saved([]) + saved([]), "no section or key"),
    ],
)
def test_configurations_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "printer.cfg"
    path.write_text(text, encoding="utf-8")
    output = refused(3, "import", path, "-o", tmp_path / "s.jsonl")
    assert message in " ".join(output.split())
    assert not (tmp_path / "s.jsonl").exists()


def test_a_printer_that_was_not_probed_yet_gets_its_machine_file(tmp_path: Path) -> None:
    """With it the places to probe are planned, and the same configuration goes on with the log."""
    cfg, machine, out = (tmp_path / name for name in ("printer.cfg", "m.toml", "s.jsonl"))
    cfg.write_text(PRINTER + ARM, encoding="utf-8")
    run = glidecal("import", cfg, "-o", out, "--machine-file-out", machine)
    assert run.status == 0, run.err
    assert "glidecal plan --machine" in run.err
    assert load_machine(machine).probe_offset_mm is None
    assert not out.exists()
    macro = tmp_path / "places.gcode"
    run = glidecal("plan", "--machine", machine, "--macro", "klipper", "-o", macro)
    assert run.status == 0, run.err
    assert macro.read_text().count("\nPROBE\n") == 58
    again = glidecal("import", cfg, "--machine-file-out", machine, "--force")
    assert (again.status, out.exists()) == (0, False)


def test_the_printers_own_configuration_is_not_replaced_by_the_machine_file(tmp_path: Path) -> None:
    """Before: --force wrote the machine file over the only copy of printer.cfg."""
    cfg, out = tmp_path / "printer.cfg", tmp_path / "s.jsonl"
    cfg.write_text(printer_cfg(PERFECT), encoding="utf-8")
    before = cfg.read_bytes()
    message = refused(2, "import", cfg, "-o", out, "--machine-file-out", cfg, "--force")
    assert "which is read. Allowed: another file" in message
    assert (cfg.read_bytes(), out.exists()) == (before, False)


def test_what_the_command_line_cannot_mean(tmp_path: Path) -> None:
    path, out = tmp_path / "printer.cfg", tmp_path / "s.jsonl"
    path.write_text(printer_cfg(PERFECT), encoding="utf-8")
    assert "one of both" in refused(2, "import", path, "-o", out, "--machine", "linear-delta")
    assert "found none" in refused(2, "import", path)
    assert "one table" in refused(2, "import", path, path, "--template")
    table = tmp_path / "t.csv"
    table.write_text("x_mm,y_mm,z_mm,height_mm\n0,0,0,0\n9,9,0,0\n", encoding="utf-8")
    where = ("--machine-file-out", tmp_path / "m.toml", "--machine", "linear-delta")
    assert "without geometry" in refused(2, "import", table, "-o", out, *where)
    assert "no geometry and no answer of a probe" in refused(3, "import", path, table, "-o", out)
    assert not out.exists()


@LONG
@pytest.mark.parametrize(
    ("hidden", "share"),
    first_quick(
        [(true.Hidden(switch_mm=(0.4, -0.3, 0.2)), 0.15), (true.OFF_IN_ALL, 0.6)], several=True
    ),
    ids=["switches", "all"],
)
def test_from_a_printer_cfg_to_a_better_one(
    tmp_path: Path, hidden: true.Hidden, share: float
) -> None:
    """Import, solve, export, and the true machine follows its tool better with the new values.

    Each place once, on whole steps: nothing tells the noise. Radius and angles are not fitted yet,
    so of all that is off a part stays.
    """
    cfg, session = tmp_path / "printer.cfg", tmp_path / "s.jsonl"
    machine, out = tmp_path / "machine.toml", tmp_path / "calib.cfg"
    cfg.write_text(printer_cfg(hidden), encoding="utf-8")
    run = glidecal("import", cfg, "-o", session, "--machine-file-out", machine)
    assert run.status == 0, run.err
    assert "19 contacts written" in run.err
    assert load_machine(machine) == read_record(session).session.opened.machine
    result = json.loads(glidecal("solve", session, "--json").out)
    assert result["correction"]["holds"] == "offsets"
    run = glidecal("export", session, "--format", "klipper", "-o", out)
    assert run.status == 0, run.err
    before = true.rms(true.errors(hidden, true.klipper(NOW)))
    after = true.rms(true.errors(hidden, true.klipper(out.read_text())))
    assert after < share * before


@given(st.text(alphabet="[]#*=:,.-+0123456789abehigt_\n stepper_adelta_radius", max_size=300))
def test_whatever_stands_below_a_config_is_read_or_refused_in_a_sentence(text: str) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "printer.cfg")
        path.write_text(PRINTER + steppers() + text, encoding="utf-8")
        try:
            values = klipper.content([(path, path.read_text(encoding="utf-8"))])
        except RecordError:
            return
        for contact in values.contacts:
            assert np.isfinite(contact.place_mm).all()


def test_motors_without_a_common_turn_have_no_screw(tmp_path: Path) -> None:
    text = PRINTER + steppers().replace(MOTOR, MOTOR.replace("40", "39.9"), 1)
    printer = read(tmp_path, text + saved([*arms_saved(), *height_lines(PERFECT)]))
    assert printer.opened.machine.screw_lead_mm is None


def relabelled(text: str, order: str) -> str:
    """The same printer with its motors at other drivers: tower a is now the first of ``order``."""

    def steps(match: re.Match[str]) -> str:
        values = dict(zip("abc", match[2].split(","), strict=True))
        of_new = {new: values[old] for old, new in zip("abc", order, strict=True)}
        return match[1] + ",".join(of_new[name] for name in "abc")

    text = re.sub(r"(_pos = )(.*)", steps, text)
    return re.sub(r"\[stepper_([abc])\]", lambda m: f"[stepper_{order['abc'.index(m[1])]}]", text)


@LONG
@pytest.mark.parametrize("order", ["bac", "bca"])
def test_a_tower_keeps_the_motor_that_moves_it(tmp_path: Path, order: str) -> None:
    """Whatever the angles of a, b, c are: values of another's switch would crash the machine."""
    values = {}
    for name in ("abc", order):
        folder = tmp_path / name
        folder.mkdir()
        text = relabelled(printer_cfg(true.OFF_IN_ALL), name)
        (folder / "printer.cfg").write_text(text, encoding="utf-8")
        session = folder / "s.jsonl"
        assert not glidecal("import", folder / "printer.cfg", "-o", session).status
        assert "tower a" in glidecal("solve", session).out
        file = folder / "calib.cfg"
        assert not glidecal("export", session, "--format", "klipper", "-o", file).status
        config = configparser.RawConfigParser()
        config.read(file)
        values[name] = [dict(config[f"stepper_{tower}"]) for tower in name]
    numbers = [
        [[float(tower[key]) for key in ("position_endstop", "arm_length", "angle")] for tower in of]
        for of in values.values()
    ]
    # towers are fitted as they stand about the third one, which is another one here
    assert np.array(numbers[1]) == pytest.approx(np.array(numbers[0]), abs=0.12)
