"""RepRapFirmware, Marlin and Repetier: lines as they hold and answer them are imported."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.evaluating.diagnosis import diagnose_sessions
from calib.errors import RecordError
from protocols.documents import Triple
from protocols.machine import load_machine
from protocols.observations import to_observations
from protocols.printers import marlin, repetier, reprapfirmware
from protocols.printers.imported import ImportedPrinter, are_of_printer, imported_printer
from protocols.printers.tower_printer import TowerPrinter
from protocols.session import fold
from tests.app.cli import glidecal
from tests.app.exports import upright_towers as true
from tests.conftest import LONG, first_quick
from tests.protocols.printers.answers import (
    CONFIG_G,
    G33_AT_DEG,
    HEIGHT,
    STOPS,
    g32,
    g33,
    held_by_marlin,
    m205,
    m503,
    real_eeprom,
    words,
)
from tests.protocols.printers.printers import PERFECT, rings, touched_at


def read(folder: Path, *texts: str) -> ImportedPrinter:
    paths = [folder / f"{number}.g" for number in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text, encoding="utf-8")
    return imported_printer(paths, "test")


def positions(printer: ImportedPrinter) -> list[tuple[float, float, float]]:
    return [contact.position_mm for contact in printer.contacts if contact.position_mm is not None]


@pytest.mark.parametrize("dialect", ["reprapfirmware", "marlin", "repetier"])
@pytest.mark.parametrize("hidden", [PERFECT, true.OFF_IN_ALL], ids=["none", "all"])
def test_geometry_and_contacts_are_what_the_firmware_holds(
    tmp_path: Path, dialect: str, hidden: true.Hidden
) -> None:
    texts = {
        "reprapfirmware": (CONFIG_G, *g32(hidden, 2)),
        "marlin": (m503(hidden, 2),),
        "repetier": (m205(hidden, 2),),
    }[dialect]
    printer = read(tmp_path, *texts)
    machine, far = printer.opened.machine, 3.0 if dialect == "repetier" else 0.0
    assert not printer.oddities
    assert machine.leg_length_mm == true.BAR
    assert machine.position_endstop_mm == pytest.approx(true.ENDSTOPS, abs=1e-9)
    assert machine.drive is not None
    stand = np.array([drive.origin_mm[:2] for drive in machine.drive])
    assert np.hypot(*stand.T) == pytest.approx([true.RADIUS] * 3, abs=1e-5)
    assert np.degrees(np.arctan2(*stand.T[::-1])) % 360.0 == pytest.approx(true.ANGLES, abs=1e-4)
    height = {"reprapfirmware": 0.25, "marlin": 2.0, "repetier": 0.0}[dialect]
    assert {contact.value_mm for contact in printer.contacts} == {height}
    assert [contact.cycle for contact in printer.contacts] == [1] * 19 + [2] * 19
    places = np.array([contact.position_mm for contact in printer.contacts[:19]])
    want = np.array([touched_at(hidden, x, y, height) for x, y in rings()]) - [0.0, 0.0, far]
    assert np.abs(places - want).max() < 0.0051
    observations = to_observations([fold([printer.opened, *printer.contacts])])
    assert observations.contact.all()
    assert len(np.unique(observations.posture)) == 19


@pytest.mark.parametrize(
    ("places", "sent", "names"),
    [
        (3, "G33 P3 V0", ["c", *G33_AT_DEG]),
        (2, "G33 P2 V0", ["c", *"xyz"]),
        (2, "G33", ["c", *"xyz"]),
        (1, "G33 P1 V0", ["c"]),
    ],
)
def test_heights_of_g33_are_contacts_at_its_places(
    tmp_path: Path, places: int, sent: str, names: list[str]
) -> None:
    """Its middle of three places at a tenth of the radius, shown in steps of 0.01 mm, too."""
    hidden = true.OFF_IN_ALL
    printer = read(tmp_path, held_by_marlin() + 2 * g33(hidden, places, sent))
    assert not printer.oddities
    assert [contact.cycle for contact in printer.contacts] == [1] * len(names) + [2] * len(names)
    for contact, name in zip(printer.contacts[: len(names)], names, strict=True):
        angle, radius = np.radians(G33_AT_DEG.get(name, 0.0)), 0.0 if name == "c" else 80.0
        want = touched_at(hidden, radius * np.cos(angle), radius * np.sin(angle), 2.0)
        assert contact.position_mm == pytest.approx(want, abs=0.011)
        assert (contact.value_mm, contact.resolution_mm) == (2.0, 0.01)


def test_g33_with_o_sends_the_probe_to_its_places(tmp_path: Path) -> None:
    """The probe is 15 mm to the right of the tool and 5 mm before it."""
    printer = read(tmp_path, held_by_marlin() + g33(PERFECT, sent="G33 P3 V0 O"))
    assert printer.contacts[0].position_mm == pytest.approx((-15.0, 5.0, 2.0))


@LONG
def test_from_g33_to_better_lines(tmp_path: Path) -> None:
    hidden, session = true.Hidden(switch_mm=(0.4, -0.3, 0.2)), tmp_path / "s.jsonl"
    log, out = tmp_path / "octoprint.log", tmp_path / "lines.g"
    log.write_text(held_by_marlin() + 3 * g33(hidden), encoding="utf-8")
    assert glidecal("import", log, "-o", session).status == 0
    assert glidecal("export", session, "--format", "marlin", "-o", out).status == 0
    after = true.rms(true.errors(hidden, true.marlin(out.read_text())))
    assert after < 0.1 * true.rms(true.errors(hidden, true.BELIEVED))


@pytest.mark.parametrize(
    ("log", "why"),
    [
        (g33(PERFECT, sent="G33 V0"), "sent with which P? From P4 on heights are means"),
        (g33(PERFECT, sent="G33 P4 V0"), "with P4 heights are means of far places; send G33 P3"),
        (g33(PERFECT, radius=""), "this version does not show its radius; probe places"),
        (g33(PERFECT, sent="G33 P3 V3", mode=""), "it changes what is held while it measures"),
        (g33(PERFECT).replace("  z:", "  lost:"), "heights are missing; send G33 P3 V0"),
    ],
    ids=["no P", "means", "no radius", "calibrates", "cut"],
)
def test_heights_of_g33_that_are_no_contacts_say_why(tmp_path: Path, log: str, why: str) -> None:
    with pytest.raises(RecordError) as problem:
        read(tmp_path, held_by_marlin() + log)
    assert why in " ".join(str(problem.value).split())
    printer = read(tmp_path, held_by_marlin() + log + m503(PERFECT))
    assert why in " ".join(printer.oddities)
    assert len(printer.contacts) == 19


def test_contacts_before_a_calibration_are_not_of_what_is_read_after_it(tmp_path: Path) -> None:
    calibrating = g33(PERFECT, sent="G33", mode="")
    text = held_by_marlin() + g33(true.OFF_IN_ALL) + calibrating + m503(PERFECT)
    printer = read(tmp_path, text)
    assert "7 contacts: G33 calibrated between them and the M665 that is read" in printer.oddities
    assert len(printer.contacts) == 19


@LONG
@pytest.mark.parametrize("dialect", first_quick(["reprapfirmware", "marlin"]))
def test_from_files_of_a_printer_to_better_lines(tmp_path: Path, dialect: str) -> None:
    hidden = true.Hidden(switch_mm=(0.4, -0.3, 0.2), bar_mm=(0.2, -0.1, 0.0))
    texts = (CONFIG_G, *g32(hidden, 2)) if dialect == "reprapfirmware" else (m503(hidden, 2),)
    paths = [tmp_path / f"{number}.g" for number in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text, encoding="utf-8")
    session, machine, out = (tmp_path / name for name in ("s.jsonl", "m.toml", "lines.g"))
    run = glidecal("import", *paths, "-o", session, "--machine-file-out", machine)
    assert run.status == 0, run.err
    assert "38 contacts written" in run.err
    assert load_machine(machine).position_endstop_mm == pytest.approx(true.ENDSTOPS)
    run = glidecal("export", session, "--format", dialect, "-o", out)
    assert run.status == 0, run.err
    firmware = {"reprapfirmware": true.reprapfirmware, "marlin": true.marlin}[dialect]
    before = true.rms(true.errors(hidden, true.BELIEVED))
    after = true.rms(true.errors(hidden, firmware(out.read_text())))
    assert after < 0.3 * before


@pytest.mark.parametrize(
    ("line", "otherwise"),
    [
        (f"M665 L{true.BAR}:", f"m665 l{true.BAR}:"),
        (f" R{true.RADIUS} H", f"R{true.RADIUS}H"),
        (f" R{true.RADIUS}", f" R {true.RADIUS}"),
        ("; as measured", "(as measured)"),
        ("M665 L", "  M665  L"),
    ],
)
def test_commands_as_firmware_takes_them(tmp_path: Path, line: str, otherwise: str) -> None:
    assert line in CONFIG_G
    printer = read(tmp_path, CONFIG_G.replace(line, otherwise), *g32(PERFECT))
    assert printer.opened.machine == read(tmp_path, CONFIG_G, *g32(PERFECT)).opened.machine


def test_where_the_probe_is_stands_in_the_machine_file(tmp_path: Path) -> None:
    """M851 of Marlin, G31 of RepRapFirmware; without one the tool itself meets the plate."""
    beside = CONFIG_G.replace("G31 P500 X0 Y0", "G31 P500 X-12.5 Y8")
    cases = {
        "marlin": ((m503(PERFECT),), (15.0, -5.0)),
        "beside": ((beside, *g32(PERFECT)), (-12.5, 8.0)),
        "at it": ((CONFIG_G, *g32(PERFECT)), None),
    }
    for name, (texts, offset_mm) in cases.items():
        folder = tmp_path / name
        folder.mkdir()
        machine = read(folder, *texts).opened.machine
        assert machine.probe_offset_mm == offset_mm
        assert (machine.platform_tilt_tolerance_mrad > 0.0) == (offset_mm is not None)
        assert machine.plate_bow_tolerance_mm == 0.05


def test_steps_per_mm_of_the_towers_are_those_of_the_last_m92(tmp_path: Path) -> None:
    def held(folder: Path, *texts: str) -> object:
        folder.mkdir()
        return read(folder, *texts).opened.machine.steps_per_mm

    answer = m503(PERFECT).replace("Y80.00 Z80.00", "Y80.10 Z79.90")
    assert held(tmp_path / "m", answer) == (80.0, 80.1, 79.9)
    assert held(tmp_path / "n", re.sub(r".*M92.*\n", "", answer)) is None
    partly = answer.replace("M92 X80.00 Y80.10 Z79.90", "M92 X80.00")
    assert held(tmp_path / "p", partly) is None
    again = answer.replace("echo:  M666", "echo:  M92 Y81\necho:  M666")
    assert held(tmp_path / "a", again) == (80.0, 81.0, 79.9)
    with pytest.raises(RecordError, match="steps per mm above 0"):
        held(tmp_path / "z", answer.replace("X80.00", "X0"))


def test_a_tower_without_a_length_has_the_first_ones(tmp_path: Path) -> None:
    two = CONFIG_G.replace(f"L{true.BAR}:{true.BAR}:{true.BAR}", f"L{true.BAR}:{true.BAR + 0.5}")
    machine = read(tmp_path, two, *g32(PERFECT)).opened.machine
    assert machine.drive is not None
    lengths = [drive.leg_length_mm for drive in machine.drive]
    assert lengths == [true.BAR, true.BAR + 0.5, true.BAR]


@LONG
def test_a_real_eeprom_is_the_machine_of_its_owner(tmp_path: Path) -> None:
    """Each switch trips at the homed height and its tower's steps of offset above it."""
    printer = read(tmp_path, real_eeprom())
    machine = printer.opened.machine
    assert machine.position_endstop_mm == pytest.approx((275.38, 275.91, 277.09))
    assert machine.drive is not None
    stand = np.array([drive.origin_mm[:2] for drive in machine.drive])
    want = [[-85.969337, -43.879192], [80.607346, -53.09], [0.0, 96.52]]
    assert stand == pytest.approx(np.array(want), abs=2e-3)
    assert printer.contacts[0].position_mm == (0.0, 70.0, -1.860)
    # ten contacts of no known noise are no reason for bars of thirty tolerances
    corrections = diagnose_sessions([fold([printer.opened, *printer.contacts])]).corrections
    assert np.abs(corrections.of("kinematics").model.parameters_mm[3:]).max() < 3.0 * 0.3
    # nor for values that could make it much worse than it is
    now_mm = corrections.off_now.bound_mm["touched-off"]
    assert corrections.of("offsets").off.bound_mm["touched-off"] < 1.02 * now_mm


