"""What if: the size of something missing is moved, and what it would explain follows."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.screen import ScreenResultType
from textual.widgets import Static, TabbedContent

from app.evaluating.diagnosis import SessionDiagnosis, mistakes_of
from app.evaluating.what_if import Choice, Trial, WhatIf, choices, trial_of
from app.report.charts.charts import Chart
from app.report.charts.results import predictions_with, residuals_with
from app.report.text import what_if as texts
from app.report.text.home import ONLY_SHOWN
from app.screens.interface import ChoiceDialog
from app.screens.paged import Page, PagedScreen
from app.screens.pages import apart, signalled
from app.screens.plot import ChartPlot
from calib.errors import GlidecalError, NotIdentifiable
from calib.identify.solution import FittedSize, Subset
from protocols.effect_entries import EffectEntry
from protocols.model_file import read_model_file
from protocols.session import Session

COARSE = 10
"""So many steps with Shift."""

SIZE_KEYS: tuple[BindingType, ...] = (
    Binding("left", "move(-1)", "Smaller", id="what_if.smaller"),
    Binding("right", "move(1)", "Larger", id="what_if.larger"),
    Binding("shift+left", f"move({-COARSE})", show=False, id="what_if.much_smaller"),
    Binding("shift+right", f"move({COARSE})", show=False, id="what_if.much_larger"),
    Binding("up", "choose(-1)", "Size before", show=False, id="what_if.size_before"),
    Binding("down", "choose(1)", "Next size", show=False, id="what_if.next_size"),
    Binding("0", "nothing", "Nothing", id="what_if.nothing"),
    Binding("f", "best", "Fits best", id="what_if.best"),
)


class Movable(Protocol):
    """What knows how far a key moves a size."""

    def moved(self, values: Sequence[float], number: int, steps: int) -> tuple[float, ...]: ...


class SizesScreen(PagedScreen[ScreenResultType]):
    """Sizes that keys move, words on what they do above the pages."""

    trial: Movable
    values: tuple[float, ...] = ()
    number = 0
    """Which of several sizes is moved."""
    known = False
    """Whether what sizes do is worked out so far that they can be moved."""
    looking = True

    def above(self) -> ComposeResult:
        yield Static(texts.WORKING, id="what-if", markup=False)

    def on_tabbed_content_tab_activated(self, event: TabbedContent.TabActivated) -> None:
        """Up and down are for sizes."""
        self.set_focus(None)

    @abstractmethod
    def move_to(self, values: Sequence[float]) -> None:
        """Show these sizes and what they do."""

    @abstractmethod
    def show_words(self) -> None:
        """Above the pages."""

    def put_words(self, *parts: str) -> None:
        words = self.app.keyed("\n".join(filter(None, parts)))
        self.query_one("#what-if", Static).update(signalled(words))

    def follow(self, name: str, chart: Chart) -> None:
        self.query_one(f"#{name}-chart0", ChartPlot).follow(chart)

    def action_move(self, steps: int) -> None:
        if self.known:
            self.move_to(self.trial.moved(self.values, self.number, steps))

    def action_choose(self, by: int) -> None:
        if self.known:
            self.number = (self.number + by) % len(self.values)
            self.show_words()

    def action_nothing(self) -> None:
        if self.known:
            self.move_to([0.0] * len(self.values))

    def action_back(self) -> None:
        self.dismiss(None)


class WhatIfScreen(SizesScreen[EffectEntry | None]):
    """One effect beside the parameters; dismissed with the size that a person adopts."""

    HELP = texts.WHAT_IF_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        *SIZE_KEYS,
        Binding("enter", "adopt", "Adopt", id="what_if.adopt"),
        Binding("pagedown", "scroll(1)", "Down", show=False, id="what_if.down"),
        Binding("pageup", "scroll(-1)", "Up", show=False, id="what_if.up"),
    ]
    PAGES = (
        Page("left", "What is left", charts=1, text=False),
        Page("predicted", "Differences", charts=1, text=False),
        Page("numbers", "Numbers"),
    )

    def __init__(
        self, choice: Choice, trial: Trial, *, model: Path | None = None, mistakes: bool = False
    ) -> None:
        super().__init__()
        self.choice = choice
        self.trial: Trial = trial
        self.values = trial.values
        self.now: WhatIf | None = None
        self.fitted: tuple[FittedSize, ...] = ()
        self._heading = texts.heading_text(choice, trial, model)
        self._doubt = texts.doubt_text(choice, mistakes=mistakes)
        self._why_not = self._figures = ""
        self._at_best = self._following = False

    @work
    async def begin(self) -> None:
        """Work out what is needed once: the parameters, the size that fits, how far steps go."""
        self.head(self._heading)
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
        self.known, self.values = True, trial.values
        if self.fitted:
            self.action_best()
        else:
            self.move_to(self.values)

    @property
    def ready(self) -> bool:
        """Whether what is shown is of the size shown."""
        return self.now is not None and self.now.values == self.values

    def move_to(self, values: Sequence[float], *, best: bool = False) -> None:
        self.values, self._at_best = tuple(values), best
        self.show_words()
        self._follow()

    @work
    async def _follow(self) -> None:
        """Work out the latest size; sizes that came and went meanwhile are left out."""
        if self._following:
            return
        self._following = True
        while not self.ready:
            outcome = self.trial.at(self.values)
            try:
                await apart(self, outcome.work_out)
            except GlidecalError as problem:
                if outcome.values == self.values:
                    self._why_not = str(problem)
                    self.show_words()
                    break
            else:
                self.now = outcome
                self._show(self.trial.without, outcome)
            finally:
                self.looking = False
        self._following = False

    def show_words(self) -> None:
        if self.ready and self.now is not None:
            self._figures = texts.effect_text(self.trial.without, self.now)
        sizes = texts.sizes_text(self.trial, self.values, self.number, self.fitted, self._why_not)
        self.put_words(sizes, self._figures, self._doubt)

    def _show(self, without: WhatIf, now: WhatIf) -> None:
        self.show_words()
        self.follow("left", residuals_with(without.solution, now.solution))
        self.follow("predicted", predictions_with(without.solution, now.solution))
        self.put("numbers", texts.numbers_text(without, now))

    def action_best(self) -> None:
        """The sizes that fit best; where the readings do not tell them, why."""
        if self.fitted:
            self.move_to([size.value for size in self.fitted], best=True)
        else:
            self.app.complain(self._why_not or texts.NOT_YET)

    def action_adopt(self) -> None:
        """As shown; what fits best is not held."""
        entry = self.trial.entry
        if self.app.read_only:
            self.app.complain(ONLY_SHOWN)
        elif not self.ready:
            self.app.complain(texts.NOT_YET)
        elif not any(self.values):
            self.app.complain(self.app.keyed(texts.NOTHING))
        else:
            self.dismiss(entry.freed() if self._at_best else entry.held_at(self.values))

    def action_scroll(self, pages: int) -> None:
        page = self.query_one(VerticalScroll)
        page.scroll_relative(y=pages * page.scrollable_content_region.height)

    def action_copy(self) -> None:
        if self.ready:
            parts = (self.query_one(f"#{name}", Static) for name in COPIED)
            self.app.copy("\n\n".join(str(part.content) for part in parts))
        else:
            self.app.complain(texts.NOT_YET)


COPIED = ("heading", "what-if", "numbers-text")


async def tried(
    screen: PagedScreen[Any],
    sessions: Sequence[Session],
    model: Path | None,
    *,
    subset: Subset | None = None,
    diagnosed: SessionDiagnosis | None = None,
) -> tuple[Choice, EffectEntry] | None:
    """An effect that a person chooses and the size that is adopted; for workers of the screen.

    Raises RecordError for a model that cannot be read.
    """
    model_file = await apart(screen, read_model_file, model) if model else None
    listed = await apart(screen, choices, sessions, model_file, diagnosed)
    if not listed:
        screen.app.complain(texts.NOTHING_TO_TRY)
        return None
    rows = [(each, texts.choice_words(each)) for each in listed]
    choice = await screen.ask(ChoiceDialog(texts.WHICH, rows))
    if choice is None:
        return None
    trial = trial_of(choice, sessions, model_file, subset)
    mistakes = diagnosed is not None and bool(mistakes_of(diagnosed))
    entry = await screen.ask(WhatIfScreen(choice, trial, model=model, mistakes=mistakes))
    return (choice, entry) if entry else None
