"""Effects of the user: Python files in one folder, and installed packages (entry points)."""

from __future__ import annotations

import os
import runpy
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import TypeVar, cast

from calib.errors import GlidecalError, RecordError
from calib.tripod.effects import BESIDE_CATALOGUE, CATALOGUE
from calib.tripod.effects.contract import fault_of
from calib.tripod.effects.effect import Effect
from protocols.documents import MOST_EDITED_BYTES, read_text

FOLDER_VARIABLE = "GLIDECAL_EFFECTS"
"""Environment variable that names another folder of effects."""

GROUP = "glidecal.effects"
"""Entry points of this group give a law or a tuple of laws."""

NAME = "EFFECTS"

T = TypeVar("T")


def known_effects() -> tuple[Effect, ...]:
    """The catalogue and the user's own effects.

    Raises RecordError naming the file or entry point that cannot be used, and why.
    """
    effects = list(CATALOGUE)
    for source, candidate in (*_from_files(), *_from_entry_points()):
        for item in _run(source, partial(_each, candidate)):
            fault = _run(source, partial(fault_of, item))
            if fault:
                raise _broken(source, fault)
            effect = cast(Effect, item)
            if effect.id in {effect_beside.id for effect_beside in (*effects, *BESIDE_CATALOGUE)}:
                raise _broken(source, f"the id '{effect.id}'", "an id that is not taken")
            effects.append(effect)
    return tuple(effects)


def effects_folder() -> Path:
    """The folder of own effects; it need not exist."""
    folder = os.environ.get(FOLDER_VARIABLE)
    if folder:
        return Path(folder)
    from platformdirs import user_data_path

    return user_data_path("glidecal", appauthor=False) / "effects"


def _from_files() -> Iterator[tuple[str, object]]:
    for path in sorted(effects_folder().glob("*.py")):
        source = f"effect file {path}"
        read_text(path, "effect file", MOST_EDITED_BYTES)  # no pipe, no device, nothing huge
        content = _run(source, partial(runpy.run_path, str(path)))
        if NAME not in content:
            raise _broken(source, f"no {NAME}", f"{NAME} = (a law, …)")
        yield source, content[NAME]


def _from_entry_points() -> Iterator[tuple[str, object]]:
    for point in sorted(entry_points(group=GROUP), key=lambda point_of_name: point_of_name.name):
        source = f"entry point {point.name} = {point.value}"
        yield source, _run(source, point.load)


def _run(source: str, load: Callable[[], T]) -> T:
    """Somebody else's code: whatever it raises is a fault of the file, all but a Ctrl-C itself."""
    try:
        return load()
    except BaseException as problem:
        if type(problem) is KeyboardInterrupt:
            raise
        raise _broken(source, _words_of(problem)) from problem


def _each(candidate: object) -> tuple[object, ...]:
    """What was given; a list of the user's own class runs strange code even here."""
    return tuple(candidate) if isinstance(candidate, tuple | list) else (candidate,)


def _words_of(problem: BaseException) -> str:
    line = getattr(problem, "lineno", None)
    where = f", line {line}" if isinstance(problem, SyntaxError) and line else ""
    name = type(problem).__name__
    try:
        text = " ".join(str(problem).split())
    except BaseException as worse:  # whose words are the file's code too
        return f"{name}, whose words raise {type(worse).__name__}"
    return text if isinstance(problem, GlidecalError) else f"{name}: {text:.300}{where}"


def _broken(source: str, fault: str, allowed: str = "") -> RecordError:
    return RecordError(
        source, fault, allowed, "See docs/effects.md; move the file away to continue without it."
    )
