"""The diagnosis screen as its tests drive and read it."""

from __future__ import annotations

from textual.pilot import Pilot

from app.screens.diagnose import DiagnoseScreen
from app.screens.interface import Glidecal
from app.screens.plot import ChartPlot
from tests.screens.driving import looked, text


def verdict(interface: Glidecal) -> str:
    return text(interface, "#verdict-text")


async def diagnosed(pilot: Pilot[str], interface: Glidecal) -> DiagnoseScreen:
    """The screen once its diagnosis is there."""
    return await looked(pilot, interface, DiagnoseScreen)


def drawn(interface: Glidecal) -> str:
    return str(interface.screen.query_one("#change-chart0", ChartPlot).render())


def offered(interface: Glidecal) -> set[str]:
    """Keys that the footer shows."""
    bindings = interface.screen.active_bindings.items()
    return {key for key, entry in bindings if entry.binding.show}
