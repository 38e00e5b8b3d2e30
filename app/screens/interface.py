"""The Textual application: it owns the open session, the screens only show it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any, ClassVar

from textual.app import App, SystemCommand
from textual.binding import Binding, BindingType
from textual.screen import Screen
from textual.widget import Widget

from app.exit_codes import Exit
from app.guided import GuidedSession
from app.opening import Indicators
from app.screens.dialogs import HelpDialog
from calib.errors import GlidecalError

NO_HELP = "The keys of this screen stand in its last line."


class Interface(App[str]):
    """Screens over one session at a time. The result of `run` is a line for after the end."""

    TITLE = "glidecal"
    CSS_PATH = "glidecal.tcss"
    ENABLE_COMMAND_PALETTE = True
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+c", "interrupt", "Stop", show=False, priority=True),
        Binding("f1", "help", "Help", id="app.help"),
        Binding("f10", "quit", "Quit", id="app.quit"),
    ]

    def __init__(self, first: Screen[None]) -> None:
        super().__init__()
        self._first = first
        self.indicators: Indicators | None = None
        self.guided: GuidedSession | None = None

    def on_mount(self) -> None:
        self.push_screen(self._first)

    def get_system_commands(self, screen: Screen[Any]) -> Iterable[SystemCommand]:
        """The palette offers what an operator can use, no tools of the developer."""
        kept = ("Theme", "Quit")
        return [entry for entry in super().get_system_commands(screen) if entry.title in kept]

    def action_help(self) -> None:
        """Words about the focused panel, then about the screen."""
        words = [self.screen.HELP or ""]
        panels = self.focused.ancestors_with_self if self.focused else []
        words[:0] = [panel.HELP for panel in panels if isinstance(panel, Widget) and panel.HELP]
        said = "\n\n".join(dict.fromkeys(text for text in words if text))
        if not isinstance(self.screen, HelpDialog):
            self.push_screen(HelpDialog(said or NO_HELP))

    def complain(self, problem: GlidecalError | str) -> None:
        """Show an error that a person can act on."""
        self.notify(str(problem), severity="error", timeout=12, markup=False)

    async def action_quit(self) -> None:
        """Quit; an open session is paused and can be continued."""
        self.notify("Finishing …", markup=False)
        self.exit(await self._leave())

    async def action_interrupt(self) -> None:
        """Ctrl-C: as quit, with the exit status of an interruption."""
        self.exit(await self._leave(), return_code=Exit.INTERRUPTED)

    async def on_unmount(self) -> None:
        """However the interface ends, ports and record are let go."""
        await self._leave()

    async def _leave(self) -> str:
        guided, indicators = self.guided, self.indicators
        self.guided = self.indicators = None
        if guided is not None and guided.closed:
            return f"The session is complete: {guided.path}"
        if guided is not None:
            await asyncio.to_thread(guided.leave)
            done, steps = len(guided.session.done()), len(guided.steps)
            return (
                f"Session paused after {done} of {steps} steps; every reading taken is on the "
                f"disk. Continue with: glidecal run --continue {guided.path}"
            )
        if indicators is not None:
            await asyncio.to_thread(indicators.close)
        return ""

    def go_to(self, screen: Screen[Any]) -> None:
        """Replace the present screen."""
        self.switch_screen(screen)
