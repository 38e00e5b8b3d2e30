"""The command line: verbs only, one file each in ``app/commands``; imports nothing heavy."""

from __future__ import annotations

import contextlib
import copy
import errno
import gc
import os
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from app.commands import demo, diagnose, indicators, measuring, planning, results, sessions
from app.exit_codes import Exit, exit_code
from app.machines.registry import LOOKS, NAMED_BESIDE, CommandOfMachines
from app.report.streams import guard_standard_streams, need_terminal
from app.version import program
from calib.errors import GlidecalError, RecordError


class Verbs(TyperGroup):
    """What a person reads of an option that does not fit is in our words, as of a file."""

    def invoke(self, ctx: Any) -> Any:  # noqa: ANN401 (typer's own)
        """Run a verb like any group of commands. Raises BadParameter."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as problem:
            problem.message = _plain(problem)
            raise


def _plain(problem: typer.BadParameter) -> str:
    from pydantic import ValidationError

    from protocols.documents import fault_words

    if not isinstance(problem.__cause__, ValidationError):
        return problem.message
    fault = problem.__cause__.errors()[0]
    message = fault_words(fault)
    return message if fault["type"] == "value_error" else f"{message} (found {fault['input']!r})"


cli = typer.Typer(
    name="glidecal",
    cls=Verbs,
    help="Calibrate parallel kinematic machines with comparator indicators.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _show_version(version_asked: bool) -> None:
    if version_asked:
        typer.echo(program())
        raise typer.Exit


@cli.callback(invoke_without_command=True)
def home(
    context: typer.Context,
    _version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show version.")
    ] = False,
    no_animations: Annotated[
        bool, typer.Option("--no-animations", help="Nothing on the screen glides or fades.")
    ] = False,
) -> None:
    """Open the terminal interface where no verb is given."""
    if no_animations:
        os.environ["TEXTUAL_ANIMATIONS"] = "none"  # Textual reads it once, when imported
    if context.invoked_subcommand is None:
        need_terminal("terminal interface", "a verb: see glidecal --help")
        from app.screens.interface import open_screen, screen_of

        raise typer.Exit(open_screen(screen_of("home.HomeScreen"), LOOKS))


def settings() -> None:
    """The settings file, its values, and every key."""
    from app.report.text.home import settings_text
    from app.screens.keys import known_keys, settings_for_screens
    from app.settings import settings_path

    path = settings_path()
    present = settings_for_screens(path)
    typer.echo(settings_text(path, path.exists(), present, known_keys().values()))


cli.command("demo")(demo.demo)
cli.command("run", cls=CommandOfMachines, epilog=NAMED_BESIDE)(measuring.run)
cli.command("align")(measuring.align)
cli.command("import", cls=CommandOfMachines, epilog=NAMED_BESIDE)(sessions.import_table)
cli.command("replay")(sessions.replay)
cli.command("serve")(sessions.serve)
cli.command("solve", cls=CommandOfMachines, epilog=NAMED_BESIDE)(results.solve)
cli.command("diagnose")(diagnose.diagnose)
cli.command("model")(diagnose.model)
cli.command("compare")(results.compare)
cli.command("verify")(results.verify)
cli.command("history")(results.history)
cli.command("simulate", cls=CommandOfMachines, epilog=NAMED_BESIDE)(sessions.simulate)
cli.command("machine")(planning.machine)
cli.command("plan")(planning.plan)
cli.command("identifiability", cls=CommandOfMachines, epilog=NAMED_BESIDE)(planning.identifiability)
cli.command("postures", cls=CommandOfMachines, epilog=NAMED_BESIDE)(planning.postures)
cli.command("workspace")(planning.workspace)
cli.command("export")(results.export)
cli.command("report")(results.report)
cli.command("validate")(sessions.validate)
cli.command("ports")(indicators.ports)
cli.command("settings")(settings)
cli.add_typer(indicators.indicator_verbs, name="indicator")
cli.command("simulate-indicator")(indicators.simulate_indicator)


def main() -> None:
    """Run the program; every error meant for a person becomes one paragraph and a status."""
    # numpy reads it once; for matrices as small as ours, waiting threads cost more than they help
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # documents have no plugins of pydantic; looking for some among all packages took 0.01 s
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # what is made here mostly stays: looking for garbage after 700 things took a tenth of a report
    gc.set_threshold(50_000)
    guard_standard_streams()
    status = _run()
    try:
        sys.stdout.flush()
    except OSError as problem:  # the reader of our output is gone, or its disk is full
        status = status or _give_up_output(problem)
    sys.exit(status)


def _with_verb(verb: Sequence[str]) -> typer.Typer:
    """The program with that verb alone, if it is one: options of all 26 took 0.04 s."""
    commands = [command for command in cli.registered_commands if command.name in verb]
    if not commands:
        return cli
    alone = copy.copy(cli)
    alone.registered_commands = commands
    return alone


def _run() -> int:
    try:
        _with_verb(sys.argv[1:2])()
    except GlidecalError as problem:
        _tell(f"glidecal: {problem}")
        return exit_code(problem)
    except KeyboardInterrupt:
        return Exit.INTERRUPTED
    except OSError as problem:
        return _give_up_output(problem)
    except SystemExit as leaving:  # typer says 1 where the reader of our output is gone
        status = leaving.code if isinstance(leaving.code, int) else 0
        return Exit.INTERRUPTED if status == 1 else status
    return Exit.DONE


def _give_up_output(problem: OSError) -> int:
    """Nothing more can be written: point the stream elsewhere so that leaving is quiet."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(problem, BrokenPipeError):
        return Exit.INTERRUPTED
    reason = "closed" if problem.errno == errno.EBADF else problem.strerror or str(problem)
    allowed = "a terminal, a pipe, or a file on a disk with free space"
    _tell(f"glidecal: {RecordError('standard output', allowed=allowed, reason=reason)}")
    return Exit.RECORD


def _tell(text: str) -> None:
    with contextlib.suppress(OSError):
        print(text, file=sys.stderr, flush=True)
