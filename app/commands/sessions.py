"""``glidecal simulate``, ``import``, ``validate``, ``replay`` and ``serve``: files of sessions."""

from __future__ import annotations

import os
import select
import sys
import threading
from collections.abc import Iterator, Sequence
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from app.exit_codes import Exit, exit_code
from app.machines.options import (
    Answer,
    AsJson,
    Force,
    Output,
    Protocol,
    Seed,
    Sessions,
    argument,
    check_ending,
    figure,
    file,
    machine_option,
    may_replace,
    option,
    say,
    tell_warnings,
    there,
)
from app.machines.registry import (
    LISTED,
    LOOKS,
    OF_INDICATORS,
    family_of,
    family_of_files,
    options_of,
    typed,
    with_options_of_machines,
)
from app.report.streams import need_terminal
from calib.errors import GlidecalError, RecordError, UsageError, extra
from calib.printable import counted
from protocols.machine_files import USUAL_MACHINE

if TYPE_CHECKING:  # heavy: imported where used
    from protocols.session import Event, Opened, Session


@with_options_of_machines
def simulate(
    context: typer.Context,
    output: Output,
    machine: Annotated[str | None, machine_option(LISTED)] = None,
    seed: Seed = 1,
    force: Force = False,
    **machine_options: Any,  # noqa: ANN401 (what the machines add)
) -> None:
    """A session of a simulated machine. The nominal one, or that of a model file."""
    name = machine or USUAL_MACHINE
    family = family_of(name)
    options = options_of(context, family, f"the machine {name}", machine_options)
    family.simulate(output, machine, seed, force, **options)


@with_options_of_machines
def import_table(
    context: typer.Context,
    source: Annotated[
        list[Path],
        argument(
            "Table of readings (.csv, .xlsx, .parquet), or files of a printer: its configuration, "
            "a log of its probe.",
            to_read=False,  # with --template it is written
        ),
    ],
    output: Annotated[Path | None, file("Session to write.", "--output", "-o")] = None,
    machine: Annotated[str | None, machine_option(LISTED)] = None,
    machine_file_out: Annotated[
        Path | None,
        file("Machine file to write, of a printer's configuration.", "--machine-file-out"),
    ] = None,
    resolution: Annotated[
        float | None, figure("Resolution of the indicators, or of the probe, mm.")
    ] = None,
    repeatability: Annotated[
        float | None,
        figure("Repeatability of the indicators or the probe (standard deviation), mm."),
    ] = None,
    distances: Annotated[
        Path | None, file("Table of measured distances between marks.", "--distances")
    ] = None,
    distance_deviation: Annotated[
        float | None,
        figure("Standard deviation of such a distance, marking included, mm; 0.05 if not stated."),
    ] = None,
    remark: Annotated[list[str] | None, option("A remark for the record; may be repeated.")] = None,
    measured_on: Annotated[
        datetime | None,
        option("The day it was measured: YYYY-MM-DD.", metavar="DATE", formats=["%Y-%m-%d"]),
    ] = None,
    template: Annotated[
        bool, option("Write the table, a row a reading, without values.", "--template")
    ] = False,
    protocol: Protocol = None,
    force: Force = False,
    **machine_options: Any,  # noqa: ANN401 (what the machines add)
) -> None:
    """A session from a table or a printer's files.

    A table holds readings or contacts; with --template it is written, to be filled in. Of a printer
    --machine-file-out writes the machine file.
    """
    name = machine or USUAL_MACHINE
    family = family_of(name)
    options = options_of(context, family, f"the machine {name}", machine_options)
    there([] if template else source)
    check_ending(output, ".jsonl")  # other files of a folder are no sessions
    if family.sessions is not None:
        _check_postures(context, name, source)
        _refuse_sessions([] if template else source)
        family.sessions.imported(
            source=source[0],
            output=output,
            machine=machine,
            protocol=protocol,
            template=template,
            remarks=remark or (),
            measured_on=_day(measured_on),
            force=force,
            **options,
        )
    elif template:
        _write_template(source, machine, protocol, force=force)
    else:
        if (output is None and machine_file_out is None) or protocol is not None:
            problem = "none" if output is None else "--protocol without --template"
            allowed = "-o SESSION, or --template to write an empty table"
            raise UsageError("--output", problem, allowed)
        _refuse_sessions(source)
        import_files(
            source,
            output,
            machine=machine,
            machine_file_out=machine_file_out,
            resolution=resolution,
            repeatability=repeatability,
            distances=distances,
            distance_deviation=distance_deviation,
            remarks=tuple(remark or ()),
            measured_on=_day(measured_on),
            force=force,
        )


def _day(measured_on: datetime | None) -> date | None:
    """The day that is stated. Raises UsageError for one to come."""
    if measured_on is None:
        return None
    if measured_on.date() > datetime.now().date():
        raise UsageError("--measured-on", f"{measured_on:%Y-%m-%d}", "a day of the past")
    return measured_on.date()


