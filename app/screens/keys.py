"""Every key of every screen by its id."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from pathlib import Path

from textual.app import App
from textual.binding import Binding, BindingsMap
from textual.keys import Keys
from textual.screen import Screen
from textual.theme import BUILTIN_THEMES

from app.report.text.home import KeyRow
from app.settings import BoundKey, Settings, check_keys, check_theme, read_settings

NAMED_KEYS = frozenset(key.value for key in Keys) | {"space", "comma"}


def known_keys() -> dict[str, KeyRow]:
    """Every binding that has an id, in the order of the ids."""
    by_id: dict[str, KeyRow] = {}
    for bound in (bound for place in _places() for bound in place if bound.id):
        _, former_keys, _ = by_id.get(bound.id, ("", (), ""))
        keys = tuple(dict.fromkeys([*former_keys, bound.key]))
        by_id[bound.id] = bound.id, keys, bound.words or bound.action
    return dict(sorted(by_id.items()))


def settings_for_screens(path: Path) -> Settings:
    """The settings of a file, checked against themes and keys. Raises RecordError."""
    settings = read_settings(path)
    check_theme(path, settings, BUILTIN_THEMES)
    if settings.keys:  # what follows loads every screen
        check_keys(path, settings, _places(), NAMED_KEYS)
    return settings


_usual: dict[str, str] = {}


def usual_key(key_id: str) -> str | None:
    """The first key of an id without settings, among the screens that are loaded by now."""
    if key_id not in _usual:
        for kind in (*_ours(App), *_ours(Screen)):
            for key, binding in bindings_of(kind):
                _usual.setdefault(binding.id or "", key)
    return _usual.get(key_id)


def _places() -> tuple[tuple[BoundKey, ...], ...]:
    """The keys of each screen together with those of the application."""
    for module in pkgutil.iter_modules(importlib.import_module("app.screens").__path__):
        importlib.import_module(f"app.screens.{module.name}")
    everywhere = tuple(key for kind in _ours(App) for key in _bound(kind))
    screens = (tuple(_bound(kind)) for kind in _ours(Screen))
    return tuple(of_screen + everywhere for of_screen in screens if of_screen)


def _bound(kind: type[object]) -> Iterator[BoundKey]:
    for key, binding in bindings_of(kind):
        action = binding.action.removeprefix("app.")
        yield BoundKey(key, binding.id or "", action, binding.description)


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