def test_answers_of_a_printer_win_over_its_configuration(tmp_path: Path) -> None:
    """M665 and M666 asked for on the printer show what is held now; config.g what it began with."""
    macro, log = g32(PERFECT)
    settings = (
        f"Diagonals {true.BAR:.3f}:{true.BAR:.3f}:{true.BAR:.3f}, delta radius {true.RADIUS:.3f}, "
        "homed height 300.500, bed radius 100.0, X 0.000°, Y 0.000°, Z 0.000°\n"
        "Endstop adjustments X0.10 Y-0.20 Z0.10, tilt X0.00% Y0.00%\n"
    )
    printer = read(tmp_path, CONFIG_G, macro, settings + log)
    assert printer.opened.machine.position_endstop_mm == pytest.approx((300.6, 300.3, 300.6))


def test_a_tower_of_repetier_goes_down_by_its_offset_after_homing(tmp_path: Path) -> None:
    """`Printer::homeZAxis` in steps: set at the switches, moved, then called the homed height."""
    steps, height, offsets = 100.0, 300.0, np.array([100.0, 22.0, -40.0])
    raised = math.sqrt(210.0**2 - 92.0**2)
    at_homed_height = (height + raised) * steps
    lowest = (0.0 - offsets).min()
    # each tower as it is taken to be at its switch, and after the move of all by the least
    at_switch = at_homed_height - (0.0 - offsets - lowest)
    moved = at_homed_height + lowest - at_switch
    stops_mm = (at_homed_height - moved) / steps - raised
    text = "".join(
        f"EPR:3 {place} {value} {name}\n"
        for place, value, name in (
            *((11, steps, "Steps per mm"), (153, height, "Z max length [mm]")),
            *((881, 210.0, "Diagonal rod length [mm]"), (885, 92.0, "Horizontal rod radius")),
            *((893 + 2 * k, offset, "endstop offset [steps]") for k, offset in enumerate(offsets)),
        )
    )
    machine = read(tmp_path, text + "Z-probe:3.000 X:0.00 Y:0.00\n").opened.machine
    assert machine.position_endstop_mm == pytest.approx(stops_mm.tolist())


