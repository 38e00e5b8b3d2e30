"""``glidecal run`` and ``align``: measuring, on real and on simulated machines."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from app.exit_codes import Exit
from app.machines.options import (
    Answer,
    AsJson,
    Force,
    Machine,
    MacroName,
    PrintableRadius,
    Protocol,
    Seed,
    argument,
    check_ending,
    figure,
    file,
    machine_option,
    may_replace,
    number,
    option,
    say,
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
from calib.errors import GlidecalError, UsageError
from calib.printable import counted

if TYPE_CHECKING:  # heavy: imported where used
    from app.measuring.moving import MoveProposal, Mover
    from app.measuring.plan import Plan
    from app.measuring.session import Indicators

WITHOUT_A_SCREEN = "--headless with --simulated or --motion"

SessionFile = Annotated[Path | None, file("Session file.", "--output", "-o")]
Resume = Annotated[
    Path | None, file("Continue an interrupted session.", "--continue", to_read=True)
]


@with_options_of_machines
def run(
    context: typer.Context,
    protocol: Protocol = None,
    machine: Annotated[str | None, machine_option(LISTED)] = None,
    indicator: Annotated[
        list[str] | None, option("PROFILE:PORT or PROFILE:PORT@AXES; twice for two indicators.")
    ] = None,
    port: Annotated[
        list[str] | None, option("Port of an indicator of --profile; once or twice.")
    ] = None,
    simulated: Annotated[
        bool, option("A simulated machine instead of ports.", "--simulated")
    ] = False,
    profile: Annotated[str, option("Indicator profile.")] = "mitutoyo-01a",
    output: SessionFile = None,
    operator: Annotated[str, option("Name for the record.")] = "",
    temperature: Annotated[float | None, number("Machine temperature, °C.", -50.0, 100.0)] = None,
    note: Annotated[str, option("Remark for the record, shown with the result.")] = "",
    seed: Seed = 1,
    random_order: Annotated[
        int | None, option("Shuffle each cycle with this seed, where the order is free.", min=0)
    ] = None,
    resume: Resume = None,
    headless: Annotated[
        bool,
        option(
            "No screen: a simulated machine, or with --motion questions in the terminal.",
            "--headless",
        ),
    ] = False,
    dry_run: Annotated[
        bool, option("Show every step; open and write nothing.", "--dry-run")
    ] = False,
    motion: Annotated[
        str | None, option("Controller that moves the machine: linuxcnc:HOST:PORT or grbl:PORT.")
    ] = None,
    prove: Annotated[bool, option("Prove each carriage again by a short move.", "--prove")] = False,
    until: Annotated[
        float | None, figure("Repeat set-ups until the bound of the tool error is this, mm.")
    ] = None,
    macro: MacroName = None,
    printable_radius: PrintableRadius = None,
    **machine_options: Any,  # noqa: ANN401 (what the machines add)
) -> None:
    """The guided session on real indicators. With --simulated on a simulated machine."""
    from app.measuring.indicators import check_indicators, choose_indicators, simulated_indicators
    from app.measuring.plan import Plan, plan_to_continue, session_name
    from drivers.motion import check_controller
    from protocols.machine import load_machine
    from protocols.motion import procedure_of
    from protocols.procedure import procedure_on, shuffled
    from protocols.record import read_record

    refuse_beside_continue(context)
    check_ending(output if macro is None else None, ".jsonl")  # of a macro another verb is named
    family = family_of(machine) if machine else family_of_files(None, [resume] if resume else [])
    options = options_of(context, family, f"the machine {machine or family.name}", machine_options)
    if family.sessions is not None:
        if wrong := typed(context, OF_INDICATORS["run"]):
            raise UsageError(wrong, f"the machine {family.name}", "machines read on their legs")
        family.sessions.run(
            machine=machine,
            protocol=protocol,
            output=output,
            resume=resume,
            operator=operator,
            temperature_c=temperature,
            note=note,
            seed=seed if simulated else None,
            dry_run=dry_run,
            indicators=indicator or (),
            **options,
        )
        return
    _check_macro(context)
    if motion is not None:
        check_controller(motion)
    machine_known = load_machine(machine)
    instruments = choose_indicators(
        indicator or (), port or (), profile, machine=machine_known, simulated=simulated
    )
    if resume:
        is_whole = until is not None and read_record(resume).end == "closed"
        plan = plan_to_continue(resume, instruments, whole=is_whole)
        plan = replace(plan, motion=motion, prove=prove)
        measured_until(plan, until, headless=headless, is_complete=is_whole)
        return
    procedure_name = protocol or procedure_of(machine_known, moving=motion is not None)
    procedure = procedure_on(machine_known, procedure_name)
    if random_order is not None:
        procedure = shuffled(procedure, random_order)
    if macro is not None:
        from app.exports import macros

        typer.echo(macros.macro(macro, procedure, machine_known, printable_radius), nl=False)
        return
    if not (instruments or dry_run):
        allowed = "--indicator PROFILE:PORT, [[indicator]] in the machine file"
        raise UsageError("indicators", "none", allowed)
    plan = Plan(
        path=output or session_name(Path(), procedure.name),
        machine=machine_known,
        procedure=procedure,
        instruments=instruments or simulated_indicators([profile]),
        operator=operator,
        temperature_c=temperature,
        note=note,
        seed=seed,
        motion=motion,
        prove=prove,
    )
    if not plan.simulated and (wrong := typed(context, ("seed",))):
        next_step = "The order of the steps is shuffled by --random-order."
        raise UsageError(wrong, "beside real indicators", "--seed with --simulated", next_step)
    check_indicators(plan.instruments, legs=bool(procedure.levels))
    if dry_run:
        typer.echo(_all_of_it(plan))
    else:
        measured_until(plan, until, headless=headless)


SETTLED = ("protocol", "output", "operator", "temperature", "note", "seed", "random_order")


def refuse_beside_continue(context: typer.Context) -> None:
    """Raises UsageError for what is settled where a session goes on."""
    if context.params["resume"] and (wrong := typed(context, (*SETTLED, "dry_run"))):
        next_step = "A continued session follows its record."
        raise UsageError(wrong, "beside --continue", "--continue without it", next_step)


def _check_macro(context: typer.Context) -> None:
    """Raises UsageError for what does not go with ``--macro``, or not without it."""
    parameters = context.params
    if parameters["macro"] is None:
        if parameters["printable_radius"] is not None:
            raise UsageError("--printable-radius", "no --macro", "with --macro alone")
        return
    if not parameters["dry_run"]:
        next_step = "The firmware of the printer measures it, and its log is imported."
        raise UsageError("--macro", "no --dry-run", "run --dry-run --macro", next_step)
    if parameters["output"] is not None:
        next_step = "glidecal plan --macro with -o writes a file."
        raise UsageError("--output", "beside --macro", "standard output", next_step)


def _all_of_it(plan: Plan) -> str:
    """Every step of a plan, and what to expect of the result."""
    from app.planning.tripod import before_measuring
    from app.report.text.motion import plan_text
    from app.report.text.planning import before_measuring_text

    expected = before_measuring(plan.procedure, plan.machine, plan.instruments)
    return f"{plan_text(plan)}\n\n{before_measuring_text(*expected)}"


def measured_until(
    plan: Plan, until: float | None, *, headless: bool, is_complete: bool = False
) -> None:
    """A session, if it is not complete; then further ones where the machine moves itself.

    Raises UsageError where no set-up after set-up can be measured up to the bound ``until``.
    """
    if plan.prove and plan.motion is None:
        raise UsageError("--prove", "no --motion", "--motion, of a machine that moves itself")
    of_legs = bool(plan.procedure.levels) and plan.machine.geometry().reads_legs
    if until is not None and (plan.motion is None or not headless):
        raise UsageError("--until", "no --motion, or a screen", "--motion … --headless")
    if until is not None and not of_legs:
        expected = f"procedure {plan.procedure.name} on machine {plan.machine.name}"
        raise UsageError("--until", expected, "readings of legs")
    if not is_complete:
        measure(plan, headless=headless)
    if plan.motion is None or not of_legs:
        return
    try:
        _go_on(plan, until)
    except GlidecalError as problem:  # nobody asked for a bound: the session is as good without
        if until is not None:
            raise
        say(f"{problem}")


def _go_on(plan: Plan, until: float | None) -> None:
    """What the readings bound; up to the bound ``until`` set-up after set-up, each a session.

    Ends where that is reached or more would not help. Without one it is said how to go on.
    """
    from app.evaluating.loading import load_sessions
    from app.planning.tripod import (
        all_sessions,
        further_procedure,
        further_session,
        next_measurement,
    )
    from app.report.text.motion import further_text

    first, before_mm = plan.path, inf
    while True:
        reach = next_measurement(load_sessions(all_sessions(first))[0]).planner.reach
        set_up = None if until is None else reach.towards(until, before_mm)
        say(further_text(reach, plan, until, set_up))
        if set_up is None:
            return
        procedure = further_procedure(plan.procedure, set_up)
        plan = replace(plan, path=further_session(first), procedure=procedure, continued=False)
        plan = replace(plan, before=None, verifies=None, note="", prove=False)
        before_mm = reach.bound_mm
        measure(plan, headless=True)


def measure(plan: Plan, *, headless: bool, otherwise: str = WITHOUT_A_SCREEN) -> None:
    """Measure on the screen, or as ``otherwise`` says; unattended where a program moves the
    machine.
    """
    from app.measuring.opening import start_session
    from app.measuring.plan import QUICK_INTERVAL_S
    from app.measuring.unattended import end_motion, measure_all
    from app.report.text.session import paused_text
    from protocols.journal import check_new

    if not plan.continued:
        check_new(plan.path)
    if plan.motion is not None:
        check_asking(plan)
    if not headless:
        need_terminal("guided session", otherwise)
        from app.screens.interface import open_screen, screen_of

        raise typer.Exit(open_screen(screen_of("check.CheckScreen", plan), LOOKS))
    if not (plan.simulated or plan.motion):
        raise UsageError("--headless", "real indicators", WITHOUT_A_SCREEN)
    quick = replace(plan, interval_s=QUICK_INTERVAL_S)
    with start_session(quick, partial(_ask, plan)) as guided:
        try:
            measure_all(guided, _consent, say, confirm)
        except BaseException as problem:
            if guided.mover is not None:
                end_motion(guided.mover, say)
            if isinstance(problem, KeyboardInterrupt | typer.Abort):
                say(paused_text(guided, headless=True))
            raise
    say(f"{counted(len(guided.session.readings), 'reading')} in {guided.path}")


def _consent(proposal: MoveProposal) -> bool:
    """The operator's word; what is typed within the dead time was meant for what moved before."""
    from app.report.text.motion import consent_question

    _wait_dead_time()
    return confirm(consent_question(proposal))


