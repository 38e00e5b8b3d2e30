"""From contacts of a printer to files for every firmware: the height of the plate stays.

The firmwares are those of `upright_towers`, written from their formulas. `met` asks one of them
where it believes to be with the carriages of a contact, so that contacts of a real printer, whose
truth nobody knows, judge a file too: the plate must be where it was, and more even.
"""

from __future__ import annotations

import configparser
import csv
import json
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.app.cli import glidecal, refused
from tests.app.exports import upright_towers as true
from tests.conftest import LONG, first_quick
from tests.protocols.printers.answers import TEN, m503, real_eeprom
from tests.protocols.printers.printers import printer_cfg

MIDDLE = np.zeros(3)
WITHIN_MM = 0.05


def session_of(folder: Path, text: str) -> Path:
    source, session = folder / "printer.txt", folder / "s.jsonl"
    source.write_text(text, encoding="utf-8")
    run = glidecal("import", source, "-o", session)
    assert run.status == 0, run.err
    return session


def file_of(session: Path, kind: str, folder: Path, *options: str) -> str:
    out = folder / kind
    run = glidecal("export", session, "--format", kind, "-o", out, *options)
    assert run.status == 0, run.err
    text = out.read_text(encoding="utf-8")
    assert true.comments(text).startswith(
        "BEFORE THE FIRST MOVE: home, then touch the plate again; these values keep the present "
        "height"
    )
    return text


def met(firmware: true.Firmware, travel_mm: true.FloatArray) -> true.FloatArray:
    """Where a firmware believes its tool to be, this far below the switches: Newton's method."""
    place = np.zeros(3)
    for _ in range(30):
        ways = 1e-4 * np.eye(3)
        slopes = [(firmware(place + way) - firmware(place - way)) / 2e-4 for way in ways]
        place = place - np.linalg.solve(np.array(slopes).T, firmware(place) - travel_mm)
    assert np.abs(firmware(place) - travel_mm).max() < 1e-9
    return place


