"""``glidecal indicator``, ``ports`` and ``simulate-indicator``: indicators outside any session."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.machines.options import AsJson, Channel, Machine, Seed, figure, number, option, say
from calib.errors import IndicatorError, UsageError

if TYPE_CHECKING:  # heavy: imported where used
    from drivers.twins import SimulatedRig

indicator_verbs = typer.Typer(help="One indicator outside any session.", no_args_is_help=True)

ProfileName = Annotated[str, option("Indicator profile.")]
Unit = Annotated[str, option("Unit of the display: mm, inch or µm.")]
PortName = Annotated[str, typer.Argument(help="Port of the indicator.", show_default=False)]


@indicator_verbs.command("read")
def read(
    port: PortName,
    profile: ProfileName = "mitutoyo-01a",
    watch: Annotated[bool, option("Continue until Ctrl-C.", "--watch")] = False,
    unit: Unit = "mm",
    channel: Channel = 1,
    as_json: AsJson = False,
) -> None:
    """One reading, or one after the other."""
    from app.measuring.indicators import asked_for
    from app.report.schema.document import to_json
    from app.report.schema.readings import outcome_report
    from app.report.text.indicator import outcome_text
    from drivers.line import IndicatorLine
    from drivers.profile import Evidence, Fault
    from drivers.profiles import profile_named

    profile_known = profile_named(profile)
    if profile_known.verified is Evidence.UNVERIFIED:
        say(f"glidecal: profile {profile_known.name} is unverified: {profile_known.source}")
    line = IndicatorLine(profile_known, port, query=asked_for(unit, channel))
    line.start()
    with closing(line):
        while True:
            outcome = line.ask().result()
            if as_json:
                typer.echo(to_json(outcome_report(profile_known.name, outcome)))
            elif watch or not isinstance(outcome, Fault):
                typer.echo(outcome_text(outcome))
            if not watch:
                break
            time.sleep(profile_known.interval_s)
    if isinstance(outcome, Fault):
        thing = f"indicator on {port}"
        raise IndicatorError(thing, f"{outcome.kind}: {outcome.words}", "", profile_known.hint)


@indicator_verbs.command("doctor")
def doctor(
    port: PortName,
    profile: Annotated[
        str | None, option("Indicator profile.", show_default="every profile is tried on the port")
    ] = None,
    unit: Unit = "mm",
    channel: Channel = 1,
) -> None:
    """Everything that can be wrong, each with the next thing to do.

    Without --profile every profile is tried: the port gets the request of one after the other.
    """
    from app.exit_codes import Exit
    from app.measuring.indicators import asked_for
    from app.report.text.indicator import findings_text, trial_text
    from drivers.doctor import examine, examine_by_trial
    from drivers.profiles import PROFILES, profile_named

    query = asked_for(unit, channel)
    if profile is None:
        say(f"Trying profiles on {port}, up to a minute. Ctrl-C stops.")
        findings = examine_by_trial(
            port, query, PROFILES.values(), lambda *trial: say(trial_text(*trial))
        )
    else:
        findings = examine(profile_named(profile), port, query, PROFILES.values())
    typer.echo(findings_text(findings))
    raise typer.Exit(Exit.DONE if all(f.well for f in findings) else Exit.INDICATOR)


def ports(as_json: AsJson = False) -> None:
    """Serial ports of this computer, indicator profiles."""
    from app.report.schema.document import to_json
    from app.report.schema.readings import PortsReport
    from drivers.port import ports_here
    from drivers.profiles import PROFILES

    report = PortsReport.of(ports_here(), [*PROFILES.values()])
    if as_json:
        typer.echo(to_json(report))
        return
    typer.echo("Serial ports:")
    for port in report.ports:
        words = filter(None, (port.port, port.description, port.hardware))
        typer.echo(f"  {'  '.join(words)}")
    if not report.ports:
        typer.echo("  none; plug the indicator in and try again")
    typer.echo("Indicator profiles:")
    for profile in report.profiles:
        typer.echo(f"  {profile.name}  {profile.title}  ({profile.verified})")


def simulate_indicator(
    profile: Annotated[str, typer.Argument(help="Indicator profile.", show_default=False)],
    fault: Annotated[str | None, option("A fault to show; 'list' names them.")] = None,
    tcp: Annotated[
        int | None, option("Listen on this loopback TCP port; 0: any.", min=0, max=65535)
    ] = None,
    resolution: Annotated[float, figure("Step of the display, mm.")] = 0.001,
    channel: Channel = 1,
    seconds: Annotated[float | None, number("Stop after this time.", 0.0, 1e6)] = None,
    protocol: Annotated[
        str | None, option("Rehearse: two indicators on a machine that follows this procedure.")
    ] = None,
    machine: Machine = None,
    seed: Seed = 1,
) -> None:
    """A simulated indicator on a port, until Ctrl-C.

    It swings; with --protocol there are two, at a simulated machine that goes from step to step
    when Enter is pressed here: to rehearse a session on real ports.
    """
    from app.measuring.indicators import swinging
    from drivers.profile import Spindle
    from drivers.profiles import profile_named
    from drivers.twins import IndicatorTwin, TwinPort, default_transport, faults_of

    profile_known = profile_named(profile)
    names = faults_of(profile_known)
    if fault == "list":
        typer.echo("\n".join(f"{name:<16}{description}" for name, description in names.items()))
        return
    if fault is not None and fault not in names:
        raise UsageError("--fault", repr(fault), ", ".join(names))
    if not resolution > 0.0:
        raise UsageError("--resolution", f"{resolution:g}", "more than 0 mm")
    if protocol is not None:
        if fault is not None or tcp is not None or channel != 1:
            raise UsageError("--protocol", "--fault, --tcp or --channel, too", "one or the others")
        _rehearse(profile, protocol, machine, seed, resolution, seconds)
        return
    transport = default_transport() if tcp is None else "tcp"
    twin = IndicatorTwin(profile_known, Spindle(swinging(), resolution, channel), fault)
    with TwinPort(twin, transport, stream_s=profile_known.stream_s, tcp_port=tcp or 0) as port:
        typer.echo(port.url)
        say(f"{profile_known.title} listens there; Ctrl-C ends it.")
        _wait(seconds)


def _wait(seconds: float | None) -> None:
    started = time.monotonic()
    while seconds is None or time.monotonic() - started < seconds:
        time.sleep(0.1)


def _rehearse(
    profile: str,
    protocol: str,
    machine: str | None,
    seed: int,
    resolution_mm: float,
    seconds: float | None,
) -> None:
    """Move a simulated machine through its procedure, as is typed here; there is no record."""
    from app.measuring.demo import WATCHED, SimulatedBench, demo_plan, rehearsed
    from app.report.text.preparing import rehearsal_text, rehearsed_text

    bench = replace(WATCHED, resolution_mm=resolution_mm)
    plan = demo_plan(Path(), protocol, seed, bench, [profile], machine)
    options = f"--protocol {protocol}" + f" --machine {machine}" * bool(machine)
    steps = plan.procedure.steps(plan.machine.geometry(), plan.axes)
    # the name of the file is that of the run: a rehearsal scatters alike every time
    stand = SimulatedBench(replace(plan, path=Path("rehearsal")))
    with closing(stand):
        typer.echo("\n".join(stand.ports))
        say(rehearsal_text(options, plan, stand.ports))

        def follow() -> None:
            for step in rehearsed(steps, _pushing(stand.rig, _typed())):
                stand.go(step)
                say(rehearsed_text(step, plan))

        threading.Thread(target=follow, daemon=True).start()
        _wait(seconds)


def _pushing(rig: SimulatedRig, typed: Iterator[str]) -> Iterator[str]:
    """Lines that are no order to push a spindle."""
    spindles = {f"p{k}": k - 1 for k in range(1, len(rig.ports) + 1)}
    for line in typed:
        if line in spindles:
            rig.push(spindles[line])
        else:
            yield line


def _typed() -> Iterator[str]:
    """Lines of standard input as they come."""
    # not sys.stdin: a thread that waits in it holds a lock that the end of the program needs
    while typed := os.read(0, 1024):
        yield from typed.decode(errors="replace").splitlines()
