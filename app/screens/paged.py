"""Screens of numbered pages: results, diagnoses, what-if, comparisons, history, postures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.screen import ScreenResultType
from textual.widget import Widget
from textual.widgets import OptionList, Static, TabbedContent, TabPane, Tabs

from app.report.charts.charts import Chart
from app.report.text.home import ONLY_SHOWN, REPORTS_SERVED
from app.screens.interface import MainScreen
from app.screens.pages import apart, signalled
from app.screens.plot import ChartPlot, LegPlots
from calib.errors import GlidecalError

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Page:
    """A text to scroll, ``charts`` below it; ``beside`` it, where the terminal is wide enough.

    ``rows`` to choose from stand above the text. Its parts are ``name-text``, ``name-chart0`` and
    so on; ``content`` is a widget in their place.
    """

    name: str
    title: str
    charts: int = 0
    text: bool = True
    beside: bool = False
    rows: tuple[str, ...] | None = None
    content: Callable[[], Widget] | None = None

    def compose(self) -> ComposeResult:
        text = Static("", id=f"{self.name}-text", classes="page", markup=False)
        charts = [ChartPlot(plot_id=f"{self.name}-chart{k}") for k in range(self.charts)]
        if self.content:
            yield self.content()
        elif self.rows is not None:
            yield Vertical(OptionList(*self.rows, markup=False), VerticalScroll(text))
        elif self.beside:
            yield Horizontal(VerticalScroll(text), Vertical(*charts, classes="beside"))
        elif charts:
            yield Vertical(*[text] * self.text, Horizontal(*charts))
        else:
            yield VerticalScroll(text)


class PagedScreen(MainScreen[ScreenResultType]):
    """A line that says what is shown, its pages, and below them what happened last."""

    BINDINGS: ClassVar[list[BindingType]] = [
        *(
            Binding(f"{n}", f"turn_to({n})", f"Page {n}", show=False, id=f"page.{n}")
            for n in range(1, 10)
        ),
        Binding("tab,right", "turn(1)", "Next page", show=False, id="page.next"),
        Binding("shift+tab,left", "turn(-1)", "Page before", show=False, id="page.before"),
        Binding("y", "copy", "Copy", show=False, id="page.copy"),
        Binding("escape", "back", "Back", id="page.back"),
    ]
    AUTO_FOCUS = ""  # else a page without a text is left for the first where a dialog ends
    PAGES: ClassVar[tuple[Page, ...]] = ()
    WRITES: ClassVar[tuple[str, ...]] = ()
    """Actions that are not for those who only look."""
    NEEDS: ClassVar[tuple[str, ...]] = ()
    """Actions that are for what is worked out; `LOOKING` is said meanwhile, `NOTHING` in vain."""
    LOOKING = NOTHING = ""
    first = ""
    """The page that is shown first, where it is not the leftmost."""
    looking = looked = False
    """Whether what the pages show is still worked out, and whether it could be."""

    def __init__(self) -> None:
        super().__init__()
        self.pages: tuple[Page, ...] = self.PAGES

    def content(self) -> ComposeResult:
        yield from self.above()
        with TabbedContent(initial=self.first):
            for number, page in enumerate(self.pages, start=1):
                with TabPane(f"{number} {page.title}", id=page.name):
                    yield from page.compose()

    def above(self) -> ComposeResult:
        """What stands above every page."""
        yield from ()

    def on_mount(self) -> None:
        self.query_one(Tabs).can_focus = False  # the keys of this screen turn the pages
        self.begin()

    def begin(self) -> object:
        """Fill the pages, or begin to work out what they show."""

    def head(self, text: str) -> None:
        self.query_one("#heading", Static).update(text)

    def put(self, name: str, text: str | None, *charts: Chart) -> None:
        """Text and charts of a page, None: those of before; keys in the text are ids in braces."""
        for panel in self.query(f"#{name}-text").results(Static):
            if text is not None:
                panel.update(signalled(self.app.keyed(text)))
        for number, chart in enumerate(charts):
            plot = self.query_one(f"#{name}-chart{number}", ChartPlot)
            plot.display = True
            plot.show(chart)

    def look(
        self,
        heading: str,
        text: str,
        job: Callable[[], Answer],
        show: Callable[[Answer], None],
        problem_text: Callable[[GlidecalError], str] = str,
    ) -> None:
        """Work out apart what the pages show: they say so meanwhile, and why where it cannot be."""
        self.looking, self.looked = True, False
        self.head(heading)
        self.wait(text)
        self.refresh_bindings()
        self._work_out(job, show, problem_text)

    # without a description Textual makes one of the arguments, every number of a result in words:
    # seconds, in the thread that draws
    @work(group="look", exclusive=True, description="look")
    async def _work_out(
        self,
        job: Callable[[], Answer],
        show: Callable[[Answer], None],
        problem_text: Callable[[GlidecalError], str],
    ) -> None:
        try:
            outcome = await apart(self, job)
        except GlidecalError as problem:
            self.looking = False
            self.wait(problem_text(problem))
        else:
            self.looking, self.looked = False, True
            show(outcome)
            self.refresh_bindings()

    def wait(self, text: str) -> None:
        """Show the same words on every page, in the place of texts and charts."""
        for page in self.pages:
            self.put(page.name, text)
        for plot in self.query(ChartPlot):
            plot.display = False

    def why_not(self, action: str) -> str:
        if self.app.read_only and action in self.WRITES:
            return f"{ONLY_SHOWN} {REPORTS_SERVED}" if action == "report" else ONLY_SHOWN
        if self.looked or action not in self.NEEDS:
            return ""
        return self.LOOKING if self.looking else self.NOTHING

    def on_tabbed_content_tab_activated(self, event: TabbedContent.TabActivated) -> None:
        """Up and down scroll the text of the page that is shown, or move in its list."""
        scrolls = event.pane.query("OptionList, VerticalScroll")
        self.set_focus(scrolls.first() if scrolls else None)

    def action_copy(self) -> None:
        """The texts of the page, or its pictures as characters, to the terminal's clipboard."""
        page = self.query_one(TabbedContent).active_pane
        if page is None:
            return
        texts = [str(part.content) for part in page.query(Static) if part.content]
        if not texts:
            charts = (part for part in page.query(ChartPlot) if part.region.area)
            texts = [str(chart.render()).rstrip() for chart in charts]
        above = [str(part.content) for part in self.query(".above").results(Static)]
        self.app.copy("\n\n".join([*above, *texts]))

    def action_figure(self, page: str, by: int) -> None:
        self.action_show_page(page)
        self.query_one(LegPlots).turn(by)

    def action_show_page(self, name: str) -> None:
        self.query_one(TabbedContent).active = name

    def action_turn_to(self, number: int) -> None:
        if number <= len(self.pages):
            self.action_show_page(self.pages[number - 1].name)

    def action_turn(self, by: int) -> None:
        tabs = self.query_one(Tabs)
        if by > 0:
            tabs.action_next_tab()
        else:
            tabs.action_previous_tab()

    def action_back(self) -> None:
        self.app.action_go_back()
