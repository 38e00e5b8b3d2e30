"""The Hexa Slide: what a procedure sees, the machine drawn, and the search for postures."""

from __future__ import annotations

import threading
from typing import ClassVar

from textual import work
from textual.binding import Binding, BindingType

from app.dialogue.hexaslide import asked_count, asked_request
from app.planning.hexaslide import Request, better_and_better, hexaslide_planning
from app.report.charts.hexaslide import drawn_machine, drawn_postures
from app.report.text import hexaslide as texts
from app.report.text.help import help_of
from app.screens.interface import once
from app.screens.paged import Page, PagedScreen
from app.screens.pages import apart
from calib.hexaslide.planning import HexaSlideSeen, look_at
from calib.hexaslide.procedures import ProcedureKind
from calib.hexaslide.search import BestPostures


class HexaSlideScreen(PagedScreen[None]):
    """Four procedures on one machine; nothing is written."""

    HELP = help_of("hexaslide")
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("p", "ask('procedure')", "Procedure", id="hexaslide.procedure"),
        Binding("o", "search", "Optimum", id="hexaslide.search"),
        Binding("c", "count", "Count", id="hexaslide.count"),
        Binding("m", "ask('measured')", "Measured", id="hexaslide.measured"),
        Binding("f", "ask('machine')", "File", id="hexaslide.machine"),
        Binding("plus", "draw(1)", "Next posture", show=False, id="hexaslide.next_posture"),
        Binding("minus", "draw(-1)", "Posture before", show=False, id="hexaslide.posture_before"),
    ]
    NEEDS = ("count", "search")
    LOOKING, NOTHING = texts.LOOKING, texts.NO_VIEW
    PAGES = (
        Page("sees", "Sees", charts=2, beside=True),
        Page("drawn", "Machine", charts=2),
        Page("search", "Postures", charts=2),
        Page("angles", "Angles", charts=2, text=False),
        Page("list", "List"),
    )

    def __init__(self, request: Request | None = None) -> None:
        super().__init__()
        self.request = request or Request(ProcedureKind.POSE_INVERSE)
        self.view: HexaSlideSeen | None = None
        self.best_postures: BestPostures | None = None
        self._conditions: dict[str, float] | None = None
        self.searching = False
        self._count = 0
        self._drawn_at = 0

    def begin(self) -> None:
        self._look(self.request)

    def _look(self, request: Request) -> None:
        """See what another procedure or machine gives; a search of before ends."""
        self._end_search()
        self.request, self.view, self.best_postures, self._conditions = request, None, None, None

        def view() -> HexaSlideSeen:
            return look_at(hexaslide_planning(request))

        heading = texts.heading_text(request.machine_file, None)
        self.look(heading, texts.LOOKING, view, self._show_view, texts.problem_text)

    def _show_view(self, view: HexaSlideSeen) -> None:
        self.view, self._drawn_at, self._count = view, 0, view.fewest
        self.head(texts.heading_text(self.request.machine_file, view))
        self._show_all()

    def _show_all(self) -> None:
        view, best = self.view, self.best_postures
        if view is None:
            return
        self.put("sees", texts.sees_text(view, best, self._conditions))
        self.put("list", texts.list_text(best))
        drawings = drawn_postures(view.machine, best)
        self.put("search", None, *drawings[:2])
        self.put("angles", None, *drawings[2:])
        self._show_search()
        self._draw_machine()

    def _show_search(self) -> None:
        """Show the words of the search alone: nothing is drawn again when it ends."""
        if self.view is not None:
            text = texts.search_text(
                self.view, self._count, self.best_postures, searching=self.searching
            )
            self.put("search", text)

    def _draw_machine(self) -> None:
        assert self.view is not None, "shown with it alone"
        machine = self.view.machine
        postures = self.best_postures.coordinates if self.best_postures else ()
        at = postures[self._drawn_at - 1] if self._drawn_at else machine.box.centre
        pair = drawn_machine(machine, at)
        self.put("drawn", texts.drawn_at_text(self._drawn_at, len(postures)), *pair)
        self.put("sees", None, *pair)

    @once("ask")
    async def action_ask(self, question: str) -> None:
        if request := await asked_request(self, question, self.request):
            self._look(request)

    @once("ask")
    async def action_count(self) -> None:
        assert self.view is not None, "offered with it alone"
        if count := await asked_count(self, self.view.fewest, self._count):
            self._begin_anew(count)

    def _begin_anew(self, count: int, *, searching: bool = False) -> None:
        """So many postures are searched for; what was found before is gone."""
        self._end_search()
        self._count, self.searching, self.best_postures, self._drawn_at = count, searching, None, 0
        self._conditions = None
        self._show_all()

    def action_search(self) -> None:
        assert self.view is not None, "offered with it alone"
        self.action_show_page("search")
        self._begin_anew(self._count, searching=True)
        self._search(self.view, self._count)

    @work(group="search", description="search")  # as of `PagedScreen.look`
    async def _search(self, view: HexaSlideSeen, count: int) -> None:
        stopped = threading.Event()
        steps = better_and_better(view, count, stopped.is_set)
        try:
            with self.app.complaining():
                while step := await apart(self, next, steps, None):
                    self.best_postures, self._conditions = step
                    self._show_all()
        finally:  # a search does not outlive its worker, and that not its screen
            stopped.set()
        self.searching = False
        self._show_search()

    def _end_search(self) -> None:
        self.searching = False
        self.workers.cancel_group(self, "search")

    def action_draw(self, by: int) -> None:
        """The machine at the next of the postures that were found; 0 is the middle of the box."""
        if self.best_postures is not None:
            self._drawn_at = (self._drawn_at + by) % (len(self.best_postures.coordinates) + 1)
            self._draw_machine()

    def action_back(self) -> None:
        """Stop the search, or go back to where this was opened from."""
        if self.searching:
            self._end_search()
            self.app.notify(texts.STOPPED)
            self._show_search()
        else:
            super().action_back()
