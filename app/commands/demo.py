"""``glidecal demo``: a whole calibration on a simulated machine."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from app.machines.options import Machine, Protocol, Seed, option, say
from app.machines.registry import LOOKS
from calib.errors import CalibrationError

if TYPE_CHECKING:  # heavy: imported where used
    from app.evaluating.solution import SessionSolution
    from app.measuring.plan import Plan

NAMED = "What the first session shows, as glidecal diagnose {} says in full:"
HIDDEN = "The machine has other errors than offsets. To look for them: glidecal diagnose {}"


def demo(
    headless: Annotated[
        bool, option("Run unattended and end with the summary.", "--headless")
    ] = False,
    seed: Seed = 1,
    protocol: Protocol = None,
    machine: Machine = None,
    profile: Annotated[
        list[str] | None, option("Profile of the simulated indicators; once or twice.")
    ] = None,
    effect: Annotated[
        str | None, option("Hide an effect in the machine, by its id; diagnose looks for it.")
    ] = None,
    folder: Annotated[Path, option("Where the sessions are written.")] = Path("demo-sessions"),
    controller: Annotated[
        Literal["twin", "linuxcnc"] | None,
        option("The machine moves itself: by a simulated controller, or LinuxCNC here."),
    ] = None,
) -> None:
    """A whole calibration on a simulated machine. It is measured again after the export."""
    from app.measuring.demo import WATCHED, demo_plan
    from app.measuring.plan import writable_folder
    from app.measuring.simulated import BenchSettings
    from app.report.text.result import comparison_text, solution_text

    unattended = headless or not (sys.stdin.isatty() and sys.stdout.isatty())
    plan = demo_plan(
        folder,
        protocol,
        seed,
        BenchSettings() if unattended else WATCHED,
        profile or (),
        machine,
        by_itself=controller,
        effect=effect,
    )
    writable_folder(folder)
    if not unattended:
        from app.screens.interface import open_screen, screen_of

        raise typer.Exit(open_screen(screen_of("check.CheckScreen", plan), LOOKS))
    first, second = run_headless(plan)
    typer.echo(solution_text(first))
    typer.echo("\nAfter the joint offsets were entered in the controller:\n")
    typer.echo(comparison_text(first.solution, second.solution))
    if controller is not None:  # the whole loop: what the first session shows is named, too
        from app.evaluating.diagnosis import diagnose_files
        from app.report.text.diagnosis import headline
        from app.report.text.tables import wrapped

        verdict_words = wrapped(headline(diagnose_files([plan.path]).diagnosis))
        typer.echo(f"\n{NAMED.format(plan.path)}\n\n{verdict_words}")
    elif effect is not None:
        typer.echo("\n" + HIDDEN.format(plan.path))


def run_headless(plan: Plan) -> tuple[SessionSolution, SessionSolution]:
    """Measure, identify, export, measure again; the two solutions to compare."""
    from app.exports import export_offsets
    from app.measuring.plan import verification_plan

    first = _measured(plan)
    folder = plan.path.with_suffix("")
    for path in export_offsets(first, folder):
        say(f"exported: {path}")
    second = _measured(verification_plan(plan, first))
    if not second.solution.rms_before_mm < first.solution.rms_before_mm:
        raise CalibrationError(
            "verification",
            f"{second.solution.rms_before_mm:.3f} mm r.m.s. after calibration",
            f"less than the {first.solution.rms_before_mm:.3f} mm before it",
            "Look at both sessions with glidecal solve.",
        )
    return first, second


def _measured(plan: Plan) -> SessionSolution:
    from app.evaluating.solution import solve_files
    from app.measuring.opening import start_session
    from app.measuring.unattended import measure_all

    with start_session(plan) as guided:
        say(f"measuring {len(guided.steps)} steps into {plan.path}")
        measure_all(guided)
    return solve_files([plan.path])