ODD_G = "G30 P0 X0 Y0 Z-99999\nG30 P1 X50 Y0 Z0.1\nG30 P2 X0 Y50 Z-99999 S-1\n"


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (
            (CONFIG_G, ODD_G, "G32 bed probe heights: 0.010 0.100 probing failed, mean 0, dev"),
            "1.g, line 2: 'G30 P1 X50 Y0 Z0.1': no place that is probed | "
            "2.g, line 1: place 'G30 P2 X0 Y50 Z-99999 S-1': probing failed",
        ),
        (
            (
                CONFIG_G,
                "G30 P0 X0 Y0 Z-99999\nG30 P1 X9 Y0 Z-99999 S6\n",
                "G32 bed probe heights: 0.010 0.020, mean\nG32 bed probe heights: 0.010 0.020, m",
            ),
            "2.g, line 2: measured after a calibration",
        ),
        (
            (m503(PERFECT) + "Bed X: nothing\nM206 Z0.5\n",),
            "an offset that M206 adds | 0.g, line 44: 'Bed X: nothing': no place of G30",
        ),
        (
            (m503(PERFECT).replace("M851 X15.00 Y-5.00 Z-2.00", "M851 Z-2.00"),),
            "the probe's offset in X and Y, which no M851 shows here",
        ),
        (
            (m205(PERFECT, extra="Z-probe: failed\nEPR:3 800 20.0 Z-probe offset x [mm]\n"),),
            "no place of a probe | the probe's offset in X and Y: places are taken as the tool's",
        ),
        (
            (m503(PERFECT) + "Bed X: 1.0 Y: 2.0 Z: -0,12\n",),
            "line 44: 'Bed X: 1.0 Y: 2.0 Z: -0,12': no place of G30",
        ),
        (
            (m205(PERFECT, extra="Z-probe:2,1 X:0.00 Y:0.00\nZ-probe:2.1 X:0.00 Y:0,5\n"),),
            "'Z-probe:2,1 X:0.00 Y:0.00': no place of a probe | 0.g, line",
        ),
    ],
    ids=["entries", "calibrated", "marlin", "marlin-z", "repetier", "marlin-,", "repetier-,"],
)
def test_what_is_not_used_is_named(tmp_path: Path, texts: tuple[str, ...], message: str) -> None:
    printer = read(tmp_path, *texts)
    assert message in " | ".join(printer.oddities)
    assert printer.opened.remarks == tuple(f"not used: {odd}" for odd in printer.oddities)


