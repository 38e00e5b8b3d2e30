"""Planned places as G-code: read back as the firmware would, and what no probe can measure."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from protocols.machine import load_machine, machine_text
from protocols.printers.tower_printer import TowerPrinter
from protocols.procedure import load_procedure
from tests.app.cli import glidecal, refused
from tests.protocols.printers.printers import PRINTER, steppers

DIALECTS = ("klipper", "reprapfirmware", "marlin")
DRY = ("run", "--dry-run", "--machine", "linear-delta")
MIDDLE = (0.0, 0.0)


def planned() -> list[tuple[float, float]]:
    procedure = load_procedure("plate-rings", load_machine("linear-delta").geometry())
    steps = procedure.steps(load_machine("linear-delta").geometry())
    return [step.position_mm[:2] for step in steps if step.position_mm is not None]


def probed(text: str) -> list[tuple[float, float]]:
    """Where each probing move of any of the three firmwares meets the plate."""
    place, points = MIDDLE, []
    for line in text.splitlines():
        words = {word[0]: float(word[1:]) for word in line.split()[1:] if line[0] != ";"}
        if line.startswith(("G1 ", "G30")) and "X" in words:
            place = words["X"], words["Y"]
        if line.startswith("G30") or line == "PROBE":
            points.append(place)
    return points


def ran(*arguments: str | Path) -> str:
    run = glidecal(*arguments)
    assert run.status == 0, run.err
    return run.out


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_planned_place_is_probed_in_its_order(dialect: str) -> None:
    points, places = probed(ran(*DRY, "--macro", dialect)), planned()
    assert len(points) == len(places) == 58
    for (x, y), (to_x, to_y) in zip(points, places, strict=True):
        assert (x, y) == pytest.approx((to_x, to_y), abs=0.0051 if dialect == "marlin" else 1e-9)


@pytest.mark.parametrize(("dialect", "far_mm"), [("klipper", 108.5), ("marlin", 108.5)])
def test_a_probe_beside_the_nozzle_needs_a_larger_plate(
    dialect: str, far_mm: float, tmp_path: Path
) -> None:
    """28.5 mm in front of the tool: at the place (0, 80) it is 108.5 mm out, or the nozzle is."""
    machine = tmp_path / "m.toml"
    beside = load_machine("linear-delta").model_copy(update={"probe_offset_mm": (0.0, 28.5)})
    machine.write_text(machine_text(beside, []), encoding="utf-8")
    above = ran("plan", "--machine", machine, "--macro", dialect).replace("\n; ", " ")
    assert f"{'probe' if dialect == 'klipper' else 'nozzle'} goes up to {far_mm} mm" in above
    assert "goes up to" not in ran("plan", "--machine", "linear-delta", "--macro", dialect)


def test_the_nozzle_rises_before_each_way_in_klipper() -> None:
    height = 0.0
    for line in ran(*DRY, "--macro", "klipper").splitlines():
        if line.startswith("G1 Z"):
            height = float(line.split()[1][1:])
        elif line.startswith("G1 X"):
            assert height >= 10.0
        elif line == "PROBE":
            height = 0.0


def test_each_cycle_is_one_report_of_reprapfirmware() -> None:
    lines = re.findall(r"^G30 P.*$", ran(*DRY, "--macro", "reprapfirmware"), re.M)
    points = [int(line.split()[1][1:]) for line in lines]
    reports = [number for number, line in enumerate(lines) if line.endswith("S-1")]
    assert points == [*range(19), *range(19), *range(20)]
    assert reports == [18, 37, 57]


def test_more_places_than_a_report_holds_are_several(tmp_path: Path) -> None:
    many = plate(tmp_path, "radii_mm = [50.0]\npoints = 70")
    text = ran(*DRY, "--protocol", many, "--macro", "reprapfirmware")
    points = [int(number) for number in re.findall(r"^G30 P(\d+) ", text, re.M)]
    assert len(points) == 70
    assert max(points) < 24, "or the answer has more than 256 characters"
    assert text.count("S-1\n") == points.count(0) == 3


def plate(folder: Path, lines: str) -> Path:
    path = folder / "mine.toml"
    head = 'schema = "glidecal.procedure/1"\nname = "mine"\ntitle = "Mine"\ncycles = 1\n'
    path.write_text(f"{head}return_to_zero = false\n[plate]\n{lines}\n", encoding="utf-8")
    return path


def test_plan_writes_the_same_to_a_file_or_to_standard_output(tmp_path: Path) -> None:
    out = tmp_path / "probe.gcode"
    text = ran("plan", "--machine", "linear-delta", "--macro", "marlin", "-o", out)
    assert "import that log" in text
    assert out.read_text(encoding="utf-8") == ran(*DRY, "--macro", "marlin")
    assert ran("plan", "--machine", "linear-delta", "--macro", "marlin") == out.read_text("utf-8")
    session = tmp_path / "s.jsonl"
    ran("simulate", "--machine", "linear-delta", "-o", session)
    assert ran("plan", session, "--macro", "marlin") == out.read_text(encoding="utf-8")


def test_places_outside_the_printable_circle_are_refused(tmp_path: Path) -> None:
    arguments = (*DRY, "--macro", "klipper")
    message = refused(2, *arguments, "--printable-radius", "75")
    assert "(0, 80, 0) mm, 80.0 mm from the middle" in message
    assert "printable circle, up to 75.0 mm" in message
    ran(*arguments, "--printable-radius", "80")
    far = plate(tmp_path, "positions_mm = [[0.0, 0.0, 0.0], [0.0, 124.5, 0.0]]")
    assert "up to 124.0 mm" in refused(2, *arguments, "--protocol", far)
    ran(*arguments, "--protocol", far, "--printable-radius", "130")


@pytest.mark.parametrize(
    ("printable", "furthest_mm"),
    [
        ("print_radius: 50", 40.0),
        ("print_radius: 75", 60.0),
        ("print_radius: 115", 92.0),
        ("", 80.0),
    ],
)
def test_rings_follow_the_printable_radius_of_the_firmware(
    printable: str, furthest_mm: float, tmp_path: Path
) -> None:
    """From `print_radius` through the machine file to the places of each firmware's macro."""
    config, machine = tmp_path / "printer.cfg", tmp_path / "printer.toml"
    config.write_text(PRINTER.replace("print_radius: 100", printable) + steppers(), "utf-8")
    ran("import", config, "--machine-file-out", machine)
    for dialect in DIALECTS:
        places = probed(ran("plan", "--machine", machine, "--macro", dialect))
        away_mm = [math.hypot(x, y) for x, y in places]
        assert len(places) == 58
        assert max(away_mm) == pytest.approx(furthest_mm, abs=0.01)
    dry = ran("run", "--dry-run", "--machine", machine, "--macro", "marlin")
    assert probed(dry) == probed(ran("plan", "--machine", machine, "--macro", "marlin"))
    if printable:  # a procedure of one's own stays as it is
        beyond_mm = furthest_mm / 0.8 + 1.0
        edge = plate(tmp_path, f"radii_mm = [0.0, {beyond_mm}]")
        message = refused(2, "plan", "--machine", machine, "--macro", "klipper", "--protocol", edge)
        assert f"{beyond_mm:.1f} mm from the middle" in message


