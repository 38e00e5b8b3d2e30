"""Measuring and replaying in words: what to do, where the session stands, what was taken."""

from __future__ import annotations

from collections.abc import Sequence

from app.measuring.indicators import profile_of
from app.measuring.leg_review import LegReview, LegRow
from app.measuring.opening import Plan
from app.measuring.session import Doubt, TakenStep
from app.measuring.simulated import short_travels
from app.report.schema.readings import ReplayReport
from app.report.text.tables import new_table, signed, table_text, uncertain, wrapped
from calib.observations import LEG_NAMES, conditions
from calib.tripod.geometry import Geometry
from calib.tripod.kinematics import inverse
from calib.tripod.pipeline import command
from drivers.profile import Verified
from protocols.expectation import Movement
from protocols.machine import Instrument, Machine
from protocols.procedure import Procedure, Step, leg_number, posture_name
from protocols.session import Session

MEASURE_HELP = """\
Space, Enter  take: read the indicators, write the readings to disk
U             measure the last step again; old readings stay in the
              record, superseded
B             an earlier step: measure it again, or take that back
S             leave this step or the rest of the leg out, with a reason
A             automatic: take whenever the indicators show a move and stand
              still again; it says where only the key can tell
P             hold: nothing is taken until P again
M             the stand was moved: later readings get a new zero
N             write a note into the record
G             the plot in the place of the table, and back
F10           leave: the session can be continued later

The word in each panel tells moving from standing still. A reading is
on the disk before this screen says that it is taken."""


def _mdi_line(step: Step, machine: Machine) -> str:
    """The line to type at the controller, in the coordinates that it takes."""
    if machine.mdi == "joint":
        position = _joints_mm(step, machine.geometry())
    elif step.position_mm is not None:
        position = dict(zip(LEG_NAMES, step.position_mm, strict=True))
    else:
        position = dict.fromkeys(LEG_NAMES, 0.0) | {step.leg: step.displacement_mm}
    words = " ".join(f"{name.upper()}{value:.3f}" for name, value in position.items())
    return f"G53 G0 {words}"


def _joints_mm(step: Step, geometry: Geometry) -> dict[str, float]:
    """Joint coordinates that the controller commands for this step."""
    if step.position_mm is not None:
        found = inverse(geometry, step.position_mm)
    else:
        leg, axis = leg_number(step.leg), leg_number(step.axes[0])
        found = command(geometry, conditions([leg], [axis], [step.displacement_mm]))[0]
    return dict(zip(LEG_NAMES, found.tolist(), strict=True))


def procedure_sentence(procedure: Procedure, geometry: Geometry, axes: Sequence[str]) -> str:
    """Steps, time and kind of repeats of a procedure."""
    steps = len(procedure.steps(geometry, axes))
    indicators = 1 if procedure.plate else len(axes)
    minutes = procedure.duration_s(geometry, axes) / 60.0
    in_place = procedure.read_in_place(geometry)
    repeats = "Every repeat approaches its posture anew."
    if in_place:
        repeats = f"{in_place} repeats do not leave their posture: they show the indicator only."
    shuffled = ""
    if procedure.random_seed is not None:
        shuffled = f" Order shuffled in each cycle, seed {procedure.random_seed}."
    return (
        f"{procedure.title}. {steps} steps with {indicators} indicator"
        f"{'s' if indicators > 1 else ''}, about {minutes:.0f} minutes. "
        f"{procedure.description} {repeats}{shuffled}"
    )


def travel_text(procedure: Procedure, machine: Machine, instruments: Sequence[Instrument]) -> str:
    """A paragraph for each indicator whose travel may not be enough."""
    return "".join(
        wrapped(
            f"Travel: {one.profile} moves up to {needed_mm:.1f} mm {where}, on a machine within "
            f"its tolerances; it has {one.travel_mm:g} mm. Take one with more travel, or smaller "
            "displacements."
        )
        + "\n\n"
        for one, needed_mm, where in short_travels(procedure, machine, instruments)
    )


