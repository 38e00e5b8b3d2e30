"""What the result of a printer tells its owner, against machines and firmware of the tests."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.report.certificate import calibration_of
from app.report.dcc.legs import results_of
from app.report.text.printer import tower_remedies
from calib.tripod.effects.bars import GravitySag, LegLength
from calib.tripod.effects.drives import ActuatorScale, AxisOffset, AxisSquareness, Backlash
from calib.tripod.effects.effect import EffectInstance
from tests.app.cli import glidecal
from tests.app.exports import upright_towers as true
from tests.app.exports.test_imported_printers import (
    REAL_NOW,
    REAL_READ,
    file_of,
    heights,
    session_of,
)
from tests.app.report.test_schemas import kept
from tests.conftest import LONG
from tests.protocols.printers.answers import m503, real_eeprom
from tests.protocols.printers.printers import printer_cfg

TOWERS = {"x": "a", "y": "b", "z": "c"}
SWITCHES = (0.4, -0.3, 0.2)


def told(session: Path, verb: str = "solve") -> str:
    run = glidecal(verb, session)
    assert run.status == 0, run.err
    return run.out.partition("\nView: ")[0]


def rows(text: str) -> dict[str, list[float]]:
    """The table of towers: what stands behind their letters."""
    matches = re.findall(r"(?m)^ (?:tower )?([abc]) +([-+\d. ]+)$", text)
    return {name: [float(figure) for figure in figures.split()] for name, figures in matches}


def figure(text: str, before: str) -> float:
    (number,) = re.findall(re.escape(before) + r" ([\d.]+) mm", " ".join(text.split()))
    return float(number)


@LONG
def test_screws_of_the_endstops_mend_what_is_off_there(tmp_path: Path) -> None:
    """The switches moved by the last column, and the values of the firmware left as they are."""
    hidden = true.Hidden(switch_mm=SWITCHES)
    table = rows(told(session_of(tmp_path, printer_cfg(hidden))))
    assert [now for now, _, _ in table.values()] == list(true.ENDSTOPS)
    assert all(then - now == pytest.approx(-by, abs=2e-3) for now, then, by in table.values())
    x, y, z = (off + table[name][2] for off, name in zip(SWITCHES, "abc", strict=True))
    moved = true.Hidden(switch_mm=(x, y, z))
    before, after = (true.rms(true.errors(state, true.BELIEVED)) for state in (hidden, moved))
    assert after < 0.15 * before


@LONG
def test_the_table_is_what_the_file_holds(tmp_path: Path) -> None:
    session = session_of(tmp_path, m503(true.OFF_IN_ALL, 2))
    table, text = rows(told(session)), file_of(session, "klipper", tmp_path)
    for name, (_, stop, _, arm, _, angle) in table.items():
        block = text.partition(f"[stepper_{name}]")[2]
        for key, value in (("position_endstop", stop), ("arm_length", arm), ("angle", angle)):
            written = float(re.findall(rf"{key}: (\S+)", block)[0])
            assert written == pytest.approx(value, abs=5.1e-4)


@LONG
def test_how_even_the_plate_would_be_is_what_the_firmware_would_show(tmp_path: Path) -> None:
    """Of ten contacts of a real printer, by the formulas of its firmware with the file."""
    session = session_of(tmp_path, real_eeprom())
    text, file = told(session), file_of(session, "klipper", tmp_path)
    now, then = heights(REAL_NOW).std(), heights(REAL_READ["klipper"](file)).std()
    assert figure(text, "The heights of the plate differ by") == pytest.approx(now, abs=5e-4)
    assert figure(text, "the same contacts would differ by") == pytest.approx(then, abs=5e-4)
    assert "No place was probed twice" in text


@LONG
def test_json_has_what_the_page_has(tmp_path: Path) -> None:
    """Values of firmware with their bound, which decides, and which a verification expects."""
    before = session_of(tmp_path, m503(true.OFF_IN_ALL, 2))
    text, out = told(before), glidecal("solve", before, "--json", "--tolerance", "1").out
    assert kept(out) == "solution"
    correction = json.loads(out)["correction"]
    firmware = correction["firmware"]
    for tower in firmware["towers"]:
        entries = (tower[key] for key in ("endstop_mm", "arm_mm", "angle_deg"))
        figures = [entry[when] for entry in entries for when in ("now", "then")]
        assert figures == pytest.approx(rows(text)[tower["tower"]], abs=5.1e-4)
    match = re.findall(r"touched off: a shift is free +(\S+) +(\S+)", text)
    bounds = correction["bound_now"], firmware["bound"]
    for words, bound in zip(*match, bounds, strict=True):
        assert float(words) == pytest.approx(bound["touched_off_mm"], rel=0.05)
    (tmp_path / "later").mkdir()
    after = session_of(tmp_path / "later", m503(true.Hidden(), 2))
    report = json.loads(glidecal("verify", before, after, "--json").out)
    assert report["bound_expected_mm"] == firmware["bound"]["touched_off_mm"]
    assert report["something_missing"] == ("missing from the model" in verified(before, after))


@LONG
def test_the_report_has_the_lines_of_the_drives(tmp_path: Path) -> None:
    """Before: only the terminal had their uncertainty, of a delta and of a printer."""
    printer = session_of(tmp_path, m503(true.OFF_IN_ALL, 2))
    delta = tmp_path / "delta.jsonl"
    assert glidecal("simulate", "--machine", "linear-delta", "-o", delta).status == 0
    for session in (printer, delta):
        page = re.sub(r"<[^>]+>", " ", glidecal("report", session, "-o", "-").out)
        text = " ".join(page.split())
        lines = [" ".join(line.split()) for line in glidecal("solve", session).out.splitlines()]
        rows_of_lines = [line for line in lines if re.match(r"axis_lean [xyz][rt] [+-]", line)]
        assert len(rows_of_lines) == 6
        assert [line for line in rows_of_lines if line not in text] == []


def verified(before: Path, after: Path) -> str:
    return glidecal("verify", before, after).out


def scattered(scatter_mm: float) -> str:
    """What M503 and three cycles of G30 show of a sound machine with a bad probe."""
    generator = np.random.default_rng(5)

    def with_scatter(match: re.Match[str]) -> str:
        return f"Z: {float(match[1]) + generator.normal(scale=scatter_mm):.3f}"

    return re.sub(r"Z: (\S+)$", with_scatter, m503(true.Hidden(), 3), flags=re.MULTILINE)


@LONG
def test_a_probe_that_scatters_is_not_taken_for_geometry(tmp_path: Path) -> None:
    text = told(session_of(tmp_path, scattered(0.05)))
    assert figure(text, "Contacts at one place repeat to") == pytest.approx(0.05, rel=0.3)
    assert "the probe limits what can be seen, not the geometry" in " ".join(text.split())


@pytest.mark.parametrize(
    ("law", "place", "value", "words"),
    [
        (ActuatorScale(), "y", 5.0, "belt of tower b: multiply its rotation_distance (Klipper) by"),
        (Backlash(), "z", 0.08, "belt or joints of tower c are slack by 0.080 mm: tighten them"),
        (LegLength(), "x", -0.4, "arm of tower a: -0.400 mm, in the exported values"),
        (AxisOffset(), "zr", 0.8, "foot of tower c is 0.800 mm too far out: "),
        (AxisOffset(), "xt", -0.3, "foot of tower a is 0.300 mm too far clockwise: "),
        (AxisSquareness(), "xy", 4.0, "towers a and b lean, for which firmware has no value: "),
    ],
)
def test_what_to_turn_is_told_in_words_of_a_printer(
    law: ActuatorScale, place: str, value: float, words: str
) -> None:
    effect = EffectInstance(law, place, (value,))
    (line,) = tower_remedies([effect], TOWERS)
    assert line.startswith(words)
    (elsewhere,) = tower_remedies([effect], {})
    assert "tower" not in elsewhere


def test_what_to_turn_has_no_more_digits_than_its_uncertainty() -> None:
    """The last digit is the second one of ±, 95 %."""
    play = EffectInstance(Backlash(), "z", (0.0812,), (0.11,))
    assert tower_remedies([play], TOWERS)[0].startswith(
        "belt or joints of tower c are slack by 0.08 "
    )
    belt = EffectInstance(ActuatorScale(), "y", (5.0,), (4.0,))
    (line,) = tower_remedies([belt], TOWERS)
    assert "(Klipper) by 1.00500, or" in tower_remedies([replace(belt, deviations=())], TOWERS)[0]
    assert "(Klipper) by 1.0050, or its steps per mm (M92) by 0.9950;" in line


def test_a_belt_that_is_put_right_makes_steps_as_long_as_they_are() -> None:
    """40 mm a turn are held, 40.2 mm it travels: commanded less steps, so that it arrives."""
    (line,) = tower_remedies([EffectInstance(ActuatorScale(), "y", (5.0,))], TOWERS)
    times, steps = map(float, re.findall(r"by (\d+\.\d+)", line))
    commanded_mm = 100.0
    turns = commanded_mm / (40.0 * times)
    assert turns * 40.2 == pytest.approx(commanded_mm, abs=1e-3)
    assert times * steps == pytest.approx(1.0, abs=1e-5)


def test_leaning_towers_that_are_moved_as_told_stand_upright_again() -> None:
    lean_xy = 0.004
    (line,) = tower_remedies([EffectInstance(AxisSquareness(), "xy", (1e3 * lean_xy,))], TOWERS)
    (way, mm_a_metre) = re.findall(r"tops (\w+), (\S+) mm", line)[0]
    assert way == "apart", "with their height they come nearer (see `Hidden`)"
    assert float(mm_a_metre) == pytest.approx(1000.0 * lean_xy, abs=0.01)


def test_laws_without_words_for_printers_have_those_of_any_machine() -> None:
    effect = EffectInstance(GravitySag(), "x", (0.3,))
    assert tower_remedies([effect], TOWERS) == tower_remedies([effect], {})


@LONG
def test_a_stretched_belt_is_named_with_what_to_turn(tmp_path: Path) -> None:
    from tests.blind import linear_delta as blind

    hidden = blind.Hidden(offset_mm=(0.1, -0.1, 0.1), scale=(0.0, 0.012, 0.0))
    generator = np.random.default_rng(3)
    lines = [m503(true.Hidden()).partition("ok\n")[0].replace("X15.00 Y-5.00 Z-2.00", "Z0.00")]
    for _, place in blind.places(3):
        z = blind.touched(hidden, place[:2])[2] + generator.normal(scale=0.003)
        lines.append(f"Bed X: {place[0]:.3f} Y: {place[1]:.3f} Z: {z:.4f}\n")
    text = " ".join(told(session_of(tmp_path, "".join(lines)), "diagnose").split())
    assert "belt of tower b: multiply its rotation_distance (Klipper) by 1.01" in text
    assert "where glidecal solve lists it, enter that value instead, with all others there" in text
    (steps,) = re.findall(r"(?m)^ belt b +80\.0000 +(\S+) ", told(tmp_path / "s.jsonl"))
    assert float(steps) == pytest.approx(80.0 / 1.012, abs=0.1), "it arrives with fewer"
    document = json.loads(glidecal("solve", tmp_path / "s.jsonl", "--json").out)
    effects = {(effect["id"], effect["place"]): effect for effect in document["lines"]}
    assert len(effects) == 14, "two places, but for one, two directions and a travel of each drive"
    belt = effects["actuator_scale", "y"]
    assert belt["value"] == pytest.approx(12.0, abs=3.0 * belt["expanded_uncertainty"])
    assert (belt["unit"], belt["tolerance"]) == ("mm/m", 1.0)
    certified = next(results_of(calibration_of([tmp_path / "s.jsonl"]))).quantities
    (entry,) = (quantity for quantity in certified if quantity.name == "tower b: steps per mm")
    assert entry.value == pytest.approx(float(steps), abs=5.1e-5), "no certificate drops a part"


@LONG
def test_repeats_that_agree_to_the_last_digit_are_repeats(tmp_path: Path) -> None:
    """Of Marlin's hundredths: it was said, too, that no place was probed twice."""
    log, session = tmp_path / "m.log", tmp_path / "s.jsonl"
    log.write_text(m503(true.OFF_IN_ALL, 3), encoding="utf-8")
    assert glidecal("import", log, "-o", session).status == 0
    text = glidecal("solve", session).out
    assert "all repeats agree within a step of the display" in " ".join(text.split())
    assert "No place was probed twice" not in text
