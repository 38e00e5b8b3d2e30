"""``glidecal simulate``: a session from the simulation, without indicators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import Machine, Output, Protocol, Seed, figure, finite, say


def simulate(
    output: Output,
    protocol: Protocol = "zero-max-min",
    model: Annotated[Path | None, typer.Option(help="Model file (JSON).", readable=False)] = None,
    machine: Machine = None,
    seed: Seed = 1,
    scatter: Annotated[float, figure("Scatter of a re-approach, mm.")] = 0.002,
    resolution: Annotated[float, figure("Step of the display, mm; 0: none.")] = 0.001,
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
) -> None:
    """A session from the simulation: the nominal machine, or that of a model file."""
    from dataclasses import replace

    from app.hidden_effect import hidden_effect
    from app.own_effects import known_laws
    from app.planning_orthoglide import planned_readings
    from app.simulated_session import simulated_session
    from calib.orthoglide.model import Model
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
    truth = Model(known.geometry())
    if model:
        truth, known = read_model(model, known_laws())
    procedure = load_procedure(protocol, known.geometry())
    if effect is not None:
        hidden = hidden_effect(
            effect,
            truth,
            planned_readings(procedure, known),
            laws=known_laws(),
            seed=seed,
            noise_mm=max(scatter, resolution),
            size=size,
        )
        truth = replace(truth, effects=(*truth.effects, *hidden))
    opened, readings = simulated_session(
        procedure,
        known,
        truth,
        seed=seed,
        scatter_mm=scatter,
        resolution_mm=resolution,
    )
    write_whole(output, opened, list(readings))
    say(f"{len(readings)} simulated readings written to {output}")
