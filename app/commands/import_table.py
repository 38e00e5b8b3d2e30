"""``glidecal import``: a session from a table of readings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import Machine, Output, figure, say


def import_table(
    table: Annotated[
        Path, typer.Argument(help="Table of readings (CSV).", show_default=False, readable=False)
    ],
    output: Output,
    machine: Machine = None,
    resolution: Annotated[float | None, figure("Resolution of the indicators, mm.")] = None,
    repeatability: Annotated[
        float | None, figure("Repeatability of the indicators (standard deviation), mm.")
    ] = None,
    remark: Annotated[
        list[str] | None, typer.Option(help="A remark for the record; may be repeated.")
    ] = None,
) -> None:
    """A session from a table of readings."""
    from app.version import program
    from protocols.events import Opened
    from protocols.journal import write_whole
    from protocols.machine import Instrument, load_machine
    from protocols.table import read_table, within_limits

    known = load_machine(machine)
    readings, unknown = read_table(table, known.geometry())
    opened = Opened(
        program=program(),
        origin="imported",
        machine=known,
        instruments=(
            Instrument(
                profile="table",
                port=table.name,
                resolution_mm=resolution,
                repeatability_mm=repeatability,
            ),
        ),
        remarks=tuple(remark or ()),
    )
    write_whole(output, opened, list(readings))
    if unknown:
        say(f"glidecal: columns kept but not used: {', '.join(unknown)}")
    outside = sum(not within_limits(reading, known.geometry()) for reading in readings)
    if outside:
        say(f"glidecal: {outside} readings lie outside the joint limits of the machine file")
    if len({reading.posture_mm for reading in readings}) < 2:
        say("glidecal: only one posture in this table; it cannot be solved alone")
    say(f"{len(readings)} readings written to {output}")
