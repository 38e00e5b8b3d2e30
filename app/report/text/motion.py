"""A machine that moves itself, in words: before the first move, on the way, where it stopped."""

from __future__ import annotations

from itertools import pairwise

from app.measuring.moving import MoveProposal, Mover, feed_mm_min, limits_of, ways_of
from app.measuring.plan import Plan
from app.report.text.preparing import check_text, dry_run_text
from app.report.text.session import continue_command
from app.report.text.tables import paragraphs, uncertain, wrapped
from calib.errors import sentence
from calib.posterior.measurements import stand_words
from calib.posterior.planning import FurtherSetUp, Reach
from drivers.motion.controller import place_words
from drivers.motion.states import State
from protocols.machine import MotionLimits
from protocols.motion import SELF_MOVING
from protocols.procedure import Step

QUESTION = "Guards closed, emergency stop at hand, nobody at the machine: may it move?"

MOVED_BY = {None: "", "twin": "A simulated controller", "linuxcnc": "LinuxCNC on this computer"}


def plan_text(plan: Plan, remarks: tuple[str, ...] = ()) -> str:
    """Every step; where a controller moves the machine, all that will move.

    ``remarks`` are what the controller says of itself. Raises as `ways_of`.
    """
    if not plan.motion:
        return dry_run_text(plan.procedure, plan.machine, plan.instruments)
    return f"{_postures_text(plan)}\n\n{_limits_text(plan, remarks)}"


def _postures_text(plan: Plan) -> str:
    return dry_run_text(plan.procedure, plan.machine, plan.instruments).replace("G53 G0", "G53 G1")


def _limits_text(plan: Plan, remarks: tuple[str, ...]) -> str:
    """How fast and how far, what is checked, and the ``remarks`` of the controller on itself."""
    ways = ways_of(plan.procedure, plan.machine, plan.axes)
    limits, motion = limits_of(plan.machine), plan.machine.motion or MotionLimits()
    places = [step.place for step in ways.steps]
    set_ups = 1 + sum(place != next_place for place, next_place in pairwise(places))
    minutes = ways.duration_s / 60.0
    unnamed = plan.motion and plan.machine.procedure is None
    return paragraphs(
        f"Procedure {SELF_MOVING}: the usual one where a machine moves itself and none is named."
        if unnamed and plan.procedure.name == SELF_MOVING
        else "",
        f"{plan.motion or MOVED_BY[plan.by_itself]} moves the machine, in {plan.machine.mdi} "
        f"coordinates: {len(ways.steps)} "
        f"steps at {feed_mm_min(plan.machine):g} mm/min, longest move {ways.longest_mm:.1f} mm, "
        f"{minutes:.1f} minutes of moving and rest. {set_ups} set-ups: each way to Zero and each "
        f"set-up begins with your consent. It comes from {motion.preroll_mm:g} mm below.",
        f"It reports: {', '.join(remarks)}." if remarks else "",
        f"Never outside {place_words(limits.low_mm)} … {place_words(limits.high_mm)}, no move over "
        f"{limits.longest_mm:g} mm, no feed over {limits.fastest_mm_min:g} mm/min. A reading is "
        f"taken where the position that is read back is within {limits.reached_mm:g} mm of the "
        "one it was sent to, before and after. It is never switched on or reset from here.",
    )


def opened_text(plan: Plan, mover: Mover | None) -> str:
    """The sentence on the screen, before the key that begins; the question is always in sight."""
    if mover is None:
        return check_text(plan)
    return paragraphs(
        [f"{{check.begin}} begins; nothing moves yet. {QUESTION} Every posture is listed below."],
        _limits_text(plan, mover.line.facts),
        _postures_text(plan),
        check_text(plan).splitlines(),
    )


def set_up_text(step: Step) -> str:
    """What the operator does by hand before a step."""
    axes = " and ".join(axis.upper() for axis in step.axes)
    return f"Set up at {step.touched}, station {step.station:g}, along {axes}"


def proposal_text(proposal: MoveProposal) -> str:
    """What the operator's consent lets the machine do, with the length of the next way."""
    step = proposal.step
    count = "1 step" if proposal.steps == 1 else f"{proposal.steps} steps"
    if proposal.proof is not None:
        return f"{proposal.proof.words}, and back"
    if proposal.to_zero:
        return f"to Zero, {proposal.first_mm:.1f} mm"
    if not proposal.places_mm:
        return f"reading here, then the rest of {count} at {step.touched}"
    first = f"{proposal.first_mm:.1f} mm to step {step.number}"
    return f"through {count} at {step.touched}; the first way is {first}"


def consent_question(proposal: MoveProposal) -> str:
    """The question for consent on the command line."""
    return f"{_by_hand_text(proposal)}Nobody at the machine? Move {proposal_text(proposal)}"


