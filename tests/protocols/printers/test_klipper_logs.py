"""Answers of the command PROBE beside a printer.cfg: contacts, and what is wrong in them."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path

import numpy as np
import pytest

from calib.errors import RecordError
from protocols.observations import to_observations
from protocols.printers import imported
from protocols.printers.imported import imported_printer
from protocols.record import read_record
from tests.app.cli import glidecal, refused
from tests.conftest import LONG
from tests.protocols.printers.printers import (
    PERFECT,
    PRINTER,
    PROBE,
    TRIGGER_MM,
    printer_cfg,
    rings,
    sample_cfg,
    sample_log,
    stable,
    steppers,
)
from tests.protocols.printers.test_klipper import read, session_of


@pytest.mark.parametrize("section", ["probe", "bltouch", "probe_eddy_current coil"])
def test_a_log_of_probe_is_cycles_of_places(tmp_path: Path, section: str) -> None:
    """The answer is of the probe, 20 mm beside the tool; the tool stood 1.5 mm higher."""
    probe = f"[{section}]\nx_offset: 20\ny_offset: -5\nz_offset: 1.5\n"
    log = "".join(
        f"Recv: // probe: at {x:.3f},{y:.3f} bed will contact at z={0.1 + k / 1000:.6f}\n"
        f"Recv: // Result: at {x:.3f},{y:.3f} estimate contact at z={0.1 + k / 1000:.6f}\n"
        for k, (x, y) in enumerate([(0, 0), (30, 0), (0, 30)] * 2)
    )
    printer = read(tmp_path, PRINTER + steppers() + probe, log)
    assert [contact.cycle for contact in printer.contacts] == [1, 1, 1, 2, 2, 2]
    assert printer.contacts[1].position_mm == pytest.approx((10.0, 5.0, 1.601))
    assert {contact.value_mm for contact in printer.contacts} == {1.5}
    observations = to_observations([session_of(printer)])
    assert len(np.unique(observations.posture)) == 3
    assert observations.beside_mm == pytest.approx(np.tile([20.0, -5.0, 0.0], (6, 1)))
    machine = printer.opened.machine
    assert machine.probe_offset_mm == (20.0, -5.0)
    assert machine.platform_tilt_tolerance_mrad > 0.0
    assert not printer.oddities


@pytest.mark.parametrize(("off_mm", "words"), [(0.0, ""), (10.0, "higher"), (-10.0, "lower")])
def test_contacts_that_are_off_alike_are_a_warning(
    off_mm: float, words: str, tmp_path: Path
) -> None:
    """As with a z_offset that is 10 mm wrong: the session is written, and so is a sentence."""
    cfg, log, out = tmp_path / "printer.cfg", tmp_path / "probe.log", tmp_path / "s.jsonl"
    cfg.write_text(PRINTER + PROBE + steppers(), encoding="utf-8")
    log.write_text(
        "".join(
            f"// probe: at {x:.3f},{y:.3f} bed will contact at z={off_mm + 0.1 + k / 1000:.6f}\n"
            for k, (x, y) in enumerate([(0, 0), (30, 0), (0, 30)] * 2)
        ),
        encoding="utf-8",
    )
    run = glidecal("import", cfg, log, "-o", out)
    assert run.status == 0
    assert "6 contacts written" in run.err
    text = " ".join(run.err.split())
    assert ("than the controller expects, at all places alike" in text) == bool(words)
    if words:
        size = abs(off_mm + 0.1025)
        assert f"the plate is {size:.3g} mm {words} than" in text
        assert "up to 2 mm (offset_tolerance_mm, k = 2)" in text


def test_more_contacts_than_a_session_takes_are_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(imported, "Reading", None)
    log = "// probe at 0.000,30.000 is z=2.506948\n" * (imported.MOST_CONTACTS + 1)
    with pytest.raises(RecordError) as refusal:
        read(tmp_path, PRINTER + PROBE + steppers(), log)
    assert "0.log: found 100,001 contacts. Allowed: up to 100,000 in a session" in str(
        refusal.value
    )


def test_a_place_beside_zero_has_no_sign(tmp_path: Path) -> None:
    steps = ",".join(f"{step:.3f}" for step in stable(PERFECT, -0.02, -0.02, 25.0))
    extra = ("manual_height0 = 2.0", f"manual_height0_pos = {steps}")
    with pytest.raises(RecordError, match=r"the tool at \(0\.0, 0\.0, 25\.0\) mm"):
        read(tmp_path, printer_cfg(PERFECT, 7, extra))


@pytest.mark.parametrize("height", ["-0,165508", "1e308", "0.165.5", "1.2e-3"])
def test_an_answer_with_half_a_number_is_named_and_not_used(height: str, tmp_path: Path) -> None:
    """Up to the comma or the letter it would be another height."""
    sound, odd = (
        f"// probe: at 0.000,{y}.000 bed will contact at z={z}\n"
        for y, z in ((0, "0.1"), (30, height))
    )
    printer = read(tmp_path, PRINTER + steppers() + PROBE, sound + odd)
    assert len(printer.contacts) == 1
    assert printer.oddities == (f"0.log, line 2: {odd.strip()!r}: no place of PROBE",)


def test_a_log_that_was_saved_before_it_went_on_is_named_once(tmp_path: Path) -> None:
    lines = [f"// probe: at 0.000,{y}.000 bed will contact at z=0.1\n" for y in range(0, 60, 10)]
    for logs, left_out in (((lines[:4], lines), "0.log"), ((lines, lines[1:3]), "1.log")):
        texts = ["".join(log) for log in logs]
        with pytest.raises(RecordError, match=rf"{left_out}: found the same text as in .*\.log"):
            read(tmp_path, PRINTER + steppers() + PROBE, *texts)
    printer = read(tmp_path, PRINTER + steppers() + PROBE, "".join(lines[:4]), "".join(lines[4:]))
    assert len(printer.contacts) == len(lines)


def test_old_answers_are_the_place_of_the_tool(tmp_path: Path) -> None:
    log = "// probe at 0.000,30.000 is z=2.506948\n// probe at 5.0 is z=1\n"
    printer = read(tmp_path, PRINTER + steppers() + "[probe]\nz_offset: 2.5\n", log)
    (contact,) = printer.contacts
    assert contact.position_mm == (0.0, 30.0, 2.506948)
    assert contact.value_mm == 2.5
    assert printer.oddities == ("0.log, line 2: '// probe at 5.0 is z=1': no place of PROBE",)
    assert printer.opened.remarks == (f"not used: {printer.oddities[0]}",)


def test_a_long_log_takes_no_square_of_its_length(tmp_path: Path) -> None:
    """20,000 contacts at 100 x 100 places, each twice: the second is cycle 2."""
    places = [(x, y) for x in range(-50, 50) for y in range(-50, 50)]
    log = "".join(f"probe: at {x},{y} bed will contact at z=0.1\n" for x, y in places * 2)
    begin = time.process_time()
    printer = read(tmp_path, PRINTER + steppers(), log)
    assert [contact.cycle for contact in printer.contacts] == [1] * 10_000 + [2] * 10_000
    assert time.process_time() - begin < 10.0  # comparing each with each takes minutes; this 2 s


def test_a_log_without_a_geometry_needs_a_machine(tmp_path: Path) -> None:
    log, out = tmp_path / "a.log", tmp_path / "s.jsonl"
    log.write_text("// probe at 0.000,30.000 is z=0.506948\n", encoding="utf-8")
    assert "contacts, and no geometry" in refused(3, "import", log, "-o", out)
    run = glidecal("import", log, "-o", out, "--machine", "linear-delta")
    assert run.status == 0, run.err
    assert "1 contact written" in run.err
    assert read_record(out).session.of_contacts


def test_heights_saved_before_the_radius_was_changed_are_no_contacts_beside_a_log(
    tmp_path: Path,
) -> None:
    """Steps tell places by the values of now, the log by those of the firmware that answered."""
    cfg, log, out = (tmp_path / name for name in ("printer.cfg", "probe.log", "s.jsonl"))
    lines = [f"// probe: at {x:.3f},{y:.3f} bed will contact at z=0.01\n" for x, y in rings(13)]
    log.write_text("".join(lines), encoding="utf-8")
    text = printer_cfg(PERFECT, 7)
    cfg.write_text(text, encoding="utf-8")
    assert glidecal("import", cfg, log, "-o", out).status == 0
    cfg.write_text(text.replace("delta_radius: 124.0", "delta_radius: 90.0"), encoding="utf-8")
    output = refused(3, "import", cfg, log, "-o", tmp_path / "t.jsonl")
    assert "Were values changed between these contacts?" in " ".join(output.split())


@LONG
def test_heights_saved_at_another_trigger_height_have_a_zero_of_their_own(tmp_path: Path) -> None:
    """PROBE_CALIBRATE behind DELTA_CALIBRATE: the same plate is met 0.1 mm elsewhere."""
    higher = re.sub(
        r"(contact at z=)(\S+)", lambda m: f"{m[1]}{float(m[2]) + 0.1:.6f}", sample_log()
    )
    arms = []
    for trigger_mm, log in ((TRIGGER_MM, sample_log()), (TRIGGER_MM - 0.1, higher)):
        folder = tmp_path / f"{trigger_mm:g}"
        folder.mkdir()
        cfg = sample_cfg().replace(f"z_offset: {TRIGGER_MM}", f"z_offset: {trigger_mm:g}")
        printer = read(folder, cfg, log)
        mounts = {contact.mount for contact in printer.contacts}
        assert len(mounts) == (1 if trigger_mm == TRIGGER_MM else 2)
        assert not glidecal("import", *sorted(folder.iterdir()), "-o", folder / "s.jsonl").status
        answer = json.loads(glidecal("solve", folder / "s.jsonl", "--json").out)
        towers = answer["correction"]["firmware"]["towers"]
        arms.append([tower["arm_mm"]["then"] for tower in towers])
    assert arms[1] == pytest.approx(arms[0], abs=0.1)  # with one zero 0.3, 1.1 and 1.0 mm off


def test_contacts_before_other_values_were_saved_are_named_and_not_used(tmp_path: Path) -> None:
    lines = [f"// probe: at {x},0.000 bed will contact at z=0.010000\n" for x in (0.0, 30.0, 60.0)]
    note = "// The SAVE_CONFIG command will update the printer config file\n"
    for command in ("SAVE_CONFIG", "Send: SAVE_CONFIG", "12:01:02 PM > SAVE_CONFIG"):
        log = "".join([lines[0], note, lines[1], f"{command}\n", lines[2]])
        printer = read(tmp_path, PRINTER + steppers(), log)
        assert [contact.position_mm for contact in printer.contacts] == [(60.0, 0.0, 0.01)]
        assert printer.oddities == (
            "2 contacts before SAVE_CONFIG in line 4 of 0.log: they may be of other values",
        )


@LONG
def test_a_log_of_two_probings_that_disagree_is_solved(tmp_path: Path) -> None:
    """A model that was tried led where no bars meet."""
    lines = sample_log().splitlines(keepends=True)
    is_answer = ["contact at" in line for line in lines]
    first = [k for k, answer in enumerate(is_answer) if answer][:7]
    for k in first:
        lines[k] = re.sub(r"z=(\S+)", lambda m: f"z={float(m[1]) + 0.2:.6f}", lines[k])
    cfg, log, session = (tmp_path / name for name in ("printer.cfg", "0.log", "s.jsonl"))
    cfg.write_text(PRINTER + PROBE + steppers(), encoding="utf-8")
    log.write_text("".join(lines), encoding="utf-8")
    assert glidecal("import", cfg, log, "-o", session).status == 0
    run = glidecal("solve", session)
    assert run.status == 0, run.err
    assert "WARNING" in run.out


def test_with_a_machine_file_a_log_alone_is_of_its_probe(tmp_path: Path) -> None:
    probe = "[probe]\nx_offset: 20\ny_offset: -5\nz_offset: 0\n"
    log = "probe: at 0.000,0.000 bed will contact at z=0.1\n"
    printer = read(tmp_path, PRINTER + steppers() + probe, log)
    alone = imported_printer([tmp_path / "0.log"], "test", machine=printer.opened.machine)
    assert alone.contacts[0].position_mm == (-20.0, 5.0, 0.1)


@pytest.mark.parametrize("places", [[(0, 0)] * 3, [(0, 0), (50, 0), (0, 50)]])
def test_too_few_places_are_answered_in_words_of_contacts(
    tmp_path: Path, places: list[tuple[int, int]]
) -> None:
    log = "".join(f"probe: at {x}.0,{y}.0 bed will contact at z=0.1\n" for x, y in places)
    cfg, file, session = (tmp_path / name for name in ("printer.cfg", "0.log", "s.jsonl"))
    cfg.write_text(PRINTER + steppers(), encoding="utf-8")
    file.write_text(log, encoding="utf-8")
    assert glidecal("import", cfg, file, "-o", session).status == 0
    assert "the middle and two rings of six places" in " ".join(
        refused(5, "solve", session).split()
    )
