"""``glidecal ports``: serial ports and indicator profiles; writes to no port."""

from __future__ import annotations

from typing import Any

import typer

from app.commands.options import AsJson


def ports(as_json: AsJson = False) -> None:
    """Serial ports of this computer and the indicator profiles that exist."""
    from serial.tools import list_ports

    from app.documents import to_json
    from drivers.profiles import PROFILES

    found = [
        {"port": port.device, "description": port.description, "hardware": port.hwid}
        for port in sorted(list_ports.comports())
    ]
    profiles = [
        {"name": p.name, "title": p.title, "verified": p.verified, "source": p.source}
        for p in PROFILES.values()
    ]
    if as_json:
        document: dict[str, Any] = {"schema": "glidecal.ports/1", "ports": found}
        typer.echo(to_json(document | {"profiles": profiles}))
        return
    typer.echo("Serial ports:")
    for entry in found:
        typer.echo(f"  {entry['port']}  {entry['description']}  {entry['hardware']}")
    if not found:
        typer.echo("  none; plug the indicator in and try again")
    typer.echo("Indicator profiles:")
    for profile in profiles:
        typer.echo(f"  {profile['name']}  {profile['title']}  ({profile['verified']})")
