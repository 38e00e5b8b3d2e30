"""``glidecal run``, ``demo`` and ``simulate``: sessions on real and on simulated machines."""

from __future__ import annotations

import os
import select
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from app.commands import measuring
from app.exit_codes import Exit, exit_code
from app.machines.options import (
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
    number,
    say,
)
from app.machines.registry import LISTED, LOOKS, family_of, options_of, with_options_of_machines
from app.report.streams import need_terminal
from calib.errors import CalibrationError, GlidecalError, RecordError, UsageError, extra
from protocols.machine_files import USUAL_MACHINE

if TYPE_CHECKING:  # heavy: imported where used
    from collections.abc import Callable

    from app.evaluating.solution import SessionSolution
    from app.measuring.opening import Plan


NAMED = "What the first session shows, as glidecal diagnose {} says in full:"
HIDDEN = "The machine has more than offsets. To look for what is missing: glidecal diagnose {}"


def run(
    protocol: Protocol = None,
    machine: Machine = None,
    indicator: Annotated[
        list[str] | None,
        typer.Option(help="PROFILE:PORT or PROFILE:PORT@AXES; twice for two indicators."),
    ] = None,
    port: Annotated[
        list[str] | None, typer.Option(help="Port of an indicator of --profile; once or twice.")
    ] = None,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="A simulated machine instead of ports.")
    ] = False,
    profile: Annotated[str, typer.Option(help="Indicator profile.")] = "mitutoyo-01a",
    output: Annotated[Path | None, file("Session file.", "--output", "-o")] = None,
    operator: Annotated[str, typer.Option(help="Name for the record.")] = "",
    temperature: Annotated[float | None, number("Machine temperature, °C.", -50.0, 100.0)] = None,
    note: Annotated[str, typer.Option(help="Remark for the record, shown with the result.")] = "",
    seed: Seed = 1,
    random_order: Annotated[
        int | None,
        typer.Option(help="Shuffle each cycle with this seed, where the order is free.", min=0),
    ] = None,
    resume: Annotated[Path | None, file("Go on with an interrupted session.", "--continue")] = None,
    headless: Annotated[
        bool, typer.Option("--headless", help="Unattended, simulated machine only.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show every step; open and write nothing.")
    ] = False,
    motion: Annotated[
        str | None,
        typer.Option(help="Controller that moves the machine: linuxcnc:HOST:PORT or grbl:PORT."),
    ] = None,
    until: Annotated[
        float | None, figure("Set-up after set-up, until the tool is off by at most this, mm.")
    ] = None,
) -> None:
    """The guided session on real indicators. With --simulated on a simulated machine."""
    from app.measuring.indicators import (
        check_indicators,
        choose_indicators,
        simulated_indicators,
    )
    from app.measuring.opening import (
        SIMULATED_INTERVAL_S,
        Plan,
        plan_to_continue,
        session_name,
    )
    from app.report.text.preparing import dry_run_text
    from protocols.machine import load_machine
    from protocols.motion import procedure_of
    from protocols.procedure import load_procedure, shuffled
    from protocols.record import read_record

    known = load_machine(machine)
    chosen = choose_indicators(
        indicator or (), port or (), profile, machine=known, simulated=simulated
    )
    if resume:
        whole = until is not None and read_record(resume).end == "closed"
        plan = replace(plan_to_continue(resume, chosen, whole=whole), motion=motion)
        measuring.measured_until(plan, until, headless=headless, done=whole)
        return
    named = protocol or procedure_of(known, moving=motion is not None)
    procedure = load_procedure(named, known.geometry())
    if random_order is not None:
        procedure = shuffled(procedure, random_order)
    if not (chosen or dry_run):
        allowed = "--indicator PROFILE:PORT, [[indicator]] in the machine file"
        raise UsageError("indicators", "none", allowed)
    plan = Plan(
        path=output or session_name(Path(), procedure.name),
        machine=known,
        procedure=procedure,
        instruments=chosen or simulated_indicators([profile]),
        operator=operator,
        temperature_c=temperature,
        note=note,
        seed=seed,
        interval_s=SIMULATED_INTERVAL_S,
        motion=motion,
    )
    check_indicators(plan.instruments, legs=bool(procedure.levels))
    if dry_run:
        from app.planning.tripod import before_measuring
        from app.report.text.planning import before_measuring_text

        asked = plan.procedure, plan.machine, plan.instruments
        steps = measuring.shown(plan) if plan.motion else dry_run_text(*asked)
        typer.echo(f"{steps}\n\n{before_measuring_text(*before_measuring(*asked))}")
    else:
        measuring.measured_until(plan, until, headless=headless)


