"""``glidecal export``: offsets for the controller."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import Method, MethodName, Output, SubsetName, say
from calib.errors import UsageError


class Format(StrEnum):
    """What to write."""

    JSON = "json"
    CSV = "csv"
    MODEL = "model"
    LINUXCNC = "linuxcnc"


def export(
    source: Annotated[Path, typer.Argument(help="Session or model file.", show_default=False)],
    output: Output,
    format_name: Annotated[Format, typer.Option("--format", help="What to write.")],
    subset: Annotated[
        SubsetName, typer.Option(help="Parameters to identify from a session.")
    ] = SubsetName.JOINT_OFFSETS,
    method: Method = MethodName.EXACT,
    home_offset: Annotated[
        str | None, typer.Option(help="Present HOME_OFFSET of joints x,y,z in mm: '1.5,0,-2'.")
    ] = None,
    ini: Annotated[
        Path | None, typer.Option(help="LinuxCNC INI file to read the present HOME_OFFSET from.")
    ] = None,
) -> None:
    """Offsets for the controller: a file, or for linuxcnc a folder with three includes."""
    from app.exports import FORMATS
    from app.exports.linuxcnc import read_home_offsets
    from app.report.offsets import offsets_from_file, with_home_offset
    from app.report.text.caveats import UNKNOWN_HOME_OFFSET
    from protocols.files import write_files

    if home_offset is not None and ini:
        raise UsageError("--home-offset and --ini", "both", "one of them")
    offsets = offsets_from_file(source, subset.value, method.value)
    if home_offset is not None:
        offsets = with_home_offset(offsets, _triple(home_offset))
    if ini:
        offsets = with_home_offset(offsets, read_home_offsets(ini))
    for text in offsets.cautions:
        say(f"glidecal: {text}")
    if format_name is Format.LINUXCNC and offsets.home_offset_mm is None:
        say(f"glidecal: WARNING: {UNKNOWN_HOME_OFFSET}")
    for path in write_files(output, FORMATS[format_name](offsets)):
        say(f"written: {path}")


def _triple(text: str) -> tuple[float, float, float]:
    from app.exports.linuxcnc import LARGEST_MM
    from protocols.table import NUMBER

    parts = text.split(",")
    if len(parts) == 3 and all(NUMBER.fullmatch(part.strip()) for part in parts):
        x, y, z = (float(part) for part in parts)
        if max(abs(x), abs(y), abs(z)) <= LARGEST_MM:
            return x, y, z
    raise UsageError("--home-offset", repr(text), "three numbers in mm: '1.5,0,-2'")
