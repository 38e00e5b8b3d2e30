"""What an operator of a Hexa Slide reads while postures are measured, and afterwards."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.table import Table

from app.measuring.hexaslide import PostureDoubt, departed
from app.report.text.tables import WIDTH, hanging, new_table, paragraphs, wrapped
from calib.hexaslide.geometry import CHAINS
from calib.hexaslide.procedures import ANGLES, COMPONENTS
from protocols.hexaslide_session import FIRST_APPROACH, PostureCommands, PostureSession

SLIDERS = tuple(f"slider {chain}" for chain in range(1, CHAINS + 1))
MOST_EXPLANATIONS = 3

GAP = 2
"""Between columns of a table that would else be too wide."""


def task_text(commands: PostureCommands, number: int, *, is_first: bool) -> str:
    """Where to send the sliders for a posture, counted from 1, and what to attach.

    ``is_first``: nothing was read before.
    """
    procedure, slider_words = commands.procedure, [f"{value:.4f}" for value in commands.of(number)]
    posture = procedure.postures[number - 1]
    coordinate_words = [
        f"{name} {value:.3f}" for name, value in zip(COMPONENTS, posture, strict=True)
    ]
    lines = [
        f"Posture {number} of {len(procedure.postures)}",
        f"  sliders 1 2 3   {'  '.join(slider_words[:3])} mm",
        f"  sliders 4 5 6   {'  '.join(slider_words[3:])} mm",
        f"  platform        {'  '.join(coordinate_words[:3])} mm",
        f"                  {'  '.join(coordinate_words[3:])} °",
    ]
    if procedure.attach:
        lines.append(hanging(f"  attach          {procedure.attach}", " " * 18))
    if is_first:
        lines.append(f"  {FIRST_APPROACH}")
    return "\n".join(lines)


def prompt_text(commands: PostureCommands, *, indicated: bool) -> str:
    """What is typed."""
    procedure = commands.procedure.whole()
    sliders = ["slider 1 … 6 as they stand"] if procedure.has_rigid_link else []
    names = [f"{name} °" if name in ANGLES else f"{name} mm" for name in procedure.measured]
    typed = ", ".join((*sliders, *names))
    return wrapped(f"{typed}; an empty line reads the indicator" if indicated else typed)


def doubt_text(doubt: PostureDoubt) -> str:
    """What is odd about a reading, and what would explain it."""
    number, departure = doubt.reading.reading, doubt.departure
    lines = [f"Reading {number}: the machine has no posture with these sliders."]
    if departure is not None:
        lines = [f"Reading {number} departs: {departed(departure)} (95 %)."]
    if doubt.explanations:
        lines.append(f"As if: {'; '.join(doubt.explanations[:MOST_EXPLANATIONS])}.")
    return wrapped("\n".join(lines))


def plan_text(planned: PostureCommands) -> str:
    """Every posture of a procedure, with the sliders for it."""
    rows = [
        (
            (str(number),),
            (*(f"{v:.3f}" for v in posture), *(f"{v:.4f}" for v in planned.of(number))),
        )
        for number, posture in enumerate(planned.procedure.postures, start=1)
    ]
    attach = planned.procedure.attach.rstrip(".")
    return paragraphs(
        f"{planned.procedure.name}: {len(planned.procedure.postures)} postures, mm and degrees. "
        f"{f'Attach {attach}. ' if attach else ''}{FIRST_APPROACH}",
        _stacked(["posture"], [*COMPONENTS, *SLIDERS], rows),
    )


def replay_text(session: PostureSession) -> str:
    """Every reading, those that do not count with the reason."""
    opened = session.opened
    return paragraphs(
        f"{session.name}: {opened.machine.full_name} ({opened.machine_file}), "
        f"{opened.procedure.name}, {opened.origin}, "
        f"{len(session.readings)} of {len(session.all_readings)} readings are used",
        *readings_parts(session),
        "\n".join(remark_lines(session)) or "No remarks.",
    )


def readings_parts(session: PostureSession) -> tuple[Table, list[str]]:
    """Every reading for a terminal, below them those that do not count with the reason."""
    reasons = [
        f"Reading {number} does not count: {why}." for number, why in session.superseded.items()
    ]
    return _stacked(["reading", "posture"], _heads(session), list(_rows(session))), reasons


def _heads(session: PostureSession) -> list[str]:
    """Headings of the figures of a reading."""
    measured = session.opened.procedure.whole().measured
    return [*SLIDERS, *(f"{name}, °" if name in ANGLES else f"{name}, mm" for name in measured)]


def _rows(session: PostureSession) -> Iterator[tuple[tuple[str, str], list[str]]]:
    """Numbers of each reading and of its posture, and its figures."""
    for reading in session.all_readings:
        figures = [f"{value:.4f}" for value in (*reading.sliders_mm, *reading.values)]
        yield (f"{reading.reading}", f"{reading.posture}"), figures


def _stacked(
    first: Sequence[str], names: Sequence[str], rows: Sequence[tuple[Sequence[str], Sequence[str]]]
) -> Table:
    """A table with all digits: columns of ``names`` one below the other where they are more than a
    terminal has room for beside those of ``first``.
    """
    widest = max(len(cell) for cells in (names, *(cells for _, cells in rows)) for cell in cells)
    room = (WIDTH - sum(len(name) + GAP for name in first)) // (widest + GAP)
    count = next((count for count in (6, 3, 2) if count <= room), 1)
    table = new_table(
        *first, *("\n".join(names[k::count]) for k in range(count)), left_columns=len(first)
    )
    for numbers, cells in rows:
        table.add_row(*numbers, *("\n".join(cells[k::count]) for k in range(count)))
    return table


def readings_table(session: PostureSession) -> Table:
    """A row for each reading, with the reason where it does not count; for a page of a report."""
    rows = (
        (*numbers, *figures, session.superseded.get(int(numbers[0]), ""))
        for numbers, figures in _rows(session)
    )
    return new_table("reading", "posture", *_heads(session), "", rows=rows)


def remark_lines(session: PostureSession) -> list[str]:
    """Postures that were left out, and notes."""
    skipped = [f"Posture {number} left out: {why}." for number, why in session.skipped.items()]
    return [*skipped, *session.notes]
