"""``glidecal model``: what a model holds, where it comes from; effects taken out again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import AsJson, say
from calib.errors import UsageError


def model(
    path: Annotated[Path, typer.Argument(help="Model file.", show_default=False, readable=False)],
    remove: Annotated[
        str | None, typer.Option("--remove", help="Take an effect out: ID or ID:WHERE.")
    ] = None,
    why: Annotated[str, typer.Option("--why", help="The reason, for the history.")] = "",
    as_json: AsJson = False,
) -> None:
    """Parameters, effects and history of a model; effects can be removed again."""
    from app.evaluating.adoption import remove as take_out
    from app.report.text.model import model_text
    from protocols.model_file import read_model_file

    if remove and not why:
        raise UsageError("--remove", "no reason", "--why with the reason, for the history")
    found = take_out(path, remove, why) if remove else read_model_file(path)
    if remove:
        say(f"{remove} removed from {path}")
    typer.echo(found.text().rstrip("\n") if as_json else model_text(found))