def waiting_text(mover: Mover) -> str:
    """What waits for the operator's consent, and the key that gives it."""
    proposal, proof = mover.proposal, mover.unproved
    wrong = f"NOT PROVED. {proof.wrong} " if proof and proof.wrong else ""
    if proposal is None:
        return f"{wrong}At rest."
    if wrong:
        return f"{wrong}{_by_hand_text(proposal)}{{measure.go}} proves it again, 5 mm at a time."
    moves = "{measure.go} moves" if proposal.proof else "{measure.go} moves it"
    by_hand = _by_hand_text(proposal)
    return f"{by_hand}Nobody at the machine? {moves} {proposal_text(proposal)}."


def _by_hand_text(proposal: MoveProposal) -> str:
    """What the operator does by hand before it moves."""
    if proposal.clears:
        return "Proved. Take the stand away from the bar. "
    if not proposal.by_hand:
        return ""
    here = ", with the machine where it is" if proposal.proof else ""
    return f"{set_up_text(proposal.step)}{here}. "


def no_consent_text(mover: Mover) -> str:
    """Why the key that gives a consent was not taken."""
    proof = mover.unproved
    if mover.proposal is None and proof is not None and proof.wrong:
        return f"NOT PROVED. {proof.wrong}"
    still = ", and all indicators rest" if proof is not None else ""
    return f"WAIT until all keys were released for a second{still}, then press {{measure.go}} once."


SAW_CHOICES = (("no", "No, or I did not look"), ("yes", "Yes, I saw it"))


def moving_text(mover: Mover, step: Step) -> str:
    """What the machine does now, in a line."""
    if mover.line.not_stopped:
        return mover.why
    move = mover.proof.move if mover.proof else None
    goal = f"to step {step.number}" if move is None else move.words
    place = f"At step {step.number}" if move is None else "Half-way"
    labels = {
        State.MOVING: f"MOVING {goal}. Any key stops it.",
        State.CONSENTED: f"{place}. It continues without a key; any key stops it.",
        State.STOPPING: "STOPPING …",
        State.HELD: f"HELD: {sentence(mover.why)} {{measure.go}} asks what to do.",
        State.FAULT: f"FAULT: {sentence(mover.why)} {{measure.go}} asks what to do.",
    }
    stopped = f"STOPPED: {sentence(mover.why)} " if mover.state is State.STOPPED else ""
    return labels.get(mover.state) or f"{stopped}{waiting_text(mover)}"


EVENTS = {
    State.STOPPING: "The machine was not seen to rest:",
    State.HELD: "The machine rests. Something interfered:",
    State.FAULT: "The machine cannot be moved:",
}
ANSWERS = {
    State.STOPPING: "{motion.still}  It does not move: I saw it",
    State.HELD: "{motion.answer}  I looked; it is over. Nothing moves until {measure.go}",
    State.FAULT: "{motion.answer}  It is mended: look again. Nothing moves until {measure.go}",
}


def event_text(mover: Mover) -> str:
    """What happened to the machine, and what the operator can answer."""
    state = mover.state
    answer = ANSWERS.get(state, "")
    home = "\n{motion.home}  Home it: all carriages go to their switches"
    home *= mover.line.can_home
    if state not in EVENTS:
        return "The machine is ready again. Nothing moves until {measure.go}."
    return f"{EVENTS[state]}\n\n{mover.why}\n\n{answer}{home if state is State.FAULT else ''}"


HOMED_QUESTION = (
    "This controller cannot report whether the machine is homed. Was it homed since it was "
    "switched on, and since its port was opened?"
)
HOME_QUESTION = "Home it now: all carriages go to their switches. Nobody at the machine"
HOMED_CHOICES = (
    ("homed", "It was homed, I saw it"),
    ("not homed", "It was not, or I do not know"),
)


def further_text(
    reach: Reach, plan: Plan, until_mm: float | None, set_up: FurtherSetUp | None
) -> str:
    """The bound at the tool after a session, and what follows: the ``set_up``, or the end.

    Where no bound was asked for, how to go on.
    """
    sentence = f"Tool over the workspace: at most {uncertain(reach.bound_mm)} mm r.m.s. (95 %)."
    if set_up is not None:
        return wrapped(f"{sentence} Next, {_set_up_words(set_up)}.")
    if until_mm is not None and reach.bound_mm <= until_mm:
        return wrapped(f"{sentence} That is within the {until_mm:g} mm asked for.")
    if until_mm is not None or not reach.further:
        return wrapped(f"{sentence} More set-ups on legs would not help: see glidecal plan.")
    command = (
        f"{continue_command(plan.path, plan.motion, headless=True)} "
        f"--until {uncertain(reach.further[-1].bound_mm)}"
    )
    return f"{wrapped(f'{sentence} Next, {_set_up_words(reach.further[0])}. To go on:')}\n{command}"


def _set_up_words(set_up: FurtherSetUp) -> str:
    count = len(set_up.legs) * len(set_up.displacements_mm)
    return (
        f"{stand_words(set_up.legs, set_up.station)}, {count} postures in "
        f"{set_up.minutes:.0f} minutes: {uncertain(set_up.bound_mm)} mm expected"
    )
