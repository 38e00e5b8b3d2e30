"""What if: the size of an effect is moved, and what it would explain follows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.widgets import Static, TabbedContent

from app.evaluating.diagnosis import SessionDiagnosis, mistakes_of
from app.evaluating.what_if import Choice, Trial, WhatIf, choices, trial_of
from app.report.charts.results import predictions_with, residuals_with
from app.report.text import what_if as texts
from app.report.text.result import ONLY_SHOWN
from app.screens.interface import ChoiceDialog
from app.screens.paged import PAGE_KEYS, SIZE_KEYS, Page, PagedScreen
from app.screens.pages import apart, signalled
from app.screens.plot import ChartPlot
from calib.errors import GlidecalError, NotIdentifiable
from calib.identify.solution import FittedSize, Subset
from protocols.effect_entries import EffectEntry
from protocols.model_file import read_model_file
from protocols.session import Session


class WhatIfScreen(PagedScreen[EffectEntry | None]):
    """One effect beside the parameters; dismissed with the size that a person adopts."""

    HELP = texts.WHAT_IF_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        *SIZE_KEYS,
        Binding("enter", "adopt", "Adopt", id="what_if.adopt"),
        Binding("pagedown", "scroll(1)", "Down", show=False, id="what_if.down"),
        Binding("pageup", "scroll(-1)", "Up", show=False, id="what_if.up"),
        *PAGE_KEYS,
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
        self.trial = trial
        self.values = trial.values
        self.number = 0
        self.without: WhatIf | None = None
        self.now: WhatIf | None = None
        self.fitted: tuple[FittedSize, ...] = ()
        self.looking = True
        self._model = model
        self._mistakes = mistakes
        self._why_not = ""
        self._at_best = False
        self._following = False
        self._figures = ""

    def above(self) -> ComposeResult:
        yield Static(texts.WORKING, id="what-if", markup=False)

    def on_tabbed_content_tab_activated(self, event: TabbedContent.TabActivated) -> None:
        """Up and down are for sizes."""
        self.set_focus(None)

    def begin(self) -> None:
        """Say what is tried, then work it out."""
        self.head(texts.heading_text(self.choice, self.trial, self._model))
        self._work_out()

    @work
    async def _work_out(self) -> None:
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
            outcome = self.trial.at(self.values)
            try:
                await apart(self, outcome.work_out)
            except GlidecalError as problem:
                if outcome.values == self.values:
                    self._why_not = str(problem)
                    self._show_words()
                    break
            else:
                self.now = outcome
                self._show()
            finally:
                self.looking = False
        self._following = False

    def _show_words(self) -> None:
        sizes = texts.sizes_text(self.trial, self.values, self.number, self.fitted, self._why_not)
        doubt = texts.doubt_text(self.choice, mistakes=self._mistakes)
        if self.ready and self.without is not None and self.now is not None:
            self._figures = texts.effect_text(self.without, self.now)
        words = self.app.keyed("\n".join(filter(None, [sizes, self._figures, doubt])))
        self.query_one("#what-if", Static).update(signalled(words))

    def _show(self) -> None:
        if self.without is None or self.now is None:
            return
        self._show_words()
        pair = self.without.solution, self.now.solution
        for name, chart in (("left", residuals_with), ("predicted", predictions_with)):
            self.query_one(f"#{name}-chart0", ChartPlot).follow(chart(*pair))
        self.put("numbers", texts.numbers_text(self.without, self.now))

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
            self._moved_to([size.value for size in self.fitted], best=True)
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

    def action_back(self) -> None:
        self.dismiss(None)

    def action_scroll(self, pages: int) -> None:
        page = self.query_one(VerticalScroll)
        if pages > 0:
            page.scroll_page_down()
        else:
            page.scroll_page_up()

    def action_copy(self) -> None:
        """All of the words, whatever page is shown."""
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
    dialog = ChoiceDialog(
        texts.WHICH,
        [(listed_choice, texts.choice_words(listed_choice)) for listed_choice in listed],
    )
    choice = await screen.ask(dialog)
    if choice is None:
        return None
    trial = trial_of(choice, sessions, model_file, subset)
    mistakes = diagnosed is not None and bool(mistakes_of(diagnosed))
    entry = await screen.ask(WhatIfScreen(choice, trial, model=model, mistakes=mistakes))
    return (choice, entry) if entry else None
