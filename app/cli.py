"""The command line: verbs only, one file each in ``app/commands``; imports nothing heavy."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from app.commands import (
    demo,
    export,
    import_table,
    ports,
    replay,
    run,
    simulate,
    solve,
    validate,
)
from app.exit_codes import exit_code
from calib.errors import GlidecalError

VERSION = "0.1.0"

cli = typer.Typer(
    name="glidecal",
    help="Calibrate parallel kinematic machines with comparator indicators.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"glidecal {VERSION}")
        raise typer.Exit


@cli.callback(invoke_without_command=True)
def home(
    context: typer.Context,
    _version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show version.")
    ] = False,
) -> None:
    """Without a verb, open the terminal interface."""
    if context.invoked_subcommand is None:
        from app.screens.start import open_interface

        raise typer.Exit(open_interface())


cli.command("demo")(demo.demo)
cli.command("run")(run.run)
cli.command("import")(import_table.import_table)
cli.command("replay")(replay.replay)
cli.command("solve")(solve.solve)
cli.command("simulate")(simulate.simulate)
cli.command("export")(export.export)
cli.command("validate")(validate.validate)
cli.command("ports")(ports.ports)


def main() -> None:
    """Run the program; every error meant for a person becomes one paragraph and a status."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a console without UTF-8 gets "?" and no traceback
            stream.reconfigure(errors="replace")
    try:
        cli()
    except GlidecalError as problem:
        print(f"glidecal: {problem}", file=sys.stderr)
        sys.exit(exit_code(problem))
    except KeyboardInterrupt:
        sys.exit(130)
