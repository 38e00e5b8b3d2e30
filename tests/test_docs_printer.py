"""docs/delta.md walked: every command on the sample files, and each text that it quotes."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.solution import solve_files
from app.report.text.glance import next_text
from app.report.text.session import step_text
from protocols.procedure import Step
from protocols.record import read_record
from tests.app.cli import glidecal, refused
from tests.app.exports import upright_towers as true
from tests.blind.linear_delta import places
from tests.blind.printers import fitted
from tests.conftest import LONG, ROOT
from tests.protocols.printers.printers import (
    SAMPLE,
    SAMPLE_HIDDEN,
    TRIGGER_MM,
    sample_cfg,
    sample_log,
)

PAGE = (ROOT / "docs" / "delta.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"(?ms)^```\n(.*?)^```\n", PAGE)
INCLUDE = "[include calib.cfg]\n"
SAVED = "\n#*# <"


def words(text: str) -> str:
    return " ".join(text.split())


def answers(firmware: true.Firmware) -> str:
    """What a true printer answers to the macro, a contact at a time, by bisection."""
    generator, lines = np.random.default_rng(12), []
    for _, (x, y, _) in places(3):
        low, high = -8.0, 8.0
        for _ in range(50):
            middle = (low + high) / 2.0
            tool = SAMPLE_HIDDEN.tool(firmware(np.array([x, y, TRIGGER_MM + middle])))
            low, high = (low, middle) if tool[2] > TRIGGER_MM else (middle, high)
        height_mm = low + generator.normal(scale=0.004)
        lines.append(f"// probe: at {x:.3f},{y:.3f} bed will contact at z={height_mm:.6f}")
    return "\n".join(lines) + "\n"


def place_of(line: str) -> tuple[float, float]:
    x, y = re.findall(r"at (\S+?),(\S+?) bed", line)[0]
    return float(x), float(y)


def test_the_sample_files_are_those_of_the_tests() -> None:
    """Again with: python -m tests.protocols.printers.printers."""
    assert (SAMPLE / "printer.cfg").read_text(encoding="utf-8") == sample_cfg()
    assert (SAMPLE / "probe.log").read_text(encoding="utf-8") == sample_log()


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder with all that the commands wrote, and all that they said, in the page's order."""
    folder = tmp_path_factory.mktemp("owner")
    (folder / "printer.cfg").write_text(sample_cfg(), encoding="utf-8")
    outputs = []
    for command in [line for block in BLOCKS for line in block.splitlines()]:
        if not command.startswith("glidecal "):
            continue
        arguments = shlex.split(command)[1:]
        if "probe.log" in arguments:
            (folder / "probe.log").write_text(sample_log(), encoding="utf-8")
        if "after.log" in arguments:
            values = (folder / "calib.cfg").read_text(encoding="utf-8")
            (folder / "after.log").write_text(answers(true.klipper(values)), encoding="utf-8")
            ends = sample_cfg().partition(SAVED)
            (folder / "printer.cfg").write_text(f"{ends[0]}\n{INCLUDE}{ends[1]}{ends[2]}")
        run = glidecal(*arguments, cwd=folder)
        assert run.status == 0, f"{command}: {run.err}"
        outputs.append(run.err + run.out)
    return folder, "\n".join(outputs)


def test_every_quoted_text_is_what_the_program_said(walked: tuple[Path, str]) -> None:
    _, output = walked
    quoted = [block for block in BLOCKS if not block.startswith("glidecal ") and block != INCLUDE]
    assert len(quoted) >= 5
    for text in quoted:
        assert words(text) in words(output)


def test_every_figure_of_the_answers_is_in_the_result(walked: tuple[Path, str]) -> None:
    table = PAGE.partition("| question | answer |")[2].partition("\n\n")[0]
    figures = re.findall(r"[\d.]+ mm", table)
    assert len(figures) == 5
    assert all(figure.removesuffix(" mm") in words(walked[1]) for figure in figures)


def test_the_macro_of_the_page_is_what_the_log_answers(walked: tuple[Path, str]) -> None:
    folder, _ = walked
    lines = (folder / "places.gcode").read_text(encoding="utf-8").splitlines()
    moves = [re.findall(r"X(\S+) Y(\S+)", line)[0] for line in lines if line.startswith("G1 X")]
    targets = [(float(x), float(y)) for x, y in moves]
    answered = [place_of(line) for line in sample_log().splitlines() if "bed will" in line]
    assert len(targets) == int(re.findall(r"(\d+) probings at 19 places", PAGE)[0])
    assert np.array(targets) == pytest.approx(np.array(answered), abs=1e-3)


