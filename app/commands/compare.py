"""``glidecal compare``: a session before and one after the offsets were entered."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import AsJson


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
