"""The Hexa Slide: what a procedure sees, the machine drawn, and the search for postures."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from textual import on, work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.message import Message
from textual.widgets import Footer, Static, TabbedContent, TabPane

from app.planning.hexaslide import Request, hexaslide_planning
from app.report.charts.hexaslide import drawn_machine, drawn_postures
from app.report.text.hexaslide import (
    HEXASLIDE_HELP,
    LOOKING,
    NO_VIEW,
    STOPPED,
    WHICH_COMPONENTS,
    WHICH_MACHINE,
    count_problem,
    count_question,
    drawn_at_text,
    heading_text,
    list_text,
    problem_text,
    search_text,
    sees_text,
)
from app.screens.interface import Interface, TextDialog
from app.screens.pages import PagedScreen
from app.screens.plot import DrawingPlot
from calib.errors import GlidecalError
from calib.hexaslide.planning import (
    KINDS,
    HexaSlideSeen,
    conditions_at,
    look_at,
)
from calib.hexaslide.procedures import Kind
from calib.hexaslide.search import BestPostures, Search, searches

STARTS = 8
MOST_POSTURES = 200
TEXTS = {"sees": "sees-text", "machine": "drawn-text", "places": "search-text", "list": "list-text"}
"""What is copied from each page."""


@dataclass
class ShownProcedure(Message):
    """What a procedure sees, or why that cannot be told."""

    asked: int
    view: HexaSlideSeen | GlidecalError


class _Left(Exception):
    """Nobody waits for the search any more."""


@dataclass
class SearchNews(Message):
    """A start of the search is done; without a result the search has ended."""

    search: threading.Event
    found: BestPostures | None
    problem: GlidecalError | None = None


class HexaSlideScreen(PagedScreen):
    """Four procedures on one machine; nothing is written."""

    app: Interface
    HELP = HEXASLIDE_HELP
    CSS = """
    HexaSlideScreen #hexaslide {
        height: 1; background: $primary; color: $text; padding: 0 1;
        text-wrap: nowrap; text-overflow: ellipsis;
    }
    HexaSlideScreen TabbedContent { height: 1fr; }
    HexaSlideScreen TabPane { padding: 0; }
    HexaSlideScreen .page { width: auto; height: auto; padding: 0 1; }
    HexaSlideScreen DrawingPlot { width: 1fr; height: 1fr; }
    HexaSlideScreen Horizontal { height: 1fr; }
    HexaSlideScreen #sketch { display: none; width: 1fr; }
    HexaSlideScreen.wide #sketch { display: block; }
    HexaSlideScreen.wide #sees VerticalScroll { width: 79; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        *(
            Binding(f"{k}", f"procedure('{kind}')", kind, show=False, id=f"hexaslide.{kind}")
            for k, kind in enumerate(KINDS, start=1)
        ),
        Binding("o", "search", "Optimum postures", id="hexaslide.search"),
        Binding("c", "count", "Count", id="hexaslide.count"),
        Binding("m", "measured", "Measured", id="hexaslide.measured"),
        Binding("f", "machine", "File", id="hexaslide.machine"),
        Binding("tab,right", "turn_to(1)", "Page", show=False, id="hexaslide.next_page"),
        Binding("shift+tab,left", "turn_to(-1)", "Page", show=False, id="hexaslide.previous_page"),
        Binding("plus", "draw(1)", "Next posture", show=False, id="hexaslide.next_posture"),
        Binding("minus", "draw(-1)", "Posture before", show=False, id="hexaslide.posture_before"),
        Binding("y", "copy", "Copy", show=False, id="hexaslide.copy"),
        Binding("escape", "back", "Back", id="hexaslide.back"),
        Binding("f10", "app.quit", "Quit", id="hexaslide.quit"),
    ]

    def __init__(self, request: Request | None = None) -> None:
        super().__init__()
        self.request = request or Request(Kind.POSE_INVERSE)
        self.view: HexaSlideSeen | None = None
        self.found: BestPostures | None = None
        self.looking = False
        self._asked = 0
        self._count = 0
        self._drawn_at = 0
        self._stop: threading.Event | None = None

    @property
    def searching(self) -> bool:
        """Whether a search goes on."""
        return self._stop is not None

    def compose(self) -> ComposeResult:
        yield Static("", id="hexaslide", markup=False)
        with TabbedContent(initial="sees"):
            with TabPane("Sees", id="sees"), Horizontal():
                with VerticalScroll():
                    yield Static("", id="sees-text", classes="page", markup=False)
                with Vertical(id="sketch"):
                    yield DrawingPlot(plot_id="sketch-front")
                    yield DrawingPlot(plot_id="sketch-above")
            with TabPane("Machine", id="machine"), Vertical():
                yield Static("", id="drawn-text", classes="page", markup=False)
                with Horizontal():
                    yield DrawingPlot(plot_id="front")
                    yield DrawingPlot(plot_id="above")
            with TabPane("Postures", id="places"), Vertical():
                yield Static("", id="search-text", classes="page", markup=False)
                with Horizontal():
                    yield DrawingPlot(plot_id="projection0")
                    yield DrawingPlot(plot_id="projection1")
            with TabPane("Angles", id="angles"), Horizontal():
                yield DrawingPlot(plot_id="projection2")
                yield DrawingPlot(plot_id="projection3")
            with TabPane("List", id="list"), VerticalScroll():
                yield Static("", id="list-text", classes="page", markup=False)
        yield Footer(compact=True, show_command_palette=False)

    def on_mount(self) -> None:
        self._look(self.request)

    def on_unmount(self) -> None:
        """A search does not outlive its screen."""
        self._end_search()

    def _say(self, name: str, text: str) -> None:
        self.query_one(f"#{name}", Static).update(text)

    def _look(self, request: Request) -> None:
        """See what another procedure or machine gives; a search of before ends."""
        self._end_search()
        self.request, self.view, self.found = request, None, None
        self.looking = True
        self._asked += 1
        self._show_heading()
        self._say_everywhere(LOOKING)
        self._look_apart(request, self._asked)

    def _show_heading(self) -> None:
        self._say("hexaslide", heading_text(self.request.machine_file, self.view))

    def _say_everywhere(self, text: str) -> None:
        for name in TEXTS.values():
            self._say(name, text)
        for plot in self.query(DrawingPlot):
            plot.display = False

    @work(thread=True, group="look")
    def _look_apart(self, request: Request, asked: int) -> None:
        try:
            view: HexaSlideSeen | GlidecalError = look_at(hexaslide_planning(request))
        except GlidecalError as problem:
            view = problem
        self.post_message(ShownProcedure(asked, view))

    @on(ShownProcedure)
    def _show_view(self, message: ShownProcedure) -> None:
        if message.asked != self._asked:
            return
        self.looking = False
        if isinstance(message.view, GlidecalError):
            self._say_everywhere(problem_text(message.view))
            return
        self.view, self._drawn_at = message.view, 0
        self._count = self.view.fewest
        for plot in self.query(DrawingPlot):
            plot.display = True
        self._show_heading()
        self._show_all()

    def _show_all(self) -> None:
        view, found = self.view, self.found
        if view is None:
            return
        best = None if found is None else conditions_at(view, found.coordinates)
        self._say("sees-text", sees_text(view, found, best))
        self._say("list-text", list_text(found))
        self._show_search()
        for k, drawing in enumerate(drawn_postures(view.machine, found)):
            self.query_one(f"#projection{k}", DrawingPlot).show(drawing)
        self._draw_machine(view)

    def _show_search(self) -> None:
        if self.view is not None:
            text = search_text(self.view, self._count, self.found, searching=self.searching)
            self._say("search-text", text)

    def _draw_machine(self, view: HexaSlideSeen) -> None:
        count = 0 if self.found is None else len(self.found.coordinates)
        self._say("drawn-text", drawn_at_text(self._drawn_at, count))
        posture = view.machine.box.centre
        if self.found is not None and self._drawn_at:
            posture = self.found.coordinates[self._drawn_at - 1]
        front, above = drawn_machine(view.machine, posture)
        for place in ("", "sketch-"):
            self.query_one(f"#{place}front", DrawingPlot).show(front)
            self.query_one(f"#{place}above", DrawingPlot).show(above)

    def action_procedure(self, name: str) -> None:
        """One of the paper's procedures."""
        self._look(replace(self.request, procedure=name, measured=(), known=None))

    def action_measured(self) -> None:
        """Ask which components of the posture are measured."""

        def typed(text: str | None) -> None:
            if text:
                measured = tuple(part.strip() for part in text.split(","))
                linked = self.request.procedure == Kind.CONSTRAINT_LINK
                kind = Kind.CONSTRAINT_LINK if linked else Kind.POSE_FORWARD
                self._look(replace(self.request, procedure=kind, measured=measured))

        proposed = ",".join(self.request.measured or ("x", "y", "z", "theta"))
        self.app.push_screen(TextDialog(WHICH_COMPONENTS, "x,y,z,theta", proposed), typed)

    def action_machine(self) -> None:
        """Ask for a machine file."""
        now = self.request.machine_file

        def typed(text: str | None) -> None:
            path = Path(text).expanduser() if text else None
            if path != now:
                self._look(replace(self.request, machine_file=path))

        proposed = str(now) if now else ""
        self.app.push_screen(TextDialog(WHICH_MACHINE, "path", proposed), typed)

    def action_count(self) -> None:
        """Ask how many postures."""
        if self.view is None:
            self.app.complain(LOOKING if self.looking else NO_VIEW)
            return
        question = TextDialog(count_question(self.view.fewest), "number", str(self._count))
        self.app.push_screen(question, self._take_count)

    def _take_count(self, text: str | None) -> None:
        if not text or self.view is None:
            return
        fewest = self.view.fewest
        if not text.isdecimal() or not fewest <= int(text) <= MOST_POSTURES:
            self.app.complain(count_problem(text, fewest, MOST_POSTURES))
            return
        self._end_search()
        self._count, self.found, self._drawn_at = int(text), None, 0
        self._show_all()

    def action_search(self) -> None:
        """Search for the best postures, one start after the other."""
        if self.view is None:
            self.app.complain(LOOKING if self.looking else NO_VIEW)
            return
        self._end_search()
        self._stop, self.found, self._drawn_at = threading.Event(), None, 0
        self.query_one(TabbedContent).active = "places"
        self._show_all()
        self._search(self.view, self._count, self._stop)

    @work(thread=True, group="search")
    def _search(self, view: HexaSlideSeen, count: int, stop: threading.Event) -> None:
        def watch() -> None:
            if stop.is_set():
                raise _Left

        wanted = Search(seed=view.planned.seed, starts=STARTS)
        problem: GlidecalError | None = None
        try:
            for found in searches(view.procedure, view.machine, count, wanted, watch):
                self.post_message(SearchNews(stop, found))
        except _Left:
            return
        except GlidecalError as failure:
            problem = failure
        self.post_message(SearchNews(stop, None, problem))

    @on(SearchNews)
    def _show_found(self, message: SearchNews) -> None:
        if message.search is not self._stop:
            return
        if message.found is None:
            self._stop = None
            if message.problem is not None:
                self.app.complain(message.problem)
            self._show_search()
            return
        self.found = message.found
        self._show_all()

    def _end_search(self) -> None:
        if self._stop is not None:
            self._stop.set()
            self._stop = None

    def action_draw(self, by: int) -> None:
        """The machine at the next of the postures that were found; 0 is the middle of the box."""
        if self.view is not None and self.found is not None:
            self._drawn_at = (self._drawn_at + by) % (len(self.found.coordinates) + 1)
            self._draw_machine(self.view)

    def action_copy(self) -> None:
        """The text of this page to the clipboard of the terminal."""
        page = TEXTS.get(self.query_one(TabbedContent).active, "list-text")
        text = str(self.query_one(f"#{page}", Static).content)
        self.app.copy(text)

    def action_back(self) -> None:
        """Stop the search, or go back to where this was opened from."""
        if self.searching:
            self._end_search()
            self.app.notify(STOPPED, markup=False)
            self._show_search()
        elif self in self.app.screen_stack[2:]:  # Textual's blank one is the first
            self.app.pop_screen()
        else:
            self.app.go_to(self.app.home())
