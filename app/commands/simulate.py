"""``glidecal simulate``: a session from the simulation, without indicators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import Machine, Output, Protocol, Seed, figure, say


def simulate(
    output: Output,
    protocol: Protocol = "zero-max-min",
    model: Annotated[Path | None, typer.Option(help="Model file (JSON).", readable=False)] = None,
    machine: Machine = None,
    seed: Seed = 1,
    scatter: Annotated[float, figure("Scatter of a re-approach, mm.")] = 0.002,
    resolution: Annotated[float, figure("Step of the display, mm; 0: none.")] = 0.001,
) -> None:
    """A session from the simulation: the nominal machine, or that of a model file."""
    from app.simulated_session import simulated_session
    from calib.orthoglide.model import Model
    from protocols.errors import UsageError
    from protocols.journal import write_whole
    from protocols.machine import load_machine
    from protocols.model_file import read_model
    from protocols.procedure import load_procedure

    if model and machine:
        raise UsageError("--model and --machine", "both", "one: a model brings its own machine")
    known = load_machine(machine)
    truth = Model(known.geometry())
    if model:
        truth, known = read_model(model)
    opened, readings = simulated_session(
        load_procedure(protocol, known.geometry()),
        known,
        truth,
        seed=seed,
        scatter_mm=scatter,
        resolution_mm=resolution,
    )
    write_whole(output, opened, list(readings))
    say(f"{len(readings)} simulated readings written to {output}")