def confirm(question: str) -> bool:
    """The operator's word, typed after the question was shown: nothing typed before counts."""
    from app.report.text.tables import wrapped

    _forget_typed()
    return typer.confirm(wrapped(question), err=True)


def _wait_dead_time() -> None:
    from drivers.motion.line import DEAD_S

    time.sleep(DEAD_S)


def _confirm_homed(mover: Mover) -> None:
    """Where the controller cannot report that it is homed, the operator's word, or homing now.

    Raises MotionError where it cannot be homed.
    """
    from app.measuring.unattended import home
    from app.report.text.motion import HOME_QUESTION, HOMED_QUESTION
    from app.report.text.tables import wrapped

    line = mover.line
    if not line.can_home and not line.needs_homing_confirmed:
        return
    if line.can_home or not confirm(HOMED_QUESTION):
        say(wrapped(mover.why))
        _wait_dead_time()
        if not confirm(HOME_QUESTION):
            raise typer.Exit(Exit.INTERRUPTED)
        home(mover, say)
    else:
        line.homing_confirmed = True


def _forget_typed() -> None:
    """Drop what was typed ahead."""
    if sys.platform == "win32":
        import msvcrt

        while msvcrt.kbhit():
            msvcrt.getwch()
    else:
        import termios

        with suppress(termios.error, OSError, ValueError):  # no terminal
            termios.tcflush(sys.stdin, termios.TCIFLUSH)


