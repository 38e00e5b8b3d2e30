"""``glidecal identifiability``: what a procedure can and cannot see."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import AsJson, finite

MachineName = Annotated[str, typer.Argument(help="Kind of machine.", show_default=False)]
Procedure = Annotated[
    str,
    typer.Option("--procedure", help="Procedure by name, or a .toml file.", show_default=False),
]
MachineFile = Annotated[
    Path | None, typer.Option("--machine-file", help="Machine file (TOML).", readable=False)
]
Noise = Annotated[
    float | None,
    typer.Option("--noise", help="Standard deviation of a reading, mm.", max=10.0, callback=finite),
]
MountingSeconds = Annotated[
    float,
    typer.Option(
        "--mounting-seconds", help="Time for a new mounting.", min=0.0, max=86400.0, callback=finite
    ),
]


def identifiability(
    machine: MachineName,
    procedure: Procedure,
    machine_file: MachineFile = None,
    noise: Noise = None,
    as_json: AsJson = False,
) -> None:
    """Which parameters a procedure can and cannot see, and what would help."""
    from app.documents import to_json
    from app.planning import Request, seen_by
    from app.planning_documents import identifiability_document
    from app.wording.planning import identifiability_text

    seen = seen_by(machine, Request(procedure, machine_file, noise))
    document = to_json(identifiability_document(seen)) if as_json else identifiability_text(seen)
    typer.echo(document)