def dry_run_text(procedure: Procedure, machine: Machine, instruments: Sequence[Instrument]) -> str:
    """Every step of a procedure with the line to type at the controller."""
    geometry, axes = machine.geometry(), [instrument.axes for instrument in instruments]
    table = new_table("step", "leg", "posture", "cycle", "station", "axes", "controller", left=7)
    for step in procedure.steps(geometry, axes):
        place = (str(step.number), step.leg, step.posture(geometry), str(step.cycle))
        table.add_row(*place, f"{step.station:g}", " ".join(step.axes), _mdi_line(step, machine))
    sentence = wrapped(procedure_sentence(procedure, geometry, axes))
    travel = travel_text(procedure, machine, instruments)
    return f"{sentence}\n\n{travel}{table_text(table)}"


def rehearsal_text(options: str, plan: Plan, ports: Sequence[str]) -> str:
    """How a rehearsal is measured, with these ``options``, and moved."""
    named = zip(plan.instruments, ports, strict=True)
    return (
        f"Measure with: glidecal run {options} "
        + " ".join(f"--indicator {instrument.profile}:{port}" for instrument, port in named)
        + "\nHere Enter moves the machine to the next step, a number and Enter to that step; "
        "Ctrl-C ends."
    )


def rehearsed_text(step: Step, plan: Plan) -> str:
    """Where the machine goes."""
    posture = step.posture(plan.machine.geometry())
    return f"step {step.number}: leg {step.leg.upper()}  {posture}  cycle {step.cycle}"


def check_text(plan: Plan) -> str:
    """What to look at before the first reading."""
    if plan.simulated:
        check = "The machine is simulated; its indicators speak real bytes over real ports."
    else:
        check = "Move each spindle by hand: the right display must follow, and read in mm."
    unverified = [
        instrument.profile
        for instrument in plan.instruments
        if profile_of(instrument).verified is Verified.UNVERIFIED
    ]
    if unverified:
        check += f"\nUNVERIFIED profile: {', '.join(unverified)}. Compare with the display first."
    sentence = procedure_sentence(plan.procedure, plan.machine.geometry(), plan.axes)
    check = travel_text(plan.procedure, plan.machine, plan.instruments) + check
    begin = "Enter continues the session" if plan.continued else "Enter begins the session"
    if plan.continued:
        begin += "; after a break the indicators get a new zero"
    entered = ""
    if plan.before is not None:
        entered = "Verification: the exported offsets must now be in the controller.\n"
    return f"{entered}{plan.machine.name}. {sentence}\n\n{check}\n\n{begin}: {plan.path}"


def progress_text(session: Session, steps: Sequence[Step], mode: str) -> str:
    """Where the session stands, in one line; ``mode`` is the word for who takes the readings."""
    opened = session.opened
    done = len(session.done() | session.skipped.keys())
    name = opened.procedure.name if opened.procedure else ""
    seconds = opened.procedure.seconds_per_step if opened.procedure else 0.0
    remaining_s = round((len(steps) - done) * seconds)
    return (
        f"{opened.machine.name} · {name} · {mode}   {done} of {len(steps)} steps done, "
        f"{remaining_s // 60:02d}:{remaining_s % 60:02d} left"
    )


def taken_text(taken: TakenStep) -> str:
    """What was written to the disk."""
    shown = ", ".join(f"{r.axis.upper()} {signed(r.value_mm, 4)} mm" for r in taken.readings)
    state = "On the disk and questioned" if taken.doubt else "Taken and on the disk"
    return f"{state}, step {taken.step.number}: {shown}"


def step_text(step: Step, session: Session) -> str:
    """Leg, posture and cycle; what to do; what the controller must show."""
    machine = session.opened.machine
    geometry = machine.geometry()
    cycles = session.opened.procedure.cycles if session.opened.procedure else 1
    leg, joints = step.leg.upper(), _joints_mm(step, geometry)
    lines = [
        f"LEG {leg}   {step.posture(geometry)}   cycle {step.cycle} of {cycles}",
        f"Move the tool to {leg} {step.displacement_mm:+.2f} mm; take when the readings stand "
        "still.",
        _mdi_line(step, machine),
        "joints " + "  ".join(f"{name} {value:.3f}" for name, value in joints.items()),
    ]
    if session.is_new_place(step):
        axes = " and ".join(axis.upper() for axis in step.axes)
        at = f"along {axes}, {step.station:.0%} from the tool end."
        lines.insert(1, f"First, at Zero: indicators on leg {leg} {at}")
    elif session.needs_new_zero(step):
        lines.insert(1, "After the break: readings from here on have a zero of their own.")
    return "\n".join(lines)