def _refuse_sessions(sources: Sequence[Path]) -> None:
    """Raises RecordError for a session: its lines look like the log of a probe."""
    from protocols.files import RECORD_START
    from protocols.machine_files import beginning_of

    for path in sources:
        if beginning_of(path).startswith(RECORD_START):
            raise RecordError(
                f"file {path}",
                "a session",
                "a table of readings, or files of a printer",
                "A session needs no import: glidecal solve, diagnose, report and export take it.",
            )


def import_files(
    source: list[Path],
    output: Path | None,
    *,
    machine: str | None = None,
    machine_file_out: Path | None = None,
    resolution: float | None = None,
    repeatability: float | None = None,
    distances: Path | None = None,
    distance_deviation: float | None = None,
    remarks: tuple[str, ...] = (),
    measured_on: date | None = None,
    force: bool = False,
) -> None:
    """A session of indicators or contacts, and what is said of it; lengths in millimetres.

    Of a printer that was not probed yet, or without ``output``, the machine file alone. Raises
    UsageError for what does not go with these files, RecordError for a file.
    """
    from protocols.files import write_files
    from protocols.journal import write_whole
    from protocols.session import fold

    if machine_file_out is not None:
        for path in source:
            if machine_file_out.exists() and path.samefile(machine_file_out):
                raise UsageError(
                    "--machine-file-out", f"{path}, which is read", "another file, FILE.toml"
                )
    may = may_replace(force, machine_file_out)
    figures = {"resolution_mm": resolution, "repeatability_mm": repeatability, "remarks": remarks}
    opened, events, machine_file, notes = _read_from(
        source,
        machine,
        distances,
        distance_deviation,
        figures,
        geometry_alone=machine_file_out is not None,
    )
    if distance_deviation is not None and not any(e.event == "distance" for e in events):
        raise UsageError(
            "--distance-deviation",
            f"{distance_deviation:g} mm, and no distances",
            "--distances TABLE",
        )
    if machine_file_out is not None and machine_file is None:
        raise UsageError(
            "--machine-file-out", f"{source[0]}, without geometry", "a printer's configuration"
        )
    opened = opened.model_copy(update={"measured_on": measured_on})
    session = fold([opened, *events])
    if output is not None and session.all_readings:
        write_whole(output, opened, [*events])
    if machine_file_out is not None and machine_file is not None:
        write_files(machine_file_out, {"": machine_file}, replace=may)
        say(f"written: {machine_file_out}")
    tell_warnings(notes)
    for text in _written_words(session, source[0], output, machine_file_out):
        say(text)


def _written_words(
    session: Session, source: Path, output: Path | None, machine_file: Path | None
) -> Iterator[str]:
    """What was written of a session, with cautions; of none what to do next."""
    if not session.all_readings:
        yield (
            f"There is no contact with the plate in {source.name}. Places to probe: glidecal plan "
            f"--machine {machine_file} --macro klipper (or reprapfirmware, marlin)"
        )
    elif output is not None:
        word = "contacts" if session.of_contacts else "readings"
        yield from (f"glidecal: {caution}" for caution in _cautions(session, word))
        text = counted(len(session.all_readings), word.removesuffix("s"))
        if session.distances:
            text += f" and {counted(len(session.distances), 'distance')} between marks"
        yield f"{text} written to {output}"


def _check_postures(context: typer.Context, name: str, source: list[Path]) -> None:
    """Raises UsageError for what is not of a table of postures."""
    if wrong := typed(context, OF_INDICATORS["import"]):
        raise UsageError(wrong, f"the machine {name}", "machines with indicators on legs")
    if len(source) > 1:
        raise UsageError("import", f"{len(source)} files", "one table")


def _write_template(
    source: list[Path], machine: str | None, protocol: str | None, *, force: bool
) -> None:
    from protocols.files import write_files
    from protocols.machine import load_machine
    from protocols.procedure import procedure_on
    from protocols.table import empty_table

    if len(source) > 1:
        raise UsageError("--template", f"{len(source)} files", "one table to write")
    machine_known = load_machine(machine)
    procedure = procedure_on(machine_known, protocol)
    empty = empty_table(procedure, machine_known.geometry(), source[0])
    write_files(source[0], {"": empty}, replace=may_replace(force, source[0]))
    say(f"{procedure.name} to be filled in, column value_mm: {source[0]}")


def _read_from(
    source: list[Path],
    machine: str | None,
    distances: Path | None,
    deviation_mm: float | None,
    figures: dict[str, Any],
    *,
    geometry_alone: bool,
) -> tuple[Opened, Sequence[Event], str | None, list[str]]:
    """First line and events of a session of these files, a machine file, and what is not used."""
    from app.version import program
    from protocols.machine import load_machine
    from protocols.printers.imported import are_of_printer, imported_printer
    from protocols.table import checked_distances, distances_of_table, opened_table

    measured_distances = distances_of_table(distances) if distances else ()
    if are_of_printer(source):
        printer = imported_printer(
            source,
            program(),
            machine=load_machine(machine) if machine else None,
            geometry_alone=geometry_alone,
            **figures,
        )
        unused = [f"not used: {odd}" for odd in printer.oddities]
        measured = checked_distances(
            (*printer.distances, *measured_distances),
            printer.opened.machine.geometry(),
            deviation_mm,
        )
        return printer.opened, (*printer.contacts, *measured), printer.machine_file, unused
    opened, events, unknown = opened_table(source[0], load_machine(machine), program(), **figures)
    unused = [f"columns kept but not used: {', '.join(unknown)}"] if unknown else []
    measured = checked_distances(measured_distances, opened.machine.geometry(), deviation_mm)
    return opened, (*events, *measured), None, unused


