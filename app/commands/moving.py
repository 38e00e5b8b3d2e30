"""What ``glidecal run --motion`` shows and asks on the terminal before a machine moves."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import typer

from app.exit_codes import Exit
from app.machines.options import say
from calib.errors import UsageError

if TYPE_CHECKING:  # heavy: imported where used
    from app.measuring.opening import Plan
    from app.measuring.session import GuidedSession


def shown(plan: Plan, said: tuple[str, ...] = ()) -> str:
    """All that will move; ``said`` is what the controller says of itself. Raises GlidecalError."""
    from app.measuring.moving import ways_of
    from app.report.text.motion import plan_text

    return plan_text(plan, ways_of(plan.procedure, plan.machine, plan.axes), said)


def ask(plan: Plan, *, on_screen: bool) -> None:
    """Show all that will move and what the controller says of itself, and ask once.

    On the screen its check shows and asks the same. Raises UsageError where nobody can be asked,
    MotionError for a machine that is not ready.
    """
    from app.measuring.moving import check_motion
    from app.report.text.motion import QUESTION

    if plan.simulated or plan.motion is None:
        raise UsageError("--motion", "a simulated machine", "indicators on ports")
    shown(plan)  # what is not allowed is refused before anybody is reached
    if not sys.stdin.isatty():
        raise UsageError("--motion", "nobody to ask", "a terminal: a machine will move")
    if on_screen:
        return
    said = check_motion(plan.motion, plan.machine)
    typer.echo(shown(plan, said), err=True)
    if not typer.confirm(QUESTION, err=True):
        raise typer.Exit(Exit.INTERRUPTED)


def measure(guided: GuidedSession) -> None:
    """The session without a screen, asked before each set-up."""
    from app.measuring.moving import measure_by_itself
    from app.report.text.motion import set_up_text

    measure_by_itself(
        guided, lambda step: typer.confirm(f"{set_up_text(step)}. Ready?", err=True), say
    )