@pytest.mark.parametrize(
    "before",
    [
        "2022-01-13 04:32:32,939 - Recv: ",
        "12:13:14.123 -> ",
        "12:13:14.123 : ",
        "< 2:23:48 PM: ",
        "READ: ",
        "# RECV: ",
    ],
)
def test_what_hosts_write_before_a_line_is_no_part_of_it(tmp_path: Path, before: str) -> None:
    told = m503(PERFECT)
    text_shown = "".join(before + line for line in told.splitlines(True))
    (tmp_path / "plain").mkdir()
    plain = read(tmp_path / "plain", told)
    assert read(tmp_path, text_shown).opened.machine == plain.opened.machine


def test_a_first_try_of_a_place_and_passes_that_calibrate_have_no_heights(tmp_path: Path) -> None:
    """P0 twice, as where the first touch of a probe differs; S6 is answered in one number."""
    macro, log = g32(PERFECT)
    first = "G30 P0 X20 Y-10 Z-99999 ; this one is not used\n"
    calibrating = first + macro.replace("S-1", "S6")
    answer = "Calibrated 6 factors using 19 points, deviation before 0.186 after 0.157\n"
    (tmp_path / "plain").mkdir()
    plain = read(tmp_path / "plain", CONFIG_G, macro, log)
    printer = read(tmp_path, CONFIG_G, calibrating, first + macro, answer + log)
    assert positions(printer) == positions(plain)
    assert not printer.oddities


