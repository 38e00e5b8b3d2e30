"""Offsets for controllers: one file a format."""

from __future__ import annotations

from app.exports import linuxcnc, plain
from app.exports.offsets import Offsets, Written

FORMATS = {
    "json": plain.as_json,
    "csv": plain.as_csv,
    "model": plain.as_model,
    "linuxcnc": linuxcnc.joint_includes,
}
"""Each takes offsets and gives the texts of the files to write, by name ('' is the path itself)."""

__all__ = ["FORMATS", "Offsets", "Written"]
