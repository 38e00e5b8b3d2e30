"""Every key of every screen by its id, and whether a user's settings fit them."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from pathlib import Path

from textual.app import App
from textual.binding import Binding, BindingsMap
from textual.keys import Keys
from textual.screen import Screen
from textual.theme import BUILTIN_THEMES

from app.report.text.home import KeyRow
from app.settings import WHAT, Settings, read_settings
from calib.errors import RecordError
from protocols.documents import line_of, read_text

MODIFIERS = ("ctrl", "shift", "alt", "super", "hyper", "meta")
KEYS_ALLOWED = "a character, or a name such as space, enter, f2, ctrl+t"
IDS_ALLOWED = "an id that glidecal settings lists"
KEY_WORDS = {"comma": ",", "plus": "+", "minus": "-", "pageup": "page up", "pagedown": "page down"}
NAMED_KEYS = frozenset(key.value for key in Keys) | {"space", "comma"}


def known_keys() -> dict[str, KeyRow]:
    """Every binding that has an id, in the order of the ids."""
    by_id: dict[str, KeyRow] = {}
    for place in _places():
        for key, binding in place:
            if binding.id:
                _, before, _ = by_id.get(binding.id, ("", (), ""))
                keys = tuple(dict.fromkeys([*before, key]))
                by_id[binding.id] = binding.id, keys, binding.description or binding.action
    return dict(sorted(by_id.items()))


def settings_for_screens(path: Path) -> Settings:
    """The settings of a file, checked against themes and keys.

    Raises RecordError naming the file, the line, what was found and what is allowed.
    """
    settings = read_settings(path)
    if settings.theme is not None and settings.theme not in BUILTIN_THEMES:
        raise _fault(path, ("theme",), repr(settings.theme), ", ".join(BUILTIN_THEMES))
    if not settings.keys:
        return settings  # what follows loads every screen
    ids = known_keys()
    for key_id, keys in settings.keys.items():
        if key_id not in ids:
            raise _fault(path, ("keys", key_id), "an unknown id", IDS_ALLOWED)
        for key in split(keys):
            if not is_key(key):
                raise _fault(path, ("keys", key_id), f"key {key!r}", KEYS_ALLOWED)
    for key_id, key, beside in clashes(settings.keys):
        problem = f"{key!r}, which is {beside} too"
        raise _fault(path, ("keys", key_id), problem, "a key of its own")
    return settings


def _fault(path: Path, location: tuple[str, ...], found: str, allowed: str) -> RecordError:
    line = line_of(read_text(path, WHAT), location)
    where = f", line {line}" if line else ""
    return RecordError(f"{WHAT} {path}{where}, {' '.join(location)}", found, allowed)


def split(keys: str) -> list[str]:
    """The keys of one setting; a comma itself is written ``comma``."""
    return [key.strip() for key in keys.split(",")]


def key_words(key: str) -> str:
    """A key as a person calls it: ``Space``, ``F2``, ``Ctrl+T``."""
    parts = (KEY_WORDS.get(part, part) for part in key.split("+"))
    return "+".join(part.upper() if len(part) == 1 else part.capitalize() for part in parts)


_usual: dict[str, str] = {}


def usual_key(key_id: str) -> str | None:
    """The first key of an id without settings, among the screens that are loaded by now."""
    if key_id not in _usual:
        for kind in (*_ours(App), *_ours(Screen)):
            for key, binding in bindings_of(kind):
                _usual.setdefault(binding.id or "", key)
    return _usual.get(key_id)


def is_key(key: str) -> bool:
    """Whether a terminal can send this key at all."""
    *modifiers, last = key.split("+") if len(key) > 1 else [key]
    plain = (len(last) == 1 and last.isprintable() and not last.isspace()) or last in NAMED_KEYS
    return key in NAMED_KEYS or (plain and all(m in MODIFIERS for m in modifiers))


def clashes(chosen: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:
    """Id, key and the other binding, wherever a chosen key does two things on one screen."""
    for place in _places():
        used: dict[str, Binding] = {}
        usual = {(key, binding.id) for key, binding in place}
        in_force = ((k, b) for key, b in place for k in split(chosen.get(b.id or "", key)))
        for key, binding in in_force:
            earlier = used.setdefault(key, binding)
            name, other_name = _name(binding), _name(earlier)
            if _action(earlier) == _action(binding) or name == other_name:
                continue
            moved = [n for n in (name, other_name) if n in chosen and (key, n) not in usual]
            if moved:
                yield moved[0], key, other_name if moved[0] == name else name


def _name(binding: Binding) -> str:
    return binding.id or binding.description or binding.action


def _action(binding: Binding) -> str:
    return binding.action.removeprefix("app.")


def _places() -> tuple[tuple[tuple[str, Binding], ...], ...]:
    """The bindings of each screen together with those of the application."""
    for module in pkgutil.iter_modules(importlib.import_module("app.screens").__path__):
        importlib.import_module(f"app.screens.{module.name}")
    everywhere = tuple(pair for kind in _ours(App) for pair in bindings_of(kind))
    screens = (tuple(bindings_of(kind)) for kind in _ours(Screen))
    return tuple(of_screen + everywhere for of_screen in screens if of_screen)


def _ours(kind: type[object]) -> Iterator[type[object]]:
    for below in kind.__subclasses__():
        if below.__module__.startswith("app.screens."):
            yield below
        yield from _ours(below)


def bindings_of(kind: type[object]) -> Iterator[tuple[str, Binding]]:
    """Key and binding, inherited ones included; a nearer one hides a farther one."""
    keys: set[str] = set()
    for base in kind.__mro__:
        nearer = BindingsMap(base.__dict__.get("BINDINGS", ())).key_to_bindings
        yield from (
            (key, b) for key, bindings in nearer.items() if key not in keys for b in bindings
        )
        keys |= nearer.keys()