SAVED_G = f"""\
; config-override.g file generated in response to M500 at 2021-06-16 13:36
; This is a system-generated file - do not edit
; Delta parameters
M665 L251.000:251.000:251.000 R126.500 H301.250 B100.0 X-0.100 Y0.200 Z0.000
M666 {words((0.1, -0.3, 0.2))} A0.00 B0.00
; Z probe parameters
G31 K0 P500 X0.0 Y0.0 Z0.45
"""


@pytest.mark.parametrize("behind", ["ok\n", "\n\n", "12:03:04 M400\nok\n"])
def test_lines_behind_the_answer_of_g32_change_nothing(tmp_path: Path, behind: str) -> None:
    macro, answer = g32(PERFECT)
    printer = read(tmp_path, CONFIG_G, macro, answer + behind)
    assert positions(printer) == positions(read(tmp_path, CONFIG_G, macro, answer))


def test_with_a_machine_file_a_log_alone_is_of_its_probe(tmp_path: Path) -> None:
    """Of Marlin that does not show M851, and says so where nobody states the probe."""
    whole = m503(PERFECT)
    machine = read(tmp_path, whole).opened.machine
    path = tmp_path / "answers.log"
    path.write_text("".join(re.findall(r"Bed X.*\n", whole)), encoding="utf-8")
    alone = imported_printer([path], "test", machine=machine)
    apart = np.subtract(positions(alone), positions(read(tmp_path, whole)))
    assert np.abs(apart[:, :2]).max() < 1e-9
    assert apart[:, 2] == pytest.approx(-2.0)  # the Z of M851 is in no machine file
    assert not alone.oddities
    stranger = imported_printer([path], "test", machine=machine.model_copy(
        update={"probe_offset_mm": None}))  # fmt: skip
    assert "no M851 shows here" in stranger.oddities[0]


