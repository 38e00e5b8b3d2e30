"""``glidecal demo``: a whole guided calibration on a simulated machine."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.commands.options import Protocol, Seed, say
from calib.errors import CalibrationError

if TYPE_CHECKING:  # heavy: imported where used
    from collections.abc import Callable

    from app.evaluating.solution import SessionSolution
    from app.measuring.opening import Plan

HIDDEN = "The machine has more than offsets. To look for what is missing: glidecal diagnose {}"


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
    """Measure, identify, export, measure again and compare, on a simulated machine."""
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

        raise typer.Exit(open_session(plan))
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
    for path in export_offsets(before, folder):
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
