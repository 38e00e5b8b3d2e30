"""Measuring from the command line; what a machine that moves itself shows and asks before."""

from __future__ import annotations

import sys
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

import typer

from app.exit_codes import Exit
from app.machines.options import say
from app.machines.registry import LOOKS
from app.report.streams import need_terminal
from calib.errors import GlidecalError, UsageError

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


def measure(plan: Plan, *, headless: bool, otherwise: str = "--headless with --simulated") -> None:
    """On the screen, or ``otherwise``; unattended where a program moves the machine."""
    from app.measuring.opening import QUICK_INTERVAL_S, measure_all, start_session
    from protocols.journal import check_new

    if not plan.continued:
        check_new(plan.path)
    if plan.motion is not None:
        ask(plan, on_screen=not headless)
    if not headless:
        need_terminal("guided session", otherwise)
        from app.screens.start import open_session

        raise typer.Exit(open_session(plan, LOOKS))
    if not (plan.simulated or plan.motion):
        allowed = "--headless with --simulated or --motion"
        raise UsageError("--headless", "real indicators", allowed)
    quick = plan if plan.motion else replace(plan, interval_s=QUICK_INTERVAL_S)
    with start_session(quick) as guided:
        if plan.motion:
            _by_itself(guided)
        else:
            measure_all(guided)
    say(f"{len(guided.session.readings)} readings in {guided.path}")


def _by_itself(guided: GuidedSession) -> None:
    """Without a screen; somebody is asked before each set-up."""
    from app.measuring.unattended import measure_by_itself
    from app.report.text.motion import set_up_text

    measure_by_itself(
        guided, lambda step: typer.confirm(f"{set_up_text(step)}. Ready?", err=True), say
    )


def measured_until(plan: Plan, until: float | None, *, headless: bool, done: bool = False) -> None:
    """A session, if it is not ``done``; then further ones where the machine moves itself.

    Raises UsageError where no set-up after set-up can be measured up to the bound ``until``.
    """
    of_legs = bool(plan.procedure.levels) and plan.machine.geometry().orthogonal
    if until is not None and (plan.motion is None or not headless):
        raise UsageError("--until", "no --motion, or a screen", "--motion … --headless")
    if until is not None and not of_legs:
        found = f"procedure {plan.procedure.name} on machine {plan.machine.name}"
        raise UsageError("--until", found, "readings of legs, on drives that are square")
    if not done:
        measure(plan, headless=headless)
    if plan.motion is None or not of_legs:
        return
    try:
        _go_on(plan, until)
    except GlidecalError as problem:  # nobody asked for a bound: the session is as good without
        if until is not None:
            raise
        say(f"{problem}")


def _go_on(plan: Plan, until: float | None) -> None:
    """What the readings bound; up to the bound ``until`` set-up after set-up, each a session.

    Ends where that is reached or more would not help. Without one it is said how to go on.
    """
    from app.planning.tripod import (
        all_sessions,
        further_procedure,
        further_session,
        next_measurement,
    )
    from app.report.text.motion import further_text

    first, before_mm = plan.path, inf
    while True:
        reach = next_measurement(all_sessions(first)).found.reach
        chosen = None if until is None else reach.towards(until, before_mm)
        say(further_text(reach, plan, until, chosen))
        if chosen is None:
            return
        procedure = further_procedure(plan.procedure, chosen)
        plan = replace(plan, path=further_session(first), procedure=procedure, continued=False)
        plan = replace(plan, before=None, verifies=None, note="")
        before_mm = reach.bound_mm
        measure(plan, headless=True)
