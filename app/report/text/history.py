"""What the history of a machine says."""

from __future__ import annotations

from datetime import datetime

from rich.table import Table

from app.evaluating.history import History, MachineHistory
from app.report.text.tables import hanging, new_table, paragraphs, signed
from calib.arrays import LEG_NAMES
from calib.control_chart import FEWEST

DAYS_A_MONTH = 30.44  # 365.25 / 12

TOO_EARLY = (
    f"Whether it drifts cannot be told yet: that takes {FEWEST} sessions over a day or longer."
)

HISTORY_HELP = """\
Tab, arrows   the plot of each machine, and back to the text
Y             copy the page to the clipboard, a plot as characters
Up, down      scroll the text; Page up, Page down, Home, End
Escape, F10   back, quit

All sessions of a folder and those below it: where the joints stood,
what the tool was off by, what was changed in between, what drifts.
In a plot a line from top to bottom stands for offsets that were
entered or a machine that was changed. Files that are altered or cut
are named first. !: changed beyond its uncertainty."""


def history_text(found: History, now: datetime) -> str:
    """Files that cannot be used first, then each machine."""
    said = [hanging(f"WARNING: {text}", "  ") for _, text in found.problems]
    return paragraphs(said, *([machine_text(one, now)] for one in found.machines))


def machine_text(found: MachineHistory, now: datetime) -> str:
    """Due when, drift, then a row for each session and what changed before it."""
    last = found.last
    ago, count = max(0, (now - last.began).days), len(found.points)
    when = "today" if ago == 0 else f"{ago} day{'s' * (ago > 1)} ago"
    table, notes = _sessions(found)
    return paragraphs(
        f"{found.machine}: {count} session{'s' * (count > 1)}. Last calibrated {when}: "
        f"{found.points[-1].path.name}. {due_words(found)}",
        _drifts(found) if any(one.drift for one in found.joints) else [],
        table,
        "Offsets with what was entered added, so that entering them changes nothing; ± for 95 %. "
        "!: changed beyond its uncertainty and the limits of its chart. tool: what it was off by "
        "at most, mm r.m.s., as it was found.",
        notes,
    )


def due_words(found: MachineHistory) -> str:
    """When the next calibration is due, or why that cannot be told."""
    if found.due is not None:
        return f"Due in {found.due:%B %Y}: by then drift will have used up the tolerance."
    if not any(one.drift for one in found.joints):
        return TOO_EARLY
    if not any(one.drift and one.drift.shown for one in found.joints):
        return "No drift beyond its uncertainty."
    if found.last.machine.tool_tolerance_mm is None:
        return "When it is due cannot be told: the machine file states no tool_tolerance_mm."
    return "Drift does not use up the tolerance within a hundred years."


def _drifts(found: MachineHistory) -> list[str]:
    said = []
    for name, one in zip(LEG_NAMES, found.joints, strict=True):
        if one.drift is None:
            said.append(f"Drift of joint {name}: cannot be told")
            continue
        um, half_um = (1000.0 * DAYS_A_MONTH * v for v in (one.drift.per_day, one.drift.expanded))
        weak = "" if one.drift.shown else ", no more than its uncertainty"
        said.append(f"Drift of joint {name}: {signed(um, 1)} ± {half_um:.1f} µm a month{weak}")
    return said


def _sessions(found: MachineHistory) -> tuple[Table, list[str]]:
    """A row for each session, and a note below."""
    table = new_table(
        "", "began", *(f"{n}, mm" for n in LEG_NAMES), "±, mm", "tool, mm", "°C", left=2
    )
    notes = []
    for number, point in enumerate(found.points, start=1):
        entry = point.entry
        offsets, expanded = entry.offsets_mm or (), entry.expanded_mm or ()
        changed = [bool(one.chart.changed[number - 1]) for one in found.joints]
        marked = zip(offsets, changed, strict=True)
        table.add_row(
            f"{number}",
            f"{entry.began:%Y-%m-%d}",
            *(f"{signed(mm, 4)}{'!' if new else ' '}" for mm, new in marked),
            f"{max(expanded):.4f}",
            f"{entry.bound_before_mm:.3f}",
            "" if entry.temperature_c is None else f"{entry.temperature_c:.1f}",
        )
        said = [point.path.name, point.event, *(entry.effects or ())]
        if any(changed):
            joints = ", ".join(name for name, new in zip(LEG_NAMES, changed, strict=True) if new)
            said.append(f"joint {joints} changed beyond uncertainty")
        notes.append(hanging(f"{number}  {'; '.join(filter(None, said))}", "   "))
    return table, notes
