"""Replaying: the picture of measuring over a recorded session. Nothing is measured or written."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.widgets import Log

from app.measuring.attended import TakenBy
from app.measuring.playback import Playback
from app.report.text import replay as texts
from app.report.text.help import help_of
from app.screens.interface import once, screen_of
from app.screens.pages import apart, last_lines
from app.screens.session_view import SessionScreen, SessionView
from calib.errors import GlidecalError
from protocols.record import read_record

TICK_S = 0.1


class ReplayScreen(SessionScreen):
    """One record, played or moved through by hand.

    Raises RecordError or UsageError where the file cannot be used.
    """

    HELP = help_of("replay")
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space", "playback('toggle')", "Play", id="replay.play"),
        Binding("right", "playback('step', 1)", "Next", id="replay.forward"),
        Binding("left", "playback('step', -1)", "Before", id="replay.back"),
        Binding("up,plus", "playback('faster', 1)", "Faster", show=False, id="replay.faster"),
        Binding("down,minus", "playback('faster', -1)", "Slower", show=False, id="replay.slower"),
        Binding("home", "playback('go', 0)", "Start", show=False, id="replay.start"),
        Binding("end", f"playback('go', {sys.maxsize})", "End", show=False, id="replay.end"),
        Binding("j", "jump", "Jump", id="replay.jump"),
        Binding("t", "list", "Taken", id="replay.list"),
        Binding("pageup", "page(-1)", "List up", show=False, id="replay.list-up"),
        Binding("pagedown", "page(1)", "List down", show=False, id="replay.list-down"),
        Binding("w", "where", "Where", show=False, id="replay.where"),
        Binding("v", "plot", "View", show=False, id="replay.plot"),
        Binding("l", "result", "Result", id="replay.result"),
        Binding("y", "copy", "Copy", show=False, id="replay.copy"),
        Binding("escape", "back", "Back", id="replay.leave"),
    ]

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path, self.playback = path, Playback(read_record(path))
        self.view = SessionView(self.playback.instruments)

    def compose(self) -> ComposeResult:
        yield self.view
        listing = Log(id="taken")
        listing.can_focus = False  # the arrow keys are the replay's
        yield listing
        yield from last_lines()

    def on_mount(self) -> None:
        self._show()
        self.set_interval(TICK_S, self._tick)

    def on_resize(self) -> None:
        self._show_picture()

    def _tick(self) -> None:
        if self.playback.tick():
            self._show()
        else:
            self.view.gauges.show(self.playback.live)

    def _show(self) -> None:
        self._show_picture()
        self.view.say(texts.said_text(self.playback))
        self._show_list()

    def _show_picture(self) -> None:
        playback = self.playback
        place = playback.shown, playback.steps, playback.now
        self.view.show(texts.progress_line(playback), *place, TakenBy.NOBODY)
        self.view.gauges.show(playback.live)

    def _show_list(self) -> None:
        """The readings so far; what is shown already is only added to."""
        if self.has_class("listing"):
            lines, listing = texts.reading_lines(self.playback.session), self.query_one(Log)
            if lines[: listing.line_count] != list(listing.lines):
                listing.clear()
            listing.write_lines(lines[listing.line_count :])

    def action_playback(self, verb: str, *to: int | str) -> None:
        """Play or pause, step, play faster, or go to a frame, as the playback calls it."""
        getattr(self.playback, verb)(*to)
        self._show()

    @work
    async def action_jump(self) -> None:
        self.action_playback("pause")  # what is said next stays to be read
        question = texts.JUMP_QUESTION.format(self.playback.unit)
        if text := await self.line(question, f"1 … {len(self.playback.steps)}"):
            try:
                self.playback.jump_to(text)
            except GlidecalError as problem:
                self.view.say(str(problem))
            else:
                self._show()

    def action_list(self) -> None:
        self.toggle_class("listing")
        self.refresh_bindings()
        self._show_list()

    def action_page(self, by: int) -> None:
        listing = self.query_one(Log)
        listing.scroll_relative(y=by * listing.scrollable_content_region.height, animate=False)

    def action_copy(self) -> None:
        self.app.copy("\n".join(texts.reading_lines(self.playback.session)))

    def action_back(self) -> None:
        """The picture again instead of the list, then the screen before, or home."""
        if self.has_class("listing"):
            self.action_list()
        else:
            self.app.action_go_back()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Who only looks has no way back from the first screen; below it is the empty one."""
        has_way = not self.app.read_only or self.has_class("listing")
        return action != "back" or has_way or self in self.app.screen_stack[2:]

    @once("result")
    async def action_result(self) -> None:
        self.action_playback("pause")
        try:
            result = await apart(self, screen_of, "result.result_of", [self.path], verified=False)
            if self.is_current:
                self.app.push_screen(result)
        except GlidecalError as problem:
            self.view.say(texts.UNSOLVED.format(problem))
