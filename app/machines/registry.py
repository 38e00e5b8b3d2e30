"""The kinds of machines: which one is meant, and which options it does not take."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import typer

from app.machines import hexaslide, tripod
from app.machines.family import Family

FAMILIES = (tripod.FAMILY, hexaslide.FAMILY)
"""Machine files by path, and files to solve that nobody knows, are of the first."""

NAMES = tuple(name for family in FAMILIES for name in family.names)


def family_of(name: str) -> Family:
    """That of a name, or of the path of a machine file. Raises UsageError for an unknown name."""
    for family in FAMILIES:
        if name in family.names:
            return family
    path = Path(name)
    if path.name == name and not path.suffix and not path.exists():
        from calib.errors import UsageError

        listed = ", ".join(sorted(NAMES))
        raise UsageError("machine", repr(name), f"{listed}, or the path of a machine file")
    return FAMILIES[0]


def family_of_files(name: str | None, files: Sequence[Path]) -> Family:
    """That of a name, else the one that reads these. Raises UsageError for an unknown name."""
    if name is None:
        return next((one for one in FAMILIES if any(map(one.reads, files))), FAMILIES[0])
    if name not in NAMES:
        from calib.errors import UsageError

        raise UsageError("--machine", repr(name), f"{', '.join(NAMES)}, or none: by the file")
    return family_of(name)


def refuse_foreign(
    context: typer.Context, family: Family, found: str, words: Callable[[Family], str] | None = None
) -> None:
    """Raises UsageError for options on the command line that other kinds of machines take.

    ``found`` says what they were given with, ``words`` what of another kind takes them.
    """
    verb = context.command.name or ""
    given = [
        option
        for option in context.command.params
        if option.name and getattr(context.get_parameter_source(option.name), "name", "") == TYPED
    ]
    for other in FAMILIES:
        foreign = other.own.get(verb, frozenset()) - family.own.get(verb, frozenset())
        wrong = [one for one in given if one.name in foreign]
        if wrong and other is not family:
            from calib.errors import UsageError

            names = [
                (one.opts if context.params[one.name or ""] is not False else one.secondary_opts)[0]
                for one in wrong
            ]
            allowed = words(other) if words else f"the machine {other.name}"
            raise UsageError(_listed(names), found, allowed)


TYPED = "COMMANDLINE"
"""Name of the source of a parameter that stands on the command line."""


def _listed(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
