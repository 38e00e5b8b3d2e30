"""``glidecal align``: rails, from a session that was measured or in rounds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.commands.measuring import measure
from app.machines.options import AsJson, Machine, Protocol, Seed, argument, file
from app.machines.registry import typed
from calib.errors import UsageError

if TYPE_CHECKING:  # heavy: imported where used
    from protocols.procedure import Leg


def align(
    context: typer.Context,
    session: Annotated[Path | None, argument("A session to tell from; none: measure.")] = None,
    reference: Annotated[
        str | None,
        typer.Option(help="The rail that stays: x, y or z; else as before, or x.", metavar="RAIL"),
    ] = None,
    protocol: Protocol = "align",
    machine: Machine = None,
    indicator: Annotated[
        list[str] | None, typer.Option(help="PROFILE:PORT or PROFILE:PORT@AXES; once or twice.")
    ] = None,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="A simulated machine whose rails are off.")
    ] = False,
    output: Annotated[Path | None, file("Session file.", "--output", "-o")] = None,
    seed: Seed = 1,
    resume: Annotated[Path | None, file("Go on with an interrupted session.", "--continue")] = None,
    as_json: AsJson = False,
) -> None:
    """Shims that make the rails square and meet. Measured, moved live, measured again."""
    from app.measuring.aligning import check_procedure
    from app.measuring.indicators import DEFAULT_PROFILE, check_indicators, choose_indicators
    from app.measuring.opening import (
        DEMO_MOTION_S,
        Plan,
        aligning,
        plan_to_continue,
        session_name,
    )
    from app.measuring.simulated import BenchSettings
    from protocols.machine import load_machine
    from protocols.procedure import ALL_AXES, load_procedure

    rail = next((one for one in ALL_AXES if reference and one == reference.lower()), None)
    if rail is None and reference is not None:
        raise UsageError("--reference", repr(reference), "x, y or z")
    if session is None and as_json:
        raise UsageError("--json", "no session", "a session that was measured: align SESSION")
    if session is not None:
        if typed(context, context.params.keys() - {"session", "reference", "as_json"}):
            wrong = "options for measuring, beside a session that was measured"
            raise UsageError(f"align {session}", wrong, "--reference and --json")
        typer.echo(_aligned(session, rail, as_json=as_json))
        return
    if resume and (held := typed(context, {"protocol", "output", "seed"})):
        raise UsageError(held, "beside --continue", "--continue without: the record tells it")
    known = load_machine(machine)
    chosen = choose_indicators(
        indicator or (), (), DEFAULT_PROFILE, machine=known, simulated=simulated
    )
    if resume:
        plan = plan_to_continue(resume, chosen)
    else:
        if not chosen:
            allowed = "--indicator PROFILE:PORT once or twice, or --simulated"
            raise UsageError("indicators", "none", allowed)
        procedure = load_procedure(protocol or "align", known.geometry())
        check_procedure(procedure, known, rail or "x")
        bench = BenchSettings(motion_s=DEMO_MOTION_S) if simulated else BenchSettings()
        path = output or session_name(Path(), procedure.name)
        plan = Plan(path, known, procedure, chosen, seed=seed, bench=bench)
        check_indicators(plan.instruments, legs=bool(procedure.levels))
    otherwise = "a session that was measured: align SESSION"
    measure(aligning(plan, rail or plan.reference or "x"), headless=False, otherwise=otherwise)


def _aligned(session: Path, reference: Leg | None, *, as_json: bool) -> str:
    """What a session tells of the rails."""
    from app.measuring.aligning import align_session
    from app.report.schema.alignment import AlignmentReport
    from app.report.schema.document import to_json
    from app.report.text.alignment import aligned_text
    from protocols.record import read_record
    from protocols.session import fold

    recorded = fold(read_record(session).events)
    found = align_session(recorded, reference or recorded.opened.aligned_to or "x")
    report = AlignmentReport.of(name=session.name, found=found)
    return to_json(report) if as_json else aligned_text(found)
