"""What the history of a machine says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime

from rich.table import Table

from app.evaluating.history import Entry, History, MachineHistory
from app.evaluating.posture_history import PastEntry, Point, PostureEntry, PostureHistory
from app.report.text.tables import (
    hanging,
    new_table,
    paragraphs,
    signed,
    uncertain,
    wrapped,
)
from calib.arrays import LEG_NAMES
from calib.control_chart import FEWEST, RULES
from calib.printable import counted

UM_A_MONTH = 1000.0 * 30.44  # of mm a day: a month has 365.25 / 12 days

TOO_EARLY = (
    f"A drift cannot be determined yet: this takes {FEWEST} sessions of one state of the machine "
    "over a week or longer."
)
NO_DAY = "Of an imported table the day must be stated (import --measured-on)."

ORIGIN_WORDS = {"measured": "", "simulated": ", simulated", "imported": ", imported"}

RULE_MARKS = " ¹²³⁴"

BELOW_TABLE = (
    "Offsets with what was entered added, so that entering them changes nothing; ± for 95 %. "
    "!: changed beyond its uncertainty and the limits of its chart; ¹²³⁴: Western Electric rules "
    "that a session completes. tool: what it was off by at most, mm r.m.s., as it was found."
)


BELOW_POSTURES = (
    "off: what the platform was off by, mm r.m.s. over the box, as it was found; then: at most "
    "with the calibrated machine (95 %). Frames that a session does not show are laid over, so "
    "figures of different procedures differ. pass, fail, undecided: as it was found, by the "
    "tolerance in the machine file."
)


def history_text(history: History, now: datetime) -> str:
    """Files that cannot be used first; a table of several machines, then each of them."""
    machines = [paragraphs(*machine_parts(past, now)) for past in history.all_machines]
    listed = [machines_table(history)] if len(machines) > 1 else []
    return paragraphs(files_text(history).splitlines(), *listed, *([text] for text in machines))


def heading_text(history: History) -> str:
    """Which folder, and how much of it is still to be worked out."""
    waiting_words = (
        f"   {history.waiting:,} of {history.sessions:,} sessions are still worked out …"
    )
    return f"History of {history.folder.absolute().name}{waiting_words if history.waiting else ''}"


def files_text(history: History, *, goes_on: bool = False) -> str:
    """Sessions that are not worked out yet, and files that cannot be used, a sentence for each.

    What ``goes_on`` by itself needs no sentence.
    """
    waiting = [] if goes_on else waiting_sentences(history)
    warnings = [hanging(f"WARNING: {text}", "  ") for _, text in history.problems]
    return "\n".join([*map(wrapped, waiting), *warnings])


def waiting_sentences(history: History) -> list[str]:
    """How many sessions are missing here; empty where none is."""
    if not history.waiting:
        return []
    return [
        f"WAIT: {history.waiting:,} of {history.sessions:,} sessions are still to be worked out. "
        "The others are remembered: the next call goes on there."
    ]


def machine_rows(history: History) -> list[str]:
    """A line for each machine, with the number of its sessions and the last one."""
    return [
        f"{name}: {counted(count, 'session')}, last {day}" for name, count, day in _rows(history)
    ]


def _rows(history: History) -> Iterator[tuple[str, int, str]]:
    """The name of each machine, how many sessions it has, and the day of the last one."""
    for past in history.all_machines:
        yield (
            f"{past.machine}{ORIGIN_WORDS[past.origin]}",
            len(past.points),
            f"{past.points[-1].entry.began:%Y-%m-%d}",
        )


def machines_table(history: History) -> Table:
    """A row for each machine."""
    rows = ((name, f"{count}", day) for name, count, day in _rows(history))
    return new_table("machine", "sessions", "last", rows=rows)


def machine_parts(
    past: MachineHistory | PostureHistory, now: datetime
) -> tuple[str, list[str], Table, str, list[str]]:
    """How many sessions, how long ago the last, when the next is due; each drift that is shown; a
    row for each session, words on that, a note for each.
    """
    last = past.points[-1]  # of a table whose day nobody stated that of the import is known
    done = "calibrated" if last.entry.dated else "imported"
    sentence = (
        f"{title_of(past)}: {counted(len(past.points), 'session')}. Last {done} "
        f"{_when_words(last.entry.began, now)}: {last.path}."
    )
    if isinstance(past, PostureHistory):
        return sentence, [], posture_sessions_table(past), BELOW_POSTURES, _notes(past)
    notes = [*rule_sentences(past), *_notes(past)]
    sentence = f"{sentence} {due_words(past)}"
    return sentence, drift_lines(past), sessions_table(past), BELOW_TABLE, notes


def title_of(past: MachineHistory | PostureHistory) -> str:
    """Name and serial number of a machine, its place and the origin of its sessions, as stated."""
    return ", ".join(filter(None, [past.machine, past.place])) + ORIGIN_WORDS[past.origin]


def _when_words(began: datetime, now: datetime) -> str:
    ago = max(0, (now.astimezone(began.tzinfo).date() - began.date()).days)
    return "today" if ago == 0 else f"{ago} day{'s' * (ago > 1)} ago"


def posture_sessions_table(past: PostureHistory) -> Table:
    """A row for each session of postures."""
    return new_table(
        *("", "began", "procedure", "postures", "off, mm", "then, mm", "", "°C"),
        left_columns=3,
        rows=(
            (
                f"{number}",
                f"{entry.began:%Y-%m-%d}",
                entry.procedure,
                f"{entry.postures}",
                "" if entry.now_mm is None else uncertain(entry.now_mm),
                "" if entry.bound_mm is None else uncertain(entry.bound_mm),
                entry.decision or "",
                _celsius(entry),
            )
            for number, entry in enumerate((point.entry for point in past.points), start=1)
        ),
    )


def _celsius(entry: PastEntry) -> str:
    return "" if entry.temperature_c is None else f"{entry.temperature_c:.1f}"


def _notes(past: MachineHistory | PostureHistory) -> list[str]:
    """A line for each session: its file, what was changed before it, effects, what changed."""
    notes: list[str] = []
    points: Sequence[Point[Entry] | Point[PostureEntry]] = past.points
    for k, point in enumerate(points):
        remarks = [str(point.path), point.event, *(point.entry.effects or ())]
        joints = past.joints if isinstance(past, MachineHistory) else ()
        pairs = zip(LEG_NAMES, joints, strict=False)
        if changed := ", ".join(name for name, joint in pairs if joint.chart.changed[k]):
            remarks.append(f"joint {changed} changed beyond uncertainty")
        notes.append(hanging(f"{k + 1}  {'; '.join(filter(None, remarks))}", "   "))
    return notes


def due_words(machine: MachineHistory) -> str:
    """When the next calibration is due, or why that cannot be told."""
    if machine.due is not None:
        return f"Due in {machine.due:%B %Y}: by then drift will have used up the tolerance."
    if not any(joint.drift for joint in machine.joints):
        every_day = all(point.entry.dated for point in machine.points)
        return TOO_EARLY if every_day else f"{TOO_EARLY} {NO_DAY}"
    if not any(joint.drift and joint.drift.shown for joint in machine.joints):
        return "No drift beyond its uncertainty."
    if machine.last.machine.tool_tolerance_mm is None:
        return "The due date is unknown: the machine file states no tool_tolerance_mm."
    return "Drift does not use up the tolerance within a hundred years."


def drift_lines(machine: MachineHistory) -> list[str]:
    """Each drift that is beyond its uncertainty."""
    lines = []
    for name, joint in zip(LEG_NAMES, machine.joints, strict=True):
        if joint.drift is not None and joint.drift.shown:
            um, wide = (UM_A_MONTH * v for v in (joint.drift.per_day, joint.drift.expanded))
            lines.append(f"Drift of joint {name}: {signed(um, 1)} ± {wide:.1f} µm a month")
    return lines


def sessions_table(machine: MachineHistory) -> Table:
    """A row for each session."""
    table = new_table(
        "", "began", *(f"{n}, mm" for n in LEG_NAMES), "±, mm", "tool, mm", "°C", left_columns=2
    )
    for k, point in enumerate(machine.points):
        entry, charts = point.entry, [joint.chart for joint in machine.joints]
        marked = zip(entry.offsets_mm or (), charts, strict=True)
        table.add_row(
            f"{k + 1}",
            f"{entry.began:%Y-%m-%d}",
            *(
                f"{signed(mm, 4)}{_sign(c.signals[k], bool(c.changed[k])) or ' '}"
                for mm, c in marked
            ),
            f"{max(entry.expanded_mm or ()):.4f}",
            uncertain(entry.bound_before_mm),
            _celsius(entry),
        )
    return table


def _sign(signals: Sequence[int], new: bool) -> str:
    """The rules that a value completes, else whether it changed."""
    return "".join(RULE_MARKS[rule] for rule in signals) or "!" * new


def rule_sentences(machine: MachineHistory) -> list[str]:
    """For each Western Electric rule the joints, the first session that completes it, how many."""
    sentences = []
    for rule, (*_, rule_text) in enumerate(RULES, start=1):
        completed = {
            name: [number for number, rules in enumerate(joint.chart.signals, 1) if rule in rules]
            for name, joint in zip(LEG_NAMES, machine.joints, strict=True)
        }
        if sessions := sorted({number for numbers in completed.values() for number in numbers}):
            joints = ", ".join(name for name, numbers in completed.items() if numbers)
            sentence = (
                f"{RULE_MARKS[rule]}  Rule {rule}, {rule_text}, joint {joints}: first in session "
                f"{sessions[0]}, in {counted(len(sessions), 'session')}."
            )
            sentences.append(hanging(sentence, "   "))
    return sentences
