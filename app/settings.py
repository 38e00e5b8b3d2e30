"""A user's own settings, such as theme and laboratory: one TOML file, read before any screen."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field, field_validator

from calib.errors import RecordError
from protocols.certificate import Laboratory
from protocols.documents import Document, line_of, read_text, read_toml

FILE_VARIABLE = "GLIDECAL_SETTINGS"
"""Environment variable that names another settings file."""

WHAT = "settings file"
THEME_LINE = re.compile(r"""^(\s*["']?theme["']?\s*=\s*)("[^"\n]*"|'[^'\n]*')""", re.MULTILINE)
TABLE_LINE = re.compile(r"^\s*\[", re.MULTILINE)


MODIFIERS = ("ctrl", "shift", "alt", "super", "hyper", "meta")
KEYS_ALLOWED = "a character, or a name such as space, enter, f2, ctrl+t"
IDS_ALLOWED = "an id that glidecal settings lists"


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
    def _ids(cls, value: object) -> object:
        """``measure.take = "x"`` without quotes is a table inside the table in TOML."""
        return dict(_flat(value)) if isinstance(value, dict) else value


def _flat(table: dict[str, Any], prefix: str = "") -> list[tuple[str, object]]:
    pairs: list[tuple[str, object]] = []
    for name, value in table.items():
        full = prefix + name
        pairs += _flat(value, full + ".") if isinstance(value, dict) else [(full, value)]
    return pairs


def settings_path() -> Path:
    """The settings file; it need not exist."""
    file = os.environ.get(FILE_VARIABLE)
    if file:
        return Path(file)
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


class BoundKey(NamedTuple):
    """A key of a screen with the id by which it can be changed, what it does, and words for it."""

    key: str
    id: str
    action: str
    words: str

    @property
    def name(self) -> str:
        """Name for messages."""
        return self.id or self.words or self.action


def split(keys: str) -> list[str]:
    """The keys of one setting; a comma itself is written ``comma``."""
    return [key.strip() for key in keys.split(",")]


def check_theme(path: Path, settings: Settings, themes: Collection[str]) -> None:
    """Raises RecordError naming the file, the line, what was found and what is allowed."""
    if settings.theme is not None and settings.theme not in themes:
        raise _fault(path, ("theme",), repr(settings.theme), ", ".join(themes))


def check_keys(
    path: Path, settings: Settings, places: Sequence[Sequence[BoundKey]], names: Collection[str]
) -> None:
    """Whether every id is one of these, every key one that a terminal can send, and free.

    ``names`` are the names of keys. Raises as `check_theme`.
    """
    ids = {bound.id for place in places for bound in place if bound.id}
    for key_id, keys in settings.keys.items():
        if key_id not in ids:
            raise _fault(path, ("keys", key_id), "an unknown id", IDS_ALLOWED)
        for key in split(keys):
            if not _is_key(key, names):
                raise _fault(path, ("keys", key_id), f"key {key!r}", KEYS_ALLOWED)
    for place in places:
        for key_id, key, other_id in _clashes(settings.keys, place):
            problem = f"{key!r}, which is {other_id} too"
            raise _fault(path, ("keys", key_id), problem, "a key of its own")


def _fault(path: Path, location: tuple[str, ...], problem: str, allowed: str) -> RecordError:
    line = line_of(read_text(path, WHAT), location)
    where = f", line {line}" if line else ""
    return RecordError(f"{WHAT} {path}{where}, {' '.join(location)}", problem, allowed)


def _is_key(key: str, names: Collection[str]) -> bool:
    *modifiers, last = key.split("+") if len(key) > 1 else [key]
    plain = (len(last) == 1 and last.isprintable() and not last.isspace()) or last in names
    return key in names or (plain and all(m in MODIFIERS for m in modifiers))


def _clashes(keys: Mapping[str, str], place: Sequence[BoundKey]) -> Iterator[tuple[str, str, str]]:
    """Id, key and the other key's name, wherever a chosen key does two things on one screen."""
    bound_keys: dict[str, BoundKey] = {}
    usual = {(bound.key, bound.id) for bound in place}
    for bound in place:
        for key in split(keys.get(bound.id, bound.key)):
            earlier = bound_keys.setdefault(key, bound)
            if earlier.action == bound.action or earlier.name == bound.name:
                continue
            pair = (bound.name, earlier.name), (earlier.name, bound.name)
            moved = [names for names in pair if names[0] in keys and (key, names[0]) not in usual]
            if moved:
                yield moved[0][0], key, moved[0][1]
