"""What the first page of a result shows against what E writes and the report prints and judges.

``python -m tests.app.exports.first_page 200`` simulates so many sessions and prints in how many
they differ. Every number is read back from the text, the files and the report, as a person does.
"""

from __future__ import annotations

import json
import re
import sys
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from app.evaluating.solution import SessionSolution, solve_files
from app.exports import export_offsets
from app.report.text.glance import glance_text
from protocols.machine import load_machine, machine_text
from tests.app.cli import glidecal
from tests.app.exports.upright_towers import comments
from tests.app.report.certificates import report_of
from tests.blind.printers import RINGS, any_printer, contacts, machine

HIDDEN = (
    (),
    ("--effect", "backlash:y"),
    ("--effect", "axis_squareness:xy"),
    ("--effect", "gravity_sag:x"),
    ("--effect", "straightness:z"),
)
MEASURED = (
    ("orthoglide", "zero-max-min"),
    ("orthoglide", "two-station"),
    ("linear-delta", "plate-rings"),
)
BARS = ("linear-delta", "bars")
KINDS = (*product(MEASURED, HIDDEN), *product([BARS], HIDDEN[:2]))
"""Machine with procedure, and what is wrong with it beside the offsets."""

TOLERANCES_MM = (None, 0.02, 0.1, 0.5)


def simulated(folder: Path, seed: int) -> Path:
    """A session of a machine of a kind, with offsets and a tolerance by the seed."""
    (machine, protocol), hidden = KINDS[seed % len(KINDS)]
    chance = np.random.default_rng(seed)
    tolerance_mm = TOLERANCES_MM[int(chance.integers(len(TOLERANCES_MM)))]
    document = {
        "schema": "glidecal.model/1",
        "machine": load_machine(machine)
        .model_copy(update={"tool_tolerance_mm": tolerance_mm})
        .model_dump(mode="json", by_alias=True),
        "parameters_mm": {f"d_rho_{leg}": float(chance.normal(0.0, 0.6)) for leg in "xyz"},
    }
    truth, path = folder / f"truth{seed}.json", folder / f"s{seed}.jsonl"
    truth.write_text(json.dumps(document))
    options: list[str | Path] = [*hidden, "--model", truth, "--seed", str(seed), "-o", path]
    run = glidecal("simulate", "--protocol", protocol, *options)
    assert run.status == 0, run.err
    return path


def shown_values(text: str) -> dict[str, float]:
    """Names and values of the table of the first page."""
    return {name: float(mm) for name, mm in re.findall(r"^ *(d_\w+) +([+-][\d.]+) ", text, re.M)}


def written_values(result: SessionSolution, folder: Path) -> dict[str, float]:
    """What E writes, from its JSON."""
    paths = {path.name: path for path in export_offsets(result, folder)}
    parameters = json.loads(paths["offsets.json"].read_text())["parameters"]
    return {name: parameter["value"] for name, parameter in parameters.items()}


def differences(path: Path, *, report: bool = True) -> list[str]:
    """Words for what differs between the first page, the files that E writes, and the report."""
    result = solve_files([path]).work_out()
    page = glance_text(result, None, (), 76, exports=True, measures=True)
    figures, messages = shown_values(page), list[str]()
    values = written_values(result, path.with_suffix(""))
    if figures != {name: round(mm, 4) for name, mm in values.items()}:
        messages.append(f"shown {figures}, written {values}")
    bounds = re.findall(r"^(?:now|after) +([\d.]+) mm ", page, re.M)
    caution = json.loads((path.with_suffix("") / "offsets.json").read_text())["cautions"][0]
    stated = re.search(r"at most ([\d.]+) mm now, at most ([\d.]+) mm", caution)
    if stated is None or bounds != [*stated.groups()]:
        messages.append(f"shown {bounds}, written {caution}")
    if report:
        printed = report_of([path])
        (section,) = [s for s in printed.sections if s.heading == "What to enter in the controller"]
        table = next(part for part in section.parts if not isinstance(part, str))
        added = list(map(float, table.columns[2].cells))  # type: ignore[union-attr]
        if added != list(figures.values()):
            messages.append(f"shown {figures}, printed {added}")
        headline = printed.sentences[0] if "NOT JUDGED" in printed.decision else printed.decision
        if page.partition("\n")[0] != headline:
            messages.append(f"headed {page.partition(chr(10))[0]!r}, printed {headline!r}")
    return messages


