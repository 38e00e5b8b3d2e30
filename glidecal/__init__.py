"""glidecal in Python: sessions, solutions, diagnoses, tables (docs/python.md).

Lengths are mm, angles rad, times s, temperatures °C. Importing this loads nothing heavy: each name
is loaded when it is first used.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from glidecal.door import *  # noqa: F403 - what is offered is listed there, once
    from glidecal.door import __all__ as __all__

ROOMS = ("app", "calib", "drivers", "protocols")


if not TYPE_CHECKING:  # a type checker would take any name for one that is offered

    def __getattr__(name: str) -> object:
        if name != "__all__" and name not in __dir__():
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(_door(), name)


def __dir__() -> list[str]:
    return list(_door().__all__)


def _door() -> ModuleType:
    if conflict_words := conflict():
        raise ImportError(conflict_words)
    return import_module("glidecal.door")


def conflict() -> str:
    """Which folder of the program belongs to another package, in one sentence; else empty.

    Two packages with a folder of one name overwrite each other's files, and pip does not tell.
    """
    home = Path(__file__).parent.parent
    ours = _installed(home)
    for room in ROOMS:
        loaded = sys.modules.get(room)
        spec = loaded.__spec__ if loaded else find_spec(room)
        place = Path(spec.origin).parent if spec and spec.origin else None
        if place is None or place.resolve() != (home / room).resolve():
            return _refusal(room, f"found in {place}" if place else "not found")
        if not ours:  # not installed from a wheel: the folder is the project's own
            continue
        strange = [entry.name for entry in place.iterdir() if f"{room}/{entry.name}" not in ours]
        if strange:
            return _refusal(room, f"contains {min(strange)} of another package, in {home}")
        if place.joinpath("__init__.py").stat().st_size != ours[f"{room}/__init__.py"]:
            return _refusal(room, f"written over by another package, in {home}")
    return ""


def _installed(home: Path) -> dict[str, int]:
    """Sizes of what pip installed in the rooms, by the two first parts of their paths."""
    sizes = {f"{room}/__pycache__": 0 for room in ROOMS}
    for record in home.glob("glidecal-*.dist-info/RECORD"):
        for line in record.read_text(encoding="utf-8").splitlines():
            path, _, size = line.rsplit(",", 2)
            room, *parts = path.split("/")
            if room in ROOMS and parts:
                sizes[f"{room}/{parts[0]}"] = int(size or 0)
    return sizes if len(sizes) > len(ROOMS) else {}


def _refusal(room: str, fault: str) -> str:
    return (
        f"package '{room}': {fault}. Allowed: the '{room}' that comes with glidecal. Install "
        "glidecal alone: pipx install glidecal, or uv tool install glidecal."
    )
