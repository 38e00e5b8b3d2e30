"""``glidecal simulate-indicator``: a device that speaks a profile, with faults on demand."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from app.commands.options import Channel, figure, say
from calib.errors import UsageError


def simulate_indicator(
    profile: Annotated[str, typer.Argument(help="Indicator profile.", show_default=False)],
    fault: Annotated[str | None, typer.Option(help="A fault to show; 'list' names them.")] = None,
    tcp: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Listen on this loopback TCP port; 0: any.")
    ] = None,
    resolution: Annotated[float, figure("Step of the display, mm.")] = 0.001,
    channel: Channel = 1,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, max=1e6, help="Stop after this time.")
    ] = None,
) -> None:
    """Open a port and answer as the device would, until Ctrl-C."""
    from app.measuring.indicators import swinging
    from drivers.profile import Spindle
    from drivers.profiles import profile_named
    from drivers.twin_port import TwinPort, default_transport
    from drivers.twins import faults_of, twin_of

    known = profile_named(profile)
    names = faults_of(known)
    if fault == "list":
        typer.echo("\n".join(names))
        return
    if fault is not None and fault not in names:
        raise UsageError("--fault", repr(fault), ", ".join(names))
    if not resolution > 0.0:
        raise UsageError("--resolution", f"{resolution:g}", "more than 0 mm")
    transport = default_transport() if tcp is None else "tcp"
    twin = twin_of(known, Spindle(swinging(), resolution, channel), fault)
    with TwinPort(twin, transport, stream_s=known.stream_s, tcp_port=tcp or 0) as port:
        typer.echo(port.url)
        say(f"{known.title} listens there; Ctrl-C ends it.")
        started = time.monotonic()
        while seconds is None or time.monotonic() - started < seconds:
            time.sleep(0.1)