def test_a_printer_smaller_than_the_usual_rings_is_probed_as_far_as_it_reaches() -> None:
    """Nobody stated what is printable: bars of 150 mm on 63 mm reach 63 mm."""
    small = TowerPrinter("p", "p", (150.0,) * 3, (63.0,) * 3, (200.0,) * 3)
    assert small.machine(()).printable_radius_mm == 63.0
    large = TowerPrinter("p", "p", (300.0,) * 3, (140.0,) * 3, (300.0,) * 3)
    assert large.machine(()).printable_radius_mm is None


def test_what_no_probe_measures_is_refused(tmp_path: Path) -> None:
    above = plate(tmp_path, "radii_mm = [0.0, 50.0]\nheights_mm = [0.0, 20.0]")
    assert "at z = 0" in refused(2, *DRY, "--macro", "klipper", "--protocol", above)
    across = plate(tmp_path, 'axis = "x"\nradii_mm = [0.0, 50.0]')
    assert "a plate across x" in refused(2, *DRY, "--macro", "klipper", "--protocol", across)
    assert "readings of legs" in refused(2, "run", "--dry-run", "--macro", "klipper")
    square = ("run", "--dry-run", "--protocol", plate(tmp_path, "radii_mm = [0.0, 20.0]"))
    assert "upright towers" in refused(2, *square, "--macro", "klipper")


def test_options_that_need_each_other() -> None:
    delta = ("--machine", "linear-delta")
    assert "no --dry-run" in refused(2, "run", *delta, "--simulated", "--macro", "klipper")
    assert "no --dry-run" in refused(2, "run", "--continue", ".", "--macro", "klipper")
    assert "no --macro" in refused(2, *DRY, "--printable-radius", "80")
    assert "plan --macro" in refused(2, *DRY, "--macro", "klipper", "-o", "probe.gcode")
    assert "no --macro" in refused(2, "plan", "--protocol", "plate-rings")
    assert "--json" in refused(2, "plan", *delta, "--macro", "klipper", "--json")
