"""``glidecal demo``: a whole guided calibration on a simulated machine."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import Protocol, Seed, say

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
    from app.bench import BenchSettings
    from app.demo import DEMO_MOTION_S, demo_plan, run_headless, with_hidden_effect
    from app.folders import writable_folder
    from app.indicators import DEFAULT_PROFILE
    from app.opening import SIMULATED_INTERVAL_S
    from app.wording.result import comparison_text, solution_text
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
