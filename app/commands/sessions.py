"""``glidecal simulate``, ``import``, ``validate``, ``replay`` and ``serve``: files of sessions."""

from __future__ import annotations

import os
import select
import sys
import threading
from pathlib import Path
from typing import Annotated, Any

import typer

from app.exit_codes import Exit, exit_code
from app.machines.options import (
    Answer,
    AsJson,
    Force,
    Machine,
    Output,
    Protocol,
    Seed,
    Sessions,
    Simulation,
    argument,
    figure,
    file,
    machine_option,
    may_replace,
    say,
)
from app.machines.registry import LISTED, LOOKS, family_of, options_of, with_options_of_machines
from app.report.streams import need_terminal
from calib.errors import GlidecalError, RecordError, UsageError, extra
from protocols.machine_files import USUAL_MACHINE


@with_options_of_machines
def simulate(
    context: typer.Context,
    output: Output,
    machine: Annotated[str | None, machine_option(LISTED)] = None,
    seed: Seed = 1,
    force: Force = False,
    **own: Any,  # noqa: ANN401 (what the machines add)
) -> None:
    """A session of a simulated machine. The nominal one, or that of a model file."""
    name = machine or USUAL_MACHINE
    family = family_of(name)
    given = options_of(context, family, f"the machine {name}", own)
    family.simulate(Simulation(output, machine, seed, force), given, say)


def import_table(
    table: Annotated[Path, argument("Table of readings (.csv or .xlsx).")],
    output: Annotated[Path | None, file("Session to write.", "--output", "-o")] = None,
    machine: Machine = None,
    resolution: Annotated[float | None, figure("Resolution of the indicators, mm.")] = None,
    repeatability: Annotated[
        float | None, figure("Repeatability of the indicators (standard deviation), mm.")
    ] = None,
    remark: Annotated[
        list[str] | None, typer.Option(help="A remark for the record; may be repeated.")
    ] = None,
    template: Annotated[
        bool, typer.Option("--template", help="Write TABLE, a row a reading, without values.")
    ] = False,
    protocol: Protocol = None,
    force: Force = False,
) -> None:
    """A session from a table of readings. With --template the table, to be filled in."""
    from app.version import program
    from protocols.files import write_files
    from protocols.journal import write_whole
    from protocols.machine import load_machine
    from protocols.procedure import load_procedure
    from protocols.session import fold
    from protocols.table import empty_table, off_bar_words, opened_table, within_limits

    known = load_machine(machine)
    if template:
        asked = load_procedure(protocol or known.usual_procedure, known.geometry())
        empty = empty_table(asked, known.geometry(), table)
        write_files(table, {"": empty}, replace=may_replace(force, table))
        say(f"{asked.name} to be filled in, column value_mm: {table}")
        return
    if output is None or protocol is not None:
        found = "none" if output is None else "--protocol without --template"
        raise UsageError("--output", found, "-o SESSION, or --template to write an empty table")
    opened, events, unknown = opened_table(
        table,
        known,
        program(),
        resolution_mm=resolution,
        repeatability_mm=repeatability,
        remarks=tuple(remark or ()),
    )
    write_whole(output, opened, [*events])
    readings = fold([opened, *events]).all_readings
    if unknown:
        say(f"glidecal: columns kept but not used: {', '.join(unknown)}")
    outside = sum(not within_limits(reading, known.geometry()) for reading in readings)
    if outside:
        say(f"glidecal: {outside} readings lie outside the joint limits of the machine file")
    if off_bar := off_bar_words(readings, known.geometry()):
        say(f"glidecal: {off_bar}")
    if len({reading.posture_mm for reading in readings}) < 2:
        say("glidecal: only one posture in this table; it cannot be solved alone")
    say(f"{len(readings)} readings written to {output}")


def validate(sessions: Sessions) -> None:
    """Are records complete, unbroken and unaltered?

    Names the first broken line. What it proves holds against accidents and careless edits: the
    digests have no key.
    """
    from app.measuring.recorded import check_values
    from protocols.record import read_record

    status = Exit.DONE
    for path in sessions:
        try:
            record = read_record(path)
            check_values(record)
        except GlidecalError as problem:
            say(f"glidecal: {problem}")
            status = exit_code(problem)
            continue
        if record.unfinished:
            say(f"glidecal: {record.unfinished} Continue it with: glidecal run --continue {path}")
            status = Exit.RECORD
            continue
        session = record.session
        typer.echo(
            f"{path}: unbroken and closed, {len(record.events)} lines, "
            f"{len(session.all_readings)} readings, {len(session.superseded)} superseded"
        )
    raise typer.Exit(status)


def replay(
    session: Sessions,
    headless: Annotated[
        bool, typer.Option("--headless", help="Print readings and averages, open no screen.")
    ] = False,
    as_json: AsJson = False,
    served: Annotated[bool, typer.Option("--served", hidden=True)] = False,
) -> None:
    """A recorded session again on the screen. With --headless its readings and averages."""
    if not headless and not as_json:
        if served:  # a page of glidecal serve: no terminal, and only to look at
            threading.Thread(target=_end_with_the_server, daemon=True).start()
        else:
            need_terminal("replay", "--headless")
        from app.screens.start import open_replay, open_served

        raise typer.Exit(open_served(session, LOOKS) if served else open_replay(session, LOOKS))
    from app.report.schema.readings import ReplayReport
    from app.report.text.session import replay_text
    from protocols.record import read_record

    if len(session) > 1:
        raise UsageError("replay without a screen", f"{len(session)} sessions", "one session")
    record = read_record(session[0])
    if record.unfinished:
        say(f"glidecal: {record.unfinished}")
    report = ReplayReport.of(name=session[0].name, session=record.session, end=record.end)
    typer.echo(Answer(lambda: replay_text(report), lambda: report).shown(as_json=as_json))


def _end_with_the_server() -> None:
    """A server that was killed says nothing, but its end of the pipe is gone."""
    if hasattr(select, "poll"):  # not on Windows
        pipe = select.poll()
        pipe.register(sys.stdin.fileno(), 0)
        pipe.poll()
        os._exit(Exit.INTERRUPTED)  # nothing is open that could be lost


def serve(
    sessions: Annotated[list[Path], argument("Session files, or folders of them.")],
    port: Annotated[
        int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.", min=0, max=65535)
    ] = 8765,
) -> None:
    """Sessions, reports and history in a browser. To look at only; Ctrl-C ends it."""
    from protocols.record import read_record

    for path in sessions:
        if not path.is_dir():
            read_record(path)
        elif next(path.rglob("*.jsonl"), None) is None:
            raise RecordError(f"folder {path}", "no session file", "files that end with .jsonl")
    with extra("glidecal serve", "serve"):
        from app.screens.serving import Pages, listen
    pages = Pages(sessions, listen(port))
    say(pages.announcement())
    pages.serve()
