"""``glidecal identifiability``, ``postures`` and ``plan``: what is seen, what to measure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from app.commands.options import AsJson, Known, Machine, Measured, file, number, parts, say
from app.machines.family import Search
from app.machines.registry import NAMES, family_of, refuse_foreign
from app.planning.request import Request

MachineName = Annotated[
    str,
    typer.Argument(help=f"{', '.join(NAMES)}, or a machine file (TOML).", show_default=False),
]
MachineFile = Annotated[Path | None, file("Machine file (TOML).")]
Noise = Annotated[float | None, number("Standard deviation of a reading, mm.", most=10.0)]
MountingSeconds = Annotated[float, number("Time for a new mounting.", 0.0, 86400.0)]


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
        Path | None, file("Hexa Slide: postures of a .csv or .json file.")
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


def postures(
    context: typer.Context,
    machine: MachineName,
    procedure: Annotated[
        str, typer.Option(help="Procedure by name, or a .toml file.", show_default=False)
    ],
    count: Annotated[
        int | None, typer.Option(help="How many postures; a --posture-file tells it.")
    ] = None,
    machine_file: MachineFile = None,
    noise: Noise = None,
    criterion: Annotated[
        Literal[
            "determinant",
            "average-variance",
            "smallest-singular-value",
            "condition",
            "noise-amplification",
            "tool-variance",
        ]
        | None,
        typer.Option(
            help="What is made best.", show_default="determinant; condition for a hexaslide"
        ),
    ] = None,
    budget: Annotated[float | None, number("Minutes at most, with set-up.", 0.0)] = None,
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
        bool, typer.Option(help="Move the chosen postures off the grid, or keep to it.")
    ] = True,
    measured: Measured = "",
    known: Known = None,
    posture_file: Annotated[
        Path | None, file("Hexa Slide: .csv or .json file to start from.")
    ] = None,
    as_is: Annotated[
        bool, typer.Option("--as-is", help="Only judge the --posture-file, move nothing.")
    ] = False,
    output: Annotated[
        Path | None,
        file("File to write: procedure (.toml); Hexa Slide: postures (.csv).", "--output", "-o"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Optimum postures, beside those of the procedure."""
    from calib.design.criteria import Criterion

    family = family_of(machine)
    refuse_foreign(context, family, f"the machine {machine}")
    request = Request(
        procedure,
        machine_file,
        noise,
        mounting_seconds / 60.0,
        measured=parts(measured),
        known=None if known is None else parts(known.replace("none", "")),
        posture_file=posture_file,
        seed=seed,
    )
    search = Search(
        count=count,
        criterion=None if criterion is None else Criterion(criterion),
        budget_min=budget,
        starts=starts,
        repeats=repeats,
        common=common,
        refine=refine,
        as_is=as_is,
        output=output,
    )
    typer.echo(family.postures(machine, request, search, say).shown(as_json=as_json))


def plan(
    sessions: Annotated[
        list[Path] | None, typer.Argument(help="Sessions already measured.", readable=False)
    ] = None,
    session: Annotated[list[Path] | None, file("The same as an option.")] = None,
    machine: Machine = None,
    model: Annotated[Path | None, file("Model file (JSON).")] = None,
    noise: Noise = None,
    mounting_seconds: MountingSeconds = 120.0,
    as_json: AsJson = False,
) -> None:
    """The one added mounting that lowers the expected tool error most per minute."""
    from app.planning.next_measurement import next_measurement
    from app.report.schema.document import to_json
    from app.report.schema.plan import PlanReport
    from app.report.text.planning import plan_text

    found = next_measurement(
        [*(sessions or ()), *(session or ())],
        machine_file=machine,
        model_file=model,
        noise_mm=noise,
        minutes_per_mounting=mounting_seconds / 60.0,
    )
    for warning in found.warnings:
        say(f"glidecal: {warning}")
    typer.echo(to_json(PlanReport.of(plan=found)) if as_json else plan_text(found))
