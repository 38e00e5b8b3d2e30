"""``glidecal postures``: optimum measurement postures."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.commands.identifiability import (
    MachineFile,
    MachineName,
    MountingSeconds,
    Noise,
    Procedure,
)
from app.commands.options import AsJson, Known, Measured, finite, say

if TYPE_CHECKING:
    from app.planning.request import Request as Asked
    from calib.design.criteria import Criterion


class CriterionName(StrEnum):
    """What is made best; `calib.design.criteria` defines them."""

    DETERMINANT = "determinant"
    AVERAGE_VARIANCE = "average-variance"
    SMALLEST_SINGULAR_VALUE = "smallest-singular-value"
    CONDITION = "condition"
    NOISE_AMPLIFICATION = "noise-amplification"
    TOOL_VARIANCE = "tool-variance"


def postures(
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
    from app.planning.machines import of_three_drives
    from app.planning.request import Request
    from app.planning.tripod import write_procedures
    from app.report.schema.document import to_json
    from app.report.schema.planning import PosturesReport
    from app.report.text.planning import postures_text
    from calib.design.criteria import Criterion
    from calib.design.optimum import optimum_postures

    request = Request(
        procedure,
        machine_file,
        noise,
        mounting_seconds / 60.0,
        measured=_parts(measured),
        known=None if known is None else _parts(known.replace("none", "")),
        posture_file=posture_file,
        seed=seed,
    )
    wanted = None if criterion is None else Criterion(criterion.value)
    if machine == "hexaslide":
        _refuse("--budget, --repeats and --common", repeats or common or budget is not None)
        _refuse("--no-refine", not refine)
        _boxed(request, count, wanted, starts, output, as_is=as_is, as_json=as_json)
        return
    _refuse("--as-is", as_is, machine, "hexaslide")
    planned, like = of_three_drives(machine, request)
    chosen = optimum_postures(
        planned,
        _needed(count),
        criterion=wanted or Criterion.DETERMINANT,
        budget_min=budget,
        seed=seed,
        starts=starts,
        repeats=repeats,
        common=common,
        refine=refine,
    )
    if output:
        for path in write_procedures(chosen.orders, like, output):
            say(f"procedure written to {path}")
    typer.echo(to_json(PosturesReport.of(chosen=chosen)) if as_json else postures_text(chosen))


def _parts(listed: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in listed.split(",")) if listed else ()


def _refuse(
    option: str, asked: bool, machine: str = "hexaslide", allowed: str = "orthoglide"
) -> None:
    """Raises UsageError for an option of the other machine."""
    from protocols.errors import UsageError

    if asked:
        raise UsageError(option, f"the machine {machine}", f"the machine {allowed}")


def _needed(count: int | None) -> int:
    from protocols.errors import UsageError

    if count is None:
        raise UsageError("--count", "none", "how many postures to choose")
    return count


def _boxed(
    request: Asked,
    count: int | None,
    criterion: Criterion | None,
    starts: int,
    output: Path | None,
    *,
    as_is: bool,
    as_json: bool,
) -> None:
    """Postures anywhere in the box of a Hexa Slide."""
    from app.planning.hexaslide import asked_postures, write_postures
    from app.report.schema.document import to_json
    from app.report.schema.hexaslide import HexaSlidePosturesReport
    from app.report.text.hexaslide import boxed_text

    found = asked_postures(request, count, criterion, starts=starts, as_is=as_is, output=output)
    if output:
        say(f"postures written to {write_postures(found, output)}")
    typer.echo(to_json(HexaSlidePosturesReport.of(boxed=found)) if as_json else boxed_text(found))
