"""The Hexa Slide: what a procedure sees, the machine drawn, and the search for postures."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import Footer, Static, TabbedContent, TabPane

from app.planning.hexaslide import Request, hexaslide_planning
from app.report.charts.hexaslide import drawn_machine, drawn_postures
from app.report.text import hexaslide as texts
from app.screens.interface import TextDialog
from app.screens.paged import PagedScreen, page_keys
from app.screens.pages import apart
from app.screens.plot import ChartPlot
from calib.errors import GlidecalError
from calib.hexaslide.planning import (
    KINDS,
    HexaSlideSeen,
    conditions_at,
    look_at,
)
from calib.hexaslide.procedures import ProcedureKind
from calib.hexaslide.search import BestPostures, Search, searches

MOST_POSTURES = 200
TEXTS = ("sees-text", "drawn-text", "search-text", "list-text")
"""Of the pages that have one."""


class _Left(Exception):
    """Nobody waits for the search any more."""


class HexaSlideScreen(PagedScreen):
    """Four procedures on one machine; nothing is written."""

    HELP = texts.HEXASLIDE_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        *(
            Binding(f"{k}", f"procedure('{kind}')", kind, show=False, id=f"hexaslide.{kind}")
            for k, kind in enumerate(KINDS, start=1)
        ),
        Binding("o", "search", "Optimum postures", id="hexaslide.search"),
        Binding("c", "count", "Count", id="hexaslide.count"),
        Binding("m", "measured", "Measured", id="hexaslide.measured"),
        Binding("f", "machine", "File", id="hexaslide.machine"),
        Binding("plus", "draw(1)", "Next posture", show=False, id="hexaslide.next_posture"),
        Binding("minus", "draw(-1)", "Posture before", show=False, id="hexaslide.posture_before"),
        *page_keys("hexaslide", "back"),
    ]

    def __init__(self, request: Request | None = None) -> None:
        super().__init__()
        self.request = request or Request(ProcedureKind.POSE_INVERSE)
        self.view: HexaSlideSeen | None = None
        self.found: BestPostures | None = None
        self.looking = False
        self.searching = False
        self._count = 0
        self._drawn_at = 0

    def compose(self) -> ComposeResult:
        yield Static("", id="hexaslide", markup=False)
        with TabbedContent(initial="sees"):
            with TabPane("Sees", id="sees"), Horizontal():
                with VerticalScroll():
                    yield Static("", id="sees-text", classes="page", markup=False)
                with Vertical(id="sketch"):
                    yield ChartPlot(plot_id="sketch-front")
                    yield ChartPlot(plot_id="sketch-above")
            with TabPane("Machine", id="machine"), Vertical():
                yield Static("", id="drawn-text", classes="page", markup=False)
                with Horizontal():
                    yield ChartPlot(plot_id="front")
                    yield ChartPlot(plot_id="above")
            with TabPane("Postures", id="places"), Vertical():
                yield Static("", id="search-text", classes="page", markup=False)
                with Horizontal():
                    yield ChartPlot(plot_id="projection0")
                    yield ChartPlot(plot_id="projection1")
            with TabPane("Angles", id="angles"), Horizontal():
                yield ChartPlot(plot_id="projection2")
                yield ChartPlot(plot_id="projection3")
            with TabPane("List", id="list"), VerticalScroll():
                yield Static("", id="list-text", classes="page", markup=False)
        yield Footer(compact=True, show_command_palette=False)

    def on_mount(self) -> None:
        self._look(self.request)

    def _say(self, name: str, text: str) -> None:
        self.query_one(f"#{name}", Static).update(text)

    def _look(self, request: Request) -> None:
        """See what another procedure or machine gives; a search of before ends."""
        self._end_search()
        self.request, self.view, self.found = request, None, None
        self.looking = True
        self._show_heading()
        self._say_everywhere(texts.LOOKING)
        self._look_apart(request)

    def _show_heading(self) -> None:
        self._say("hexaslide", texts.heading_text(self.request.machine_file, self.view))

    def _say_everywhere(self, text: str) -> None:
        for name in TEXTS:
            self._say(name, text)
        for plot in self.query(ChartPlot):
            plot.display = False

    @work(group="look", exclusive=True)
    async def _look_apart(self, request: Request) -> None:
        try:
            view = await apart(self, lambda: look_at(hexaslide_planning(request)))
        except GlidecalError as problem:
            self.looking = False
            self._say_everywhere(texts.problem_text(problem))
            return
        self.looking = False
        self.view, self._drawn_at, self._count = view, 0, view.fewest
        for plot in self.query(ChartPlot):
            plot.display = True
        self._show_heading()
        self._show_all()

    def _show_all(self) -> None:
        view, found = self.view, self.found
        if view is None:
            return
        best = None if found is None else conditions_at(view, found.coordinates)
        self._say("sees-text", texts.sees_text(view, found, best))
        self._say("list-text", texts.list_text(found))
        self._show_search()
        for k, drawing in enumerate(drawn_postures(view.machine, found)):
            self.query_one(f"#projection{k}", ChartPlot).show(drawing)
        self._draw_machine(view)

    def _show_search(self) -> None:
        if self.view is not None:
            text = texts.search_text(self.view, self._count, self.found, searching=self.searching)
            self._say("search-text", text)

    def _draw_machine(self, view: HexaSlideSeen) -> None:
        count = 0 if self.found is None else len(self.found.coordinates)
        self._say("drawn-text", texts.drawn_at_text(self._drawn_at, count))
        posture = view.machine.box.centre
        if self.found is not None and self._drawn_at:
            posture = self.found.coordinates[self._drawn_at - 1]
        front, above = drawn_machine(view.machine, posture)
        for place in ("", "sketch-"):
            self.query_one(f"#{place}front", ChartPlot).show(front)
            self.query_one(f"#{place}above", ChartPlot).show(above)

    def action_procedure(self, name: str) -> None:
        """One of the paper's procedures."""
        self._look(replace(self.request, procedure=name, measured=(), known=None))

    def action_measured(self) -> None:
        """Ask which components of the posture are measured."""

        def typed(text: str) -> None:
            measured = tuple(part.strip() for part in text.split(","))
            linked = self.request.procedure == ProcedureKind.CONSTRAINT_LINK
            kind = ProcedureKind.CONSTRAINT_LINK if linked else ProcedureKind.POSE_FORWARD
            self._look(replace(self.request, procedure=kind, measured=measured))

        proposed = ",".join(self.request.measured or ("x", "y", "z", "theta"))
        self.app.ask(TextDialog(texts.WHICH_COMPONENTS, "x,y,z,theta", proposed), typed)

    def action_machine(self) -> None:
        """Ask for a machine file."""
        now = self.request.machine_file

        def typed(text: str | None) -> None:
            path = Path(text).expanduser() if text else None
            if path != now:
                self._look(replace(self.request, machine_file=path))

        proposed = str(now) if now else ""
        self.app.push_screen(TextDialog(texts.WHICH_MACHINE, "path", proposed), typed)

    def _ready(self) -> HexaSlideSeen | None:
        """What is seen; where there is nothing, the reason is said."""
        if self.view is None:
            self.app.complain(texts.LOOKING if self.looking else texts.NO_VIEW)
        return self.view

    def action_count(self) -> None:
        """Ask how many postures."""
        if view := self._ready():
            question = TextDialog(texts.count_question(view.fewest), "number", str(self._count))
            self.app.ask(question, partial(self._take_count, view.fewest))

    def _take_count(self, fewest: int, text: str) -> None:
        if not text.isdecimal() or not fewest <= int(text) <= MOST_POSTURES:
            self.app.complain(texts.count_problem(text, fewest, MOST_POSTURES))
            return
        self._end_search()
        self._count, self.found, self._drawn_at = int(text), None, 0
        self._show_all()

    def action_search(self) -> None:
        """Search for the best postures, one start after the other."""
        view = self._ready()
        if view is None:
            return
        self._end_search()
        self.searching, self.found, self._drawn_at = True, None, 0
        self.query_one(TabbedContent).active = "places"
        self._show_all()
        self._search(view, self._count)

    @work(group="search")
    async def _search(self, view: HexaSlideSeen, count: int) -> None:
        left = threading.Event()

        def watch() -> None:
            if left.is_set():
                raise _Left

        wanted = Search(seed=view.planned.seed)
        try:
            with self.app.complaining():
                starts = searches(view.procedure, view.machine, count, wanted, watch)
                while found := await apart(self, next, starts, None):
                    self.found = found
                    self._show_all()
        finally:  # a search does not outlive its worker, and that not its screen
            left.set()
        self.searching = False
        self._show_search()

    def _end_search(self) -> None:
        self.searching = False
        self.workers.cancel_group(self, "search")

    def action_draw(self, by: int) -> None:
        """The machine at the next of the postures that were found; 0 is the middle of the box."""
        if self.view is not None and self.found is not None:
            self._drawn_at = (self._drawn_at + by) % (len(self.found.coordinates) + 1)
            self._draw_machine(self.view)

    def action_back(self) -> None:
        """Stop the search, or go back to where this was opened from."""
        if self.searching:
            self._end_search()
            self.app.notify(texts.STOPPED, markup=False)
            self._show_search()
        else:
            self.app.action_go_back()
