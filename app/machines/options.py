"""Options that several verbs or machines share."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Concatenate, Generic, Literal, TypeVar

import typer
from typer.models import ArgumentInfo, OptionInfo

from calib.errors import UsageError
from protocols.files import unreadable
from protocols.machine_files import USUAL_MACHINE, machine_names

if TYPE_CHECKING:  # heavy: imported where used
    from app.report.certificate import CertificateHead
    from app.report.pages.report import ReportSource
    from app.report.schema.document import Report
    from app.screens import Look, MakeScreen
    from protocols.files import Contents
    from protocols.record import Record


def _finite(value: float | None) -> float | None:
    """Refuse NaN, which no range excludes, and infinity; -0 is 0."""
    if value is None:
        return None
    if not math.isfinite(value):
        raise typer.BadParameter("a finite number is needed")
    return value + 0.0


def _no_trace(value_mm: float | None) -> float | None:
    """Refuse what is neither 0 nor a length that any indicator could have."""
    from protocols.documents import LEAST_FIGURE_MM

    if value_mm and value_mm < LEAST_FIGURE_MM:
        raise typer.BadParameter(f"0, or {LEAST_FIGURE_MM:g} mm at least")
    return _finite(value_mm)


def option(help_text: str, *names: str, **settings: Any) -> OptionInfo:  # noqa: ANN401 (typer's own)
    """An option with this help, under other ``names`` than its parameter's where some are given."""
    information: OptionInfo = typer.Option(*names, help=help_text, **settings)
    return information


figure = partial(option, min=0.0, max=10.0, callback=_no_trace)
"""An option for a small length of an indicator, mm."""


def number(help_text: str, least: float | None = None, most: float | None = None) -> OptionInfo:
    """An option for a finite number."""
    return option(help_text, min=least, max=most, callback=_finite)


def file(
    help_text: str, *names: str, default: str | bool = True, to_read: bool = False
) -> OptionInfo:
    """An option for a file; ``default`` as in typer's ``show_default``."""
    # readable=False: our own message and exit status for a file without permission
    callback = there if to_read else None
    return option(help_text, *names, show_default=default, readable=False, callback=callback)


def argument(help_text: str, *, to_read: bool = True) -> ArgumentInfo:
    """A file, or several, without an option's name; to be read, it must be there at once."""
    information: ArgumentInfo = typer.Argument(
        help=help_text, show_default=False, readable=False, callback=there if to_read else None
    )
    return information


def there(paths: Path | list[Path] | None) -> Path | list[Path] | None:
    """Check that the files exist, before anything heavy is imported. Raises RecordError."""
    for path in paths if isinstance(paths, list) else [paths] if paths else []:
        try:
            path.stat()
        except FileNotFoundError as problem:
            raise unreadable(f"file {path}", problem) from problem
        except (OSError, ValueError):
            pass  # whoever reads it says why that is impossible
    return paths


machine_option = partial(option, show_default=USUAL_MACHINE)
"""An option for a machine, by name or file; without it the usual one is taken."""


def parts(listed: str | None) -> tuple[str, ...]:
    """What stands between commas."""
    return tuple(part.strip() for part in listed.split(",")) if listed and listed.strip() else ()


def may_replace(force: bool, *targets: Path | None) -> bool:
    """Whether files that are there may be replaced: by ``--force``, else a terminal is asked.

    Ask before long work, and write with the answer. Raises FilesThere where nobody can be asked.
    """
    from protocols.files import FilesThere, check_targets

    try:
        check_targets([target for target in targets if target], replace=force)
    except FilesThere as problem:
        if not (sys.stdin.isatty() and sys.stderr.isatty()):
            raise
        typer.confirm(f"{problem.words}. Replace?", abort=True, err=True)
        return True
    return force


def check_ending(output: Path | None, suffix: str) -> None:
    """Raises UsageError for the name of a file to write that does not end so."""
    if output is not None and output.name != "-" and output.suffix != suffix:
        raise UsageError("--output", f"{output}", f"a path that ends with {suffix}")


def may_write(output: Path | None, suffix: str, *, force: bool) -> bool:
    """Check a target like `check_ending` and `may_replace`."""
    check_ending(output, suffix)
    return may_replace(force, output)


