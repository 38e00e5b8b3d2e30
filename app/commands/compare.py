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
    from app.comparing import compare_files, comparison_document
    from app.documents import to_json
    from app.wording.comparison import comparison_report

    comparison = compare_files(before, after)
    document = comparison_document(comparison)
    typer.echo(to_json(document) if as_json else comparison_report(comparison))
