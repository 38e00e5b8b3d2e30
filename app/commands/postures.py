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
from app.commands.options import AsJson, finite, say

if TYPE_CHECKING:
    from app.planning import Request as Asked


class CriterionName(StrEnum):
    """What is made best; `calib.criteria` defines them."""

    DETERMINANT = "determinant"
    AVERAGE_VARIANCE = "average-variance"
    SMALLEST_SINGULAR_VALUE = "smallest-singular-value"
    CONDITION = "condition"
    NOISE_AMPLIFICATION = "noise-amplification"
    TOOL_VARIANCE = "tool-variance"


def postures(
    machine: MachineName,
    procedure: Procedure,
    count: Annotated[int, typer.Option(help="How many postures.", show_default=False)],
    machine_file: MachineFile = None,
    noise: Noise = None,
    criterion: Annotated[
        CriterionName, typer.Option(help="What is made best.")
    ] = CriterionName.DETERMINANT,
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
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Procedure file (TOML) to write.", readable=False),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Optimum postures, beside those of the procedure."""
    from app.documents import to_json
    from app.planning import Request, optimum_postures, write_procedures
    from app.planning_documents import postures_document
    from app.wording.planning import postures_text
    from calib.criteria import Criterion

    request = Request(procedure, machine_file, noise, mounting_seconds / 60.0)
    if machine == "hexaslide":
        _refuse_lists(repeats or common or budget is not None or output is not None)
        _boxed(request, count, criterion, seed, starts, as_json=as_json)
        return
    chosen = optimum_postures(
        machine,
        request,
        count,
        criterion=Criterion(criterion.value),
        budget_min=budget,
        seed=seed,
        starts=starts,
        repeats=repeats,
        common=common,
    )
    if output:
        for path in write_procedures(chosen, output):
            say(f"procedure written to {path}")
    typer.echo(to_json(postures_document(chosen)) if as_json else postures_text(chosen))


def _refuse_lists(asked: bool) -> None:
    """Raises UsageError for options that belong to a list of candidates."""
    from protocols.errors import UsageError

    if asked:
        raise UsageError(
            "--budget, --repeats, --common and --output", "the machine hexaslide", "orthoglide"
        )


def _boxed(
    request: Asked, count: int, criterion: CriterionName, seed: int, starts: int, *, as_json: bool
) -> None:
    """Postures anywhere in the box of a Hexa Slide."""
    from app.documents import to_json
    from app.planning_hexaslide import boxed_document, boxed_postures
    from app.wording.hexaslide import boxed_text
    from calib.criteria import Criterion

    found = boxed_postures(request, count, Criterion(criterion.value), seed=seed, starts=starts)
    typer.echo(to_json(boxed_document(found)) if as_json else boxed_text(found))
