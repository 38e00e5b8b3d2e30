"""What is asked while measuring, and what an answer leads to: readings, ports, the stand."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from app.measuring.doubts import Doubt, TakenStep
from app.measuring.gauges import LostNews
from app.report.text.session import cycle_words, step_name
from app.report.text.tables import signed, uncertain
from calib.errors import sentence
from calib.printable import with_capital
from drivers.profile import FaultKind
from protocols.procedure import Step, posture_words
from protocols.session import Session


def question_text(step_taken: TakenStep, session: Session) -> str:
    """Why readings are questioned: what was read, what was expected, what its repeats show."""
    rows, odd = _repeat_rows(step_taken, session), step_taken.doubt is Doubt.ODD
    if step_taken.earlier:
        earlier_step = step_name(session.steps()[(step_taken.earlier[0].step or 1) - 1], session)
    if odd:
        agree = "The others agree with each other. Was the machine in another posture then?"
        return "\n".join([f"The odd one is {earlier_step}:", *rows, agree])
    if step_taken.doubt is Doubt.REPEATS:
        same_zero = len({r.mount for r in (*step_taken.readings, *step_taken.earlier)}) <= len(
            step_taken.readings
        )
        zeros = [] if same_zero else ["Each set-up has a zero of its own: compare from there."]
        first = f"Step {step_taken.step.number} does not agree with {earlier_step}:"
        question = "Which of these two is wrong? Look at posture, unit and sign now."
        return "\n".join([first, *rows, *zeros, question])
    name = step_name(step_taken.step, session)
    lines = [f"{with_capital(name)}:", *_off_lines(step_taken, session)]
    if len(rows) > 2:  # a heading and more than the step itself
        lines += ["Its repeats agree with each other:", *rows]
    if _same_again(step_taken, session):
        lines.append("It shows the same again. If all is right now, the stand has moved.")
        return "\n".join(lines)
    return "\n".join([*lines, _question_words(step_taken, session)])


def _off_lines(step_taken: TakenStep, session: Session) -> list[str]:
    """For each axis what was read, and how it is off."""
    previous = _before(step_taken, session)
    readings = [f"along {r.axis.upper()} {signed(r.value_mm, 4)} mm" for r in step_taken.readings]
    if not step_taken.due:
        return readings
    lines = []
    for line, reading, due in zip(readings, step_taken.readings, step_taken.due, strict=True):
        if step_taken.doubt is not Doubt.BEYOND:
            line += f", {signed(reading.value_mm - due.previous.value_mm, 4)} mm since {previous}"
        elif due.is_beyond(reading.value_mm):
            line += f" where {signed(due.mean_mm)} ± {uncertain(due.limit_mm)} mm is expected"
        lines.append(line)
    return lines


def _before(step_taken: TakenStep, session: Session) -> str:
    """The posture before the step."""
    if not step_taken.due:
        return ""
    previous = step_taken.due[0].previous
    posture = posture_words(previous.posture_mm, session.opened.machine.geometry())
    return f"{posture} {previous.station:g}" if step_taken.step.over_plane else posture


def _question_words(step_taken: TakenStep, session: Session) -> str:
    """The question itself."""
    previous, mover = _before(step_taken, session), "the machine"
    if step_taken.step.over_plane:
        mover = "machine or stand"
    if step_taken.doubt is Doubt.STAND:
        last = step_name(session.steps()[(step_taken.earlier[0].step or 1) - 1], session)
        return f"Unchanged since {last}: was the stand set up again, at {step_taken.step.touched}?"
    questions = {
        Doubt.UNCHANGED: f"Unchanged since {previous}: did {mover} move?",
        Doubt.TOO_SOON: f"So soon after {previous} the machine cannot be there: did it move?",
    }
    beyond = (
        f"Other {'position' if step_taken.step.position_mm else 'leg'}, other unit, other direction"
    )
    return questions.get(step_taken.doubt or Doubt.BEYOND, f"{beyond}? Or did the stand move?")


def _repeat_rows(step_taken: TakenStep, session: Session) -> list[str]:
    """The readings of this posture on this leg, a row a step, under a heading of the axes."""
    now, superseded = step_taken.readings[0], session.superseded
    asked_numbers = {r.reading for r in (*step_taken.readings, *step_taken.earlier)}
    repeats = [
        r
        for r in session.all_readings
        if (r.leg, r.station, r.posture_mm) == (now.leg, now.station, now.posture_mm)
        and (r.reading in asked_numbers or r.reading not in superseded)
    ]
    axes = step_taken.step.axes
    heading = f"{'':<24}" + "".join(f"{f'along {axis.upper()}, mm':>14}" for axis in axes)
    rows = [heading]
    for number, of_step in groupby(sorted(repeats, key=lambda r: r.step or 0), lambda r: r.step):
        values = {r.axis: r.value_mm for r in of_step}
        step = session.steps()[(number or 1) - 1]
        name = f"step {number}, {cycle_words(step, session.steps())}"
        name += " (now)" if number == step_taken.step.number else ""
        cells = "".join(f"{signed(values[a], 4) if a in values else '':>14}" for a in axes)
        odd = (
            "  odd"
            if step_taken.doubt is Doubt.ODD and number == step_taken.earlier[0].step
            else ""
        )
        rows.append(f"{name:<24}{cells}{odd}")
    return rows


def _same_again(step_taken: TakenStep, session: Session) -> bool:
    """Whether the step shows what it showed when it was questioned before, and was not kept."""
    if step_taken.doubt is not Doubt.BEYOND or step_taken.earlier:
        return False
    now = {r.axis: r for r in step_taken.readings}
    previous = {
        r.axis: r
        for r in session.all_readings
        if r.step == step_taken.step.number and r.reading < step_taken.readings[0].reading
        if r.mount == now[r.axis].mount
    }
    limit_mm = session.opened.procedure.repeat_limit_mm if session.opened.procedure else 0.0
    return previous.keys() == now.keys() and all(
        abs(previous[axis].value_mm - now[axis].value_mm) <= limit_mm for axis in now
    )


LEAVE_QUESTION = (
    "Pause this session? Every reading taken is on the disk, and you can continue later."
)
LEAVE_CHOICES = (("stay", "No, stay here"), ("home", "Yes, to the home screen"))
NOT_KEPT = "{dialog.cancel}: not kept."
WHICH_STEP = "Which step? Nothing changes until you say what to do with it."
WHAT_TO_SKIP = "What do you want to skip?"
WHY_SKIP = "Why? The reason stays in the record."
SKIPPED = "Skipped: {}. {measure.earlier} brings it back."
RESTORE_QUESTION = "The readings of step {} do not count ({}). Use them all the same?"
RESTORE_CHOICES = (("no", "No, nothing changes"), ("use", "Yes, use them again"))
RESTORED = (
    "Step {} cannot be restored: the stand was moved after it.",
    "The readings of step {} are used again.",
)
"""By whether they are."""

MOVED_QUESTION = "Was the stand moved or touched? If so, readings get a new zero from here on."
MOVED = "New set-up: readings from here on have a new zero"
MOVED_CHOICES = (("no", "No, continue as before"), ("moved", "Yes, start a new zero"))


def next_again_text(step: Step | None) -> str:
    """What comes after a repeat of the last step."""
    again = f"Step {step.number if step else 0} is next again."
    return f"{again} Its readings stay in the record and are not used."


def again_question(step: int, skipped: bool, count: int) -> str:
    """The question before a step is measured again; with it ``count`` steps of a stand that has
    left.
    """
    verb = "brought back" if skipped else "measured again"
    question = f"Why is step {step} {verb}? With a reason it becomes the next step."
    if count > 1:
        question += f" Its stand is gone: {count} steps are measured, to share one zero."
    return question


def as_before_words(step: Step | None) -> str:
    """What happens without a reason, ``step`` being the next one."""
    then = f"step {step.number} stays the next" if step else "the session is done"
    return f"nothing changes, {then}."


def skip_choices(step: Step, steps: list[int]) -> list[tuple[list[int], str]]:
    """One step, or all of the rest of its leg."""
    choices = [([step.number], f"Step {step.number} only")]
    if len(steps) > 1:
        choices.append((steps, f"The rest of leg {step.leg.upper()}: {len(steps)} steps"))
    return choices


def question_choices(step_taken: TakenStep) -> tuple[tuple[str, str], ...]:
    """What can be done about questioned readings."""
    doubt, number = step_taken.doubt, step_taken.step.number
    earlier = step_taken.earlier[0].step if step_taken.earlier else 0
    if doubt is Doubt.ODD:
        return (
            ("earlier", f"Measure step {earlier} again"),
            ("keep", f"Step {earlier} is right: keep it"),
        )
    if doubt is Doubt.STAND:
        return (
            ("read", "No. I set it up now and take again"),
            ("keep", "Yes, it is there: keep the reading"),
        )
    first, last = "Read again here, without moving", "Keep the reading"
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


def answer_reason(answer: str, step_taken: TakenStep) -> str:
    """What goes into the record with the answer to a question."""
    if step_taken.doubt is Doubt.STAND:
        return f"{step_taken.doubt}: {ANSWERED[answer]}"
    if step_taken.doubt in (Doubt.REPEATS, Doubt.ODD):
        before_mm = {r.axis: r.value_mm for r in step_taken.earlier}
        apart = (r.value_mm - before_mm.get(r.axis, r.value_mm) for r in step_taken.readings)
        earlier = step_taken.earlier[0].step
        return (
            f"{step_taken.doubt}, {signed(max(apart, key=abs), 4)} mm from step {earlier}: "
            f"{ANSWERED[answer]}"
        )
    pairs = zip(step_taken.readings, step_taken.due, strict=True)
    worst_mm = max((r.value_mm - due.mean_mm for r, due in pairs), key=abs)
    return f"{step_taken.doubt}, {signed(worst_mm, 4)} mm from expected: {ANSWERED[answer]}"


def answered_text(answer: str, step_taken: TakenStep, unsure: Sequence[int] = ()) -> str:
    """What comes next after the answer; ``unsure`` are steps that are measured again with it."""
    number = step_taken.questioned[0].step
    if answer == "keep":
        return f"Step {number} is kept; the table marks it."
    if answer == "earlier" or step_taken.doubt is Doubt.ODD:
        return f"Next is step {step_taken.earlier[0].step}: move there, and take it again."
    if step_taken.doubt is Doubt.STAND:
        return f"Not kept. Set the stand up at {step_taken.step.touched}, then take step {number}."
    if unsure:
        names = ", ".join(map(str, unsure))
        again = f"step{'s' * (len(unsure) > 1)} {names} {'are' if len(unsure) > 1 else 'is'}"
        return f"Not kept. With the new zero {again} measured again, too: since when is not known."
    then = {"approach": "leave the posture, come back, and ", "stand": "with the new zero, "}
    return f"Not kept. Next is step {number}: {then.get(answer, '')}take it again."


def lost_text(name: str, news: LostNews, *, alone: bool = True) -> str:
    """An indicator that gives no value, or gives one again: why, its adapter, and what to do.

    ``alone``: no other one of the step is lost.
    """
    if news.fault is None:
        return f"{with_capital(name)} answers again.{' Continue with this step.' * alone}"
    fault_words = f"FAULT: {name}: {sentence(news.fault.words)} The session waits."
    if news.elsewhere:
        return (
            f"{fault_words} Its adapter is at {news.elsewhere} now: {{measure.port}} goes on there."
        )
    if news.fault.kind is FaultKind.DISCONNECTED:
        return f"{fault_words} If it comes back under another name, {{measure.port}} chooses it."
    return fault_words


def other_adapter_text(name: str, adapter_before: str, now: str) -> str:
    """An indicator that answers again is behind another adapter: perhaps another indicator."""
    return (
        f"WARNING: {name} answers again, but adapter {now or 'without a number'} is there now, "
        f"before it was {adapter_before}. Plug it back, or make sure that it is the same indicator."
    )


NO_PORT_LOST = "Every indicator answers: no other port is needed."
PORT_ELSEWHERE = "A port that is not listed: type it"
WHICH_PORT = "Type the port of the indicator."


def port_question(name: str, *, none: bool) -> str:
    """Where an indicator is now; ``none``: no port is listed."""
    plug = "\nNo other serial port is here. Plug the adapter in, then choose again." if none else ""
    return f"At which port is {name} now?{plug}"


def port_choices(ports: Sequence[tuple[str, str, bool]], adapter: str) -> list[tuple[str, str]]:
    """Ports with what the system says of them; the one of the same ``adapter`` is named."""
    suffix = f", the same adapter, no. {adapter}"
    return [
        (port, f"{port}  {description}{suffix if is_same else ''}".rstrip())
        for port, description, is_same in ports
    ]
