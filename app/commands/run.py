"""``glidecal run``: the guided session."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import Machine, Protocol, Seed, finite, need_terminal, say


def run(
    protocol: Protocol = "zero-max-min",
    machine: Machine = None,
    port: Annotated[
        list[str] | None,
        typer.Option(help="Port of an indicator; twice for two indicators on each leg."),
    ] = None,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="A simulated machine instead of ports.")
    ] = False,
    profile: Annotated[str, typer.Option(help="Indicator profile.")] = "mitutoyo-01a",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Session file.", readable=False)
    ] = None,
    operator: Annotated[str, typer.Option(help="Name for the record.")] = "",
    temperature: Annotated[
        float | None,
        typer.Option(help="Machine temperature, °C.", min=-50.0, max=100.0, callback=finite),
    ] = None,
    seed: Seed = 1,
    resume: Annotated[
        Path | None,
        typer.Option("--continue", help="Go on with an interrupted session.", readable=False),
    ] = None,
    headless: Annotated[
        bool, typer.Option("--headless", help="Unattended, simulated machine only.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show every step; open and write nothing.")
    ] = False,
) -> None:
    """The guided session on real indicators, or on a simulated machine."""
    from app.demo import measure_all
    from app.opening import (
        SIMULATED_INTERVAL_S,
        Plan,
        continue_session,
        plan_to_continue,
        session_name,
        start_session,
    )
    from app.wording.session import dry_run_text
    from protocols.errors import UsageError
    from protocols.machine import load_machine
    from protocols.procedure import load_procedure

    ports = tuple(port or ())
    if simulated and ports:
        raise UsageError("--simulated and --port", "both", "one of them")
    if len(ports) > 2 or len(set(ports)) < len(ports):
        raise UsageError("--port", ", ".join(ports), "one port, or two different ports")
    procedure = load_procedure(protocol)
    plan = Plan(
        path=output or session_name(Path(), procedure.name),
        machine=load_machine(machine),
        procedure=procedure,
        ports=ports,
        profile=profile,
        operator=operator,
        temperature_c=temperature,
        seed=seed,
        interval_s=0.0 if headless else SIMULATED_INTERVAL_S,
    )
    if dry_run:
        typer.echo(dry_run_text(plan.procedure, plan.machine.geometry(), plan.indicators))
        return
    if not (resume or simulated or ports):
        raise UsageError(
            "indicators", "neither --port nor --simulated", "--port PORT, once or twice"
        )
    if not headless:
        need_terminal("guided session", "--headless with --simulated")
        from app.screens.start import open_session

        chosen = plan_to_continue(resume, ports) if resume else plan
        raise typer.Exit(open_session(chosen, continued=resume is not None))
    if ports:
        raise UsageError("--headless with --port", ", ".join(ports), "--headless --simulated only")
    guided = continue_session(plan_to_continue(resume)) if resume else start_session(plan)
    with guided:
        measure_all(guided)
    say(f"{len(guided.session.readings)} readings in {guided.path}")