@pytest.fixture(scope="module", params=first_quick(["klipper", "marlin"]))
def simulated(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    text = {"klipper": printer_cfg(true.OFF_IN_ALL), "marlin": m503(true.OFF_IN_ALL, 2)}
    return session_of(tmp_path_factory.mktemp("simulated"), text[request.param])


@LONG
@pytest.mark.parametrize("kind", first_quick(true.READ_ANY))
def test_the_true_machine_keeps_its_height_over_the_plate(
    kind: str, simulated: Path, tmp_path: Path
) -> None:
    now, then = true.BELIEVED, true.READ_ANY[kind](file_of(simulated, kind, tmp_path))
    raised = true.OFF_IN_ALL.tool(then(MIDDLE))[2] - true.OFF_IN_ALL.tool(now(MIDDLE))[2]
    assert raised == pytest.approx(0.0, abs=WITHIN_MM)
    assert true.rms(true.errors(true.OFF_IN_ALL, then)) < true.rms(
        true.errors(true.OFF_IN_ALL, now)
    )


REAL_BAR, REAL_RADIUS = 203.45, 96.52
REAL_STOPS, REAL_ANGLES = (275.38, 275.91, 277.09), (207.04, 326.63, 90.0)
"""Of the public printer, as its EEPROM has them (see `test_firmwares`)."""

REAL_NOW = true.klipper(
    f"[printer]\ndelta_radius: {REAL_RADIUS}\n"
    + "".join(
        f"[stepper_{name}]\nposition_endstop: {stop}\narm_length: {REAL_BAR}\nangle: {angle}\n"
        for name, stop, angle in zip("abc", REAL_STOPS, REAL_ANGLES, strict=True)
    )
)


def real_p_3z(text: str) -> true.Firmware:
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    values = {row["parameter"]: float(row["value"]) for row in csv.DictReader(lines)}
    towers = np.array([[values[f"Rail {n} {way}-position"] for way in "XY"] for n in (1, 2, 3)])
    change = [values[f"axis {n} position at homing, change"] for n in (1, 2, 3)]
    homes = np.array(REAL_STOPS) + math.sqrt(REAL_BAR**2 - REAL_RADIUS**2) + change
    bars = np.full(3, values["Arm length"])
    return lambda place: homes - true.carriages(place, bars, towers)


REAL_READ: dict[str, Callable[[str], true.Firmware]] = {**true.READ_ANY, "p-3z": real_p_3z}


def heights(firmware: true.Firmware) -> true.FloatArray:
    """Of the ten contacts, the last in the middle, as a firmware believes them."""
    places = [np.array([x, y, -down]) for x, y, down in TEN]
    return np.array([met(firmware, REAL_NOW(place))[2] for place in places])


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return session_of(tmp_path_factory.mktemp("real"), real_eeprom())


@pytest.mark.parametrize("kind", first_quick(REAL_READ))
@pytest.mark.parametrize(
    "options", first_quick([(), ("--subset", "leg-lengths")]), ids=["correction", "lengths"]
)
def test_ten_contacts_of_a_real_printer_stay_at_their_height(
    kind: str, options: Sequence[str], real: Path, tmp_path: Path
) -> None:
    """Bars shorter by 7 mm, as the set of lengths has them, would raise the tool by 8 mm."""
    before = heights(REAL_NOW)
    assert before == pytest.approx([-down for _, _, down in TEN], abs=1e-9)
    after = heights(REAL_READ[kind](file_of(real, kind, tmp_path, *options)))
    assert after[-1] - before[-1] == pytest.approx(0.0, abs=WITHIN_MM)
    assert after.std() < before.std()


@LONG
def test_no_document_drops_what_the_firmware_of_a_printer_holds(
    simulated: Path, tmp_path: Path
) -> None:
    """Judged by the file for Klipper. Before: JSON, CSV and diagnose had joint offsets only."""
    run = glidecal("export", simulated, "--format", "klipper", "-o", tmp_path / "c.cfg")
    file = configparser.ConfigParser(inline_comment_prefixes="#")
    file.read(tmp_path / "c.cfg", encoding="utf-8")
    (bound,) = re.findall(r"at most (\S+) mm with these values", run.err)

    def document(*arguments: str | Path) -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(glidecal(*arguments).out)
        return answer

    offsets = document("export", simulated, "--format", "json", "-o", "-")
    firmware = offsets["firmware"]
    assert firmware["radius_mm"]["then"] == pytest.approx(
        file.getfloat("printer", "delta_radius"), abs=1e-6
    )
    for tower in firmware["towers"]:
        stepper = file[f"stepper_{tower['tower']}"]
        value = [stepper.getfloat(key) for key in ("position_endstop", "arm_length", "angle")]
        entries = [tower[key]["then"] for key in ("endstop_mm", "arm_mm", "angle_deg")]
        assert entries == pytest.approx(value, abs=1e-6)
    tool = document("diagnose", simulated, "--json")["tool"]
    for bound_mm in (firmware["bound"]["touched_off_mm"], tool["firmware_mm"]):
        assert bound_mm == pytest.approx(float(bound), abs=5e-4)
    assert f"With all values of the firmware entered: {bound} mm." in words(
        glidecal("diagnose", simulated).out
    )
    table = glidecal("export", simulated, "--format", "csv", "-o", "-")
    lacks = (
        "arm lengths, radius and angles of the firmware are not among these values. With all "
        f"values of the firmware entered, the tool is off by at most {bound} mm"
    )
    assert all(lacks in words(text) for text in (table.out, table.err, *offsets["cautions"][1:2]))


def words(text: str) -> str:
    return " ".join(text.split())


def test_a_set_that_a_plate_does_not_show_is_refused_without_advice_on_legs(
    simulated: Path, tmp_path: Path
) -> None:
    """Before: "measure Zero, Max and Min on all three legs", which no printer can."""
    arguments = ("--subset", "both", "--format", "json", "-o", tmp_path / "o.json")
    message = refused(5, "export", simulated, *arguments)
    assert "the set 'both' cannot be identified from these readings" in message
    assert "all three legs" not in message
    assert "a procedure that shows it: glidecal identifiability" in message