def _cautions(session: Session, word: str) -> Iterator[str]:
    """What was measured where the machine file allows none, and too little."""
    from protocols.table import off_bar_words, off_plate_words, outside_limits

    readings, geometry = session.all_readings, session.opened.machine.geometry()
    if outside := outside_limits(readings, geometry):
        count = counted(outside, word.removesuffix("s"))
        yield f"{count} outside the joint limits of the machine file"
    if off_bar := off_bar_words(readings, geometry):
        yield off_bar
    if off_plate := off_plate_words(readings, session.opened.machine):
        yield off_plate
    if len({reading.posture_mm for reading in readings}) < 2:
        yield f"only one posture in these {word}; they cannot be solved alone"


def validate(sessions: Sessions) -> None:
    """Are records complete, unbroken and unaltered?

    Names the first broken line. What it proves holds against accidents and careless edits: the
    digests have no key.
    """
    from app.measuring.recorded import check_values
    from protocols.record import read_record

    status = Exit.DONE
    for path in sessions:
        verbs = family_of_files(None, [path]).sessions
        try:
            if verbs is not None:
                session, record = verbs.validated(path)
            else:
                record = read_record(path)
                session = record.session
                check_values(record)
        except GlidecalError as problem:
            say(f"glidecal: {problem}")
            status = exit_code(problem)
            continue
        if record.unfinished:
            is_table = record.opened.origin == "imported"
            advice = "" if is_table else f" Continue it with: glidecal run --continue {path}"
            say(f"glidecal: {record.unfinished}{advice}")
            status = Exit.RECORD
            continue
        typer.echo(
            f"{path}: unbroken and closed, {len(record.events)} lines, "
            f"{counted(len(session.all_readings), 'reading')}, {len(session.superseded)} superseded"
        )
    raise typer.Exit(status)


def replay(
    session: Sessions,
    headless: Annotated[
        bool, option("Print readings and averages, open no screen.", "--headless")
    ] = False,
    as_json: AsJson = False,
    served: Annotated[bool, typer.Option("--served", hidden=True)] = False,
) -> None:
    """A recorded session again on the screen. With --headless its readings and averages."""
    verbs = family_of_files(None, session).sessions
    if verbs is not None and (headless or as_json):
        if len(session) > 1:
            raise UsageError("replay of postures", f"{len(session)} sessions", "one session")
        verbs.replayed(session[0]).show(as_json=as_json)
        return
    if not headless and not as_json:
        if served:  # a page of glidecal serve: no terminal, and only to look at
            threading.Thread(target=_end_with_the_server, daemon=True).start()
        else:
            need_terminal("replay", "--headless")
        from app.screens.home import first_replay
        from app.screens.interface import open_screen

        first = first_replay(session, LOOKS, served=served)
        raise typer.Exit(open_screen(first, LOOKS, read_only=served))
    from app.report.schema.readings import ReplayReport
    from app.report.text.session import replay_text
    from protocols.record import read_record

    if len(session) > 1:
        raise UsageError("replay without a screen", f"{len(session)} sessions", "one session")
    record = read_record(session[0])
    if record.unfinished:
        say(f"glidecal: {record.unfinished}")
    report = ReplayReport.of(record)
    Answer(report, replay_text, lambda report: report).show(as_json=as_json)


def _end_with_the_server() -> None:
    """A server that was killed says nothing, but its end of the pipe is gone."""
    if hasattr(select, "poll"):  # not on Windows
        pipe = select.poll()
        pipe.register(sys.stdin.fileno(), 0)
        pipe.poll()
        os._exit(Exit.INTERRUPTED)  # nothing is open that could be lost


def serve(
    sessions: Annotated[list[Path], argument("Session files, or folders of them.")],
    port: Annotated[int, option("Port on 127.0.0.1; 0 takes a free one.", min=0, max=65535)] = 8765,
) -> None:
    """Sessions, reports and history in a browser. To look at only; Ctrl-C ends it."""
    from app.measuring.recorded import check_session

    for path in sessions:
        if not path.is_dir():
            check_session(path)
        elif next(path.rglob("*.jsonl"), None) is None:
            raise RecordError(f"folder {path}", "no session file", "files that end with .jsonl")
    with extra("glidecal serve", "serve"):
        from app.serving.server import Pages, listen
    pages = Pages(sessions, listen(port))
    say(pages.announcement())
    pages.serve()
