"""``glidecal simulate``: a session from the simulation, without indicators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.hexaslide_calibration import (
    Own,
    optional_figure,
    refuse_own,
    simulate_hexaslide,
)
from app.commands.options import Output, Protocol, Seed, figure, finite, say
from protocols.machine_files import USUAL_MACHINE, machine_names

HEXASLIDE = "hexaslide"
SCATTER_MM, RESOLUTION_MM = 0.002, 0.001


def simulate(
    output: Output,
    protocol: Protocol = None,
    model: Annotated[Path | None, typer.Option(help="Model file (JSON).", readable=False)] = None,
    machine: Annotated[
        str | None,
        typer.Option(
            "--machine",
            help=f"{', '.join((*machine_names(), HEXASLIDE))}, or a machine file (TOML).",
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
    own = Own(
        procedure=procedure,
        postures=postures,
        noise=noise,
        angle_noise=angle_noise,
        errors=errors,
        measured=measured,
        machine_file=machine_file,
        posture_file=posture_file,
        truth=truth,
    )
    usual = (protocol, scatter, resolution) == (None, SCATTER_MM, RESOLUTION_MM)
    if machine == HEXASLIDE:
        foreign = not usual or any(one is not None for one in (model, effect, size))
        simulate_hexaslide(own, output, seed, foreign=foreign)
        return
    refuse_own(own)
    from dataclasses import replace

    from app.evaluating.own_effects import known_laws
    from app.measuring.hidden_effect import hidden_effect
    from app.measuring.simulated import planned_readings, simulated_session
    from calib.tripod.pipeline import Model
    from protocols.errors import UsageError
    from protocols.journal import write_whole
    from protocols.machine import load_machine
    from protocols.model_file import read_model
    from protocols.procedure import load_procedure

    if size is not None and effect is None:
        raise UsageError("--size", "no --effect", "the size of an effect: both options, or none")
    if model and machine:
        raise UsageError("--model and --machine", "both", "one: a model brings its own machine")
    known = load_machine(machine)
    real = Model(known.geometry())
    if model:
        real, known = read_model(model, known_laws())
    planned = load_procedure(protocol or known.usual_procedure, known.geometry())
    if effect is not None:
        hidden = hidden_effect(
            effect,
            real,
            planned_readings(planned, known),
            laws=known_laws(),
            seed=seed,
            noise_mm=max(scatter, resolution),
            size=size,
        )
        real = replace(real, effects=(*real.effects, *hidden))
    opened, readings = simulated_session(
        planned,
        known,
        real,
        seed=seed,
        scatter_mm=scatter,
        resolution_mm=resolution,
    )
    write_whole(output, opened, list(readings))
    say(f"{len(readings)} simulated readings written to {output}")
