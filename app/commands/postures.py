"""``glidecal postures``: optimum measurement postures."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from app.commands.identifiability import (
    MachineFile,
    MachineName,
    MountingSeconds,
    Noise,
    Procedure,
)
from app.commands.options import AsJson, Known, Measured, finite, parts, say
from app.machines.family import Search
from app.machines.registry import family_of, refuse_foreign
from app.planning.request import Request


class CriterionName(StrEnum):
    """What is made best; `calib.design.criteria` defines them."""

    DETERMINANT = "determinant"
    AVERAGE_VARIANCE = "average-variance"
    SMALLEST_SINGULAR_VALUE = "smallest-singular-value"
    CONDITION = "condition"
    NOISE_AMPLIFICATION = "noise-amplification"
    TOOL_VARIANCE = "tool-variance"


def postures(
    context: typer.Context,
    machine: MachineName,
    procedure: Procedure,
    count: Annotated[
        int | None, typer.Option(help="How many postures; a --posture-file tells it.")
    ] = None,
    machine_file: MachineFile = None,
    noise: Noise = None,
    criterion: Annotated[
        CriterionName | None,
        typer.Option(
            help="What is made best.", show_default="determinant; condition for a hexaslide"
        ),
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(help="Minutes at most, with set-up.", min=0.0, callback=finite),
    ] = None,
    mounting_seconds: MountingSeconds = 120.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the starts.")] = 0,
    starts: Annotated[int, typer.Option(min=1, max=10_000, help="Random starts.")] = 8,
    repeats: Annotated[
        bool, typer.Option("--repeats", help="A posture may be chosen more than once.")
    ] = False,
    common: Annotated[
        bool, typer.Option("--common", help="The same displacements on all legs: one file.")
    ] = False,
    refine: Annotated[
        bool,
        typer.Option(
            "--refine/--no-refine", help="Move the chosen postures off the grid, or keep to it."
        ),
    ] = True,
    measured: Measured = "",
    known: Known = None,
    posture_file: Annotated[
        Path | None,
        typer.Option(help="Hexa Slide: .csv or .json file to start from.", readable=False),
    ] = None,
    as_is: Annotated[
        bool, typer.Option("--as-is", help="Only judge the --posture-file, move nothing.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="File to write: procedure (.toml); Hexa Slide: postures (.csv).",
            readable=False,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Optimum postures, beside those of the procedure."""
    from calib.design.criteria import Criterion

    family = family_of(machine)
    refuse_foreign(context, family, f"the machine {machine}")
    request = Request(
        procedure,
        machine_file,
        noise,
        mounting_seconds / 60.0,
        measured=parts(measured),
        known=None if known is None else parts(known.replace("none", "")),
        posture_file=posture_file,
        seed=seed,
    )
    search = Search(
        count=count,
        criterion=None if criterion is None else Criterion(criterion.value),
        budget_min=budget,
        starts=starts,
        repeats=repeats,
        common=common,
        refine=refine,
        as_is=as_is,
        output=output,
    )
    typer.echo(family.postures(machine, request, search, say).shown(as_json=as_json))
