"""A machine that moves itself, in words: before the first move, on the way, where it stopped."""

from __future__ import annotations

from itertools import pairwise
from shlex import quote

from app.measuring.moving import Mover, Moving, feed_mm_min, limits_of, ways_of
from app.measuring.plan import Plan
from app.report.text.preparing import dry_run_text
from app.report.text.tables import paragraphs, uncertain, wrapped
from calib.errors import sentence
from calib.identify.next_mounting import FurtherSetUp, Reach
from drivers.motion.controller import place_words
from protocols.machine import MotionLimits
from protocols.motion import SELF_MOVING
from protocols.procedure import Step

QUESTION = "Guards closed, emergency stop at hand, nobody at the machine: may it move?"

MOVED_BY = {None: "", "twin": "A simulated controller", "linuxcnc": "LinuxCNC on this computer"}


def plan_text(plan: Plan, said: tuple[str, ...] = ()) -> str:
    """All that will move, every posture of it: shown before anything does.

    ``said`` is what the controller says of itself. Raises as `ways_of`.
    """
    return f"{_postures_text(plan)}\n\n{_limits_text(plan, said)}"


def _postures_text(plan: Plan) -> str:
    return dry_run_text(plan.procedure, plan.machine, plan.instruments).replace("G53 G0", "G53 G1")


def _limits_text(plan: Plan, said: tuple[str, ...]) -> str:
    """How fast and how far, what is checked, and what the controller ``said`` of itself."""
    ways = ways_of(plan.procedure, plan.machine, plan.axes)
    limits, motion = limits_of(plan.machine), plan.machine.motion or MotionLimits()
    places = [step.place for step in ways.steps]
    set_ups = 1 + sum(before != after for before, after in pairwise(places))
    minutes = (ways.moving_s + ways.resting_s) / 60.0
    unnamed = plan.motion and plan.machine.procedure is None
    return paragraphs(
        f"Procedure {SELF_MOVING}: the usual one where a machine moves itself and none is named."
        if unnamed and plan.procedure.name == SELF_MOVING
        else "",
        f"{plan.motion or MOVED_BY[plan.by_itself]} moves the machine, in {plan.machine.mdi} "
        f"coordinates: {len(ways.steps)} "
        f"steps at {feed_mm_min(plan.machine):g} mm/min, longest move {ways.longest_mm:.1f} mm, "
        f"{minutes:.1f} minutes of moving and rest. {set_ups} set-ups: before each it goes to Zero "
        f"and waits for your key. Then it comes from {motion.preroll_mm:g} mm below.",
        f"It says: {', '.join(said)}." if said else "",
        f"Never outside {place_words(limits.low_mm)} … {place_words(limits.high_mm)}, no move over "
        f"{limits.longest_mm:g} mm, no feed over {limits.fastest_mm_min:g} mm/min. A reading is "
        f"taken where the position that is read back is within {limits.reached_mm:g} mm of the "
        "one it was sent to, before and after. It is never switched on, homed or reset from here.",
    )


def check_text(plan: Plan, mover: Mover) -> str:
    """The same on the screen, before the key that lets it move; the question is always in sight."""
    return paragraphs(
        f"With Enter it moves. {QUESTION} Every posture stands below.",
        _limits_text(plan, mover.said),
        _postures_text(plan),
    )


def set_up_text(step: Step) -> str:
    """What the operator does by hand before a step."""
    axes = " and ".join(axis.upper() for axis in step.axes)
    return f"Set up at {step.touched}, station {step.station:g}, along {axes}"


def moving_text(mover: Mover, step: Step) -> str:
    """What the machine does now, in a line."""
    match mover.state:
        case Moving.SET_UP:
            return f"{set_up_text(step)}. Space when nobody is in the way: it moves."
        case Moving.UNDER_WAY:
            return f"MOVING to step {step.number}. Space, P or Escape stop it."
        case Moving.THERE:
            return f"Arrived at step {step.number}."
    return f"STOPPED: {sentence(mover.why)} Nothing was taken. P goes on."


def further_text(
    reach: Reach, plan: Plan, until_mm: float | None, chosen: FurtherSetUp | None
) -> str:
    """The bound at the tool after a session, and what follows: the ``chosen`` set-up, or the end.

    Where no bound was asked for, how to go on.
    """
    said = f"Tool over the workspace: at most {uncertain(reach.bound_mm)} mm r.m.s. (95 %)"
    said += f", because of {reach.open_name}." if reach.open_name else "."
    if chosen is not None:
        return wrapped(f"{said} Next, {_set_up_words(chosen)}.")
    if until_mm is not None and reach.bound_mm <= until_mm:
        return wrapped(f"{said} That is within the {until_mm:g} mm asked for.")
    if until_mm is not None or not reach.further:
        return wrapped(f"{said} More set-ups on legs would not help: see glidecal plan.")
    command = (
        f"glidecal run --headless --continue {quote(str(plan.path))} --motion {plan.motion} "
        f"--until {uncertain(reach.further[-1].bound_mm)}"
    )
    return f"{wrapped(f'{said} Next, {_set_up_words(reach.further[0])}. To go on:')}\n{command}"


def _set_up_words(one: FurtherSetUp) -> str:
    count = len(one.legs) * len(one.displacements_mm)
    return (
        f"leg {', '.join(one.legs)} at station {one.station:g}, {count} postures in "
        f"{one.minutes:.0f} minutes: {uncertain(one.bound_mm)} mm expected"
    )
