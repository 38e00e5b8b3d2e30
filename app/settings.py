"""A user's own settings, such as theme and laboratory: one TOML file, read before any screen."""

from __future__ import annotations

import json
import os
import re
import tomllib
from pathlib import Path
from typing import Any

from pydantic import Field, field_validator

from calib.errors import RecordError
from protocols.certificate import Laboratory
from protocols.documents import Document, read_text, read_toml

FILE_VARIABLE = "GLIDECAL_SETTINGS"
"""Environment variable that names another settings file."""

WHAT = "settings file"
THEME_LINE = re.compile(r"""^(\s*["']?theme["']?\s*=\s*)("[^"\n]*"|'[^'\n]*')""", re.MULTILINE)
TABLE_LINE = re.compile(r"^\s*\[", re.MULTILINE)


class Settings(Document):
    """What a user may choose; everything has a default.

    ``theme`` is the name of a theme of Textual, ``keys`` gives a binding by its id other keys,
    several with commas between them. ``laboratory`` is the head of certificates.
    """

    theme: str | None = None
    animations: bool = True
    keys: dict[str, str] = Field(default_factory=dict)
    laboratory: Laboratory | None = None

    @field_validator("keys", mode="before")
    @classmethod
    def _ids(cls, given: object) -> object:
        """``measure.take = "x"`` without quotes is a table inside the table in TOML."""
        return dict(_flat(given)) if isinstance(given, dict) else given


def _flat(table: dict[str, Any], before: str = "") -> list[tuple[str, object]]:
    pairs: list[tuple[str, object]] = []
    for name, value in table.items():
        full = before + name
        pairs += _flat(value, full + ".") if isinstance(value, dict) else [(full, value)]
    return pairs


def settings_path() -> Path:
    """The settings file; it need not exist."""
    named = os.environ.get(FILE_VARIABLE)
    if named:
        return Path(named)
    from platformdirs import user_config_path

    return user_config_path("glidecal", appauthor=False) / "settings.toml"


def data_path() -> Path:
    """What the program remembers by itself; it need not exist."""
    from platformdirs import user_data_path

    return user_data_path("glidecal", appauthor=False) / "indicators.json"


def cache_path() -> Path:
    """Where what can be made again is kept; it need not exist."""
    from platformdirs import user_cache_path

    return user_cache_path("glidecal", appauthor=False)


def read_settings(path: Path) -> Settings:
    """The settings of a file; the defaults where there is none. Raises RecordError."""
    return read_toml(path, Settings, WHAT) if path.exists() else Settings()


def save_theme(path: Path, theme: str) -> None:
    """Write the theme into the file and keep the rest as it is.

    Raises RecordError, UsageError where the file is a link.
    """
    from protocols.files import write_files

    settings = read_settings(path).model_copy(update={"theme": theme})
    text = with_theme(read_text(path, WHAT) if path.exists() else "", theme)
    if _settings_in(text) != settings:
        raise RecordError(
            f"{WHAT} {path}", "a form that cannot be changed safely", f'theme = "{theme}" by hand'
        )
    write_files(path, {"": text}, replace=True)


def _settings_in(text: str) -> Settings | None:
    try:
        return Settings.model_validate(tomllib.loads(text))
    except ValueError:
        return None


def with_theme(text: str, theme: str) -> str:
    """TOML text in which the theme stands before the first table."""
    first_table = TABLE_LINE.search(text)
    end = first_table.start() if first_table else len(text)
    quoted = json.dumps(theme, ensure_ascii=False)
    head, count = THEME_LINE.subn(lambda match: match[1] + quoted, text[:end], count=1)
    return head + text[end:] if count else f"theme = {quoted}\n{text}"
