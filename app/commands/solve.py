"""``glidecal solve``: from sessions to parameters with uncertainties."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import (
    AsJson,
    Method,
    MethodName,
    Seed,
    Sessions,
    Subset,
    WeightsName,
    finite,
    say,
)
from app.machines.family import Solving
from app.machines.registry import NAMES, family_of_files, refuse_foreign


def solve(
    context: typer.Context,
    sessions: Sessions,
    subset: Subset = None,
    method: Method = MethodName.EXACT,
    weights: Annotated[
        WeightsName,
        typer.Option(help="Linear method only: equal as in the papers, or covariance (14)."),
    ] = WeightsName.EQUAL,
    tolerance: Annotated[
        float | None,
        typer.Option(help="Judge the tool's r.m.s. error against this, mm.", callback=finite),
    ] = None,
    show_map: Annotated[
        bool, typer.Option("--map", help="Expected tool error on three planes.")
    ] = False,
    monte_carlo: Annotated[
        int, typer.Option("--monte-carlo", help="Check on so many simulated sessions.", min=0)
    ] = 0,
    seed: Seed = 1,
    machine: Annotated[
        str | None,
        typer.Option(help=f"{', '.join(NAMES)}; default: by the file."),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="Hexa Slide: the true machine that simulate wrote.", readable=False),
    ] = None,
    held_out: Annotated[
        float | None,
        typer.Option(
            help="Hexa Slide: share of postures kept out as a check (default 0.2).",
            min=0.0,
            max=0.9,
            callback=finite,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Averages, differences, parameters with uncertainties, residuals, what is not seen."""
    family = family_of_files(machine, sessions)
    refuse_foreign(context, family, family.measured, lambda other: other.measured)
    asked = Solving(
        files=sessions,
        subset=subset.value if subset else None,
        method=method.value,
        weights=weights.value,
        tolerance_mm=tolerance,
        show_map=show_map,
        monte_carlo=monte_carlo,
        seed=seed,
        truth=truth,
        held_out=held_out,
    )
    typer.echo(family.solve(asked, say).shown(as_json=as_json))
