"""``glidecal serve``: replay and results in the browsers of this computer."""

from __future__ import annotations

from typing import Annotated

import typer

from app.commands.options import Sessions, say
from calib.errors import UsageError

DEFAULT_PORT = 8765


def serve(
    sessions: Sessions,
    port: Annotated[
        int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.", min=0, max=65535)
    ] = DEFAULT_PORT,
) -> None:
    """Recorded sessions in a browser of this computer, to look at only; Ctrl-C ends it."""
    from protocols.record import read_record

    for path in sessions:
        read_record(path)
    try:
        from app.screens.serving import Pages, listen
    except ImportError as problem:
        raise UsageError(
            "glidecal serve",
            f"no package {problem.name or 'textual-serve'}",
            "an installation with the extra serve",
            'Install it with: pip install "glidecal[serve]"',
        ) from problem
    pages = Pages(sessions, listen(port))
    say(pages.announcement())
    pages.serve()
