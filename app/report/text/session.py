"""Measuring and replaying in words: what to do, where the session stands, what was taken."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from shlex import quote

from app.measuring.leg_review import LegReview, LegRow, Usual, leg_rows, positions
from app.measuring.session import Doubt, GuidedSession, TakenStep
from app.report.schema.readings import ReplayReport
from app.report.text.tables import new_table, paragraphs, signed, uncertain
from calib.arrays import LEG_NAMES
from calib.errors import sentence
from calib.tripod.geometry import Geometry
from protocols.expectation import Movement
from protocols.machine import Instrument, Machine
from protocols.motion import joints_mm, told_mm
from protocols.procedure import (
    Step,
    leg_number,
    position_words,
    posture_name,
    posture_words,
)
from protocols.session import Session

KeyWords = Callable[[str], str]
"""The key in force for the id of a binding, as a person calls it."""

MEASURE_KEYS = (
    (("measure.take", "measure.take-too"), "take: read the indicators, write the readings to disk"),
    (("measure.repeat",), "measure the last step again; its readings stay, superseded"),
    (("measure.earlier",), "an earlier step: measure it again, or take that back"),
    (("measure.skip",), "leave this step or the rest of the leg out, with a reason"),
    (("measure.automatic",), "automatic: take when the readings have moved and rest again"),
    (("measure.hold",), "hold: nothing is taken until the same key again"),
    (("measure.remount",), "the stand was moved: later readings get a new zero"),
    (("measure.note",), "write a note into the record"),
    (("measure.where",), "where: leg, stand and indicators as a picture"),
    (("measure.plot",), "the plot, larger strip charts, and back to the table"),
    (("measure.port",), "an indicator is at another port now: choose it"),
    (("measure.go",), "go: the machine moves; every key but that of the view stops it"),
    (("measure.home", "measure.leave"), "pause the session: to the home screen, or quit"),
)
"""Ids of bindings and what they do, in the order of the help."""

MEASURE_END = """\
Each panel says whether its reading moves or is stable. A reading is on
the disk before this screen says that it is taken.

Below the number: the last seconds. The figures beside them are the
height and the width of the chart; between its dotted lines readings rest."""


def measure_help_text(key: KeyWords, without: str) -> str:
    """What each key does while measuring, by the keys that are in force, ``without`` one id."""
    rows = [(", ".join(map(key, ids)), words) for ids, words in MEASURE_KEYS if without not in ids]
    width = max(len(keys) for keys, _ in rows) + 2
    return paragraphs([f"{keys:<{width}}{words}" for keys, words in rows], MEASURE_END)


def mdi_line(step: Step, machine: Machine, lift_mm: float = 0.0) -> str:
    """The line to type at the controller, in the coordinates that it takes.

    For the tool lifted off along its axis by ``lift_mm``.
    """
    if lift_mm and step.position_mm is not None:
        parts = zip(LEG_NAMES, step.position_mm, strict=True)
        x, y, z = (mm + lift_mm * (name in step.axes) for name, mm in parts)
        return mdi_line(replace(step, position_mm=(x, y, z)), machine)
    told = zip("XYZ", told_mm(step, machine), strict=True)
    return f"G53 G0 {' '.join(f'{name}{value:.3f}' for name, value in told)}"


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
    waits = taken.questioned == taken.readings and taken.doubt
    state = "WAIT: on the disk, in question" if waits else "Taken and on the disk"
    return f"{state}, step {taken.step.number}: {shown}"


class TakenBy(StrEnum):
    """Who moves the machine and takes the readings of a step."""

    HAND = "by hand"
    INDICATORS = "automatic"
    CONTROLLER = "a controller"
    NOBODY = "a replay"


WHO_TAKES = {
    TakenBy.HAND: "Move the tool to {to}. When stable, press {{measure.take}}.",
    TakenBy.INDICATORS: "Move the tool to {to}. It is read when stable.",
    TakenBy.CONTROLLER: "The tool goes to {to}, and is read when stable.",
    TakenBy.NOBODY: "The tool goes to {to}.",
}


@lru_cache(maxsize=4)
def visits_of(steps: tuple[Step, ...]) -> dict[int, str]:
    """For the number of each step its cycle, ``end`` for the last Zero of a leg.

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


