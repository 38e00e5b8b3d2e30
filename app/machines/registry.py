"""The kinds of machines: which one is meant, and the options that come from it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Container, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import typer
from typer.core import TyperCommand, TyperOption

from app.machines import hexaslide, tripod
from app.machines.options import Family
from calib.errors import RecordError, UsageError
from protocols.machine_files import model_form, schema_of

FAMILIES = (tripod.FAMILY, hexaslide.FAMILY)
"""Machine files of no known schema, and files to solve that nobody knows, are of the first."""

NAMES = tuple(name for family in FAMILIES for name in family.names)
NAMES_OF_FILES = tuple(name for family in FAMILIES[1:] for name in family.names)
"""Machines of which files of measurements need not be sessions."""


def _listed_machines(families: Iterable[Family]) -> str:
    names = (name for family in families for name in family.names)
    return f"{', '.join(names)}, or a machine file (TOML)."


LISTED = _listed_machines(FAMILIES)
HAVE_WORKSPACE = _listed_machines(family for family in FAMILIES if family.workspace)

CRITERIA = "; ".join(
    family.criterion if family is FAMILIES[0] else f"{family.criterion} for a {family.name}"
    for family in FAMILIES
)
POSTURE_FILES = "; ".join(family.posture_file for family in FAMILIES)
"""What postures are chosen by and written to, in the help."""

LOOKS = tuple(family.look for family in FAMILIES if family.look is not None)
"""What the home screen offers of machines."""

NAMED_BESIDE = "With the name of a machine, --help shows the options of that machine only."
"""Below the help of a `CommandOfMachines`."""

OF_INDICATORS = {
    "run": (
        *("port", "profile", "random_order", "headless"),
        *("motion", "prove", "until", "macro", "printable_radius"),
    ),
    "import": (
        *("machine_file_out", "resolution", "repeatability"),
        *("distances", "distance_deviation"),
    ),
}
"""By verb, options that no machine with sessions of its own form takes."""

C = TypeVar("C", bound=Callable[..., None])


def family_of(name: str) -> Family:
    """The family of a name, or of a machine file by the schema it names.

    A file that cannot be read is of the first, which says why. Raises UsageError for an unknown
    name.
    """
    from protocols.documents import read_text

    for family in FAMILIES:
        if name in family.names:
            return family
    path = Path(name)
    if path.name == name and not path.suffix and not path.exists():
        listed = ", ".join(sorted(NAMES))
        raise UsageError("machine", repr(name), f"{listed}, or the path of a machine file")
    try:
        schema = schema_of(read_text(path, "machine file"))
    except RecordError:
        return FAMILIES[0]
    kind = schema.partition("/")[0]  # older files of a machine are of the same kind
    return next(
        (family for family in FAMILIES if family.schema.partition("/")[0] == kind), FAMILIES[0]
    )


def family_of_files(name: str | None, files: Sequence[Path]) -> Family:
    """The family of a name, else the one that reads the files. Raises UsageError."""
    if name is None:
        return next((family for family in FAMILIES if any(map(family.reads, files))), FAMILIES[0])
    if name not in NAMES_OF_FILES:
        allowed = f"{', '.join(NAMES_OF_FILES)}, or none: a session names its machine"
        raise UsageError("--machine", repr(name), allowed)
    return family_of(name)


def family_of_model(path: Path) -> Family:
    """The family of a model file; the first for one that names no other kind."""
    form = model_form(path)
    return next((family for family in FAMILIES if family.name == form), FAMILIES[0])


def family_with(verb: str, name: str | None) -> tuple[Family, Any]:
    """The family of a name (None: the first), with its answer to a verb that not all kinds have.

    Raises UsageError for one that has not, and for an unknown name.
    """
    able = [family for family in FAMILIES if getattr(family, verb) is not None]
    family = able[0] if name is None else family_of(name)
    if family not in able:
        listed = ", ".join(name_of_family for family in able for name_of_family in family.names)
        allowed = f"{listed}, or the path of a file of such a machine"
        next_step = f"There is no glidecal {verb} for a {family.name}."
        raise UsageError("machine", repr(name), allowed, next_step)
    return family, getattr(family, verb)


def with_options_of_machines(command: C) -> C:
    """A command whose ``**machine_options`` are those of every kind of machine."""
    plain = inspect.signature(command, eval_str=True)
    shared = [p for p in plain.parameters.values() if p.kind is not p.VAR_KEYWORD]
    verb = command.__name__.removesuffix("_table")  # import is no name of a function
    of_machines = {name: p for family in FAMILIES for name, p in _own(family, verb).items()}
    signature = plain.replace(parameters=[*shared, *of_machines.values()])
    vars(command)["__signature__"] = signature  # what typer makes the options of
    return command


class CommandOfMachines(TyperCommand):
    """A verb whose help, beside a machine's name, leaves out the options of other kinds alone."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401 (typer's own)
        """Parse like any command; the help is then of the machine that is named."""
        arguments = {word for part in args for word in (part, part.partition("=")[2])}
        named_family = next(
            (family for family in FAMILIES if arguments.intersection(family.names)), None
        )
        verb = self.name or ""
        all_options = {name for family in FAMILIES for name in _own(family, verb)}
        other_options = all_options - _own(named_family, verb).keys() if named_family else set()
        if named_family is not None and named_family.sessions is not None:
            other_options |= {*OF_INDICATORS.get(verb, ())}
        for option in self.params:
            if isinstance(option, TyperOption):
                option.hidden = option.name in other_options
        return super().parse_args(ctx, args)


