"""``glidecal ports``: serial ports and indicator profiles; writes to no port."""

from __future__ import annotations

import typer

from app.commands.options import AsJson


def ports(as_json: AsJson = False) -> None:
    """Serial ports of this computer and the indicator profiles that exist."""
    from serial.tools import list_ports

    from app.report.schema.document import to_json
    from app.report.schema.readings import PortsReport
    from drivers.profiles import PROFILES

    found = PortsReport.of(
        ports=tuple(sorted(list_ports.comports())), profiles=tuple(PROFILES.values())
    )
    if as_json:
        typer.echo(to_json(found))
        return
    typer.echo("Serial ports:")
    for one in found.ports:
        typer.echo(f"  {one.port}  {one.description}  {one.hardware}")
    if not found.ports:
        typer.echo("  none; plug the indicator in and try again")
    typer.echo("Indicator profiles:")
    for profile in found.profiles:
        typer.echo(f"  {profile.name}  {profile.title}  ({profile.verified})")
