"""``glidecal replay``: a recorded session again."""

from __future__ import annotations

from typing import Annotated

import typer

from app.commands.options import AsJson, OneSession, need_terminal, say


def replay(
    session: OneSession,
    headless: Annotated[
        bool, typer.Option("--headless", help="Print readings and averages, open no screen.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Readings and averages of a recorded session, or its result screen."""
    if not headless and not as_json:
        need_terminal("replay", "--headless")
        from app.screens.start import open_result

        raise typer.Exit(open_result(session))
    from app.documents import replay_document, to_json
    from app.solving import end_warning
    from app.wording.session import replay_text
    from protocols.record import read_record
    from protocols.session import fold

    record = read_record(session)
    if record.end != "closed":
        say(f"glidecal: {end_warning(record)}")
    document = replay_document(session.name, fold(record.events), record.end)
    typer.echo(to_json(document) if as_json else replay_text(document))
