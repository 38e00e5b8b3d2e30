"""What if: the size of something missing is moved, and what it would explain follows."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

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
from app.report.text.help import help_of
from app.report.text.home import ONLY_SHOWN
from app.report.text.tables import wrapped
from app.screens.interface import once
from app.screens.paged import Page, PagedScreen
from app.screens.pages import apart, signalled
from app.screens.plot import ChartPlot
from calib.errors import GlidecalError
from calib.identify.solution import Subset
from calib.quantity import Sizes
from protocols.effect_entries import EffectEntry
from protocols.model_file import read_model_file
from protocols.session import Session

SIZE_KEYS: tuple[BindingType, ...] = (
    Binding("left", "move(-1)", "Smaller", id="what_if.smaller"),
    Binding("right", "move(1)", "Larger", id="what_if.larger"),
    Binding("shift+left", "move(-10)", "Much smaller", show=False, id="what_if.much_smaller"),
    Binding("shift+right", "move(10)", "Much larger", show=False, id="what_if.much_larger"),
    Binding("up", "choose(-1)", "Size before", show=False, id="what_if.size_before"),
    Binding("down", "choose(1)", "Next size", show=False, id="what_if.next_size"),
    Binding("0", "nothing", "Nothing", id="what_if.nothing"),
    Binding("f", "best", "Fits best", id="what_if.best"),
)


Outcome = TypeVar("Outcome")
"""What sizes do."""


class SizesScreen(PagedScreen[ScreenResultType], Generic[ScreenResultType, Outcome]):
    """Sizes that keys move, words on what they do above the pages."""

    NEEDS = ("best", "choose", "copy", "move", "nothing")
    LOOKING = NOTHING = texts.NOT_YET
    sizes: Sizes
    """How they can be moved, from when that is worked out."""
    values: tuple[float, ...] = ()
    number = 0
    """Which of several sizes is moved."""
    now: Outcome | None = None

    def __init__(self, heading: str, doubt: str = "") -> None:
        super().__init__()
        self._heading, self._doubt = heading, doubt
        self._figures = ""
        self._worked_out: tuple[float, ...] | None = None

    def above(self) -> ComposeResult:
        yield Static("", id="what-if", classes="above", markup=False)

    def on_tabbed_content_tab_activated(self, event: TabbedContent.TabActivated) -> None:
        """Up and down are for sizes."""
        self.set_focus(None)

    @abstractmethod
    def begun(self) -> Sizes:
        """Work out what is needed once: the parameters, the sizes that fit, how far steps go."""

    @abstractmethod
    def outcome(self, values: tuple[float, ...]) -> Outcome:
        """Work out what these sizes do."""

    @abstractmethod
    def show(self, outcome: Outcome) -> str:
        """Show it on the pages. Returns words on it."""

    def begin(self) -> None:
        self.look(self._heading, texts.WORKING, self.begun, self._begin)

    def _begin(self, sizes: Sizes) -> None:
        self.sizes = sizes
        self.move_to(sizes.first)

    def wait(self, text: str) -> None:
        """Above the pages, which are charts."""
        self.query_one("#what-if", Static).update(signalled(text))

    @property
    def ready(self) -> bool:
        """Whether what is shown is of the size shown."""
        return self._worked_out == self.values

    def move_to(self, values: Sequence[float]) -> None:
        self.values = tuple(values)
        self.show_words()
        self._follow()

    @once("follow")
    async def _follow(self) -> None:
        """Work out the latest size; sizes that came and went meanwhile are left out."""
        self.looking = True
        while not self.ready:
            values = self.values
            try:
                self.now = await apart(self, self.outcome, values)
            except GlidecalError as problem:
                if values == self.values:
                    self._figures = wrapped(str(problem))
                    break
            else:
                self._worked_out, self._figures = values, self.show(self.now)
        self.looking = False
        self.show_words()

    def show_words(self) -> None:
        table = texts.sizes_text(self.sizes, self.values, self.number)
        text = "\n".join(filter(None, [table, self._figures, self._doubt]))
        self.wait(self.app.keyed(text))

    def follow(self, name: str, chart: Chart) -> None:
        self.query_one(f"#{name}-chart0", ChartPlot).follow(chart)

    def action_move(self, steps: int) -> None:
        self.move_to(self.sizes.moved(self.values, self.number, steps))

    def action_choose(self, by: int) -> None:
        self.number = (self.number + by) % len(self.values)
        self.show_words()

    def action_nothing(self) -> None:
        self.move_to([0.0] * len(self.values))

    def action_best(self) -> None:
        """The sizes that fit best; where the readings do not tell them, why."""
        if self.sizes.best:
            self.move_to(self.sizes.best)
        else:
            self.app.complain(self.sizes.why_not)

    def action_back(self) -> None:
        self.dismiss(None)


class WhatIfScreen(SizesScreen[EffectEntry | None, WhatIf]):
    """One effect beside the parameters; dismissed with the size that a person adopts."""

    HELP = help_of("what-if")
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
        doubt = texts.doubt_text(choice, mistakes=mistakes)
        super().__init__(texts.heading_text(choice, trial, model), doubt)
        self.effect_choice, self.trial = choice, trial

    def begun(self) -> Sizes:
        self.trial = self.trial.begin()
        return self.trial.sizes

    def outcome(self, values: tuple[float, ...]) -> WhatIf:
        return self.trial.at(values).work_out()

    def show(self, outcome: WhatIf) -> str:
        without = self.trial.without
        self.follow("left", residuals_with(without.solution, outcome.solution))
        self.follow("predicted", predictions_with(without.solution, outcome.solution))
        self.put("numbers", texts.numbers_text(without, outcome))
        return texts.effect_text(without, outcome)

    def action_adopt(self) -> None:
        """Adopt the effect as shown; what fits best is not held."""
        entry = self.trial.entry
        if self.app.read_only:
            self.app.complain(ONLY_SHOWN)
        elif not self.ready:
            self.app.complain(texts.NOT_YET)
        elif not any(self.values):
            self.app.complain(self.app.keyed(texts.NOTHING))
        elif self.effect_choice.standing == "undiagnosed":
            self.app.complain(self.app.keyed(texts.DIAGNOSE_FIRST))
        else:
            at_best = self.values == self.sizes.best
            self.dismiss(entry.freed() if at_best else entry.held_at(self.values))

    def action_scroll(self, pages: int) -> None:
        page = self.query_one(VerticalScroll)
        page.scroll_relative(y=pages * page.scrollable_content_region.height)


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
    rows = [(effect, texts.choice_words(effect)) for effect in listed]
    choice = await screen.choice(texts.WHICH, rows)
    if choice is None:
        return None
    trial = trial_of(choice, sessions, model_file, subset)
    mistakes = diagnosed is not None and bool(mistakes_of(diagnosed))
    entry = await screen.ask(WhatIfScreen(choice, trial, model=model, mistakes=mistakes))
    return (choice, entry) if entry else None
