"""What is left in LinuxCNC after a calibration, behind a simulated machine: `tests/controller`."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from calib.tripod.controller import ControllerJoint
from tests.controller.joints import HERE, OFFSETS, SCALE, WHOLE, found, on_switch, worst_um
from tests.controller.loop import Loop
from tests.controller.machine import L, Machine, homing
from tests.controller.running import need_linuxcnc

Entry = Mapping[str, float | str]
COMPLETE = ("--format", "linuxcnc")
"""Offsets, play and tables, as far as they are worth it."""
ALONE = (*COMPLETE, "--subset", "joint-offsets")
HEADINGS = [
    "| hidden, then found and exported | tool before, mm r.m.s. | after | control: what | mm |",
    "|---|---|---|---|---|",
]
"""Of the tool at twelve places; homing is real, no reading is told how its posture was reached."""


def controller() -> list[str]:
    """Tool error and carriage error before and after, in LinuxCNC."""
    try:
        need_linuxcnc()
    except pytest.skip.Exception as problem:
        return [*HEADINGS, f"| {problem} | | | | |"]
    with tempfile.TemporaryDirectory() as folder:
        return [*HEADINGS, *_loops(Path(folder)), "", *_homing(Path(folder))]


def _loops(folder: Path) -> list[str]:
    plain = Loop(Machine(OFFSETS), folder / "offsets")
    rows = [_row("offsets 0.8, −1.3, 0.45 mm", plain, COMPLETE, plain.session)]
    scaled = {"": (), ", scale 0.5 mm/m of one drive": (2,), ", the same of all three": (0, 1, 2)}
    for number, (name, drives) in enumerate(scaled.items()):
        errors = {k: {"scale": 5e-4} for k in drives}
        machine = Machine(OFFSETS, joint={"play": 0.06, "cyclic": 0.01}, one=errors)
        loop = Loop(machine, folder / f"scale{number}")
        alone = loop.after_mm("offsets", loop.session, *ALONE)
        row = _row(f"offsets, play 60 µm, cyclic 10 µm{name}", loop, COMPLETE, loop.session)
        rows.append(row.format(f"offsets alone | {alone:.4f}"))
    lean, shift = np.zeros((3, 3)), np.zeros((3, 3))
    lean[0, 1] = lean[1, 0] = 1e-3
    shift[0, 2], shift[2, 1] = 0.2, -0.2
    axes = Machine(OFFSETS, (0.3, -0.2, 0.1), lean=lean, shift_mm=shift)
    loop = Loop(axes, folder / "axes", zero_set=True)
    model = loop.session.with_name("found.json")
    loop.do("diagnose", loop.session, "--adopt", model)
    options = ("--model", model, "--subset", "both", "--format", "linuxcnc-kins")
    turned = loop.after_mm("turned", loop.session, *options, sign=-1.0)
    row = _row("six parameters, 2 mrad, axes 0.2 mm apart", loop, options, loop.session)
    return [line.format("– | –") for line in [*rows, row.format(f"signs turned | {turned:.4f}")]]


def _row(name: str, loop: Loop, options: Sequence[str | Path], source: Path) -> str:
    after = loop.after_mm("after", source, *options)
    return f"| {name} | {loop.before_mm:.4f} | {after:.4f} | {{}} |"


def _homing(folder: Path) -> list[str]:
    rows = ["| homing, after the export | worst carriage, µm |", "|---|---|"]
    entries: dict[str, tuple[Machine, list[ControllerJoint], Entry]] = {}
    full, scaled = Machine(OFFSETS, joint=WHOLE), Machine(OFFSETS, joint=SCALE)
    for name, way in (("upwards", 1.0), ("downwards", -1.0)):
        on = on_switch(full, way)
        entries[f"on a switch, latched {name}; every effect"] = full, on, homing(0.0, way)
    for kind, name in enumerate(("where it stands", "absolute encoder, 1", "the same, 2")):
        joints = [ControllerJoint(L, absolute_encoder=kind > 0)] * 3
        entries[f"{name}; scale"] = scaled, joints, {**HERE, "HOME_ABSOLUTE_ENCODER": kind}
    for number, (name, (machine, joints, home)) in enumerate(entries.items()):
        worst = worst_um(folder / f"homing{number}", machine, found(machine), joints, home)
        rows.append(f"| {name} | {worst:.1f} |")
    return rows
