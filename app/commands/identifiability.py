"""``glidecal identifiability``: what a procedure can and cannot see."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import AsJson, Known, Measured, finite, parts
from app.machines.registry import NAMES, family_of, refuse_foreign
from app.planning.request import Request

MachineName = Annotated[
    str,
    typer.Argument(
        help=f"{', '.join(NAMES)}, or a machine file (TOML).",
        show_default=False,
    ),
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
    context: typer.Context,
    machine: MachineName,
    procedure: Annotated[
        str | None,
        typer.Option(help="Procedure by name, or a .toml file; none with --measured."),
    ] = None,
    machine_file: MachineFile = None,
    noise: Noise = None,
    measured: Measured = "",
    known: Known = None,
    postures: Annotated[
        int | None, typer.Option(help="Hexa Slide: random postures.", min=1, max=10_000)
    ] = None,
    posture_file: Annotated[
        Path | None,
        typer.Option(help="Hexa Slide: postures of a .csv or .json file.", readable=False),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of random postures.", min=0)] = 0,
    screen: Annotated[
        bool, typer.Option("--screen", help="Hexa Slide: look around on a screen.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Which parameters a procedure can and cannot see, and what would help."""
    family = family_of(machine)
    refuse_foreign(context, family, f"the machine {machine}")
    request = Request(
        procedure or "",
        machine_file,
        noise,
        measured=parts(measured),
        known=None if known is None else parts(known.replace("none", "")),
        postures=postures,
        posture_file=posture_file,
        seed=seed,
    )
    if screen and family.look is not None:
        raise typer.Exit(family.look(request))
    typer.echo(family.identifiability(machine, request).shown(as_json=as_json))
