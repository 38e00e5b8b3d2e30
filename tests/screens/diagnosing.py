"""The diagnosis screen as its tests drive and read it."""

from __future__ import annotations

from textual.pilot import Pilot

from app.screens.diagnose import DiagnoseScreen
from app.screens.interface import Interface
from app.screens.plot import ChartPlot
from tests.screens.driving import looked, text


def verdict(interface: Interface) -> str:
    return text(interface, "#verdict-text")


async def diagnosed(pilot: Pilot[str], interface: Interface) -> DiagnoseScreen:
    """The screen once its diagnosis is there."""
    return await looked(pilot, interface, DiagnoseScreen)


def drawn(interface: Interface) -> str:
    return str(interface.screen.query_one("#change-chart0", ChartPlot).render())


def offered(interface: Interface) -> set[str]:
    """Keys that the footer shows."""
    bindings = interface.screen.active_bindings.items()
    return {key for key, entry in bindings if entry.binding.show}