def printer(folder: Path, seed: int) -> Path:
    """Contacts of a printer, each part of which is off as parts of printers are."""
    chance = np.random.default_rng([seed, 11])
    contacts_mm = contacts(any_printer(chance), chance)
    rows = [
        f"{x:.4f},{y:.4f},{z:.5f},0,{k // len(RINGS) + 1}"
        for k, (x, y, z) in enumerate(contacts_mm)
    ]
    table, machine_file = folder / f"p{seed}.csv", folder / "printer.toml"
    table.write_text("\n".join(["x_mm,y_mm,z_mm,height_mm,cycle", *rows]) + "\n")
    machine_file.write_text(machine_text(machine(), []), encoding="utf-8")
    path = table.with_suffix(".jsonl")
    run = glidecal("import", table, "-o", path, "--machine", machine_file)
    assert run.status == 0, run.err
    return path


USUAL_ANGLES = (210.0, 330.0, 90.0)
"""Of towers a, b, c."""


def printer_differences(path: Path) -> list[str]:
    """The same for the values of a printer, to all digits that are shown."""
    result = solve_files([path]).work_out()
    page = glance_text(result, None, (), 76, exports=True, measures=True)
    export_offsets(result, path.with_suffix(""))
    text = (path.with_suffix("") / "klipper.cfg").read_text()
    rows = [line.split() for line in page.splitlines()]
    towers = [row for row in rows if row[:1] and row[0] in ("tower", "a", "b", "c")]
    numbers = [[float(word) for word in row if re.fullmatch(r"\d+\.\d+", word)] for row in towers]
    figures_of_towers = [figures for figures in numbers if figures]  # a sentence may begin so, too
    keys = ("position_endstop", "arm_length", "angle")
    by_key = [re.findall(rf"^{key}: ([\d.]+)", text, re.M) for key in keys]
    messages = []
    arm_mm = result.sessions[0].opened.machine.geometry().leg_length_mm
    pairs = zip(figures_of_towers, zip(*by_key, strict=True), strict=True)
    for tower, (figures, values) in enumerate(pairs):
        unchanged = [arm_mm[tower], USUAL_ANGLES[tower]]  # which the page leaves out
        expected = figures[1::2] if len(figures) > 2 else [figures[1], *unchanged]
        if expected != [round(float(value), 3) for value in values]:
            messages.append(f"shown {figures}, written {values}")
    for row in rows:
        if row[:1] == ["radius"] and f"{float(row[2]):.3f}" != _radius(text):
            messages.append(f"shown {row}, written {_radius(text)}")
    bounds = re.findall(r"^(?:now|after) +([\d.]+) mm ", page, re.M)
    stated = re.search(r"at most ([\d.]+) mm now, at most ([\d.]+) mm", comments(text))
    if stated is None or bounds != [*stated.groups()]:
        messages.append(f"shown {bounds}, written {stated}")
    return messages


def _radius(text: str) -> str:
    (value,) = re.findall(r"^delta_radius: ([\d.]+)", text, re.M)
    return f"{float(value):.3f}"


def main(sessions: int) -> None:
    """Print in how many sessions anything differs, and what."""
    differing = 0
    with TemporaryDirectory() as name:
        for seed in range(sessions):
            if seed % 5 == 4:
                words = printer_differences(printer(Path(name), seed))
            else:
                words = differences(simulated(Path(name), seed), report=False)
            differing += bool(words)
            for line in words:
                print(f"seed {seed}: {line}")
    print(f"{differing} of {sessions} simulated sessions differ")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