def options_of(
    context: typer.Context,
    family: Family,
    kind_words: str,
    values: dict[str, Any],
    words_of: Callable[[Family], str] = lambda family_beside: f"the machine {family_beside.name}",
) -> dict[str, Any]:
    """What was given of the options of a kind. Raises UsageError for those of others alone.

    ``kind_words`` says what they were given with, ``words_of`` what of another kind takes them.
    """
    verb = context.command.name or ""
    own_options = _own(family, verb)
    for family_beside in FAMILIES:
        if wrong := typed(context, _own(family_beside, verb).keys() - own_options.keys()):
            raise UsageError(wrong, kind_words, words_of(family_beside))
    return {name: values[name] for name in own_options}


def _own(family: Family, verb: str) -> dict[str, inspect.Parameter]:
    """Options of a verb that come from this kind of machine: keywords of what answers it there."""
    answers = {**vars(family), **(vars(family.sessions) if family.sessions else {})}
    answer = answers.get("imported" if verb == "import" else verb)
    if answer is None:
        return {}
    parameters = inspect.signature(answer, eval_str=True).parameters
    return {name: p for name, p in parameters.items() if p.kind is p.KEYWORD_ONLY}


def the_session(
    context: typer.Context, sessions: Sequence[Path], of_indicators: Container[str]
) -> Path:
    """The session of a machine with sessions of its own form, one for each call.

    Raises UsageError for more of them, and for options that are ``of_indicators`` on legs.
    """
    if wrong := typed(context, of_indicators):
        raise UsageError(wrong, f"session {sessions[0]}", "sessions of indicators on legs")
    if len(sessions) > 1:
        verb = context.command.name or ""
        raise UsageError(verb, f"{len(sessions)} sessions", "one of this kind of machine")
    return sessions[0]


def typed(context: typer.Context, names: Container[str]) -> str:
    """The parameters among these that are on the command line: ``--a, --b and --c``."""
    types = [
        (option.opts if context.params[option.name] is not False else option.secondary_opts)[0]
        for option in context.command.params
        if option.name in names
        and getattr(context.get_parameter_source(option.name), "name", "") == "COMMANDLINE"
    ]
    return " and ".join([", ".join(types[:-1]), types[-1]] if len(types) > 1 else types)
