"""``glidecal run``, ``demo`` and ``simulate``: sessions on real and on simulated machines."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from app.machines.family import Simulation
from app.machines.options import (
    Force,
    Machine,
    Output,
    Protocol,
    Seed,
    file,
    machine_option,
    number,
    say,
)
from app.machines.registry import LISTED, LOOKS, family_of, options_of, with_options_of_machines
from app.report.streams import need_terminal
from calib.errors import CalibrationError, UsageError
from protocols.machine_files import USUAL_MACHINE

if TYPE_CHECKING:  # heavy: imported where used
    from collections.abc import Callable

    from app.evaluating.solution import SessionSolution
    from app.measuring.opening import Plan

HIDDEN = "The machine has more than offsets. To look for what is missing: glidecal diagnose {}"


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
    output: Annotated[Path | None, file("Session file.", "--output", "-o")] = None,
    operator: Annotated[str, typer.Option(help="Name for the record.")] = "",
    temperature: Annotated[float | None, number("Machine temperature, °C.", -50.0, 100.0)] = None,
    seed: Seed = 1,
    random_order: Annotated[
        int | None,
        typer.Option(help="Shuffle each cycle with this seed, where the order is free.", min=0),
    ] = None,
    resume: Annotated[Path | None, file("Go on with an interrupted session.", "--continue")] = None,
    headless: Annotated[
        bool, typer.Option("--headless", help="Unattended, simulated machine only.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show every step; open and write nothing.")
    ] = False,
) -> None:
    """The guided session on real indicators. With --simulated on a simulated machine."""
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
        typer.echo(dry_run_text(plan.procedure, plan.machine, plan.instruments))
    else:
        _measure(plan, headless=headless)


def _measure(plan: Plan, *, headless: bool) -> None:
    """On the screen, or unattended for a simulated machine."""
    from app.measuring.demo import measure_all
    from app.measuring.opening import start_session
    from protocols.journal import check_new

    if not plan.continued:
        check_new(plan.path)
    if not headless:
        need_terminal("guided session", "--headless with --simulated")
        from app.screens.start import open_session

        raise typer.Exit(open_session(plan, LOOKS))
    if not plan.simulated:
        raise UsageError("--headless", "real indicators", "--headless --simulated only")
    fast = replace(plan, interval_s=0.0)
    with start_session(fast) as guided:
        measure_all(guided)
    say(f"{len(guided.session.readings)} readings in {guided.path}")


def demo(
    headless: Annotated[
        bool, typer.Option("--headless", help="Run unattended and end with the summary.")
    ] = False,
    seed: Seed = 1,
    protocol: Protocol = None,
    profile: Annotated[
        list[str] | None, typer.Option(help="Profile of the simulated indicators; once or twice.")
    ] = None,
    effect: Annotated[
        str | None,
        typer.Option(help="Hide an effect in the machine, by its id; to be found by diagnose."),
    ] = None,
    folder: Annotated[Path, typer.Option(help="Where the sessions are written.")] = Path(
        "demo-sessions"
    ),
) -> None:
    """A whole calibration on a simulated machine. It is measured again after the export."""
    from app.measuring.demo import DEMO_MOTION_S, demo_plan, with_hidden_effect
    from app.measuring.indicators import DEFAULT_PROFILE
    from app.measuring.opening import SIMULATED_INTERVAL_S, writable_folder
    from app.measuring.simulated import BenchSettings
    from app.report.text.result import comparison_text, solution_text
    from protocols.machine import USUAL_PROCEDURE

    unattended = headless or not (sys.stdin.isatty() and sys.stdout.isatty())
    bench = BenchSettings() if unattended else BenchSettings(motion_s=DEMO_MOTION_S)
    interval_s = 0.0 if unattended else SIMULATED_INTERVAL_S
    plan = replace(
        demo_plan(folder, protocol or USUAL_PROCEDURE, seed, bench, profile or [DEFAULT_PROFILE]),
        interval_s=interval_s,
    )
    if effect is not None:
        plan = with_hidden_effect(plan, effect)
    writable_folder(folder)
    if not unattended:
        from app.screens.start import open_session

        raise typer.Exit(open_session(plan, LOOKS))
    before, after = run_headless(plan, say)
    typer.echo(solution_text(before))
    typer.echo("\nAfter the joint offsets were entered in the controller:\n")
    typer.echo(comparison_text(before.solution, after.solution))
    if effect is not None:
        typer.echo("\n" + HIDDEN.format(plan.path))


def run_headless(plan: Plan, say: Callable[[str], None]) -> tuple[SessionSolution, SessionSolution]:
    """Measure, identify, export, measure again; the two solutions to compare."""
    from app.exports import export_offsets
    from app.measuring.demo import verification_plan

    before = _measured(plan, say)
    folder = plan.path.with_suffix("")
    for path in export_offsets(before, plan.path, folder)[0]:
        say(f"exported: {path}")
    after = _measured(verification_plan(plan, before), say)
    if not after.solution.rms_before_mm < before.solution.rms_before_mm:
        raise CalibrationError(
            "verification",
            f"{after.solution.rms_before_mm:.3f} mm r.m.s. after calibration",
            f"less than the {before.solution.rms_before_mm:.3f} mm before it",
            "Look at both sessions with glidecal solve.",
        )
    return before, after


def _measured(plan: Plan, say: Callable[[str], None]) -> SessionSolution:
    from app.evaluating.solution import solve_for_controller
    from app.measuring.demo import measure_all
    from app.measuring.opening import start_session

    with start_session(plan) as guided:
        total = len(guided.steps)
        say(f"measuring {total} steps into {plan.path}")
        measure_all(guided)
    return solve_for_controller(plan.path)


@with_options_of_machines
def simulate(
    context: typer.Context,
    output: Output,
    machine: Annotated[str | None, machine_option(LISTED)] = None,
    seed: Seed = 1,
    force: Force = False,
    **own: Any,  # noqa: ANN401 (what the machines add)
) -> None:
    """A session of a simulated machine. The nominal one, or that of a model file."""
    name = machine or USUAL_MACHINE
    family = family_of(name)
    given = options_of(context, family, f"the machine {name}", own)
    family.simulate(Simulation(output, machine, seed, force), given, say)
