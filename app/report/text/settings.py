"""Settings and keys in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from app.report.text.tables import new_table, table_text
from app.settings import FILE_VARIABLE, Settings

KeyRow = tuple[str, Sequence[str], str]
"""Id of a binding, its keys without settings, what it does."""


def settings_text(path: Path, exists: bool, settings: Settings, keys: Iterable[KeyRow]) -> str:
    """Where the file is, what holds now, and every key that can be changed."""
    state = "" if exists else " (not there yet: everything has its default)"
    lines = [
        f"Settings file: {path}{state}",
        f"{FILE_VARIABLE} names another file.",
        "",
        f"theme       {settings.theme or 'default'}",
        f"animations  {'on' if settings.animations else 'off'}",
        "",
        'Keys; under [keys] a line such as "measure.take" = "space,f2" changes them:',
    ]
    table = new_table("id", "default", "now", "does", left=4)
    for key_id, default, words in keys:
        table.add_row(key_id, ", ".join(default), settings.keys.get(key_id, ""), words)
    return "\n".join(lines) + "\n\n" + table_text(table)


def key_list_text(keys: Iterable[tuple[str, str]]) -> str:
    """The keys of the present screen, one a line."""
    rows = [f"{key:<12}{words}" for key, words in keys]
    return "Keys of this screen\n\n" + "\n".join(rows)