def test_files_are_read_in_the_firmwares_order(tmp_path: Path) -> None:
    """As a shell sorts them: bed.g, config-override.g, config.g."""
    macro, log = g32(PERFECT)
    macro = "G31 X0 Y0 ; no offset\n" + macro
    beside = CONFIG_G.replace("G31 P500 X0", "G31 P500 X12") + "M501 ; what M500 saved\n"
    (tmp_path / "run").mkdir()
    run = read(tmp_path / "run", beside, SAVED_G, macro, log)
    assert run.opened.machine.position_endstop_mm == pytest.approx((301.35, 300.95, 301.45))
    assert run.opened.machine.probe_offset_mm is None
    sorted_ones = read(tmp_path, macro, SAVED_G, beside, log)
    assert positions(sorted_ones) == positions(run)
    machine, want = sorted_ones.opened.machine, run.opened.machine
    assert (machine.drive, machine.position_endstop_mm) == (want.drive, want.position_endstop_mm)


def test_a_log_that_is_named_twice_is_refused(tmp_path: Path) -> None:
    """Before: each contact counted twice, as if it repeated exactly."""
    macro, log = g32(PERFECT)
    with pytest.raises(
        RecordError, match=r"3\.g: found the same text as in .*2\.g\. Allowed: each"
    ):
        read(tmp_path, CONFIG_G, macro, log, log)


def test_what_m500_saved_counts_if_the_configuration_reads_it(tmp_path: Path) -> None:
    """Only M501 reads it as the firmware starts. Before: it was taken in any case."""
    macro, log = g32(PERFECT)
    (tmp_path / "plain").mkdir()
    plain = read(tmp_path / "plain", CONFIG_G, macro, log)
    unread = read(tmp_path, CONFIG_G, SAVED_G, macro, log)
    assert unread.opened.machine.drive == plain.opened.machine.drive
    assert positions(unread) == positions(plain)
    assert unread.oddities == (
        "1.g: the configuration has no M501, so the firmware does not read it when it starts",
    )
    alone = read(tmp_path, SAVED_G, macro, log)
    assert not alone.oddities
    assert alone.opened.machine.position_endstop_mm == pytest.approx((301.35, 300.95, 301.45))


@pytest.mark.parametrize("stated", ["Z0.1", "Z-5", ""])
@pytest.mark.parametrize("number", [7, 18])
def test_a_stated_height_is_in_the_answer_and_no_contact(
    tmp_path: Path, number: int, stated: str
) -> None:
    """P7 states its height, or has no Z: the firmware probes nothing there, and answers for it.

    Before: the answers were refused, and without Z a height that nobody measured was a contact.
    """
    macro, log = g32(PERFECT)
    (tmp_path / "plain").mkdir()
    plain = positions(read(tmp_path / "plain", CONFIG_G, macro, log))
    places = macro.splitlines(keepends=True)
    places[number] = places[number].replace("Z-99999", stated)
    answer = re.findall(r"-?\d\.\d{3}", log)
    answer[number] = "0.100"
    texts = "".join(places), f"G32 bed probe heights: {' '.join(answer[:19])}, mean 0.1\n"
    printer = read(tmp_path, CONFIG_G, *texts)
    del plain[number]
    assert positions(printer) == plain
    assert len(printer.oddities) == 1
    assert f"P{number} " in printer.oddities[0]
    assert "no place that is probed" in printer.oddities[0]


@pytest.mark.parametrize("clock", ["19:31:24 19:31:21 19:29:25 19:29:22", "1:02:04 PM 12:59:21 PM"])
def test_a_console_with_the_newest_on_top_is_read_from_below(tmp_path: Path, clock: str) -> None:
    times = re.findall(r"[\d:]+(?: PM)?", clock)
    figures = "homed height {}, bed radius 100.0, X 0.000Â°, Y 0.000Â°, Z 0.000Â°"
    lines = [
        f"5.11.2019, {time} | M665Diagonals 250.000:250.000:250.000, delta radius 125.000, "
        + figures.format(f"{302.0 - number:.3f}")
        for number, time in enumerate(times)
    ]
    tops = [
        read(tmp_path, "\n".join(order), *g32(PERFECT)).opened.machine.position_endstop_mm
        for order in (lines, lines[::-1])
    ]
    assert tops == [(302.0, 302.0, 302.0)] * 2