def step_text(step: Step, session: Session, by: TakenBy = TakenBy.HAND) -> str:
    """Leg, posture and cycle; what to do, or who else does it; the position.

    Keys in it are ids of bindings in braces.
    """
    machine = session.opened.machine
    geometry = machine.geometry()
    cycles = session.opened.procedure.cycles if session.opened.procedure else 1
    leg, joints = step.leg.upper(), joints_mm(step, geometry)
    plate = session.opened.procedure.plate if session.opened.procedure else None
    to = f"{leg} {step.displacement_mm:+.2f} mm" if plate is None else "the position"
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
    if session.is_new_place(step) or not session.was_read(step):
        read = zip(step.axes, step.indicators, strict=True)
        axes = " and ".join(f"{axis.upper()} ({k + 1})" for axis, k in read)
        first = f"indicators on leg {leg} along {axes}, {_from_tool_end(step, geometry)}"
        if step.over_plane:
            first = f"stand on the plane under leg {leg}, indicator along {axes}"
        if by is not TakenBy.NOBODY:
            first += ". {measure.where} shows it"
        if plate is not None:
            first = f"indicator at the tool, plate under it; + is towards +{step.axes[0].upper()}"
        lines.insert(1, f"First, at Zero: {first}.")
    elif session.needs_new_zero(step):
        lines.insert(1, "After the break the readings have a new zero.")
    return "\n".join(lines)


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
    known = [(axis, have[k]) for axis, k in zip(step.axes, step.indicators, strict=True)]
    for number, (axis, one) in enumerate(known, start=step.first + 1):
        side = "−" if one and one.pushed_in == "smaller" else "+"
        name = f"{one.profile} {one.port}: " if one else ""
        lines.append(f"{number}  {name}along {axis.upper()}, on the {side}{axis.upper()} side")
    sure = all(one and one.pushed_in for _, one in known)
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
    measured again. Six levels, as many as the program's own procedures have, fit in 80 columns.
    """
    measured = [level for row in rows for level in row.minus_zero_mm]
    levels = [v for v in dict.fromkeys([*levels_mm, *measured]) if v or over_plane]
    what = "far − near" if over_plane else "minus Zero"
    heading = f"{what:<11}" + "".join(f"{posture_name(v, geometry):>8}" for v in levels)
    marked = " *kept" if any(row.kept_mm for row in rows) else ""
    lines = [heading + f"{'back at Zero':>13}" + marked]
    for row in rows:
        cells = "".join(
            _cell(row.minus_zero_mm.get(level), 8, kept=level in row.kept_mm) for level in levels
        )
        label = f"{row.axis.upper()}  cycle {row.cycle}" + "*" * (0.0 in row.kept_mm)
        lines.append(f"{label:<11}" + cells + _cell(row.back_at_zero_mm, 13))
    return "\n".join(lines)


PLATE_POSITIONS, PLATE_CYCLES = 4, 5
"""So many positions and cycles are shown; with heading and return there is room for six lines."""


def so_far_text(session: Session, steps: Sequence[Step], step: Step) -> str:
    """What was read where a step is, minus the Zero of its cycle, in mm."""
    rows, geometry = leg_rows(session, step), session.opened.machine.geometry()
    if step.position_mm is None:
        here = [one for one in steps if one.leg == step.leg and one.over_plane == step.over_plane]
        levels_mm = [one.displacement_mm for one in here]
        return leg_table_text(rows, levels_mm, geometry, over_plane=step.over_plane)
    places, shown = positions(session), rows[-PLATE_CYCLES:]
    first = min(places.index(step.position_mm) - 2, len(places) - PLATE_POSITIONS)
    heading = "".join(f"{f'cycle {row.cycle}':>10}" for row in shown)
    marked = "  *kept" if any(row.kept_mm for row in shown) else ""
    lines = [f"{'minus Zero':<24}{heading}{marked}"]
    for k in range(max(1, first), len(places))[:PLATE_POSITIONS]:  # the first place is Zero itself
        values = (_cell(row.minus_zero_mm.get(k), 10, kept=k in row.kept_mm) for row in shown)
        lines.append(f"{position_words(places[k]):<24}{''.join(values)}")
    back = "".join(_cell(row.back_at_zero_mm, 10) for row in shown)
    return "\n".join([*lines, f"{'back at Zero':<24}{back}"])


def _cell(value: float | None, width: int, *, kept: bool = False) -> str:
    return f"{'' if value is None else signed(value) + '*' * kept:>{width}}"


def _at(displacement_mm: float, position_mm: Sequence[float] | None) -> str:
    if position_mm is not None:
        return ", ".join(f"{part:g}" for part in position_mm)
    return f"{displacement_mm:+.2f}"


def replay_text(report: ReplayReport) -> str:
    """The readings of a session in the order taken, then the averages of those that count."""
    readings = new_table("no", "leg", "axis", "at, mm", "cycle", "mount", "value, mm", "", left=3)
    stations: dict[str, set[float]] = {}
    for r in report.readings:
        stations.setdefault(r.mount, set()).add(r.station)
    for r in report.readings:
        state = f"superseded: {r.superseded}" if r.superseded else ""
        place = (str(r.reading), r.leg, r.axis, _at(r.displacement_mm, r.position_mm))
        mount = f"{r.mount} {r.station:g}" if len(stations[r.mount]) > 1 else r.mount
        readings.add_row(*place, str(r.cycle), mount, signed(r.value_mm, 4), state)
    averages = new_table("leg", "axis", "station", "at, mm", "mean, mm", "readings", left=2)
    for a in report.averages:
        place = (a.leg, a.axis, f"{a.station:g}", _at(a.displacement_mm, a.position_mm))
        averages.add_row(*place, signed(a.mean_mm, 4), str(a.readings))
    return paragraphs(
        [f"{report.session}: {len(report.readings)} readings ({report.end})"],
        *(f"Remark: {remark}" for remark in report.remarks),
        readings,
        "Averages",
        averages,
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


def question_text(taken: TakenStep, session: Session) -> str:
    """Why readings are questioned: what was read, what was expected, what its repeats show."""
    rows, odd = _repeat_rows(taken, session), taken.doubt is Doubt.ODD
    if taken.earlier:
        other = step_name(session.steps()[(taken.earlier[0].step or 1) - 1], session)
    if odd:
        agree = "The others agree with each other. Was the machine in another posture then?"
        return "\n".join([f"The odd one is {other}:", *rows, agree])
    if taken.doubt is Doubt.REPEATS:
        same_zero = len({r.mount for r in (*taken.readings, *taken.earlier)}) <= len(taken.readings)
        zeros = [] if same_zero else ["Each set-up has a zero of its own: compare from there."]
        first = f"Step {taken.step.number} does not agree with {other}:"
        asked = "Which of these two is wrong? Look at posture, unit and sign now."
        return "\n".join([first, *rows, *zeros, asked])
    name = step_name(taken.step, session)
    lines = [f"{name[0].upper()}{name[1:]}:", *_off_lines(taken, session)]
    if len(rows) > 2:  # a heading and more than the step itself
        lines += ["Its repeats agree with each other:", *rows]
    if _same_again(taken, session):
        lines.append("It shows the same again. If all is right now, the stand has moved.")
        return "\n".join(lines)
    return "\n".join([*lines, _asked(taken, session)])


def _off_lines(taken: TakenStep, session: Session) -> list[str]:
    """For each axis what was read, and how it is off."""
    before = _before(taken, session)
    shown = [f"along {r.axis.upper()} {signed(r.value_mm, 4)} mm" for r in taken.readings]
    if not taken.due:
        return shown
    lines = []
    for line, reading, due in zip(shown, taken.readings, taken.due, strict=True):
        if taken.doubt is not Doubt.BEYOND:
            line += f", {signed(reading.value_mm - due.before.value_mm, 4)} mm since {before}"
        elif due.is_beyond(reading.value_mm):
            line += f" where {signed(due.mean_mm)} ± {uncertain(due.limit_mm)} mm is expected"
        lines.append(line)
    return lines


def _before(taken: TakenStep, session: Session) -> str:
    """The posture before the step."""
    if not taken.due:
        return ""
    before = taken.due[0].before
    posture = posture_words(before.posture_mm, session.opened.machine.geometry())
    return f"{posture} {before.station:g}" if taken.step.over_plane else posture


def _asked(taken: TakenStep, session: Session) -> str:
    """The question itself."""
    before, mover = _before(taken, session), "the machine"
    if taken.step.over_plane:
        mover = "machine or stand"
    if taken.doubt is Doubt.STAND:
        last = step_name(session.steps()[(taken.earlier[0].step or 1) - 1], session)
        return f"Unchanged since {last}: was the stand set up anew, at {taken.step.touched}?"
    asked = {
        Doubt.UNCHANGED: f"Unchanged since {before}: did {mover} move?",
        Doubt.TOO_SOON: f"So soon after {before} the machine cannot be there: did it move?",
    }
    beyond = f"Other {'position' if taken.step.position_mm else 'leg'}, other unit, other direction"
    return asked.get(taken.doubt or Doubt.BEYOND, f"{beyond}? Or did the stand move?")


def _repeat_rows(taken: TakenStep, session: Session) -> list[str]:
    """The readings of this posture on this leg, a row a step, under a heading of the axes."""
    now, superseded = taken.readings[0], session.superseded
    asked = {r.reading for r in (*taken.readings, *taken.earlier)}
    shown = [
        r
        for r in session.all_readings
        if (r.leg, r.station, r.posture_mm) == (now.leg, now.station, now.posture_mm)
        and (r.reading in asked or r.reading not in superseded)
    ]
    axes = taken.step.axes
    heading = f"{'':<24}" + "".join(f"{f'along {axis.upper()}, mm':>14}" for axis in axes)
    rows = [heading]
    for number, of_step in groupby(sorted(shown, key=lambda r: r.step or 0), lambda r: r.step):
        values = {r.axis: r.value_mm for r in of_step}
        step = session.steps()[(number or 1) - 1]
        name = f"step {number}, {cycle_words(step, session.steps())}"
        name += " (now)" if number == taken.step.number else ""
        cells = "".join(f"{signed(values[a], 4) if a in values else '':>14}" for a in axes)
        odd = "  odd" if taken.doubt is Doubt.ODD and number == taken.earlier[0].step else ""
        rows.append(f"{name:<24}{cells}{odd}")
    return rows


def _same_again(taken: TakenStep, session: Session) -> bool:
    """Whether the step shows what it showed when it was questioned before, and was not kept."""
    if taken.doubt is not Doubt.BEYOND or taken.earlier:
        return False
    now = {r.axis: r for r in taken.readings}
    before = {
        r.axis: r
        for r in session.all_readings
        if r.step == taken.step.number and r.reading < taken.readings[0].reading
        if r.mount == now[r.axis].mount
    }
    limit_mm = session.opened.procedure.repeat_limit_mm if session.opened.procedure else 0.0
    return before.keys() == now.keys() and all(
        abs(before[axis].value_mm - now[axis].value_mm) <= limit_mm for axis in now
    )


def paused_text(guided: GuidedSession, *, headless: bool = False) -> str:
    """How much of a session that was left is measured, and the command that continues it."""
    done, steps = len(guided.session.done()), len(guided.steps)
    command = continue_command(guided.path, guided.motion, headless=headless)
    return (
        f"Session paused after {done} of {steps} steps; every reading taken is on the disk. "
        f"Continue with: {command}"
    )


def continue_command(path: Path, motion: str | None, *, headless: bool) -> str:
    """The command that continues a session, with the controller that moves its machine."""
    screen = " --headless" if headless else ""
    controller = f" --motion {quote(motion)}" if motion else ""
    return f"glidecal run{screen} --continue {quote(str(path))}{controller}"


LEAVE_QUESTION = (
    "Pause this session? Every reading taken is on the disk, and you can continue later."
)
LEAVE_CHOICES = (("stay", "No, stay here"), ("home", "Yes, to the home screen"))
RESTORE_QUESTION = "The readings of step {} do not count ({}). Use them all the same?"
RESTORE_CHOICES = (("no", "No, nothing changes"), ("use", "Yes, use them again"))
MOVED_QUESTION = "Was the stand moved or touched? If so, readings get a new zero from here on."
MOVED_CHOICES = (("no", "No, continue as before"), ("moved", "Yes, start a new zero"))


def question_choices(taken: TakenStep) -> tuple[tuple[str, str], ...]:
    """What can be done about questioned readings."""
    doubt, number = taken.doubt, taken.step.number
    earlier = taken.earlier[0].step if taken.earlier else 0
    if doubt is Doubt.ODD:
        return (
            ("earlier", f"Measure step {earlier} again"),
            ("keep", f"Step {earlier} is right: keep it as it is"),
        )
    if doubt is Doubt.STAND:
        return (
            ("read", "No. I set it up now and take again"),
            ("keep", "Yes, it stands there: keep the reading"),
        )
    first, last = "Read again here, without moving", "Keep the reading as it is"
    if doubt in (Doubt.UNCHANGED, Doubt.TOO_SOON):
        first, last = "No. I move it now and take again", "Yes, it moved: keep the reading"
    elif doubt is Doubt.REPEATS:
        first, last = f"Read step {number} again here, without moving", "Keep both for now"
    wrong = ("earlier", f"Step {number} is right: measure step {earlier} again")
    return (
        ("read", first),
        ("approach", f"Measure step {number} again: leave the posture and come back"),
        *([wrong] if earlier else []),
        ("stand", "The stand moved: start a new set-up, with a new zero"),
        ("keep", last),
    )


ANSWERED = {
    "": "no answer, not kept",
    "read": "read again in place",
    "approach": "approached again",
    "earlier": "the earlier one is measured again",
    "stand": "the stand moved",
    "keep": "kept",
}


def answer_reason(answer: str, taken: TakenStep) -> str:
    """What goes into the record with the answer to a question."""
    if taken.doubt is Doubt.STAND:
        return f"{taken.doubt}: {ANSWERED[answer]}"
    if taken.doubt in (Doubt.REPEATS, Doubt.ODD):
        before_mm = {r.axis: r.value_mm for r in taken.earlier}
        apart = (r.value_mm - before_mm.get(r.axis, r.value_mm) for r in taken.readings)
        earlier = taken.earlier[0].step
        return (
            f"{taken.doubt}, {signed(max(apart, key=abs), 4)} mm from step {earlier}: "
            f"{ANSWERED[answer]}"
        )
    pairs = zip(taken.readings, taken.due, strict=True)
    worst_mm = max((r.value_mm - due.mean_mm for r, due in pairs), key=abs)
    return f"{taken.doubt}, {signed(worst_mm, 4)} mm from expected: {ANSWERED[answer]}"


def answered_text(answer: str, taken: TakenStep, unsure: Sequence[int] = ()) -> str:
    """What comes next after the answer; ``unsure`` are steps that are measured again with it."""
    number = taken.questioned[0].step
    if answer == "keep":
        return f"Step {number} is kept; the table marks it."
    if answer == "earlier" or taken.doubt is Doubt.ODD:
        return f"Next is step {taken.earlier[0].step}: move there, and take it again."
    if taken.doubt is Doubt.STAND:
        return f"Not kept. Set the stand up at {taken.step.touched}, then take step {number}."
    if unsure:
        names = ", ".join(map(str, unsure))
        again = f"step{'s' * (len(unsure) > 1)} {names} {'are' if len(unsure) > 1 else 'is'}"
        return f"Not kept. With the new zero {again} measured again, too: since when is not known."
    then = {"approach": "leave the posture, come back, and ", "stand": "with the new zero, "}
    return f"Not kept. Next is step {number}: {then.get(answer, '')}take it again."


def lost_text(name: str, words: str, elsewhere: str | None, *, gone: bool) -> str:
    """An indicator that gives no value: why, where its adapter is now, and what to do."""
    lost = f"FAULT: {name}: {sentence(words)} The session waits."
    if elsewhere:
        return f"{lost} Its adapter is at {elsewhere} now: {{measure.port}} goes on there."
    if gone:
        return f"{lost} Does it come back under another name, {{measure.port}} chooses it."
    return lost


def other_adapter_text(name: str, adapter: str, before: str) -> str:
    """An indicator that answers again is behind another adapter: perhaps another indicator."""
    return (
        f"WARNING: {name} answers again, but adapter {adapter or 'without a number'} is there now, "
        f"before it was {before}. Plug it back, or make sure that it is the same indicator."
    )


NO_PORT_LOST = "Every indicator answers: no other port is needed."
NO_OTHER_PORT = "No other serial port is here. Plug the adapter in; then {measure.port} again."


def port_question(name: str) -> str:
    """Where an indicator is now."""
    return f"At which port is {name} now?"


def port_choices(
    ports: Sequence[tuple[str, str]], numbers: Mapping[str, str], adapter: str
) -> list[tuple[str, str]]:
    """Ports with what the system says of them; the one of the same ``adapter`` is named."""
    same = {port: f", the same adapter, no. {adapter}" for port in numbers if adapter}
    same = {port: words for port, words in same.items() if numbers[port] == adapter}
    return [(port, f"{port}  {words}{same.get(port, '')}".rstrip()) for port, words in ports]


def automatic_waits_text(moved: Movement, step: Step, session: Session) -> str:
    """Why the automatic takes nothing though all stand still."""
    posture = step.posture(session.opened.machine.geometry())
    if moved is Movement.UNCHANGED:
        move = f"WAIT: no change, so no move to {posture} is seen."
        return move + " If it moved, {measure.take} takes it."
    move = f"WAIT: readings cannot show the move to {posture}."
    return move + " {measure.take} or the button takes it."


def point_text(step: Step, session: Session) -> str:
    """One step that was measured or skipped, in one line."""
    posture = step.posture(session.opened.machine.geometry())
    posture += f" {step.station:g}" * step.over_plane
    cycle = cycle_words(step, session.steps())
    where = f"step {step.number:>3}  {step.touched}  {posture:<9} {cycle}"
    if step.number in session.skipped:
        return f"{where}   skipped: {session.skipped[step.number]}"
    counting = [r for r in session.readings if r.step == step.number]
    shown = counting or [r for r in session.all_readings if r.step == step.number]
    latest = shown[-len(step.axes) :]  # of what was taken again and again
    values = "  ".join(f"{r.axis.upper()} {signed(r.value_mm, 4)}" for r in latest)
    reason = session.superseded.get(shown[-1].reading) if shown and not counting else None
    return f"{where}   {values}" + (f"   superseded: {reason}" if reason else "")


REVIEW_HELP = """\
Scatter       standard deviation of a reading in the repeats of a posture
Usual         the scatter to hold against it: what the indicator states,
              the other legs, or an indicator at rest
