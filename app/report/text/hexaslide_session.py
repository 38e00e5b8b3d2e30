"""What an operator of a Hexa Slide reads while postures are measured, and afterwards."""

from __future__ import annotations

from rich.table import Table

from app.measuring.hexaslide import PostureDoubt, PostureTask, departed
from app.report.text.tables import new_table, paragraphs
from calib.hexaslide.procedures import ANGLES
from protocols.hexaslide_session import PostureCommands, PostureMmDeg, PostureSession

COORDINATES = ("x", "y", "z", "theta", "psi", "phi")
MOST_EXPLANATIONS = 3


def _posture(posture: PostureMmDeg) -> str:
    coordinate_words = [
        f"{name} {value:.3f}" for name, value in zip(COORDINATES, posture, strict=True)
    ]
    return f"{'  '.join(coordinate_words[:3])} mm  {'  '.join(coordinate_words[3:])} °"


def task_text(task: PostureTask) -> str:
    """Where to send the sliders, and what to attach."""
    sliders = "  ".join(f"{value:.4f}" for value in task.sliders_mm)
    lines = [
        f"Posture {task.number} of {task.count}",
        f"  sliders 1 … 6   {sliders} mm",
        f"  platform        {_posture(task.posture)}",
    ]
    if task.attach:
        lines.append(f"  attach          {task.attach}")
    return "\n".join(lines)


def prompt_text(task: PostureTask, *, indicated: bool) -> str:
    """What is typed."""
    sliders = ["slider 1 … 6 as they stand"] if task.reads_sliders else []
    names = [f"{name} °" if name in ANGLES else f"{name} mm" for name in task.measured]
    typed = ", ".join((*sliders, *names))
    return f"{typed}; an empty line reads the indicator" if indicated else typed


def doubt_text(doubt: PostureDoubt) -> str:
    """What is odd about a reading, and what would explain it."""
    number, departure = doubt.reading.reading, doubt.departure
    lines = [f"Reading {number}: the machine has no posture with these sliders."]
    if departure is not None:
        lines = [f"Reading {number} departs: {departed(departure)} (95 %)."]
    if doubt.explanations:
        lines.append(f"As if: {'; '.join(doubt.explanations[:MOST_EXPLANATIONS])}.")
    return "\n".join(lines)


def plan_text(planned: PostureCommands) -> str:
    """Every posture of a procedure, with the sliders for it."""
    table = new_table("posture", *COORDINATES, *(f"slider {k}" for k in range(1, 7)))
    for number, posture in enumerate(planned.procedure.postures, start=1):
        values = (*posture, *planned.of(number))
        table.add_row(str(number), *(f"{value:.2f}" for value in values))
    return paragraphs(
        f"{planned.procedure.name}: {len(planned.procedure.postures)} postures, mm and degrees. "
        f"{planned.procedure.attach}",
        table,
    )


def replay_text(session: PostureSession) -> str:
    """Every reading, those that do not count with the reason."""
    opened = session.opened
    return paragraphs(
        f"{session.name}: {opened.machine.name} ({opened.machine_file}), {opened.procedure.name}, "
        f"{opened.origin}, {len(session.readings)} of {len(session.all_readings)} readings count",
        readings_table(session),
        "\n".join(remark_lines(session)) or "No remarks.",
    )


def readings_table(session: PostureSession) -> Table:
    """A row for each reading, with the reason where it does not count."""
    measured = session.opened.procedure.whole().measured
    heads = [f"{name}, °" if name in ANGLES else f"{name}, mm" for name in measured]
    table = new_table("reading", "posture", *(f"slider {k}" for k in range(1, 7)), *heads, "")
    for reading in session.all_readings:
        numbers = (*reading.sliders_mm, *reading.values)
        why = session.superseded.get(reading.reading, "")
        row = (str(reading.reading), str(reading.posture), *(f"{value:.4f}" for value in numbers))
        table.add_row(*row, why)
    return table


def remark_lines(session: PostureSession) -> list[str]:
    """Postures that were left out, and notes."""
    skipped = [f"Posture {number} left out: {why}." for number, why in session.skipped.items()]
    return [*skipped, *session.notes]