@pytest.mark.parametrize("answered", [False, True])
def test_contacts_with_a_tilt_are_where_the_carriages_were(tmp_path: Path, answered: bool) -> None:
    """LinearDeltaKinematics::Transform raises each carriage by A % of x and B % of y."""
    a, b = 0.74, -0.42
    macro, log = g32(PERFECT)
    plain_heights = re.findall(r"-?\d\.\d{3}", log.split("heights:")[1])[: len(rings())]
    raised = [(a * x + b * y) / 100.0 for x, y in rings()]
    heights = [float(h) - up for h, up in zip(plain_heights, raised, strict=True)]
    tilted = "G32 bed probe heights: " + " ".join(f"{h:.3f}" for h in heights) + ", mean 0\n"
    config = CONFIG_G
    if answered:
        stops = " ".join(f"{k}{stop:.3f}" for k, stop in zip("XYZ", STOPS, strict=True))
        tilted = f"Endstop adjustments {stops}, tilt X{a}% Y{b}%\n" + tilted
    else:
        config = CONFIG_G.replace("A0.00 B0.00", f"A{a} B{b}")
    (tmp_path / "plain").mkdir()
    plain = read(tmp_path / "plain", CONFIG_G, macro, log)
    printer = read(tmp_path, config, macro, tilted)
    values, want = np.array(positions(printer)), np.array(positions(plain))
    assert values == pytest.approx(want, abs=1.1e-3)
    assert np.abs(np.array(raised)).max() > 0.5
    assert not printer.oddities


GLOBALS_G = f"""\
; Global M665 Variables
global deltaRadius = {true.RADIUS}            ; Horizontal radius (R)
global armLength = {true.BAR}
global homedHeight = {HEIGHT}    ; 540 with other arms
M665 R{{global.deltaRadius}} L{{global.armLength}} B100 H{{global.homedHeight}}  ; Delta Parameters
"""


def test_a_global_with_one_number_is_that_number(tmp_path: Path) -> None:
    config = GLOBALS_G + CONFIG_G[CONFIG_G.index("M666") :]
    machine = read(tmp_path, config, *g32(PERFECT)).opened.machine
    plain = read(tmp_path, CONFIG_G, *g32(PERFECT)).opened.machine
    assert machine.drive == plain.drive
    assert machine.position_endstop_mm == pytest.approx(plain.position_endstop_mm)
    for otherwise in (
        "set global.armLength = 351.1",
        "  set global.armLength = {move.axes[0].max}",
    ):
        with pytest.raises(RecordError, match="letters and numbers"):
            read(tmp_path, config + otherwise + "\n", *g32(PERFECT))


def test_lines_for_marlin_are_marlins_and_those_of_smoothieware_nobodys(tmp_path: Path) -> None:
    """M666 has the other sign there, and H of Smoothieware is an angle."""
    lines = f"M665 L{true.BAR} R{true.RADIUS} H{HEIGHT}\nM665 X0 Y0 Z0 A0 B0 C0\n"
    text = lines + f"M666 {words([-stop for stop in STOPS])}\n"
    machine = imported_printer([_file(tmp_path, text)], "test", geometry_alone=True).opened.machine
    assert machine.position_endstop_mm == pytest.approx(true.ENDSTOPS)
    for other in (
        "M665 A0.0 B0.0 C0.0 D0.12 E-0.21 H0.3 L250.0 R124.0 Z300.0\n",
        "M665 L250.0 R124.0 Z300.0\nM665 A0.0 B0.0 C0.0 D0.12 E-0.21 H0.3\n",
    ):
        with pytest.raises(RecordError):
            imported_printer([_file(tmp_path, other)], "test", geometry_alone=True)


def _file(folder: Path, text: str) -> Path:
    path = folder / "lines.g"
    path.write_text(text, encoding="utf-8")
    return path


