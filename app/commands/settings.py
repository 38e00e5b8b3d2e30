"""``glidecal settings``: where the settings file is, what it says, and every key."""

from __future__ import annotations

import typer


def settings() -> None:
    """The settings file, its present values, and every key with its id."""
    from app.report.text.settings import settings_text
    from app.screens.keys import known_keys, settings_for_screens
    from app.settings import settings_path

    path = settings_path()
    present = settings_for_screens(path)
    rows = [(known.key_id, known.keys, known.words) for known in known_keys().values()]
    typer.echo(settings_text(path, path.exists(), present, rows))