def demo(
    headless: Annotated[
        bool, typer.Option("--headless", help="Run unattended and end with the summary.")
    ] = False,
    seed: Seed = 1,
    protocol: Protocol = None,
    machine: Machine = None,
    profile: Annotated[
        list[str] | None, typer.Option(help="Profile of the simulated indicators; once or twice.")
    ] = None,
    effect: Annotated[
        str | None,
        typer.Option(help="Hide an effect in the machine, by its id; to be found by diagnose."),
    ] = None,
    folder: Annotated[Path, typer.Option(help="Where the sessions are written.")] = Path(
        "demo-sessions"
    ),
    controller: Annotated[
        Literal["twin", "linuxcnc"] | None,
        typer.Option(help="The machine moves itself: by a simulated controller, or LinuxCNC here."),
    ] = None,
) -> None:
    """A whole calibration on a simulated machine. It is measured again after the export."""
    from app.measuring.indicators import DEFAULT_PROFILE
    from app.measuring.opening import (
        DEMO_MOTION_S,
        QUICK_INTERVAL_S,
        SIMULATED_INTERVAL_S,
        demo_plan,
        moving_itself,
        with_hidden_effect,
        writable_folder,
    )
    from app.measuring.simulated import BenchSettings
    from app.report.text.result import comparison_text, solution_text

    unattended = headless or not (sys.stdin.isatty() and sys.stdout.isatty())
    bench = BenchSettings() if unattended else BenchSettings(motion_s=DEMO_MOTION_S)
    interval_s = QUICK_INTERVAL_S if unattended else SIMULATED_INTERVAL_S
    plan = replace(
        demo_plan(folder, protocol, seed, bench, profile or [DEFAULT_PROFILE], machine),
        interval_s=interval_s,
    )
    if controller is not None:
        plan = moving_itself(plan, controller, hurried=unattended)
    if effect is not None:
        plan = with_hidden_effect(plan, effect)
    writable_folder(folder)
    if not unattended:
        from app.screens.start import open_session

        raise typer.Exit(open_session(plan, LOOKS))
    before, after = run_headless(plan, say)
    typer.echo(solution_text(before))
    typer.echo("\nAfter the joint offsets were entered in the controller:\n")
    typer.echo(comparison_text(before.solution, after.solution))
    if controller is not None:  # the whole loop: what the first session shows is named, too
        from app.evaluating.diagnosis import diagnose_files
        from app.report.text.diagnosis import headline

        found = headline(diagnose_files([plan.path]).diagnosis)
        typer.echo(f"\n{NAMED.format(plan.path)}\n\n{found}")
    elif effect is not None:
        typer.echo("\n" + HIDDEN.format(plan.path))


def run_headless(plan: Plan, say: Callable[[str], None]) -> tuple[SessionSolution, SessionSolution]:
    """Measure, identify, export, measure again; the two solutions to compare."""
    from app.exports import export_offsets
    from app.measuring.opening import verification_plan

    before = _measured(plan, say)
    folder = plan.path.with_suffix("")
    for path in export_offsets(before, folder)[0]:
        say(f"exported: {path}")
    after = _measured(verification_plan(plan, before), say)
    if not after.solution.rms_before_mm < before.solution.rms_before_mm:
        raise CalibrationError(
            "verification",
            f"{after.solution.rms_before_mm:.3f} mm r.m.s. after calibration",
            f"less than the {before.solution.rms_before_mm:.3f} mm before it",
            "Look at both sessions with glidecal solve.",
        )
    return before, after


def _measured(plan: Plan, say: Callable[[str], None]) -> SessionSolution:
    from app.evaluating.solution import solve_for_controller
    from app.measuring.opening import measure_all, start_session
    from app.measuring.unattended import measure_by_itself

    with start_session(plan) as guided:
        total = len(guided.steps)
        say(f"measuring {total} steps into {plan.path}")
        if guided.mover is not None:
            measure_by_itself(guided, lambda _: True, lambda _: None)
        else:
            measure_all(guided)
    return solve_for_controller(plan.path)


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


DEFAULT_PORT = 8765


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
    from protocols.session import fold

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
        session = fold(record.events)
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
    from app.report.schema.document import to_json
    from app.report.schema.readings import ReplayReport
    from app.report.text.session import replay_text
    from protocols.record import read_record
    from protocols.session import fold

    if len(session) > 1:
        raise UsageError("replay without a screen", f"{len(session)} sessions", "one session")
    record = read_record(session[0])
    if record.unfinished:
        say(f"glidecal: {record.unfinished}")
    report = ReplayReport.of(name=session[0].name, session=fold(record.events), end=record.end)
    typer.echo(to_json(report) if as_json else replay_text(report))


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
    ] = DEFAULT_PORT,
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
