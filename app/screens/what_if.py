"""What if: the size of an effect is moved, and what it would explain follows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.widgets import Footer, Static, TabbedContent, TabPane

from app.evaluating.what_if import COARSE, Adopt, Choice, Trial, WhatIf
from app.report.charts.results import predictions_with, residuals_with
from app.report.text import what_if as texts
from app.report.text.result import ONLY_SHOWN
from app.screens.interface import ChoiceDialog, Interface
from app.screens.paged import PagedScreen, page_keys
from app.screens.pages import apart, signalled
from app.screens.plot import ChartPlot
from calib.errors import GlidecalError, NotIdentifiable
from calib.identify.solution import FittedSize

LEFT, DIFFERENCES, NUMBERS = "left-over", "predicted", "numbers"


class WhatIfScreen(PagedScreen):
    """One effect beside the parameters; ``adopt`` is what Enter does once this screen is gone."""

    HELP = texts.WHAT_IF_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "move(-1)", "Smaller", id="what_if.smaller"),
        Binding("right", "move(1)", "Larger", id="what_if.larger"),
        Binding("shift+left", f"move({-COARSE})", show=False, id="what_if.much_smaller"),
        Binding("shift+right", f"move({COARSE})", show=False, id="what_if.much_larger"),
        Binding("up", "choose(-1)", "Size before", show=False, id="what_if.size_before"),
        Binding("down", "choose(1)", "Next size", show=False, id="what_if.next_size"),
        Binding("0", "nothing", "Nothing", id="what_if.nothing"),
        Binding("f", "best", "Fits best", id="what_if.best"),
        Binding("enter", "adopt", "Adopt", id="what_if.adopt"),
        Binding("1", f"page('{LEFT}')", "What is left", show=False, id="what_if.left"),
        Binding("2", f"page('{DIFFERENCES}')", "Differences", show=False, id="what_if.predicted"),
        Binding("3", f"page('{NUMBERS}')", "Numbers", show=False, id="what_if.numbers"),
        Binding("pagedown", "scroll(1)", "Down", show=False, id="what_if.down"),
        Binding("pageup", "scroll(-1)", "Up", show=False, id="what_if.up"),
        *page_keys("what_if", words="Drop", arrows=False),
    ]

    def __init__(
        self,
        choice: Choice,
        trial: Trial,
        adopt: Adopt,
        *,
        model: Path | None = None,
        mistakes: bool = False,
    ) -> None:
        super().__init__()
        self.choice = choice
        self.trial = trial
        self.values = trial.values
        self.number = 0
        self.without: WhatIf | None = None
        self.now: WhatIf | None = None
        self.fitted: tuple[FittedSize, ...] = ()
        self.looking = True
        self._adopt = adopt
        self._model = model
        self._mistakes = mistakes
        self._why_not = ""
        self._at_best = False
        self._following = False
        self._figures = ""

    def compose(self) -> ComposeResult:
        yield Static("", id="diagnosed", markup=False)
        yield Static(texts.WORKING, id="what-if", markup=False)
        with TabbedContent(initial=LEFT):
            with TabPane("1 What is left", id=LEFT):
                yield ChartPlot(plot_id="left-chart")
            with TabPane("2 Differences", id=DIFFERENCES):
                yield ChartPlot(plot_id="predicted-chart")
            with TabPane("3 Numbers", id=NUMBERS), VerticalScroll(can_focus=False):
                yield Static("", id="numbers-text", markup=False)
        yield Footer(compact=True, show_command_palette=False)

    def on_mount(self) -> None:
        heading = texts.heading_text(self.choice, self.trial, self._model)
        self.query_one("#diagnosed", Static).update(heading)
        self._begin()

    @work
    async def _begin(self) -> None:
        """What is worked out once: the set of parameters, the size that fits, how far steps go."""
        fitted: tuple[FittedSize, ...] = ()
        why_not = ""
        try:
            trial = await apart(self, self.trial.usual)
            try:
                fitted = await apart(self, lambda: trial.fitted)
            except NotIdentifiable as problem:
                why_not = str(problem)
            await apart(self, trial.begin)
        except GlidecalError as problem:
            self.looking = False
            self.query_one("#what-if", Static).update(str(problem))
            return
        # all at once: keys that come before find nothing, and say so
        self.trial, self.fitted, self._why_not = trial, fitted, why_not
        self.without, self.values = trial.without, trial.values
        if self.fitted:
            self.action_best()
        else:
            self._moved_to(self.values)

    @property
    def ready(self) -> bool:
        """Whether what is shown is of the size shown."""
        return self.now is not None and self.now.values == self.values

    def _moved_to(self, values: Sequence[float], *, best: bool = False) -> None:
        self.values, self._at_best = tuple(values), best
        self._show_words()
        self._follow()

    @work
    async def _follow(self) -> None:
        """Work out the latest size; sizes that came and went meanwhile are left out."""
        if self._following:
            return
        self._following = True
        while not self.ready:
            found = self.trial.at(self.values)
            try:
                await apart(self, found.work_out)
            except GlidecalError as problem:
                if found.values == self.values:
                    self._why_not = str(problem)
                    self._show_words()
                    break
            else:
                self.now = found
                self._show()
            finally:
                self.looking = False
        self._following = False

    def _show_words(self) -> None:
        sizes = texts.sizes_text(self.trial, self.values, self.number, self.fitted, self._why_not)
        doubt = texts.doubt_text(self.choice, mistakes=self._mistakes)
        if self.ready and self.without is not None and self.now is not None:
            self._figures = texts.effect_text(self.without, self.now)
        parts = [sizes, self._figures, doubt]
        self.query_one("#what-if", Static).update(signalled("\n".join(filter(None, parts))))

    def _show(self) -> None:
        if self.without is None or self.now is None:
            return
        self._show_words()
        pair = self.without.solution, self.now.solution
        self.query_one("#left-chart", ChartPlot).follow(residuals_with(*pair))
        self.query_one("#predicted-chart", ChartPlot).follow(predictions_with(*pair))
        numbers = texts.numbers_text(self.without, self.now)
        self.query_one("#numbers-text", Static).update(numbers)

    def action_move(self, steps: int) -> None:
        if self.without is not None:
            self._moved_to(self.trial.moved(self.values, self.number, steps))

    def action_choose(self, by: int) -> None:
        """Another of several sizes."""
        self.number = (self.number + by) % len(self.values)
        if self.without is not None:
            self._show_words()

    def action_nothing(self) -> None:
        if self.without is not None:
            self._moved_to(self.without.values)

    def action_best(self) -> None:
        """The sizes that fit best; where the readings do not tell them, why."""
        if self.fitted:
            self._moved_to([one.value for one in self.fitted], best=True)
        else:
            self.app.complain(self._why_not or texts.NOT_YET)

    def action_adopt(self) -> None:
        """As shown; what fits best is not held."""
        if self.app.read_only:
            self.app.complain(ONLY_SHOWN)
        elif not self.ready:
            self.app.complain(texts.NOT_YET)
        elif not any(self.values):
            self.app.complain(texts.NOTHING)
        else:
            entry = self.trial.entry
            entry = entry.freed() if self._at_best else entry.held_at(self.values)
            self.app.pop_screen()
            self.app.call_later(partial(self._adopt, self.choice, entry))

    def action_scroll(self, pages: int) -> None:
        page = self.query_one(VerticalScroll)
        if pages > 0:
            page.scroll_page_down()
        else:
            page.scroll_page_up()

    def action_copy(self) -> None:
        if self.ready:
            parts = (self.query_one(f"#{name}", Static) for name in COPIED)
            self.app.copy("\n\n".join(str(one.content) for one in parts))
        else:
            self.app.complain(texts.NOT_YET)


COPIED = ("diagnosed", "what-if", "numbers-text")


def ask_effect(
    interface: Interface, listed: Sequence[Choice], then: Callable[[Choice], None]
) -> None:
    """Ask for one of these effects; nothing is done where none is chosen."""
    if not listed:
        interface.complain(texts.NOTHING_TO_TRY)
        return
    dialog = ChoiceDialog(texts.WHICH, [(one, texts.choice_words(one)) for one in listed])
    interface.ask(dialog, then)
