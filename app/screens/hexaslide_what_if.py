"""What if, of a session of postures: the size of a cause is moved, and what it would do follows."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import BindingType
from textual.widgets import Static, TabbedContent

from app.evaluating.hexaslide_what_if import CausesToTry
from app.report.charts.hexaslide import left_with
from app.report.text import hexaslide_what_if as texts
from app.screens.paged import PAGE_KEYS, SIZE_KEYS, Page, PagedScreen
from app.screens.pages import signalled
from app.screens.plot import ChartPlot
from calib.diagnosis.hexaslide_what_if import PostureTrial


class PostureWhatIfScreen(PagedScreen[None]):
    """One cause beside the parameters; nothing is written."""

    HELP = texts.WHAT_IF_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        *SIZE_KEYS,
        *PAGE_KEYS,
    ]
    PAGES = (Page("left", "What is left", charts=1, text=False),)

    def __init__(self, path: Path, causes: CausesToTry, name: tuple[str, str]) -> None:
        super().__init__()
        self.path = path
        self.causes = causes
        self.name_of_cause = name
        self.trial: PostureTrial | None = None
        self.values: tuple[float, ...] = ()
        self.number = 0
        self.looking = True

    def above(self) -> ComposeResult:
        yield Static(texts.WORKING, id="what-if", markup=False)

    def on_tabbed_content_tab_activated(self, event: TabbedContent.TabActivated) -> None:
        """Up and down are for sizes."""
        self.set_focus(None)

    def begin(self) -> None:
        """Work out apart what is linear in the sizes."""
        self.head(texts.heading_text(self.name_of_cause, self.path))
        self.look(partial(self.causes.trial, self.name_of_cause), self._begin, str)

    def _begin(self, trial: PostureTrial) -> None:
        self.trial = trial
        self._show(trial.best or (0.0,) * len(trial.cause.names))

    def _show(self, values: tuple[float, ...]) -> None:
        if self.trial is None:
            return
        self.values = values
        before, now = self.trial.at([0.0] * len(values)), self.trial.at(values)
        words = [
            texts.sizes_text(self.trial, values, self.number),
            texts.effect_text(before, now),
        ]
        self.query_one("#what-if", Static).update(signalled("\n".join(words)))
        readings = self.trial.models.readings
        numbers = [readings.number(row) for row in range(len(readings.sliders))]
        self.query_one("#left-chart0", ChartPlot).follow(left_with(numbers, before, now))

    def action_move(self, steps: int) -> None:
        if self.trial is not None:
            self._show(self.trial.moved(self.values, self.number, steps))

    def action_choose(self, by: int) -> None:
        """Another of several sizes."""
        if self.trial is not None:
            self.number = (self.number + by) % len(self.values)
            self._show(self.values)

    def action_nothing(self) -> None:
        self._show((0.0,) * len(self.values))

    def action_best(self) -> None:
        """The sizes that fit best; where the readings do not show them, why."""
        if self.trial is not None and self.trial.best:
            self._show(self.trial.best)
        else:
            self.app.complain(texts.WORKING if self.looking else texts.NOT_SEEN)

    def action_back(self) -> None:
        self.dismiss(None)