def leg_table_text(rows: Sequence[LegRow], geometry: Geometry) -> str:
    """The present leg so far: readings minus the Zero of their cycle, in mm.

    Six levels, as many as the program's own procedures have, fit in 80 columns.
    """
    levels = list(dict.fromkeys(level for row in rows for level in row.minus_zero_mm))
    heading = f"{'minus Zero':<11}" + "".join(f"{posture_name(v, geometry):>8}" for v in levels)
    marked = " *kept" if any(row.kept_mm for row in rows) else ""
    lines = [heading + f"{'back at Zero':>13}" + marked]
    for row in rows:
        cells = "".join(
            _cell(row.minus_zero_mm.get(level), 8, kept=level in row.kept_mm) for level in levels
        )
        label = f"{row.axis.upper()}  cycle {row.cycle}" + "*" * (0.0 in row.kept_mm)
        lines.append(f"{label:<11}" + cells + _cell(row.back_at_zero_mm, 13))
    return "\n".join(lines)


def _cell(value: float | None, width: int, *, kept: bool = False) -> str:
    return f"{'' if value is None else signed(value) + '*' * kept:>{width}}"


def _at(displacement_mm: float, position_mm: Sequence[float] | None) -> str:
    if position_mm is not None:
        return ", ".join(f"{part:g}" for part in position_mm)
    return f"{displacement_mm:+.2f}"


def replay_text(report: ReplayReport) -> str:
    """The readings of a session in the order taken, then the averages of those that count."""
    readings = new_table("no", "leg", "axis", "at, mm", "cycle", "mount", "value, mm", "", left=3)
    for r in report.readings:
        state = f"superseded: {r.superseded}" if r.superseded else ""
        place = (str(r.reading), r.leg, r.axis, _at(r.displacement_mm, r.position_mm))
        readings.add_row(*place, str(r.cycle), r.mount, signed(r.value_mm, 4), state)
    averages = new_table("leg", "axis", "station", "at, mm", "mean, mm", "readings", left=2)
    for a in report.averages:
        place = (a.leg, a.axis, f"{a.station:g}", _at(a.displacement_mm, a.position_mm))
        averages.add_row(*place, signed(a.mean_mm, 4), str(a.readings))
    title = f"{report.session}: {len(report.readings)} readings ({report.end})"
    remarks = [wrapped(f"Remark: {remark}") for remark in report.remarks]
    return "\n\n".join([title, *remarks, table_text(readings), "Averages", table_text(averages)])


def question_text(taken: TakenStep, session: Session) -> str:
    """Why readings are questioned: what was read, what was expected."""
    geometry = session.opened.machine.geometry()
    before = posture_name(taken.due[0].before.displacement_mm, geometry)
    posture = taken.step.posture(geometry)
    lines = [f"Step {taken.step.number}, leg {taken.step.leg.upper()} {posture}:"]
    for reading, due in zip(taken.readings, taken.due, strict=True):
        line = f"along {reading.axis.upper()} {signed(reading.value_mm, 4)} mm"
        if taken.doubt is not Doubt.BEYOND:
            line += f", {signed(reading.value_mm - due.before.value_mm, 4)} mm since {before}"
        elif due.is_beyond(reading.value_mm):
            line += f" where {signed(due.mean_mm)} ± {uncertain(due.limit_mm)} mm is expected"
        lines.append(line)
    asked = {
        Doubt.UNCHANGED: f"Unchanged since {before}: did the machine move?",
        Doubt.TOO_SOON: f"So soon after {before} the machine cannot be there: did it move?",
        Doubt.BEYOND: "Other leg, other unit, other direction? Or did the stand move?",
    }
    return "\n".join([*lines, asked[taken.doubt or Doubt.BEYOND]])


MOVED_QUESTION = "Was the stand moved or touched? If so, readings get a new zero from here on."
MOVED_CHOICES = (("no", "1  No: go on as before"), ("moved", "2  Yes: a new zero"))


def question_choices(doubt: Doubt) -> tuple[tuple[str, str], ...]:
    """What can be done about questioned readings."""
    first, last = "Read again here, without moving", "Keep the reading as it is"
    if doubt is not Doubt.BEYOND:
        first, last = "No. It moves now; then take again", "Yes, it moved: keep the reading"
    return (
        ("read", f"1  {first}"),
        ("approach", "2  Leave the posture, come back, and measure it again"),
        ("stand", "3  The stand moved: a new set-up from here, with a zero of its own"),
        ("keep", f"4  {last}"),
    )


