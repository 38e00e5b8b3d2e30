"""``glidecal replay``: a recorded session again."""

from __future__ import annotations

import os
import select
import sys
import threading
from typing import Annotated

import typer

from app.commands.options import AsJson, Sessions, say
from app.exit_codes import Exit
from app.report.streams import need_terminal
from calib.errors import UsageError


def replay(
    session: Sessions,
    headless: Annotated[
        bool, typer.Option("--headless", help="Print readings and averages, open no screen.")
    ] = False,
    as_json: AsJson = False,
    served: Annotated[bool, typer.Option("--served", hidden=True)] = False,
) -> None:
    """A recorded session again on the screen, or its readings and averages."""
    if not headless and not as_json:
        if served:  # a page of glidecal serve: no terminal, and only to look at
            threading.Thread(target=_end_with_the_server, daemon=True).start()
        else:
            need_terminal("replay", "--headless")
        from app.screens.start import open_replay

        raise typer.Exit(open_replay(session, read_only=served))
    from app.evaluating.solution import end_warning
    from app.report.schema.document import to_json
    from app.report.schema.readings import ReplayReport
    from app.report.text.session import replay_text
    from protocols.record import read_record
    from protocols.session import fold

    if len(session) > 1:
        raise UsageError("replay without a screen", f"{len(session)} sessions", "one session")
    record = read_record(session[0])
    if record.end != "closed":
        say(f"glidecal: {end_warning(record)}")
    report = ReplayReport.of(name=session[0].name, session=fold(record.events), end=record.end)
    typer.echo(to_json(report) if as_json else replay_text(report))


def _end_with_the_server() -> None:
    """A server that was killed says nothing, but its end of the pipe is gone."""
    if hasattr(select, "poll"):  # not on Windows
        pipe = select.poll()
        pipe.register(sys.stdin.fileno(), 0)
        pipe.poll()
        os._exit(Exit.INTERRUPTED)  # nothing is open that could be lost