def may_deliver(output: Path, *, force: bool, folder: bool = False, suffix: str = "") -> bool:
    """Check what `deliver` will write like `may_write`, before the work; any name without a suffix.

    Into a ``folder`` that is there `deliver` looks itself: what files it gets is known only then.
    Raises UsageError where a folder is needed and the output is another thing.
    """
    from protocols.files import STANDARD_OUTPUT

    if output == STANDARD_OUTPUT and not folder:
        return force
    if folder and output.is_dir():
        return force
    if folder and output.exists():
        raise UsageError("output", f"{output}, not a folder", "a folder: these are several files")
    return may_write(output, suffix or output.suffix, force=force)


def deliver(output: Path, contents: Contents, *, force: bool) -> None:
    """Write the files of a result and say so; one text goes to standard output for ``-o -``.

    Raises as `may_replace` and `write_files`.
    """
    from protocols.files import STANDARD_OUTPUT, targets_of, write_files

    text = contents.get("")
    if output == STANDARD_OUTPUT and isinstance(text, str):
        typer.echo(text, nl=False)
        return
    may = may_replace(force, *targets_of(output, contents))
    for path in write_files(output, contents, replace=may):
        say(f"written: {path}")


@contextmanager
def working(text: str, parts_name: str = "") -> Iterator[None]:
    """Tells a terminal what is under way, for how long, and how far where that is known.

    How far is "412 of 1,000 sessions" where the parts have that name. Nothing may be said
    meanwhile.
    """
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TimeElapsedColumn

    from calib.clusters import on_part

    columns = ("{task.description}", BarColumn(), "{task.fields[far]}", TimeElapsedColumn())
    # a bar needs the terminal's own codes, and shows no text of a file
    with Progress(*columns, console=Console(file=sys.__stderr__), transient=True) as bar:
        task = bar.add_task(f"{text}, Ctrl-C stops", total=None, far="")

        def show(count: float, parts: int) -> None:
            far = f"{count:,.0f} of {parts:,} {parts_name}" if parts_name else ""
            bar.update(task, completed=count, total=parts, far=far)

        token = on_part.set(show)
        try:
            yield
        finally:
            on_part.reset(token)


def say(text: str) -> None:
    """Progress and warnings go to standard error."""
    typer.echo(text, err=True)


def tell_warnings(warnings: Iterable[str]) -> None:
    """What session files warn of, what is not used, what an export leaves out."""
    for warning in warnings:
        say(f"glidecal: {warning}")


Sessions = Annotated[list[Path], argument("Session files.")]
Force = Annotated[bool, option("Replace existing files; a session is never replaced.", "--force")]
Output = Annotated[Path, file("File to write.", "--output", "-o", default=False)]
Machine = Annotated[
    str | None, machine_option(f"{', '.join(machine_names())}, or a machine file (TOML).")
]
Protocol = Annotated[
    str | None,
    option("Procedure by name, or a .toml file of your own.", show_default="the machine's"),
]
Seed = Annotated[int, option("Seed of the simulation.", min=0)]
AsJson = Annotated[bool, option("One JSON document on standard output.", "--json")]
Channel = Annotated[int, option("Input of an interface.", min=1, max=99)]
SubsetName = Literal["joint-offsets", "leg-lengths", "both", "with-tolerances"]
HoldsName = Annotated[
    Literal["offsets", "play", "tables", "kinematics"],
    option("What the controller can take; the values are for it.", "--holds"),
]
FrameName = Annotated[
    Literal["touched-off", "aligned", "machine"] | None,
    option(
        "How workpieces are set: touched-off (a shift is free), aligned (shift and turn), or "
        "machine (its own frame).",
        "--frame",
        show_default="that of the machine file",
    ),
]
Method = Annotated[
    Literal["linear", "exact"], option("linear: system (11); exact: nonlinear, raw readings.")
]

MacroName = Annotated[
    Literal["klipper", "reprapfirmware", "marlin"] | None,
    option(
        "Write the places over the plate as G-code for the firmware's probe instead: klipper, "
        "reprapfirmware or marlin.",
        "--macro",
    ),
]
PrintableRadius = Annotated[
    float | None,
    number(
        "With --macro: radius of the circle that the firmware prints in, mm; default: that of the "
        "machine file, else what towers and bars allow.",
        least=1.0,
        most=10_000.0,
    ),
]

SCATTER_MM, RESOLUTION_MM = 0.002, 0.001
"""Of a simulated machine and its indicators where nothing is asked for."""


R = TypeVar("R")


