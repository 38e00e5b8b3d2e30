"""``glidecal identifiability``: what a procedure can and cannot see."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import AsJson, finite

MachineName = Annotated[
    str, typer.Argument(help="Kind of machine, as in orthoglide.", show_default=False)
]
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
    measured: Annotated[
        str, typer.Option(help="Hexa Slide: what is measured, such as x,y,z,theta.")
    ] = "",
    postures: Annotated[
        int | None, typer.Option(help="Hexa Slide: random postures.", min=1, max=10_000)
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of random postures.", min=0)] = 0,
    as_json: AsJson = False,
) -> None:
    """Which parameters a procedure can and cannot see, and what would help."""
    from app.documents import to_json
    from app.planning import Request, seen_by
    from app.planning_documents import identifiability_document
    from app.wording.planning import identifiability_text

    components = tuple(part.strip() for part in measured.split(",")) if measured else ()
    request = Request(
        procedure, machine_file, noise, measured=components, postures=postures, seed=seed
    )
    seen = seen_by(machine, request)
    document = to_json(identifiability_document(seen)) if as_json else identifiability_text(seen)
    typer.echo(document)
