"""Between two rounds of measuring: turn the screws of the rails, live."""

from __future__ import annotations

from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.widgets import Static

from app.measuring.aligning import Round, align_session
from app.report.text import alignment as texts
from app.report.text.help import help_of
from app.report.text.session import progress_text
from app.screens.corrections import Corrections
from app.screens.interface import screen_of
from app.screens.pages import last_lines, signalled
from app.screens.session_view import Gauges
from calib.errors import GlidecalError


class AlignScreen(Corrections):
    """One screw after the other; what it has moved by and what is to go, while it is turned."""

    HELP = help_of("align")
    FINISHES, LEAVES = "align.finish", "align.leave"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "choose(-1)", "Up", show=False, id="align.up"),
        Binding("down", "choose(1)", "Down", show=False, id="align.down"),
        Binding("space,enter", "watch", "Watch/done", id="align.watch"),
        Binding("x", "as_asked", "As asked", id="align.asked"),
        Binding("left", "turn(-1)", "Turn −", id="align.less"),
        Binding("right", "turn(1)", "Turn +", id="align.more"),
        Binding("c", "again", "Again", id="align.again"),
        Binding("f", "finish", "Finish", id="align.finish"),
        Binding("n", "note", "Note", show=False, id="align.note"),
        Binding("escape", "leave", "Home", show=False, id="align.home"),
        Binding("f10", "app.quit", "Leave", id="align.leave"),
    ]

    round: Round | None = None
    """None where the session does not tell how the rails lie."""

    def compose(self) -> ComposeResult:
        yield Static("", id="progress", markup=False)
        yield Static("", id="step", markup=False)
        yield Gauges(self.plan.instruments)
        yield Static("", id="said", markup=False)
        yield Static("", id="screws", markup=False)
        yield from last_lines()

    def on_mount(self) -> None:
        mode = f"align to rail {(self.plan.reference or 'x').upper()}"
        text = progress_text(self.guided.session, self.guided.steps, mode)
        self.query_one("#progress", Static).update(text)
        try:
            aligned = align_session(self.guided.session, self.plan.reference or "x")
        except GlidecalError as problem:
            self.say(f"{problem} {{align.again}} measures again.")
        else:
            self.round = Round(self.guided, aligned)
            self.say(texts.round_begins_text(aligned))
            self.action_choose(0)
        self.set_interval(0.2, self._show)
        self._show()

    def proceed(self) -> None:
        self._show()

    def say(self, text: str, *, wrong: bool = False) -> None:
        self.query_one("#said", Static).update(signalled(self.app.keyed(text)))

    def _show(self) -> None:
        self.query_one(Gauges).show([gauge.live() for gauge in self.guided.gauges])
        if self.round:
            self.query_one("#step", Static).update(self.app.keyed(texts.screw_text(self.round)))
            self.query_one("#screws", Static).update(texts.round_text(self.round))

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Only a simulated machine has screws to be turned by a key."""
        if action == "turn":
            return self.round is not None and self.guided.turn is not None
        return action not in ("choose", "watch", "as_asked") or self.round is not None

    @property
    def rails(self) -> Round:
        assert self.round is not None, "these keys are offered in a round alone"
        return self.round

    def action_choose(self, by: int) -> None:
        """Another screw; one that is watched is finished first."""
        if self.rails.watching:
            self.say(texts.IS_WATCHED)
            return
        with self.writing():
            self.query_one(Gauges).name_them(self.plan.instruments, self.rails.choose(by))
        self._show()

    async def _may_move(self) -> bool:
        """The first move of a round ends what the round has measured: that is asked."""
        measured = self.guided.session.readings
        return not measured or await self.agreed(texts.MOVE_QUESTION, texts.MOVE_CHOICES)

    @work
    async def action_watch(self) -> None:
        """Begin to watch the chosen screw, or write down where it is now."""
        if self.rails.watching:
            self._note_move(watched=True)
        elif await self._may_move():
            with self.app.complaining():
                self.say(texts.WATCH[self.rails.watch()])

    @work
    async def action_as_asked(self) -> None:
        if self.rails.number not in self.rails.moved_mm and await self._may_move():
            self._note_move(watched=False)

    def _note_move(self, *, watched: bool) -> None:
        with self.writing():
            self.say(texts.moved_text(self.rails.done(watched=watched)))
            self.action_choose(1)

    def action_turn(self, way: int) -> None:
        if not self.rails.turn(way):
            self.say(texts.WATCH_FIRST)

    def action_again(self) -> None:
        """Measure every step once more; without a move nothing is to be measured."""
        if self.round is not None and self.round.watching:
            self.say(texts.IS_WATCHED)
        elif self.guided.step() is None:
            self.say(texts.NOTHING_MOVED)
        else:
            self.app.go_to(screen_of("measure.MeasureScreen", self.guided, self.plan))

    def action_finish(self) -> None:
        if self.guided.step() is not None:
            self.say(texts.MOVED_SINCE)
        elif not self.busy:
            self.busy = True
            self.finish()