@dataclass(frozen=True)
class Answer(Generic[R]):
    """A result that can be told as text or as a document."""

    result: R
    text: Callable[[R], str]
    document: Callable[[R], Report]

    def show(self, *, as_json: bool) -> None:
        """Print one of them."""
        from app.report.schema.document import to_json

        typer.echo(to_json(self.document(self.result)) if as_json else self.text(self.result))


@dataclass(frozen=True)
class ScreenAnswer:
    """A result that is looked at on a screen."""

    screen: MakeScreen


def machine_file_of(machine: str, names: Sequence[str], machine_file: Path | None) -> Path | None:
    """The file of a machine: ``machine_file``, or what stands where one of the ``names`` may stand.

    Raises UsageError for two files.
    """
    if machine in names:
        return machine_file
    if machine_file is not None:
        raise UsageError("--machine-file", f"beside the machine file {machine}", "one machine file")
    return Path(machine)


Place = tuple[float, float, float]
"""Of the tool, mm from Zero."""


def finite_place(place_mm: Place | None) -> Place | None:
    """Refuse NaN and infinity in any coordinate."""
    for value_mm in place_mm or ():
        _finite(value_mm)
    return place_mm


@dataclass(frozen=True)
class PostureSearch:
    """How postures are looked for; None: not given. With ``force`` a file is replaced unasked."""

    count: int | None
    criterion: str
    seed: int
    starts: int
    output: Path | None
    force: bool


@dataclass(frozen=True)
class SessionVerbs:
    """What a kind of machine does with sessions of its own form.

    ``run`` and ``imported`` have so many arguments that all are given by name; options of theirs as
    in `Family`.
    ``validated`` is a session and its record, raising RecordError; ``exported`` are the files of a
    format, by name, with cautions; ``diagnosed`` is beside a model, and writes one with a named
    effect, or a candidate, where a path is given; ``compared`` is of two sessions of one machine,
    ``verified`` has the decision of `app.exit_codes.VERIFIED` beside the answer; ``reported`` is
    what the report of a session is written from, with a later one, a tolerance in mm, and the head
    of a certificate where they are given; ``modelled`` is a model file in words and as it stands,
    without an effect where one is named, for a reason.
    """

    run: Callable[..., None]
    imported: Callable[..., None]
    validated: Callable[[Path], tuple[Any, Record]]
    replayed: Callable[[Path], Answer[Any]]
    exported: Callable[[Path, str], tuple[Contents, tuple[str, ...]]]
    verified: Callable[[Path, Path, float | None], tuple[Answer[Any], str]]
    diagnosed: Callable[[Path, Path | None, Path | None, str | None, bool], Answer[Any]]
    compared: Callable[[Path, Path], Answer[Any]]
    reported: Callable[[Path, Path | None, float | None, CertificateHead | None], ReportSource]
    modelled: Callable[[Path, str, str], tuple[str, str]]


@dataclass(frozen=True)
class Family:
    """One kind of machine.

    ``name`` stands for all of ``names``, ``schema`` is that of its machine files; ``measured`` says
    what its files to solve are, ``reads`` tells whether a file is one. ``criterion`` is what its
    postures are chosen by where nothing is asked for, ``posture_file`` what they are written to.
    Options that not every kind takes are keywords of the functions, with their `typer.Option`; what
    comes before them is of the verb. Without ``plan`` there is no next measurement to propose.
    ``look`` is its screen that needs no session. ``workspace`` tells where the tool can be; None:
    not known. ``sessions`` are the verbs of sessions that are not those of indicators on legs.
    """

    name: str
    names: tuple[str, ...]
    schema: str
    measured: str
    criterion: str
    posture_file: str
    reads: Callable[[Path], bool]
    identifiability: Callable[
        Concatenate[str, str | None, Path | None, ...], Answer[Any] | ScreenAnswer
    ]
    postures: Callable[Concatenate[str, str, Path | None, PostureSearch, ...], Answer[Any]]
    simulate: Callable[Concatenate[Path, str | None, int, bool, ...], None]
    solve: Callable[Concatenate[Sequence[Path], ...], Answer[Any]]
    plan: Callable[Concatenate[str | None, Sequence[Path], ...], Answer[Any]] | None = None
    workspace: Callable[[str, float, Place | None], Answer[Any]] | None = None
    look: Look | None = None
    sessions: SessionVerbs | None = None