def check_asking(plan: Plan) -> None:
    """Raises UsageError where nobody can be asked whether a machine may move."""
    from app.report.text.motion import plan_text

    if plan.simulated or plan.motion is None:
        raise UsageError("--motion", "a simulated machine", "indicators on ports")
    plan_text(plan)  # what is not allowed is refused before anybody is reached
    if not sys.stdin.isatty():
        raise UsageError("--motion", "no terminal", "a terminal: a machine will move")


def _ask(plan: Plan, indicators: Indicators) -> None:
    """Show all that will move and what the controller reports of itself, and ask once.

    On the screen its check shows and asks the same.
    """
    from app.report.text.motion import QUESTION, plan_text

    if indicators.mover is not None:
        typer.echo(plan_text(plan, indicators.mover.line.facts), err=True)
        if not confirm(QUESTION):
            raise typer.Exit(Exit.INTERRUPTED)
        _confirm_homed(indicators.mover)


def align(
    context: typer.Context,
    session: Annotated[Path | None, argument("A measured session; none: measure one.")] = None,
    reference: Annotated[
        str | None, option("The rail that stays: x, y or z; else as before, or x.", metavar="RAIL")
    ] = None,
    protocol: Protocol = "align",
    machine: Machine = None,
    indicator: Annotated[
        list[str] | None, option("PROFILE:PORT or PROFILE:PORT@AXES; once or twice.")
    ] = None,
    simulated: Annotated[
        bool, option("A simulated machine whose rails are off.", "--simulated")
    ] = False,
    output: SessionFile = None,
    seed: Seed = 1,
    resume: Resume = None,
    machine_file_out: Annotated[
        Path | None, file("Machine file to write, with the measured drives.", "--machine-file-out")
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Shims that make the rails square and meet. Measured, moved live, measured again."""
    from app.measuring.aligning import align_session, check_procedure
    from app.measuring.demo import WATCHED
    from app.measuring.indicators import DEFAULT_PROFILE, check_indicators, choose_indicators
    from app.measuring.plan import Plan, aligning, plan_to_continue, session_name
    from app.report.schema.alignment import AlignmentReport
    from app.report.text.alignment import aligned_text, lines_of_drives
    from calib.tripod.alignment import check_common_zero
    from protocols.files import write_files
    from protocols.machine import load_machine, machine_text
    from protocols.procedure import ALL_AXES, procedure_on
    from protocols.record import read_record

    rail = next((letter for letter in ALL_AXES if reference and letter == reference.lower()), None)
    if rail is None and reference is not None:
        raise UsageError("--reference", repr(reference), "x, y or z")
    if session is None and as_json:
        raise UsageError("--json", "no session", "a session that was measured: align SESSION")
    if session is not None:
        of_session = {"session", "reference", "as_json", "machine_file_out", "force"}
        if typed(context, context.params.keys() - of_session):
            wrong = "options for measuring, beside a session that was measured"
            raise UsageError(f"align {session}", wrong, "--reference, --machine-file-out, --json")
        may = may_replace(force, machine_file_out)
        recorded = read_record(session).session
        aligned = align_session(recorded, rail or recorded.opened.aligned_to or "x")
        if machine_file_out is not None:
            text = machine_text(aligned.as_it_lies, lines_of_drives(session.name))
            write_files(machine_file_out, {"": text}, replace=may)
            say(f"written: {machine_file_out}")
        Answer(aligned, aligned_text, partial(AlignmentReport.of, session.name)).show(
            as_json=as_json
        )
        return
    if wrong := typed(context, ("machine_file_out", "force")):
        raise UsageError(wrong, "no session", "a session that was measured: align SESSION")
    refuse_beside_continue(context)
    check_ending(output, ".jsonl")
    machine_known = load_machine(machine)
    instruments = choose_indicators(
        indicator or (), (), DEFAULT_PROFILE, machine=machine_known, simulated=simulated
    )
    if resume:
        plan = plan_to_continue(resume, instruments)
    else:
        if not instruments:
            allowed = "--indicator PROFILE:PORT once or twice, or --simulated"
            raise UsageError("indicators", "none", allowed)
        check_common_zero(machine_known.geometry())
        procedure = procedure_on(machine_known, protocol or "align")
        check_procedure(procedure, machine_known, rail or "x")
        path = output or session_name(Path(), procedure.name)
        plan = Plan(path, machine_known, procedure, instruments, seed=seed, bench=WATCHED)
        check_indicators(plan.instruments, legs=bool(procedure.levels))
    otherwise = "a session that was measured: align SESSION"
    measure(aligning(plan, rail or plan.reference or "x"), headless=False, otherwise=otherwise)
