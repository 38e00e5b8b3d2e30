"""Offsets for controllers: one file a format.

May import `app.report` and what that may import.
"""

from __future__ import annotations

from pathlib import Path

from app.evaluating.solution import SessionSolution
from app.exports import linuxcnc, plain
from app.report.offsets import offsets_from_solved
from protocols.files import write_files

FORMATS = {
    "json": plain.as_json,
    "csv": plain.as_csv,
    "model": plain.as_model,
    "linuxcnc": linuxcnc.joint_includes,
}
"""Each takes offsets and gives the texts of the files to write, by name ('' is the path itself)."""

FILE_NAMES = {"json": "offsets.json", "csv": "offsets.csv", "model": "model.json"}


def export_offsets(solved: SessionSolution, folder: Path) -> list[Path]:
    """Offsets of a solution in every format, into a folder. Raises RecordError."""
    offsets = offsets_from_solved(solved)
    paths: list[Path] = []
    for name, written in FORMATS.items():
        target = folder if name == "linuxcnc" else folder / FILE_NAMES[name]
        paths += write_files(target, written(offsets))
    return paths
