"""Effects of the user: Python files in one folder, and installed packages (entry points)."""

from __future__ import annotations

import os
import re
import runpy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from calib.errors import GlidecalError
from calib.observations import Conditions, conditions
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectParameter, Kind, Law, Placed
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Stage, simulate
from protocols.documents import MOST_WRITTEN_BYTES, read_text
from protocols.errors import RecordError

FOLDER_VARIABLE = "GLIDECAL_EFFECTS"
"""Environment variable that names another folder of effects."""

GROUP = "glidecal.effects"
"""Entry points of this group give a law or a tuple of laws."""

NAME = "EFFECTS"
ID = re.compile(r"[a-z][a-z0-9_]{1,39}")
WORDS = ("id", "title", "controller")

TRIED_MM = (1.0, -0.7, 0.5, 0.1, -0.1, 0.05)
"""Offsets and lengths of the machine on which a law is tried: its indicators show something."""

LEAST_TOLERANCE, MOST_TOLERANCE = 1e-9, 1e9

T = TypeVar("T")


def known_laws() -> tuple[Law, ...]:
    """The catalogue and the user's own effects.

    Raises RecordError naming the file or entry point that cannot be used, and why.
    """
    laws = list(CATALOGUE)
    for source, given in (*_from_files(), *_from_entry_points()):
        for law in _run(source, partial(_laws_in, given)):
            checked = _checked(source, law)
            if checked.id in {known.id for known in laws}:
                raise _broken(source, f"the id '{checked.id}'", "an id that is not taken")
            laws.append(checked)
    return tuple(laws)


def effects_folder() -> Path:
    """The folder of own effects; it need not exist."""
    named = os.environ.get(FOLDER_VARIABLE)
    if named:
        return Path(named)
    from platformdirs import user_data_path

    return user_data_path("glidecal", appauthor=False) / "effects"


def _from_files() -> Iterator[tuple[str, object]]:
    for path in sorted(effects_folder().glob("*.py")):
        source = f"effect file {path}"
        read_text(path, "effect file", MOST_WRITTEN_BYTES)  # no pipe, no device, nothing huge
        content = _run(source, partial(runpy.run_path, str(path)))
        if NAME not in content:
            raise _broken(source, f"no {NAME}", f"{NAME} = (a law, …)")
        yield source, content[NAME]


def _from_entry_points() -> Iterator[tuple[str, object]]:
    for point in sorted(entry_points(group=GROUP), key=lambda found: found.name):
        source = f"entry point {point.name} = {point.value}"
        yield source, _run(source, point.load)


def _run(source: str, load: Callable[[], T]) -> T:
    """Somebody else's code: whatever it raises is a fault of the file, all but a Ctrl-C itself."""
    try:
        return load()
    except BaseException as problem:
        if type(problem) is KeyboardInterrupt:
            raise
        raise _broken(source, _said(problem)) from problem


def _laws_in(given: object) -> tuple[object, ...]:
    return tuple(given) if isinstance(given, tuple | list) else (given,)


def _checked(source: str, given: object) -> Law:
    """The law, tried at every place with an unremarkable size."""
    fault = _run(source, partial(_fault_of, given))
    if fault:
        raise _broken(source, fault)
    law = cast(Law, given)
    fault = _run(source, partial(_fault_of_change, law))
    if fault:
        raise _broken(source, f"{law.id}: {fault}")
    return law


def _fault_of(given: object) -> str:
    """What it lacks to be a law; empty if nothing."""
    if not all(isinstance(getattr(given, name, None), str) for name in WORDS):
        return f"{given!r:.80}, which lacks one of the texts {', '.join(WORDS)}"
    law = cast(Law, given)
    if not ID.fullmatch(law.id):
        return f"the id {law.id!r}, not of small letters, digits and _"
    if not isinstance(law.kind, Kind) or not isinstance(law.stage, Stage):
        return f"{law.id}: kind or stage that is no Kind or no Stage"
    parameters = law.parameters
    if not parameters or not all(isinstance(p, EffectParameter) for p in parameters):
        return f"{law.id}: parameters that are no EffectParameter"
    if not all(LEAST_TOLERANCE <= p.tolerance <= MOST_TOLERANCE for p in parameters):
        return f"{law.id}: a tolerance outside {LEAST_TOLERANCE:g} … {MOST_TOLERANCE:g}"
    return ""


@np.errstate(all="ignore")  # what is not finite is told below
def _fault_of_change(law: Law) -> str:
    """What is wrong with the readings that it makes; empty if nothing."""
    legs, axes = [0, 0, 1, 1, 2, 2] * 3, [1, 2, 0, 2, 0, 1] * 3
    taken = conditions(legs, axes, [0.0] * 6 + [60.0] * 6 + [-100.0] * 6)
    places = law.places(taken)
    if not places or not all(isinstance(place, str) for place in places):
        return "places that are no texts, or none"
    faults = (_fault_at(_Trial(law, place, taken)) for place in places)
    return next((fault for fault in faults if fault), "")


@dataclass(frozen=True)
class _Trial:
    """A law at one place of a machine that is a little off."""

    law: Law
    place: str
    taken: Conditions

    def readings(self, step: complex, size: float = 1.0) -> NDArray[Any]:
        """Readings with every value, and the machine, a step further."""
        values = tuple(size * p.tolerance * (1 + step) for p in self.law.parameters)
        parameters = np.array(TRIED_MM) * (1 + step)
        effect = Placed(self.law, self.place, values)
        return simulate(Geometry(), parameters, self.taken, (effect,))


def _fault_at(trial: _Trial) -> str:
    plain = simulate(Geometry(), TRIED_MM, trial.taken)
    shown = trial.readings(0.0)
    if shown.shape != plain.shape or not np.all(np.isfinite(shown)):
        return f"readings of shape {shown.shape} or not finite at {trial.place}"
    if np.abs(trial.readings(0.0, size=0.0) - plain).max() > 1e-12:
        return f"a value of 0 changes readings at {trial.place}"
    exact = trial.readings(1e-20j).imag / 1e-20
    central = (trial.readings(1e-5) - trial.readings(-1e-5)) / 2e-5
    if np.abs(exact - central).max() > 1e-6:
        return f"complex values do not pass at {trial.place}"
    return ""


def _said(problem: BaseException) -> str:
    line = getattr(problem, "lineno", None)
    where = f", line {line}" if isinstance(problem, SyntaxError) and line else ""
    name = type(problem).__name__
    try:
        words = " ".join(str(problem).split())
    except BaseException as worse:  # whose words are the file's code too
        return f"{name}, whose words raise {type(worse).__name__}"
    return words if isinstance(problem, GlidecalError) else f"{name}: {words:.300}{where}"


def _broken(source: str, found: str, allowed: str = "") -> RecordError:
    return RecordError(
        source,
        found,
        allowed,
        "See docs/effects.md; move the file away to go on without it.",
    )
