"""An own kinematics module for LinuxCNC, and the values of its pins from a model.

It holds what no entry of a joint can: lengths of bars, where the drives lie and lean, how straight
they are, what weight does to the bars. What moves a carriage along its own drive stays with the
joints (`app.exports.linuxcnc`), so nothing is corrected twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import resources

from calib.tripod.controller import Kinematics, kinematics_of
from calib.tripod.pipeline import Model
from protocols.files import Written

MODULE = "orthoglidekins"


def kinematics_files(model: Model, mm_per_unit: float = 1.0, heading: str = "") -> Written:
    """The module's source and ``calib.hal`` with ``setp`` lines in the machine's unit."""
    source = resources.files("app.exports").joinpath(f"{MODULE}.comp").read_text(encoding="utf-8")
    lines = [*(f"# {line}" for line in heading.splitlines()), *_pins(model, mm_per_unit)]
    return {f"{MODULE}.comp": source, "calib.hal": "\n".join(lines) + "\n"}


def _pins(model: Model, mm_per_unit: float) -> Iterator[str]:
    kinematics: Kinematics = kinematics_of(model)
    geometry = model.geometry
    vectors = {
        "origin": kinematics.origin_mm / mm_per_unit,
        "direction": kinematics.direction,
        "bend": kinematics.bend_per_mm * mm_per_unit,
        "platform": geometry.platform / mm_per_unit,
    }
    lengths = {
        "zero": kinematics.zero_mm,
        "length": kinematics.length_mm,
        "sag": kinematics.sag_mm,
    }
    for drive in range(3):
        for name, rows in vectors.items():
            for axis, value in zip("xyz", rows[drive], strict=True):
                yield _setp(f"{name}-{drive}-{axis}", float(value))
        for name, values in lengths.items():
            yield _setp(f"{name}-{drive}", float(values[drive]) / mm_per_unit)
    for axis, value in zip("xyz", geometry.gravity, strict=True):
        yield _setp(f"gravity-{axis}", value)
    yield _setp("side", geometry.side)


def _setp(pin: str, value: float) -> str:
    return f"setp {MODULE}.{pin} {value:.12g}"