ANSWERED = {
    "": "no answer, not kept",
    "read": "read again in place",
    "approach": "approached again",
    "stand": "the stand moved",
    "keep": "kept",
}


def answer_reason(answer: str, taken: TakenStep) -> str:
    """What goes into the record with the answer to a question."""
    pairs = zip(taken.readings, taken.due, strict=True)
    worst_mm = max((r.value_mm - due.mean_mm for r, due in pairs), key=abs)
    return f"{taken.doubt}, {signed(worst_mm, 4)} mm from expected: {ANSWERED[answer]}"


def answered_text(answer: str, step: Step) -> str:
    """What comes next after the answer."""
    if answer == "keep":
        return f"Step {step.number} is kept; the table marks it."
    then = {"approach": "leave the posture, come back, and ", "stand": "with a zero of its own, "}
    return f"Not kept. Step {step.number} is still the next: {then.get(answer, '')}take it again."


def automatic_waits_text(moved: Movement, step: Step, session: Session) -> str:
    """Why the automatic takes nothing though all stand still."""
    posture = step.posture(session.opened.machine.geometry())
    if moved is Movement.UNCHANGED:
        return f"Automatic waits for a move to {posture}: unchanged. If it did move, Space."
    return f"Automatic waits for Space or the button: no reading tells a move to {posture}."


def point_text(step: Step, session: Session) -> str:
    """One step that was measured or skipped, in one line."""
    posture = step.posture(session.opened.machine.geometry())
    where = f"{step.number:>3}  leg {step.leg.upper()}  {posture:<9} cycle {step.cycle}"
    if step.number in session.skipped:
        return f"{where}   skipped: {session.skipped[step.number]}"
    counting = [r for r in session.readings if r.step == step.number]
    shown = counting or [r for r in session.all_readings if r.step == step.number]
    values = "  ".join(f"{r.axis.upper()} {signed(r.value_mm, 4)}" for r in shown[-2:])
    reason = session.superseded.get(shown[-1].reading) if shown and not counting else None
    return f"{where}   {values}" + (f"   superseded: {reason}" if reason else "")


def review_text(review: LegReview) -> str:
    """A leg after its last step: repeatability beside the indicator's, drift, differences."""
    table = new_table("axis", "scatter, mm", "repeats", "stated, mm", "worst return, mm")
    for one in review.axes:
        table.add_row(
            one.axis.upper(),
            _or_none(one.standard_deviation_mm, "no repeats"),
            str(one.degrees_of_freedom),
            _or_none(one.stated_mm, "not stated"),
            "" if one.worst_return_mm is None else signed(one.worst_return_mm, 4),
        )
    measured = new_table("difference", "measured, mm")
    for name, value in review.differences_mm:
        measured.add_row(name, signed(value))
    title = f"Leg {review.leg.upper()} is done. {review_verdict(review)}"
    so_far = f"{len(review.differences_mm)} differences so far:"
    return "\n\n".join([wrapped(title), table_text(table), so_far, table_text(measured)])


WORSE_THAN_STATED = 3.0
"""Scatter of so many times the stated one is worth a word."""


def review_verdict(review: LegReview) -> str:
    """Whether the scatter is what the indicators promise, in one sentence."""
    bad = [
        one.axis.upper()
        for one in review.axes
        if one.stated_mm
        and one.standard_deviation_mm
        and one.standard_deviation_mm > WORSE_THAN_STATED * one.stated_mm
    ]
    if bad:
        return f"Along {' and '.join(bad)} it scatters more than the indicator explains."
    if all(one.standard_deviation_mm is None for one in review.axes):
        return "Without repeats its scatter is not known."
    return "Nothing about its scatter is suspicious."


def _or_none(value: float | None, words: str) -> str:
    return words if value is None else f"{value:.4f}"


def clock_set_text(jump_s: float) -> str:
    """The clock of the computer was set while the session was open."""
    way = "forward" if jump_s > 0.0 else "back"
    return (
        f"The computer's clock was set {way} by {abs(jump_s):.0f} s. It is noted in the record; "
        "times and drift of this session go by another clock."
    )


def slept_text(seconds: float) -> str:
    """The computer was suspended while the session was open."""
    return (
        f"The computer slept for {max(1, round(seconds / 60.0))} min; the session is on hold. "
        "If the stand was touched press M. Press P to measure again."
    )