MACRO, LOG = g32(PERFECT)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        ((CONFIG_G, LOG), "1 answers of G32 to 0 lists of places G30 P"),
        ((CONFIG_G, MACRO), "no contact with the plate"),
        ((CONFIG_G, ODD_G, LOG), "19 heights for 3 places"),
        ((CONFIG_G.replace(f"R{true.RADIUS}", ""), MACRO, LOG), "M665 without R"),
        ((CONFIG_G.replace(f"R{true.RADIUS}", "R900"), MACRO, LOG), "on a radius of 900 mm"),
        ((CONFIG_G.replace("H300.0", "H1:2"), MACRO, LOG), "H and a number"),
        ((MACRO, LOG), "contacts, and no geometry"),
        ((CONFIG_G.replace(f" R{true.RADIUS}", " R{var.r}"), MACRO, LOG), "letters and numbers"),
        ((CONFIG_G.replace("L250", "L250:250"), MACRO, LOG), "M665 with 4 lengths of bars"),
        (("G20\n" + m503(PERFECT),), "'G20': lengths in inches"),
        ((m503(PERFECT).replace(" H300.00", ""),), "M665 without H"),
        ((m205(PERFECT).replace("EPR:3 881", "EPR:3 1881"),), "without Diagonal rod length"),
        ((m205(PERFECT).replace("80.000 Steps", "0 Steps"),), "steps per mm above 0"),
        ((m503(PERFECT) + "Bed X: 15.0 Y: -5.0 Z: 9.5\n",), "9.5 mm off the others"),
        ((m503(PERFECT) + "Bed X: 600 Y: 0 Z: 0.1\n",), "not reached"),
        ((m503(PERFECT) + f"Bed X: {'9' * 400} Y: 0 Z: 0.1\n",), "not reached"),
        ((m503(PERFECT).replace("L250.00", f"L{'9' * 400}"),), "M665 L"),
        ((CONFIG_G.replace("X0 Y0 Z0 ;", "X99999 Y0 Z0 ;"), MACRO, LOG), "found 100209"),
        ((m205(PERFECT).replace("EPR:3 885 124", "EPR:3 885 12400"),), "up to 10000"),
        ((m503(PERFECT), m205(PERFECT)), "no geometry and no answer of a probe"),
    ],
)
def test_files_that_cannot_be_used(tmp_path: Path, texts: tuple[str, ...], message: str) -> None:
    with pytest.raises(RecordError) as problem:
        read(tmp_path, *texts)
    assert message in " ".join(str(problem.value).split())


BEGUN = (
    CONFIG_G + MACRO,
    m503(PERFECT) + "G33 P3\nChecking... AC at radius:80.00 (DRY-RUN)\n. ",
    m205(PERFECT),
)
ALPHABET = "GM0356 XYZLRHPSB.:-+;echoBdprbiagnlsEPRxyz\n"


@given(st.text(alphabet=ALPHABET, max_size=300), st.sampled_from([0, 1, 2]))
def test_whatever_a_log_holds_is_read_or_refused_in_a_sentence(text: str, which: int) -> None:
    dialect = (reprapfirmware, marlin, repetier)[which]
    try:
        values = dialect.content([(Path("a.g"), BEGUN[which] + text)])
    except RecordError:
        return
    for contact in values.contacts:
        assert np.isfinite(contact.place_mm).all()


@pytest.mark.parametrize(
    ("angle_deg", "apart"),
    [
        ((210.0, 330.0, 90.0), True),
        ((0.0, 30.0, 180.0), True),
        ((30.0, 0.0, 180.0), True),
        ((0.0, 29.9, 180.0), False),
        ((29.9, 0.0, 180.0), False),
        ((345.0, 15.0, 180.0), True),
        ((345.1, 15.0, 180.0), False),
        ((15.0, 345.1, 180.0), False),
        ((-150.0, -30.0, 450.0), True),
    ],
)
def test_towers_are_30_degrees_apart_or_more_round_the_circle(
    angle_deg: Triple, apart: bool
) -> None:
    bars: Triple = (250.0, 250.0, 250.0)
    if apart:
        assert (
            TowerPrinter("delta", "name", bars, (124.0, 124.0, 124.0), bars, angle_deg).angle_deg
            == angle_deg
        )
    else:
        with pytest.raises(RecordError, match="30° or more between two of them"):
            TowerPrinter("delta", "name", bars, (124.0, 124.0, 124.0), bars, angle_deg)


@pytest.mark.parametrize(
    ("text", "printer"),
    [
        ("x_mm,y_mm,z_mm,height_mm\n0,0,0.1,0\n", False),
        ("leg,axis,displacement_mm,value_mm\nx,y,0,0.1\n", False),
        (f"; in x_mm\n{CONFIG_G}", True),
        ("no columns here\n", True),
    ],
)
def test_a_table_is_no_file_of_a_printer(tmp_path: Path, text: str, printer: bool) -> None:
    path = tmp_path / "any"
    path.write_text(text, encoding="utf-8")
    assert are_of_printer([path]) == printer
    assert are_of_printer([path, path])
