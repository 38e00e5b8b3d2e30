"""Measuring and replaying in words: what to do, where the session stands, what was taken."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from shlex import quote

from app.measuring.attended import Press, TakenBy
from app.measuring.doubts import TakenStep
from app.measuring.leg_review import LegRow, leg_rows, positions
from app.measuring.session import GuidedSession
from app.report.schema.readings import ReplayReport
from app.report.text.tables import new_table, paragraphs, signed
from calib.arrays import LEG_NAMES
from calib.errors import sentence
from calib.printable import counted, with_capital
from calib.tripod.geometry import COORDINATES, Geometry
from drivers.profile import Fault
from protocols.expectation import Movement
from protocols.machine import Instrument, Machine
from protocols.motion import commanded_mm, joints_mm
from protocols.procedure import Step, leg_number, position_words, posture_name
from protocols.session import Session


def mdi_line(step: Step, machine: Machine, lift_mm: float = 0.0) -> str:
    """The line to type at the controller, in the coordinates that it takes.

    For the tool lifted off along its axis by ``lift_mm``.
    """
    if lift_mm and step.position_mm is not None:
        parts = zip(LEG_NAMES, step.position_mm, strict=True)
        x, y, z = (mm + lift_mm * (name in step.axes) for name, mm in parts)
        return mdi_line(replace(step, position_mm=(x, y, z)), machine)
    coordinates = zip("XYZ", commanded_mm(step, machine), strict=True)
    return f"G53 G0 {' '.join(f'{name}{value:.3f}' for name, value in coordinates)}"


def progress_text(session: Session, steps: Sequence[Step], mode: str) -> str:
    """Where the session stands, in one line; ``mode`` is the word for who takes the readings."""
    opened = session.opened
    count = len(session.done() | session.skipped.keys())
    name = opened.procedure.name if opened.procedure else ""
    seconds = opened.procedure.seconds_per_step if opened.procedure else 0.0
    remaining_s = round((len(steps) - count) * seconds)
    return (
        f"{opened.machine.name} · {name} · {mode}   {count} of {len(steps)} steps done, "
        f"{remaining_s // 60:02d}:{remaining_s % 60:02d} left"
    )


def taken_text(step_taken: TakenStep) -> str:
    """What was written to the disk."""
    values = ", ".join(f"{r.axis.upper()} {signed(r.value_mm, 4)} mm" for r in step_taken.readings)
    waits = step_taken.questioned == step_taken.readings and step_taken.doubt
    state = "WAIT: on the disk, in question" if waits else "Taken and on the disk"
    return f"{state}, step {step_taken.step.number}: {values}"


def not_taken_text(faults: Sequence[Fault]) -> str:
    """Why readings of a step were not taken."""
    first, *more_faults = (sentence(fault.words) for fault in faults)
    sentences = [first, *map(with_capital, more_faults)]
    return f"Not taken: {' '.join(sentences)}"


WHO_TAKES = {
    TakenBy.HAND: "Move the tool to {to}. When stable, press {{measure.take}}.",
    TakenBy.INDICATORS: "Move the tool to {to}. It is read when stable.",
    TakenBy.CONTROLLER: "The tool goes to {to}, and is read when stable.",
    TakenBy.NOBODY: "The tool goes to {to}.",
}


@lru_cache(maxsize=4)
def visits_of(steps: tuple[Step, ...]) -> dict[int, str]:
    """The cycle of each step by its number, ``end`` for the last Zero of a leg.

    A second visit in one cycle is ``2b``: no two steps have one name.
    """
    last = {step.place: step.number for step in steps}
    names, visits = {}, Counter[tuple[object, ...]]()
    for step in steps:
        visit = (step.place, step.station, step.posture_mm, step.cycle)
        visits[visit] += 1
        again = "" if visits[visit] == 1 else "abcdefghijklmnop"[min(visits[visit], 16) - 1]
        names[step.number] = f"{step.cycle}{again}"
        if again and step.at_zero and step.number == last[step.place]:
            names[step.number] = "end"
    return names


def cycle_words(step: Step, steps: tuple[Step, ...]) -> str:
    """``cycle 2``, ``cycle 2, visit b``, or ``end`` for the last Zero of a leg."""
    name = visits_of(steps).get(step.number, str(step.cycle))
    if name == "end":
        return "end"
    return f"cycle {step.cycle}" + (f", visit {name[-1]}" if name[-1:].isalpha() else "")


def step_name(step: Step, session: Session) -> str:
    """``step 2, leg X MAX, cycle 1``."""
    posture = step.posture(session.opened.machine.geometry())
    posture += f" {step.station:g}" * step.over_plane
    return f"step {step.number}, {step.touched} {posture}, {cycle_words(step, session.steps())}"


def _along_words(step: Step, geometry: Geometry) -> str:
    """How far along the drive of the leg, which need not be along a coordinate."""
    leg, number = step.leg.upper(), leg_number(step.leg)
    if geometry.direction[number] == COORDINATES[number]:
        return f"{leg} {step.displacement_mm:+.2f} mm"
    return f"{step.displacement_mm:+.2f} mm along drive {leg}"


def step_text(step: Step, session: Session, by: TakenBy = TakenBy.HAND) -> str:
    """Leg, posture and cycle; what to do, or who else does it; the position.

    Keys in it are ids of bindings in braces.
    """
    machine = session.opened.machine
    geometry = machine.geometry()
    cycles = session.opened.procedure.cycles if session.opened.procedure else 1
    leg, joints = step.leg.upper(), joints_mm(step, geometry)
    plate = session.opened.procedure.plate if session.opened.procedure else None
    of_tool = step.leg == "tool"
    to = "the position" if of_tool else _along_words(step, geometry)
    lines = [
        f"{step.touched.upper()}   {step.posture(geometry)}   "
        + cycle_words(step, session.steps())
        .replace("end", f"end of cycle {step.cycle}")
        .replace(f"cycle {step.cycle}", f"cycle {step.cycle} of {cycles}"),
        WHO_TAKES[by].format(to=to),
        mdi_line(step, machine),
        "joints " + "  ".join(f"{name} {value:.3f}" for name, value in joints.items()),
    ]
    if step.over_plane:
        at = _from_tool_end(step, geometry)
        lines[1] = f"Move the tool to {to}. Slide the stand to"
        last = session.readings[-1] if session.readings and not session.is_new_place(step) else None
        if last and last.posture_mm == step.posture_mm:
            lines[1] = "The machine stays. Slide the stand to"
        lines[1] += f" {at}; " + ("{measure.take}." if by is TakenBy.HAND else "it is read.")
    if plate is not None and plate.lift_mm:
        lines[1] = f"Lift off by {plate.lift_mm:g} mm, go above the position, come down; take."
        lines.insert(2, mdi_line(step, machine, plate.lift_mm))
    if session.is_new_place(step) or not session.has_readings_at(step):
        axis_numbers = zip(step.axes, step.indicators, strict=True)
        axes = " and ".join(f"{axis.upper()} ({k + 1})" for axis, k in axis_numbers)
        first = f"indicators on leg {leg} along {axes}, {_from_tool_end(step, geometry)}"
        if step.over_plane:
            first = f"stand on the plane under leg {leg}, indicator along {axes}"
        if by is not TakenBy.NOBODY:
            first += ". {measure.where} shows it"
        if of_tool:
            first = f"indicator at the tool, plate under it; + is towards +{step.axes[0].upper()}"
        if of_tool and any(
            instrument.profile == "probe" for instrument in session.opened.instruments
        ):
            first = "the tool, or a probe beside it, comes down on the plate"
        lines.insert(1, f"First, at Zero: {first}.")
    elif session.needs_new_zero(step):
        lines.insert(1, _new_zero_words(session))
    return "\n".join(lines)


def _new_zero_words(session: Session) -> str:
    if not session.last_is_alone:
        return "After the break the readings have a new zero."
    return (
        "After the break a new zero; the posture before is lost.\n{measure.earlier} takes it again."
    )


def _from_tool_end(step: Step, geometry: Geometry) -> str:
    at_mm = step.station * geometry.leg_length_mm[leg_number(step.leg)]
    return f"{at_mm:.0f} mm from its tool end ({step.station:.0%})"


def set_up_text(session: Session, step: Step, instruments: Sequence[Instrument | None]) -> str:
    """Where each indicator stands for a step, to be read beside the picture of it."""
    at = _from_tool_end(step, session.opened.machine.geometry())
    lines = [f"Bar {step.leg.upper()}, {at}. Set up with the machine at Zero."]
    if step.over_plane:
        lines = [f"Bar {step.leg.upper()}, {at}. The stand slides on the plane."]
    have = [*instruments, None, None]
    along = [(axis, have[k]) for axis, k in zip(step.axes, step.indicators, strict=True)]
    for number, (axis, indicator) in enumerate(along, start=step.first + 1):
        side = "−" if indicator and indicator.pushed_in == "smaller" else "+"
        name = f"{indicator.profile} {indicator.port}: " if indicator else ""
        lines.append(f"{number}  {name}along {axis.upper()}, on the {side}{axis.upper()} side")
    sure = all(indicator and indicator.pushed_in for _, indicator in along)
    usual = "" if sure else " On the side named it does, if it grows when the spindle is pushed in."
    return "\n".join([*lines, f"A reading must grow when the bar moves towards +.{usual}"])


def leg_table_text(
    rows: Sequence[LegRow],
    levels_mm: Sequence[float],
    geometry: Geometry,
    *,
    over_plane: bool = False,
) -> str:
    """The present leg so far: readings minus the Zero of their cycle, in mm.

    Over a plane the far end minus the near one. Columns in the order of ``levels_mm``, whatever was
    measured again. Six levels, as many as the program's own procedures have, fit in 78 columns.
    """
    measured = [level for row in rows for level in row.minus_zero_mm]
    levels = [v for v in dict.fromkeys([*levels_mm, *measured]) if v or over_plane]
    quantity = "far − near" if over_plane else "minus Zero"
    heading = f"{quantity:<11}" + "".join(f"{posture_name(v, geometry):>8}" for v in levels)
    marked = " *kept" if any(row.kept_mm for row in rows) else ""
    lines = [heading + f"{'back at Zero':>13}" + marked]
    for row in rows:
        cells = "".join(
            _cell(row.minus_zero_mm.get(level), 8, used=level in row.kept_mm) for level in levels
        )
        label = f"{row.axis.upper()}  cycle {row.cycle}" + "*" * (0.0 in row.kept_mm)
        lines.append(f"{label:<11}" + cells + _cell(row.back_at_zero_mm, 13))
    return "\n".join(lines)


PLATE_POSITIONS, PLATE_CYCLES = 4, 5
"""So many positions and cycles are shown; with heading and return there is room for six lines."""


LINES_THERE = 6
"""Of the table of readings on the least screen."""


def so_far_text(
    session: Session, steps: Sequence[Step], step: Step, lines_there: int = LINES_THERE
) -> str:
    """What was read where a step is, minus the Zero of its cycle, in mm.

    Of a leg the last cycles that fit; without lines as on the least screen.
    """
    rows, geometry = leg_rows(session, step), session.opened.machine.geometry()
    if step.position_mm is None:
        cycles = max(1, ((lines_there or LINES_THERE) - 1) // len(step.axes))
        along = [[row for row in rows if row.axis == axis] for axis in step.axes]
        rows = [row for rows_of_axis in along for row in rows_of_axis[-cycles:]]
        here = [s for s in steps if (s.leg, s.over_plane) == (step.leg, step.over_plane)]
        levels_mm = [s.displacement_mm for s in here]
        return leg_table_text(rows, levels_mm, geometry, over_plane=step.over_plane)
    places, last_rows = positions(session), rows[-PLATE_CYCLES:]
    first = min(places.index(step.position_mm) - 2, len(places) - PLATE_POSITIONS)
    heading = "".join(f"{f'cycle {row.cycle}':>10}" for row in last_rows)
    marked = "  *kept" if any(row.kept_mm for row in last_rows) else ""
    lines = [f"{'minus Zero':<24}{heading}{marked}"]
    for k in range(max(1, first), len(places))[:PLATE_POSITIONS]:  # the first place is Zero itself
        values = (_cell(row.minus_zero_mm.get(k), 10, used=k in row.kept_mm) for row in last_rows)
        lines.append(f"{position_words(places[k]):<24}{''.join(values)}")
    back = "".join(_cell(row.back_at_zero_mm, 10) for row in last_rows)
    return "\n".join([*lines, f"{'back at Zero':<24}{back}"])


def _cell(value: float | None, width: int, *, used: bool = False) -> str:
    return f"{'' if value is None else signed(value) + '*' * used:>{width}}"


def _at(displacement_mm: float, position_mm: Sequence[float] | None) -> str:
    if position_mm is not None:
        return ", ".join(f"{part:g}" for part in position_mm)
    return f"{displacement_mm:+.2f}"


def replay_text(report: ReplayReport) -> str:
    """The readings of a session in the order taken, then the averages of those that count."""
    readings = new_table(
        "no", "leg", "axis", "at, mm", "cycle", "mount", "value, mm", "", left_columns=3
    )
    stations: dict[str, set[float]] = {}
    for r in report.readings:
        stations.setdefault(r.mount, set()).add(r.station)
    for r in report.readings:
        state = f"superseded: {r.superseded}" if r.superseded else ""
        place = (str(r.reading), r.leg, r.axis, _at(r.displacement_mm, r.position_mm))
        mount = f"{r.mount} {r.station:g}" if len(stations[r.mount]) > 1 else r.mount
        readings.add_row(*place, str(r.cycle), mount, signed(r.value_mm, 4), state)
    averages = new_table("leg", "axis", "station", "at, mm", "mean, mm", "readings", left_columns=2)
    for a in report.averages:
        place = (a.leg, a.axis, f"{a.station:g}", _at(a.displacement_mm, a.position_mm))
        averages.add_row(*place, signed(a.mean_mm, 4), str(a.readings))
    return paragraphs(
        [f"{report.session}: {counted(len(report.readings), 'reading')} ({report.end})"],
        *(f"Remark: {remark}" for remark in report.remarks),
        readings,
        "Averages",
        averages,
    )


STEPS_THERE = 4
"""Of the list of steps on the least screen."""


def steps_text(session: Session, steps: Sequence[Step], now: Step | None, rows: int) -> str:
    """A line for each step around the present one, in so many rows: + done, - skipped, > now."""
    geometry, visits = session.opened.machine.geometry(), visits_of(tuple(steps))
    marks = dict.fromkeys(session.skipped, "-") | dict.fromkeys(session.done(), "+")
    if now is not None:
        marks[now.number] = ">"
    height, at = max(rows, STEPS_THERE), (now.number if now else len(steps)) - 1
    first = max(0, min(at - height // 2, len(steps) - height))
    return "\n".join(
        f"{marks.get(s.number, ' ')} {s.number:>3} {step_in_list(s, geometry, visits[s.number])}"
        for s in steps[first : first + height]
    )


def step_in_list(step: Step, geometry: Geometry, visit: str) -> str:
    """Leg, posture and ``visit`` of a step, over a plane station for cycle; the list is narrow.

    A position stands alone, in whole mm.
    """
    if step.position_mm is None:
        posture = step.posture(geometry)
        if visit[1:].isalpha():
            posture = posture.removesuffix(" mm")
        return f"{step.leg.upper()} {posture} {f'{step.station:g}' if step.over_plane else visit}"
    return "ZERO" if step.at_zero else " ".join(f"{mm:.0f}" for mm in step.position_mm)


def paused_text(guided: GuidedSession, *, headless: bool = False) -> str:
    """How much of a session that was left is measured, and the command that continues it."""
    count, steps = len(guided.session.done()), len(guided.steps)
    command = continue_command(guided.path, guided.motion, headless=headless)
    return (
        f"Session paused after {count} of {steps} steps; every reading taken is on the disk. "
        f"Continue with: {command}"
    )


def left_text(guided: GuidedSession) -> str:
    """What to know of a session that was left: whether its machine moves, how to go on."""
    warning = f"{guided.mover.why}\n" if guided.mover and guided.mover.line.not_stopped else ""
    return warning + paused_text(guided)


def continue_command(path: Path, motion: str | None, *, headless: bool) -> str:
    """The command that continues a session, with the controller that moves its machine."""
    screen = " --headless" if headless else ""
    controller = f" --motion {quote(motion)}" if motion else ""
    return f"glidecal run{screen} --continue {quote(str(path))}{controller}"


def automatic_waits_text(moved: Movement, step: Step, session: Session) -> str:
    """Why the automatic takes nothing though all stand still."""
    posture = step.posture(session.opened.machine.geometry())
    if moved is Movement.UNCHANGED:
        move = f"WAIT: no change, so no move to {posture} is seen."
        return move + " If it moved, {measure.take} takes it."
    move = f"WAIT: readings cannot show the move to {posture}: press"
    return move + " {measure.take} or the button at the indicator."


PRESSED = {
    Press.ON_HOLD: "WAIT: on hold, nothing is taken. Press {goes_on} to continue.",
    Press.LACKS_VALUE: "WAIT: nothing is taken while an indicator of the step gives no value.",
    Press.MOVES: "WAIT: the readings move. Press {measure.take} again to take them anyway.",
}
SETTLED = "The readings are stable now: {measure.take} takes them."
ON_HOLD = "On hold. Press {goes_on} to continue."
CONTINUED = "The session continues."
COMPUTING = "Every reading is on the disk. Computing the result …"


def point_text(step: Step, session: Session) -> str:
    """One step that was measured or skipped, in one line."""
    posture = step.posture(session.opened.machine.geometry())
    posture += f" {step.station:g}" * step.over_plane
    cycle = cycle_words(step, session.steps())
    where = f"step {step.number:>3}  {step.touched}  {posture:<9} {cycle}"
    if step.number in session.skipped:
        return f"{where}   skipped: {session.skipped[step.number]}"
    counting = [r for r in session.readings if r.step == step.number]
    readings = counting or [r for r in session.all_readings if r.step == step.number]
    latest = readings[-len(step.axes) :]  # of what was taken again and again
    values = "  ".join(f"{r.axis.upper()} {signed(r.value_mm, 4)}" for r in latest)
    reason = session.superseded.get(readings[-1].reading) if readings and not counting else None
    return f"{where}   {values}" + (f"   superseded: {reason}" if reason else "")


def clock_set_text(jump_s: float) -> str:
    """The clock of the computer was set while the session was open."""
    way = "forward" if jump_s > 0.0 else "back"
    return (
        f"The computer's clock was set {way} by {abs(jump_s):.0f} s. The record notes it; "
        "times and drift of this session use another clock."
    )


def slept_text(seconds: float) -> str:
    """The computer was suspended while the session was open."""
    return (
        f"The computer slept for {max(1, round(seconds / 60.0))} min; the session is on hold. "
        f"If the stand was touched, press {{measure.remount}}. Then press {{goes_on}} to continue."
    )
