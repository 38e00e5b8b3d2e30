"""``glidecal validate``: is a record complete, unbroken and unaltered?"""

from __future__ import annotations

import typer

from app.commands.options import Sessions, say
from app.exit_codes import Exit, exit_code
from calib.errors import GlidecalError


def validate(sessions: Sessions) -> None:
    """Check records: complete, unbroken, unaltered; names the first broken line.

    What it proves holds against accidents and careless edits: the digests have no key.
    """
    from app.evaluating.solution import end_warning
    from app.measuring.value_check import check_values
    from protocols.record import read_record
    from protocols.session import fold

    status = Exit.DONE
    for path in sessions:
        try:
            record = read_record(path)
            check_values(record)
        except GlidecalError as problem:
            say(f"glidecal: {problem}")
            status = exit_code(problem)
            continue
        if record.end != "closed":
            say(f"glidecal: {end_warning(record)} Continue it with: glidecal run --continue {path}")
            status = Exit.RECORD
            continue
        session = fold(record.events)
        typer.echo(
            f"{path}: unbroken and closed, {len(record.events)} lines, "
            f"{len(session.all_readings)} readings, {len(session.superseded)} superseded"
        )
    raise typer.Exit(status)
