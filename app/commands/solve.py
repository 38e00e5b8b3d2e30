"""``glidecal solve``: from sessions to parameters with uncertainties."""

from __future__ import annotations

from typing import Annotated

import typer

from app.commands.options import AsJson, Method, MethodName, Sessions, Subset, WeightsName, say


def solve(
    sessions: Sessions,
    subset: Subset = None,
    method: Method = MethodName.EXACT,
    weights: Annotated[
        WeightsName,
        typer.Option(help="Linear method only: equal as in the papers, or covariance (14)."),
    ] = WeightsName.EQUAL,
    as_json: AsJson = False,
) -> None:
    """Averages, differences, parameters with uncertainties, residuals, what is not seen."""
    from app.documents import solution_document, to_json
    from app.solving import solve_files
    from app.wording.result import solution_text

    solved, warnings = solve_files(
        sessions,
        subset=subset.value if subset else None,
        method=method.value,
        weights=weights.value,
    )
    for warning in warnings:
        say(f"glidecal: {warning}")
    typer.echo(to_json(solution_document(solved)) if as_json else solution_text(solved))
