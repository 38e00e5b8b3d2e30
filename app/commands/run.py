"""``glidecal run``: the guided session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.commands.options import Machine, Protocol, Seed, finite, say
from app.report.streams import need_terminal

if TYPE_CHECKING:  # heavy: imported where used
    from app.measuring.opening import Plan


def run(
    protocol: Protocol = None,
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
    random_order: Annotated[
        int | None,
        typer.Option(help="Shuffle each cycle with this seed, where the order is free.", min=0),
    ] = None,
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
    from app.measuring.indicators import choose_indicators, some_indicators
    from app.measuring.opening import (
        SIMULATED_INTERVAL_S,
        Plan,
        plan_to_continue,
        refuse_plate,
        session_name,
    )
    from app.report.text.session import dry_run_text
    from protocols.machine import load_machine
    from protocols.procedure import load_procedure, shuffled

    known = load_machine(machine)
    chosen = choose_indicators(
        indicator or (), port or (), profile, machine=known, simulated=simulated
    )
    if resume:
        _measure(plan_to_continue(resume, chosen), headless=headless)
        return
    procedure = load_procedure(protocol or known.usual_procedure, known.geometry())
    if not dry_run:
        refuse_plate(procedure)
    if random_order is not None:
        procedure = shuffled(procedure, random_order)
    plan = Plan(
        path=output or session_name(Path(), procedure.name),
        machine=known,
        procedure=procedure,
        instruments=chosen or some_indicators(profile, needed=not dry_run),
        operator=operator,
        temperature_c=temperature,
        seed=seed,
        interval_s=SIMULATED_INTERVAL_S,
    )
    if dry_run:
        typer.echo(dry_run_text(plan.procedure, plan.machine, plan.axes))
    else:
        _measure(plan, headless=headless)


def _measure(plan: Plan, *, headless: bool) -> None:
    """On the screen, or unattended for a simulated machine."""
    from app.measuring.demo import measure_all
    from app.measuring.opening import start_session
    from protocols.errors import UsageError
    from protocols.journal import check_new

    if not plan.continued:
        check_new(plan.path)
    if not headless:
        need_terminal("guided session", "--headless with --simulated")
        from app.screens.start import open_session

        raise typer.Exit(open_session(plan))
    if not plan.simulated:
        raise UsageError("--headless", "real indicators", "--headless --simulated only")
    fast = replace(plan, interval_s=0.0)
    with start_session(fast) as guided:
        measure_all(guided)
    say(f"{len(guided.session.readings)} readings in {guided.path}")