Return        largest difference between two Zeros of one cycle: it shows
              drift, and a stand that moved"""


def review_text(review: LegReview, session: Session) -> str:
    """A leg after its last step: repeatability beside the usual one, drift, differences.

    Keys in it are ids of bindings in braces.
    """
    table = new_table("axis", "scatter, mm", "repeats", "usual, mm", "return, mm")
    for one in review.axes:
        table.add_row(
            one.axis.upper(),
            "no repeats" if one.standard_deviation_mm is None else _four(one.standard_deviation_mm),
            str(one.degrees_of_freedom),
            f"{_four(one.usual_mm)} {one.usual}",
            "" if one.worst_return_mm is None else signed(one.worst_return_mm, 4),
        )
    read, wide = f"Leg {review.leg.upper()}", 8
    verdict = review_verdict(review, session)
    worst = verdict.startswith("WARNING:")  # on a line of its own: it stands out
    if review.leg == "tool":
        read, wide = "The plate", 22
    cells = [f"{name:<{wide}}{signed(value):>8}" for name, value in review.differences_mm]
    rows = ["      ".join(cells[k : k + ACROSS]) for k in range(0, len(cells), ACROSS)]
    return paragraphs(
        *([f"{read} is done.", verdict] if worst else [f"{read} is done. {verdict}"]),
        table,
        [f"{len(cells)} differences so far, mm", *rows],
        ["Space continues, {measure.hold} holds the session, {measure.plot} shows the plot."],
    )


ACROSS = 2
"""Differences on a line: all twelve of a session fit into the smallest terminal."""

MORE_THAN_USUAL = 3.0
"""Scatter of so many times the usual one is worth a word."""

BESIDE = {
    Usual.STATED: "its indicator states",
    Usual.OTHERS: "the other legs do",
    Usual.AT_REST: "an indicator at rest",
}


def review_verdict(review: LegReview, session: Session) -> str:
    """Whether the scatter is as usual, in a sentence or two; which reading to look at."""
    worst = max(review.axes, key=lambda one: one.excess)
    if worst.excess > MORE_THAN_USUAL:
        much = f"{worst.excess:.0f} times as much as {BESIDE[worst.usual]}"
        said = f"WARNING: readings along {worst.axis.upper()} scatter {much}."
        if worst.furthest is not None and worst.furthest.step:
            name = step_name(session.steps()[worst.furthest.step - 1], session)
            off = f"is {signed(worst.furthest_mm)} mm off its repeats"
            again = "{measure.hold} holds the session, then {measure.earlier} measures it again."
            said += f" {name[0].upper()}{name[1:]}, {off}: {again}"
        return said
    if all(one.standard_deviation_mm is None for one in review.axes):
        return "Without repeats the scatter is not known."
    return "No scatter is suspicious."


def _four(length_mm: float) -> str:
    return f"{length_mm:.4f}"


def clock_set_text(jump_s: float) -> str:
    """The clock of the computer was set while the session was open."""
    way = "forward" if jump_s > 0.0 else "back"
    return (
        f"The computer's clock was set {way} by {abs(jump_s):.0f} s. The record notes it; "
        "times and drift of this session use another clock."
    )


def slept_text(seconds: float, key: str) -> str:
    """The computer was suspended while the session was open; the ``key``, an id, goes on."""
    return (
        f"The computer slept for {max(1, round(seconds / 60.0))} min; the session is on hold. "
        f"If the stand was touched, press {{measure.remount}}. Then press {{{key}}} to continue."
    )