@LONG
def test_the_printer_is_a_better_one(walked: tuple[Path, str]) -> None:
    """The true machine with the file, and what its owner sees when it is probed again."""
    folder, _ = walked
    now, then = true.BELIEVED, true.klipper((folder / "calib.cfg").read_text(encoding="utf-8"))
    contacts = read_record(folder / "printer.jsonl").session.all_readings
    points = [np.array(contact.position_mm) - (0.0, 0.0, contact.value_mm) for contact in contacts]
    peers = [fitted(points, factors, true.ENDSTOPS) for factors in (6, 9)]
    before, *residuals, ours = (
        true.rms(true.errors(SAMPLE_HIDDEN, firmware)) for firmware in (now, *peers, then)
    )
    assert min(residuals) < 0.5 * before, "what firmware fits to the same contacts is a calibration"
    assert ours < 0.6 * min(residuals)
    assert ours < 0.26 * before, "0.20 before what firmware fits became a case of the prior"
    middle = np.zeros(3)
    raised = SAMPLE_HIDDEN.tool(then(middle)) - SAMPLE_HIDDEN.tool(now(middle))
    assert raised[2] == pytest.approx(0.0, abs=0.05)
    after = words(glidecal("solve", folder / "after.jsonl").out)
    (uneven_mm,) = re.findall(r"heights of the plate differ by (\S+) mm", after)
    assert float(uneven_mm) < 0.008
    assert "the probe limits what can be seen, not the geometry. Change nothing in the" in after
    assert "tower endstop now, mm fit or the switch by, mm" in after
    assert "mm endstop enter arm enter angle, ° enter" in words(
        glidecal("solve", folder / "printer.jsonl").out
    )


@LONG
def test_values_that_help_are_the_next_step_on_the_screen(walked: tuple[Path, str]) -> None:
    """Before: joint offsets alone did not, so that the screen said to leave all as it is."""
    result = solve_files([walked[0] / "printer.jsonl"])
    assert result.printer_change is not None
    assert result.printer_change.helps
    assert not result.correction.helps
    text = words(glidecal("solve", walked[0] / "printer.jsonl").out)
    assert "alone leave 2.7 times the noise. With the lines of the drives" in text
    assert "WARNING" not in text, "the diagnosis agrees"
    text = next_text(result, (), exports=True, measures=False)
    assert text == "Next: {result.export} writes these values as files for the controller."


@LONG
def test_before_and_after_are_compared_though_the_firmware_holds_other_values(
    walked: tuple[Path, str],
) -> None:
    folder, _ = walked
    before, after = folder / "printer.jsonl", folder / "after.jsonl"
    run = glidecal("verify", before, after, "--tolerance", "1")
    assert run.status == 0, run.err
    # a plate shows little of single joints: less than these offsets were
    assert len(re.findall(r"(?m) not shown$", run.out)) == 3
    assert "the firmware got other lengths, radius, angles or travels" in words(run.out)
    deviations = re.findall(
        r"went from (\S+) to (\S+) mm", words(glidecal("compare", before, after).out)
    )
    was, residual = map(float, deviations[0])
    assert residual < 0.1 * was
    assert "machine file changed: leg_length_mm" in glidecal("history", folder).out


def test_a_replay_of_contacts_speaks_of_a_plate(walked: tuple[Path, str]) -> None:
    session = read_record(walked[0] / "printer.jsonl").session
    reading = session.readings[0]
    step = Step(1, "tool", 0.0, 1, 0.0, ("z",), reading.position_mm)
    text = step_text(step, replace(session, readings=()))
    assert "First, at Zero: the tool, or a probe beside it, comes down on the plate." in text
    assert "TOOL   (0, 0, 2.3625) mm" in text
    assert "leg TOOL" not in text


def test_plan_sends_the_owner_of_a_printer_to_what_tells_more(walked: tuple[Path, str]) -> None:
    message = words(refused(2, "plan", walked[0] / "printer.jsonl"))
    assert "--macro writes places to probe" in message
    assert "glidecal import --distances" in message
