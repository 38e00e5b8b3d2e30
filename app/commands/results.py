"""``glidecal solve``, ``compare`` and ``export``: from sessions to parameters and offsets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from app.commands.options import (
    AsJson,
    Method,
    Output,
    Seed,
    Sessions,
    SubsetName,
    file,
    number,
    say,
)
from app.machines.family import Solving
from app.machines.registry import NAMES, family_of_files, refuse_foreign
from calib.errors import UsageError


def solve(
    context: typer.Context,
    sessions: Sessions,
    subset: Annotated[
        SubsetName | None,
        typer.Option(help="Parameters to identify; default: the recommended set."),
    ] = None,
    method: Method = "exact",
    weights: Annotated[
        Literal["equal", "covariance"],
        typer.Option(help="Linear method only: equal as in the papers, or covariance (14)."),
    ] = "equal",
    model: Annotated[
        Path | None, file("Fit the sizes of this model's effects together with the parameters.")
    ] = None,
    tolerance: Annotated[
        float | None, number("Judge the tool's r.m.s. error against this, mm.")
    ] = None,
    show_map: Annotated[
        bool, typer.Option("--map", help="Expected tool error on three planes.")
    ] = False,
    monte_carlo: Annotated[
        int, typer.Option(help="Check on so many simulated sessions.", min=0)
    ] = 0,
    seed: Seed = 1,
    machine: Annotated[
        str | None, typer.Option(help=f"{', '.join(NAMES)}; default: by the file.")
    ] = None,
    truth: Annotated[Path | None, file("Hexa Slide: the true machine that simulate wrote.")] = None,
    held_out: Annotated[
        float | None,
        number("Hexa Slide: share of postures kept out as a check (default 0.2).", 0.0, 0.9),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Averages, differences, parameters with uncertainties, residuals, what is not seen."""
    family = family_of_files(machine, sessions)
    refuse_foreign(context, family, family.measured, lambda other: other.measured)
    asked = Solving(
        files=sessions,
        subset=subset,
        method=method,
        weights=weights,
        model=model,
        tolerance_mm=tolerance,
        show_map=show_map,
        monte_carlo=monte_carlo,
        seed=seed,
        truth=truth,
        held_out=held_out,
    )
    typer.echo(family.solve(asked, say).shown(as_json=as_json))


def compare(
    before: Annotated[
        Path, typer.Argument(help="Session before.", show_default=False, readable=False)
    ],
    after: Annotated[
        Path, typer.Argument(help="Session after.", show_default=False, readable=False)
    ],
    as_json: AsJson = False,
) -> None:
    """The differences before and after the offsets were entered in the controller."""
    from app.evaluating.comparison import compare_files

    found = compare_files(before, after)
    if as_json:
        from app.report.schema.document import to_json
        from app.report.schema.solution import ComparisonReport

        typer.echo(to_json(ComparisonReport.of(found=found)))
    else:
        from app.report.text.result import comparison_report

        typer.echo(comparison_report(found))


def export(
    source: Annotated[Path, typer.Argument(help="Session or model file.", show_default=False)],
    output: Output,
    format_name: Annotated[
        Literal["json", "csv", "model", "linuxcnc", "linuxcnc-kins"],
        typer.Option("--format", help="What to write."),
    ],
    subset: Annotated[
        SubsetName, typer.Option(help="Parameters to identify from a session.")
    ] = "joint-offsets",
    method: Method = "exact",
    model: Annotated[
        Path | None, file("Of a session: fit the sizes of this model's effects, too.")
    ] = None,
    home_offset: Annotated[
        str | None, typer.Option(help="Present HOME_OFFSET of joints x,y,z in mm: '1.5,0,-2'.")
    ] = None,
    ini: Annotated[
        Path | None, typer.Option(help="LinuxCNC INI file: what the joints hold now.")
    ] = None,
) -> None:
    """Offsets for the controller: a file, or for linuxcnc a folder of includes and tables."""
    from app.exports import FORMATS
    from app.exports.linuxcnc_ini import read_controller
    from app.report.offsets import offsets_from_file
    from app.report.text.caveats import UNKNOWN_HOME_OFFSET
    from calib.tripod.controller import Controller
    from protocols.files import write_files

    if home_offset is not None and ini:
        raise UsageError("--home-offset and --ini", "both", "one of them")
    offsets = offsets_from_file(source, subset, method, model)
    if home_offset is not None:
        offsets = replace(offsets, controller=Controller.homed_at(_triple(home_offset)))
    if ini:
        offsets = replace(offsets, controller=read_controller(ini))
    for text in offsets.cautions:
        say(f"glidecal: {text}")
    if format_name.startswith("linuxcnc") and offsets.controller is None:
        say(f"glidecal: WARNING: {UNKNOWN_HOME_OFFSET}")
    for path in write_files(output, FORMATS[format_name](offsets)):
        say(f"written: {path}")


def _triple(text: str) -> tuple[float, float, float]:
    from app.exports.linuxcnc_ini import LARGEST_MM
    from protocols.table import NUMBER

    parts = text.split(",")
    if len(parts) == 3 and all(NUMBER.fullmatch(part.strip()) for part in parts):
        x, y, z = (float(part) for part in parts)
        if max(abs(x), abs(y), abs(z)) <= LARGEST_MM:
            return x, y, z
    raise UsageError("--home-offset", repr(text), "three numbers in mm: '1.5,0,-2'")
