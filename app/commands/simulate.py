"""``glidecal simulate``: a session from the simulation, without indicators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer.models import OptionInfo

from app.commands.options import Output, Protocol, Seed, figure, finite, parts, say
from app.machines.family import Simulation
from app.machines.registry import NAMES, family_of, refuse_foreign
from protocols.machine_files import USUAL_MACHINE

SCATTER_MM, RESOLUTION_MM = Simulation.scatter_mm, Simulation.resolution_mm


def optional_figure(help_text: str) -> OptionInfo:
    """An option for a small number; None where it is not given."""
    option: OptionInfo = typer.Option(help=help_text, min=0.0, max=10.0, callback=finite)
    return option


def simulate(
    context: typer.Context,
    output: Output,
    protocol: Protocol = None,
    model: Annotated[Path | None, typer.Option(help="Model file (JSON).", readable=False)] = None,
    machine: Annotated[
        str | None,
        typer.Option(
            "--machine",
            help=f"{', '.join(NAMES)}, or a machine file (TOML).",
            show_default=USUAL_MACHINE,
        ),
    ] = None,
    seed: Seed = 1,
    scatter: Annotated[float, figure("Scatter of a re-approach, mm.")] = SCATTER_MM,
    resolution: Annotated[float, figure("Step of the display, mm; 0: none.")] = RESOLUTION_MM,
    effect: Annotated[
        str | None, typer.Option(help="Hide an effect in the machine: ID or ID:WHERE.")
    ] = None,
    size: Annotated[
        float | None,
        typer.Option(
            help="Its largest value, in its own unit; default: well above the scatter.",
            callback=finite,
        ),
    ] = None,
    procedure: Annotated[
        str | None, typer.Option(help="Hexa Slide: pose-inverse, position, …")
    ] = None,
    postures: Annotated[
        int | None, typer.Option(help="Hexa Slide: how many, random.", min=1, max=10_000)
    ] = None,
    noise: Annotated[
        float | None, optional_figure("Hexa Slide: standard deviation of a measured length, mm.")
    ] = None,
    angle_noise: Annotated[
        float | None, optional_figure("Hexa Slide: of a measured angle, mrad; default as --noise.")
    ] = None,
    errors: Annotated[
        float | None, optional_figure("Hexa Slide: of each hidden error, mm (default 1).")
    ] = None,
    measured: Annotated[
        str | None, typer.Option(help="Hexa Slide, pose-forward: such as x,y,z,theta.")
    ] = None,
    machine_file: Annotated[
        Path | None, typer.Option(help="Hexa Slide: machine file (TOML).", readable=False)
    ] = None,
    posture_file: Annotated[
        Path | None,
        typer.Option(help="Hexa Slide: these postures (CSV, JSON).", readable=False),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="Hexa Slide: file for the true machine.", readable=False),
    ] = None,
) -> None:
    """A session from the simulation: the nominal machine, or that of a model file."""
    name = machine or USUAL_MACHINE
    family = family_of(name)
    refuse_foreign(context, family, f"the machine {name}")
    family.simulate(
        Simulation(
            output,
            seed,
            machine,
            protocol,
            model,
            scatter_mm=scatter,
            resolution_mm=resolution,
            effect=effect,
            size=size,
            procedure=procedure,
            postures=postures,
            noise_mm=noise,
            angle_noise_mrad=angle_noise,
            errors_mm=errors,
            measured=parts(measured or ""),
            machine_file=machine_file,
            posture_file=posture_file,
            truth=truth,
        ),
        say,
    )
