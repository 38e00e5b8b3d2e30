"""``glidecal run``: the guided session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import Machine, Protocol, Seed, finite, need_terminal, say


def run(
    protocol: Protocol = "zero-max-min",
    machine: Machine = None,
    indicator: Annotated[
        list[str] | None,
        typer.Option(help="PROFILE:PORT or PROFILE:PORT@AXES; twice for two indicators."),
    ] = None,
    port: Annotated[
        list[str] | None, typer.Option(help="Port of an indicator of --profile; once or twice.")
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
    from app.indicators import check_indicators, parse_indicator
    from app.opening import (
        SIMULATED_INTERVAL_S,
        Plan,
        continue_session,
        plan_to_continue,
        session_name,
        simulated_indicators,
        start_session,
    )
    from app.wording.session import dry_run_text
    from protocols.errors import RecordError, UsageError
    from protocols.machine import Instrument, load_machine
    from protocols.procedure import load_procedure

    chosen = [parse_indicator(text) for text in indicator or ()]
    chosen += [Instrument(profile=profile, port=name) for name in port or ()]
    if simulated and chosen:
        raise UsageError("--simulated and a port", "both", "one of them")
    known = load_machine(machine)
    instruments = tuple(chosen)
    if not (resume or instruments):
        instruments = () if simulated else known.indicator
        if not instruments and not (simulated or dry_run):
            raise UsageError(
                "indicators", "none", "--indicator PROFILE:PORT, [[indicator]] in the machine file"
            )
        instruments = instruments or simulated_indicators([profile])
    if instruments:
        check_indicators(instruments)
    procedure = load_procedure(protocol)
    plan = Plan(
        path=output or session_name(Path(), procedure.name),
        machine=known,
        procedure=procedure,
        instruments=instruments or simulated_indicators([profile]),
        operator=operator,
        temperature_c=temperature,
        seed=seed,
        interval_s=0.0 if headless else SIMULATED_INTERVAL_S,
    )
    if dry_run:
        typer.echo(dry_run_text(plan.procedure, plan.machine.geometry(), plan.axes))
        return
    if not resume and plan.path.exists():
        raise RecordError(
            f"session {plan.path}", "a file that exists already", "a new file, or --continue"
        )
    if not headless:
        need_terminal("guided session", "--headless with --simulated")
        from app.screens.start import open_session

        opened = plan_to_continue(resume, instruments) if resume else plan
        raise typer.Exit(open_session(opened, continued=resume is not None))
    if resume:
        plan = replace(plan_to_continue(resume), interval_s=0.0)
    if not plan.simulated:
        raise UsageError("--headless", "real indicators", "--headless --simulated only")
    guided = continue_session(plan) if resume else start_session(plan)
    with guided:
        measure_all(guided)
    say(f"{len(guided.session.readings)} readings in {guided.path}")
