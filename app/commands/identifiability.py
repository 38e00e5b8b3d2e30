"""``glidecal identifiability``: what a procedure can and cannot see."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from app.commands.options import AsJson, Known, Measured, finite
from protocols.machine_files import machine_names

if TYPE_CHECKING:
    from app.planning.request import Request as Asked

MachineName = Annotated[
    str,
    typer.Argument(
        help=f"{', '.join((*machine_names(), 'hexaslide'))}, or a machine file (TOML).",
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
    from app.planning.request import Request

    components = _parts(measured)
    request = Request(
        procedure or _usual(machine, components),
        machine_file,
        noise,
        measured=components,
        known=None if known is None else _parts(known.replace("none", "")),
        postures=postures,
        posture_file=posture_file,
        seed=seed,
    )
    if screen:
        _show(machine, request)
    typer.echo(_told(machine, request, as_json=as_json))


def _parts(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",")) if text.strip() else ()


def _usual(machine: str, measured: tuple[str, ...]) -> str:
    """Measured components alone are those of a posture; other machines have a usual procedure.

    Raises UsageError without either.
    """
    from protocols.errors import UsageError

    if machine != "hexaslide":
        return ""
    if not measured:
        raise UsageError(
            "--procedure", "none", "the name of a procedure", "For hexaslide --measured also does."
        )
    return "pose-forward"


def _told(machine: str, request: Asked, *, as_json: bool) -> str:
    """The document of the machine, or its words."""
    from app.report.schema.document import to_json

    if machine == "hexaslide":
        from app.planning.hexaslide import hexaslide_planning
        from app.report.schema.hexaslide import HexaSlideIdentifiabilityReport
        from app.report.text.hexaslide import seen_text
        from calib.hexaslide.seen import hexaslide_seen

        found = hexaslide_seen(hexaslide_planning(request))
        if not as_json:
            return seen_text(found)
        return to_json(HexaSlideIdentifiabilityReport.of(seen=found.seen, found=found))
    from app.planning.machines import planned_machine
    from app.report.schema.planning import IdentifiabilityReport
    from app.report.text.planning import identifiability_text
    from calib.design.planning import seen_by

    seen = seen_by(planned_machine(machine, request))
    return to_json(IdentifiabilityReport.of(seen=seen)) if as_json else identifiability_text(seen)


def _show(machine: str, request: Asked) -> NoReturn:
    """The screen of the machine; leaves with its exit status."""
    from protocols.errors import UsageError

    if machine != "hexaslide":
        raise UsageError("--screen", f"the machine {machine}", "hexaslide")
    from app.screens.start import open_hexaslide

    raise typer.Exit(open_hexaslide(request))
