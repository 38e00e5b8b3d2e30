"""Measuring and replaying in words: what to do, where the session stands, what was taken."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from app.guided import Taken
from app.indicators import profile_of
from app.leg_table import LegRow
from app.opening import Plan
from app.wording.tables import new_table, signed, table_text, wrapped
from calib.observations import LEG_NAMES, conditions
from calib.orthoglide.geometry import Geometry
from calib.orthoglide.pipeline import command
from drivers.profile import Verified
from protocols.machine import Instrument
from protocols.procedure import Procedure, Step, leg_number, posture_name
from protocols.session import Session

MEASURE_HELP = """\
Space, Enter  take: read the indicators, write the readings to disk
U             measure the last step again; old readings stay in the
              record, superseded
A             automatic: take whenever all indicators stand still
M             the stand was moved: later readings get a new zero
N             write a note into the record
F10           pause: the session can be continued later

The word in each panel tells moving from standing still. A reading is
on the disk before this screen says that it is taken."""


def instruction(step: Step) -> str:
    """What to do now, in one sentence."""
    return (
        f"Move the tool to {step.leg.upper()} {step.displacement_mm:+.2f} mm; "
        "take when the readings stand still."
    )


def set_up(step: Step) -> str:
    """How to mount the stand for the leg of this step."""
    axes = " and ".join(axis.upper() for axis in step.axes)
    return (
        f"First, at Zero: indicators on leg {step.leg.upper()} along {axes}, "
        f"{step.station:.0%} from the tool end."
    )


def mdi_line(step: Step) -> str:
    """The line to type at the controller, in tool coordinates."""
    position = dict.fromkeys(LEG_NAMES, 0.0) | {step.leg: step.displacement_mm}
    words = " ".join(f"{name.upper()}{value:.3f}" for name, value in position.items())
    return f"G53 G0 {words}"


def joints_text(step: Step, geometry: Geometry) -> str:
    """Joint coordinates that the controller commands for this step."""
    one = conditions([leg_number(step.leg)], [leg_number(step.axes[0])], [step.displacement_mm])
    joints = command(geometry, one)[0]
    return "joints " + "  ".join(f"{n} {v:.3f}" for n, v in zip(LEG_NAMES, joints, strict=True))


def procedure_sentence(procedure: Procedure, geometry: Geometry, axes: Sequence[str]) -> str:
    """Steps and time of a procedure in one sentence."""
    steps = len(procedure.steps(geometry, axes))
    minutes = procedure.duration_s(geometry, axes) / 60.0
    return (
        f"{procedure.title}. {steps} steps with {len(axes)} indicator"
        f"{'s' if len(axes) > 1 else ''}, about {minutes:.0f} minutes. {procedure.description}"
    )


def dry_run_text(procedure: Procedure, geometry: Geometry, axes: Sequence[str]) -> str:
    """Every step of a procedure with the line to type at the controller."""
    table = new_table("step", "leg", "posture", "cycle", "station", "axes", "controller", left=7)
    for step in procedure.steps(geometry, axes):
        place = (str(step.number), step.leg, step.posture(geometry), str(step.cycle))
        table.add_row(*place, f"{step.station:g}", " ".join(step.axes), mdi_line(step))
    sentence = wrapped(procedure_sentence(procedure, geometry, axes))
    return f"{sentence}\n\n{table_text(table)}"


def check_text(plan: Plan, *, continued: bool) -> str:
    """What to look at before the first reading."""
    if plan.simulated:
        check = "The machine is simulated; its indicators speak real bytes over real ports."
    else:
        check = "Move each spindle by hand: the right display must follow, and read in mm."
    unverified = [i.profile for i in plan.instruments if not _is_verified(i)]
    if unverified:
        check += f"\nUNVERIFIED profile: {', '.join(unverified)}. Compare with the display first."
    sentence = procedure_sentence(plan.procedure, plan.machine.geometry(), plan.axes)
    begin = "Enter continues the session" if continued else "Enter begins the session"
    if continued:
        begin += "; after a break the indicators get a new zero"
    entered = ""
    if plan.before is not None:
        entered = "Verification: the exported offsets must now be in the controller.\n"
    return f"{entered}{plan.machine.name}. {sentence}\n\n{check}\n\n{begin}: {plan.path}"


def _is_verified(instrument: Instrument) -> bool:
    return profile_of(instrument).verified is not Verified.UNVERIFIED


def progress_text(session: Session, steps: Sequence[Step], *, automatic: bool) -> str:
    """Where the session stands, in one line."""
    opened = session.opened
    done = len(session.done())
    name = opened.procedure.name if opened.procedure else ""
    seconds = opened.procedure.seconds_per_step if opened.procedure else 0.0
    left = round((len(steps) - done) * seconds)
    mode = "automatic" if automatic else "recording"
    return (
        f"{opened.machine.name} · {name} · {mode}   {done} of {len(steps)} steps done, "
        f"{left // 60:02d}:{left % 60:02d} left"
    )


def taken_text(taken: Taken) -> str:
    """What was written to the disk."""
    shown = ", ".join(f"{r.axis.upper()} {signed(r.value_mm, 4)} mm" for r in taken.readings)
    return f"Taken and on the disk, step {taken.step.number}: {shown}"


def step_text(step: Step, geometry: Geometry, session: Session) -> str:
    """Leg, posture and cycle; what to do; what the controller must show."""
    cycles = session.opened.procedure.cycles if session.opened.procedure else 1
    where = f"LEG {step.leg.upper()}   {step.posture(geometry)}   cycle {step.cycle} of {cycles}"
    lines = [where, instruction(step), mdi_line(step), joints_text(step, geometry)]
    if session.is_new_place(step):
        lines.insert(1, set_up(step))
    elif session.needs_new_zero(step):
        lines.insert(1, "After the break: readings from here on have a zero of their own.")
    return "\n".join(lines)


def leg_table_text(rows: Sequence[LegRow], geometry: Geometry) -> str:
    """The present leg so far: readings minus the Zero of their cycle, in mm."""
    levels = list(dict.fromkeys(level for row in rows for level in row.minus_zero_mm))
    heading = f"{'minus Zero':<12}" + "".join(f"{posture_name(v, geometry):>9}" for v in levels)
    lines = [heading + f"{'back at Zero':>14}"]
    for row in rows:
        cells = "".join(_cell(row.minus_zero_mm.get(level), 9) for level in levels)
        lines.append(
            f"{row.axis.upper()}  cycle {row.cycle:<3}" + cells + _cell(row.back_at_zero_mm, 14)
        )
    return "\n".join(lines)


def _cell(value: float | None, width: int) -> str:
    return f"{'' if value is None else signed(value):>{width}}"


def replay_text(document: dict[str, Any]) -> str:
    """The readings of a session in the order taken, then the averages of those that count."""
    readings = new_table("no", "leg", "axis", "at, mm", "cycle", "mount", "value, mm", "", left=3)
    for r in document["readings"]:
        state = f"superseded: {r['superseded']}" if r["superseded"] else ""
        place = (str(r["reading"]), r["leg"], r["axis"], f"{r['displacement_mm']:+.2f}")
        readings.add_row(*place, str(r["cycle"]), r["mount"], signed(r["value_mm"], 4), state)
    averages = new_table("leg", "axis", "station", "at, mm", "mean, mm", "readings", left=2)
    for a in document["averages"]:
        place = (a["leg"], a["axis"], f"{a['station']:g}", f"{a['displacement_mm']:+.2f}")
        averages.add_row(*place, signed(a["mean_mm"], 4), str(a["readings"]))
    title = f"{document['session']}: {len(document['readings'])} readings ({document['end']})"
    remarks = [wrapped(f"Remark: {remark}") for remark in document["remarks"]]
    return "\n\n".join([title, *remarks, table_text(readings), "Averages", table_text(averages)])
