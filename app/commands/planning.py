"""``glidecal machine``, ``identifiability``, ``postures``, ``plan``, ``workspace``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from app.machines.options import (
    AsJson,
    Force,
    Machine,
    Place,
    PostureSearch,
    ScreenAnswer,
    argument,
    deliver,
    file,
    finite_place,
    machine_file_of,
    may_deliver,
    number,
    option,
)
from app.machines.registry import (
    CRITERIA,
    HAVE_WORKSPACE,
    LISTED,
    LOOKS,
    NAMES,
    POSTURE_FILES,
    family_of,
    family_with,
    options_of,
    with_options_of_machines,
)
from calib.errors import UsageError
from protocols.machine_files import USUAL_MACHINE, machine_files

MachineName = Annotated[str, typer.Argument(help=LISTED, show_default=False)]
MachineFile = Annotated[Path | None, file("Machine file (TOML).", to_read=True)]


def machine(
    name: Annotated[
        str, typer.Argument(help=", ".join(machine_files()), show_default=USUAL_MACHINE)
    ] = USUAL_MACHINE,
    output: Annotated[Path, file("File to write.", "--output", "-o", default="the terminal")] = (
        Path("-")
    ),
    force: Force = False,
) -> None:
    """A machine file to begin with. Write the lengths and limits of your machine into a copy."""
    names = [stem for stem in machine_files() if stem == name or stem.startswith(f"{name}-")]
    if not names:
        raise UsageError("machine", repr(name), ", ".join(machine_files()))
    force = may_deliver(output, force=force)
    deliver(output, {"": machine_files()[names[0]].read_text(encoding="utf-8")}, force=force)


@with_options_of_machines
def identifiability(
    context: typer.Context,
    machine: MachineName,
    procedure: Annotated[
        str | None, option("Procedure by name, or a .toml file; none with --measured.")
    ] = None,
    machine_file: MachineFile = None,
    as_json: AsJson = False,
    **machine_options: Any,  # noqa: ANN401 (what the machines add)
) -> None:
    """Which parameters a procedure can and cannot see. And what would help."""
    family = family_of(machine)
    options = options_of(context, family, f"the machine {machine}", machine_options)
    its_file = machine_file_of(machine, NAMES, machine_file)
    answer = family.identifiability(machine, procedure, its_file, **options)
    if isinstance(answer, ScreenAnswer):
        from app.screens.interface import open_screen

        raise typer.Exit(open_screen(answer.screen(), LOOKS))
    answer.show(as_json=as_json)


@with_options_of_machines
def postures(
    context: typer.Context,
    machine: MachineName,
    procedure: Annotated[str, option("Procedure by name, or a .toml file.", show_default=False)],
    count: Annotated[int | None, option("Number of postures; a --posture-file gives it.")] = None,
    machine_file: MachineFile = None,
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
        option(
            "Criterion: determinant, average-variance, smallest-singular-value, "
            "condition, noise-amplification or tool-variance.",
            metavar="CRITERION",
            show_default=CRITERIA,
        ),
    ] = None,
    seed: Annotated[int, option("Seed of the starts.", min=0)] = 0,
    starts: Annotated[int, option("Random starts.", min=1, max=10_000)] = 8,
    output: Annotated[
        Path | None, file(f"File to write: {POSTURE_FILES}.", "--output", "-o")
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
    **machine_options: Any,  # noqa: ANN401 (as above)
) -> None:
    """Optimum postures, beside those of the procedure."""
    family = family_of(machine)
    options = options_of(context, family, f"the machine {machine}", machine_options)
    its_file = machine_file_of(machine, NAMES, machine_file)
    search = PostureSearch(count, criterion or family.criterion, seed, starts, output, force)
    family.postures(machine, procedure, its_file, search, **options).show(as_json=as_json)


@with_options_of_machines
def plan(
    context: typer.Context,
    sessions: Annotated[list[Path] | None, argument("Sessions already measured.")] = None,
    session: Annotated[
        list[Path] | None, file("Session already measured; may be repeated.", to_read=True)
    ] = None,
    machine: Machine = None,
    as_json: AsJson = False,
    **machine_options: Any,  # noqa: ANN401 (as above)
) -> None:
    """What to measure next. The set-up that lowers the bound most per minute.

    With --macro the places of a plate, as G-code for the probe of a printer.
    """
    family, propose = family_with("plan", machine)
    options = options_of(context, family, f"the machine {machine}", machine_options)
    answer = propose(machine, [*(sessions or ()), *(session or ())], **options)
    answer.show(as_json=as_json)


def workspace(
    machine: Annotated[str, typer.Argument(help=HAVE_WORKSPACE, show_default=False)],
    limit: Annotated[
        float, number("Transmission factors wanted within 1/LIMIT … LIMIT.", 1.0, 1000.0)
    ] = 2.0,
    at: Annotated[
        Place | None,
        option(
            "One place of the tool, mm from Zero.",
            metavar="X Y Z",
            min=-1e5,
            max=1e5,
            callback=finite_place,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Where the tool can be. How the drives move it there."""
    _, name = family_with("workspace", machine)
    name(machine, limit, at).show(as_json=as_json)
