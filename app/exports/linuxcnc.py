"""Joint includes for LinuxCNC.

``HOME_OFFSET`` is the joint coordinate of the home switch, so with true = believed + d_rho:
``HOME_OFFSET_new = HOME_OFFSET_old + d_rho`` (docs/export.md). The controller refuses comments
behind a number; comments stand on lines of their own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from textwrap import wrap

from app.report.offsets import Offsets, one_line
from app.report.schema.solution import Offset
from app.report.text.tables import WIDTH, uncertain
from calib.errors import RecordError, UsageError
from calib.observations import LEG_NAMES
from protocols.documents import read_text
from protocols.files import Written
from protocols.table import NUMBER

MILLIMETRES = ("mm", "metric")
LARGEST_MM = 100_000.0
DEEPEST_INCLUDE = 8


def joint_includes(offsets: Offsets) -> Written:
    """``calib_joint<n>.inc`` for n = 0, 1, 2. Raises UsageError where lengths cannot be held."""
    if offsets.lengths_mm:
        shown = ", ".join(f"{name} {value:+.4f}" for name, value in offsets.lengths_mm.items())
        raise UsageError(
            "LinuxCNC joint includes",
            f"leg length errors ({shown} mm)",
            "joint offsets alone: HOME_OFFSET cannot hold a length",
            "Export with --subset joint-offsets, or use --format json.",
        )
    old = offsets.home_offset_mm or (0.0, 0.0, 0.0)
    return {
        f"calib_joint{n}.inc": _include(offsets, n, old[n], offset)
        for n, offset in enumerate(offsets.joint_offsets_mm)
    }


def _include(offsets: Offsets, joint: int, old_mm: float, offset_mm: float) -> str:
    name = f"d_rho_{LEG_NAMES[joint]}"
    said = [
        f"glidecal: joint {joint} ({LEG_NAMES[joint]}) of {one_line(offsets.machine.name)}, "
        f"from {one_line(offsets.source)}",
        f"old HOME_OFFSET {old_mm:.6f} mm + {name} {offset_mm:+.6f} mm",
    ]
    said += _known(name, offsets.parameters[name], lacks_fit=offsets.lacks_fit)
    put = f"# put '#INCLUDE calib_joint{joint}.inc' directly under [JOINT_{joint}]; "
    return (
        "".join(f"# {line}\n" for text in [*said, *offsets.cautions] for line in _lines(text))
        + f"{put}LINEAR_UNITS = mm\nHOME_OFFSET = {old_mm + offset_mm:.6f}\n"
    )


def _known(name: str, one: Offset, *, lacks_fit: bool) -> list[str]:
    """The figures of the result: the larger one first where it warns of what the model leaves."""
    if one.standard_uncertainty is None or one.expanded_uncertainty is None:
        return []
    known = f"±{uncertain(one.expanded_uncertainty, 4)} mm"
    noise = f"u = {uncertain(one.standard_uncertainty, 4)} mm"
    if lacks_fit and one.expanded_with_lack_of_fit is not None:
        larger = f"±{uncertain(one.expanded_with_lack_of_fit)} mm"
        return [
            f"{name} is known to {larger} (95 %, what the model leaves counted as noise); with "
            f"reading noise only {known}, {noise}"
        ]
    return [f"{name} is known to {known} (95 %), {noise}"]


def _lines(text: str) -> list[str]:
    """Short lines: the controller refuses long ones."""
    return wrap(one_line(text), WIDTH, break_on_hyphens=False)


def read_home_offsets(path: Path) -> tuple[float, float, float]:
    """HOME_OFFSET of [JOINT_0], [JOINT_1] and [JOINT_2] in a LinuxCNC INI file, mm.

    As in the controller the first occurrence of a key wins and a comment behind a number is an
    error. Raises RecordError.
    """
    found: dict[tuple[str, str], str] = {}
    section = ""
    for line in _with_includes(path):
        if heading := re.fullmatch(r"\s*\[(\w+)\]\s*", line):
            section = heading[1]
        elif entry := re.fullmatch(r"\s*(\w+)\s*=\s*(.*?)\s*", line):
            found.setdefault((section, entry[1]), entry[2])
    units = found.get(("TRAJ", "LINEAR_UNITS"), "mm")
    if units.lower() not in MILLIMETRES:
        raise RecordError(f"INI file {path}, LINEAR_UNITS", repr(units), ", ".join(MILLIMETRES))
    x, y, z = (_number(path, f"JOINT_{n}", found) for n in range(3))
    return x, y, z


def _with_includes(path: Path, depth: int = 0) -> Iterator[str]:
    """The lines of an INI file with those of its included files in place."""
    if depth > DEEPEST_INCLUDE:
        raise RecordError(f"INI file {path}", "an include of an include …", "a few levels")
    for line in read_text(path, "INI file").splitlines():
        if include := re.fullmatch(r"\s*#INCLUDE\s+(\S+)\s*", line):
            yield from _with_includes(path.parent / include[1], depth + 1)
        else:
            yield line


def _number(path: Path, section: str, found: dict[tuple[str, str], str]) -> float:
    text = found.get((section, "HOME_OFFSET"), "")
    if not NUMBER.fullmatch(text) or abs(float(text)) > LARGEST_MM:
        raise RecordError(
            f"INI file {path}, [{section}] HOME_OFFSET",
            repr(text) if text else "nothing",
            "a number with a decimal point and no comment behind it",
        )
    return float(text)
