"""The result: what to enter, text, plots, export, verification, and the comparison after it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.binding import Binding, BindingType
from textual.widgets import TabbedContent

from app.evaluating.diagnosis import resize
from app.evaluating.solution import SessionSolution, solve_files, solve_sessions
from app.exports import export_offsets
from app.measuring.plan import Plan, plan_to_repeat, verification_plan
from app.report.charts.legs import leg_figures
from app.report.charts.results import before_and_after, measured_and_predicted
from app.report.text import result as texts
from app.report.text import what_if as what_if_texts
from app.report.text.correction import SUBSET_WORDS
from app.report.text.glance import Done, glance_text
from app.report.text.help import help_of
from app.screens.interface import once, screen_of
from app.screens.paged import Page, PagedScreen
from app.screens.pages import apart, is_left
from app.screens.plot import LegPlots
from app.screens.what_if import tried
from calib.errors import extra
from calib.identify.solution import SUBSETS

COMPARISON = Page("before-after", "Before/after", charts=1, beside=True)


class ResultScreen(PagedScreen[None]):
    """One solution; with the plan of its session it can be verified."""

    HELP = help_of("result")
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("e", "export", "Export", id="result.export"),
        Binding("v", "verify", "Verify", id="result.verify"),
        Binding("r", "report", "Report", id="result.report"),
        Binding("s", "choose", "Set", show=False, id="result.set"),
        Binding("plus", "figure('legs', 1)", "Next leg", show=False, id="result.next_leg"),
        Binding("minus", "figure('legs', -1)", "Leg before", show=False, id="result.leg_before"),
        Binding("d", "diagnose", "Diagnose", id="result.diagnose"),
        Binding("w", "what_if", "What if", id="result.what_if"),
    ]
    WRITES = ("export", "report", "verify")
    PAGES = (
        Page("result", "Result", charts=1, beside=True),
        Page("details", "Details"),
        Page("plot", "Plot", charts=1, text=False),
        Page("legs", "Legs", content=LegPlots),
    )

    def __init__(
        self, result: SessionSolution, plan: Plan | None, path: Path, model: Path | None = None
    ) -> None:
        super().__init__()
        self.model = model
        self.result = result
        self.plan = plan
        self.path = path
        self.before = plan.before if plan else None
        if self.before:
            self.pages = (*self.PAGES, COMPARISON)
        self.done: set[Done] = set()

    @work
    async def begin(self) -> None:
        """The comparison is there at once; the rest is worked out apart, once for all keys."""
        self.head(texts.result_heading(self.result, self.path, self.model))
        if self.before is not None:
            with self.app.complaining():  # either may have no view
                pair = self.before.solution, self.result.solution
                self.put("before-after", texts.comparison_text(*pair), before_and_after(*pair))
        if not self.result.corrections.is_worked_out:
            self.put("result", texts.WORKING_OUT)
            with self.app.complaining():
                await apart(self, self.result.work_out)
        self._show()

    @work(group="show", exclusive=True)
    async def _show(self) -> None:
        if self.result.corrections.is_worked_out:  # else it is shown when it is
            self._show_glance()
            self.put("details", texts.solution_text(self.result))
            if (view := self.result.view_solution) is None:
                return  # there is nothing to draw; the details say why
            chart = measured_and_predicted(view)
            self.put("result", None, chart)
            self.put("plot", None, chart)
        self.query_one(LegPlots).show(await apart(self, leg_figures, self.result))

    def _show_glance(self) -> None:
        if self.result.corrections.is_worked_out:
            columns = min(self.size.width, 80) - 4  # beside it the plot, where there is more room
            able = {"exports": not self.app.read_only, "measures": self.plan is not None}
            self.put("result", glance_text(self.result, self.before, self.done, columns, **able))
            self.refresh_bindings()  # whoever shows it: it is what the keys are for

    def on_resize(self) -> None:
        """The bars are as long as there is room."""
        self._show_glance()

    def why_not(self, action: str) -> str:
        reason = super().why_not(action)
        if reason or action != "verify":
            return reason
        if self.plan is None:
            return texts.NO_PLAN
        return "" if self.result.corrections.is_worked_out else texts.WORKING_OUT

    @once("set")
    async def action_choose(self) -> None:
        """Show another set of parameters, which is a view: what to enter stays."""
        sets = [(subset, SUBSET_WORDS[subset]) for subset in SUBSETS]
        subset = await self.choice(texts.WHICH_SET, sets)
        if subset is not None:
            if self.query_one(TabbedContent).active == "result":
                self.action_show_page("details")
            self.result = self.result.with_subset(subset)
            self._show()

    @once("export", outlives=True)
    async def action_export(self) -> None:
        """What was written is said in passing, what to beware of stays on the page."""
        folder = self.path.with_suffix("")
        paths = await self.written(partial(export_offsets, self.result, folder))
        if paths is not None:
            self.app.notify(texts.exported_text(folder, paths))
            self._did(Done.EXPORTED)

    def _did(self, errand: Done) -> None:
        self.done.add(errand)
        if not is_left(self):
            self._show_glance()

    def action_verify(self) -> None:
        with self.app.complaining():
            if self.plan is not None:
                plan = verification_plan(self.plan, self.result)
                self.app.push_screen(screen_of("check.CheckScreen", plan))

    @once("report", outlives=True)
    async def action_report(self) -> None:
        self.app.notify(texts.WRITING_REPORT)
        target = self.path.with_suffix(".html")
        if await self.written(partial(_report, self.path, target)):
            self.app.notify(texts.REPORT_WRITTEN.format(target.name))
            self._did(Done.REPORTED)

    @once("what-if")
    async def action_what_if(self) -> None:
        """What an effect does at any size beside the set that is shown.

        One of the model gets this size; any other one is for the diagnosis to adopt.
        """
        if self.result.view_solution is None:
            self.app.complain(self.result.choice.refused["joint-offsets"])
            return
        sessions, subset = self.result.sessions, self.result.subset
        pair = await tried(self, sessions, self.model, subset=subset)
        if pair is None:
            return
        _, entry = pair
        assert self.model is not None, "other effects are adopted by the diagnosis"
        self.app.notify(what_if_texts.RESIZING)
        model = await asyncio.to_thread(resize, sessions, self.model, entry)
        result = await apart(self, solve_sessions, sessions, subset=subset, model=model)
        await apart(self, result.work_out)
        self.app.notify(what_if_texts.RESIZED.format(self.model))
        self.result = result
        self._show()

    def action_diagnose(self) -> None:
        self._did(Done.DIAGNOSED)
        self.app.push_screen(screen_of("diagnose.DiagnoseScreen", [self.path]))


def _report(path: Path, target: Path, *, replace: bool) -> Path:
    with extra("glidecal report", "report"):
        from app.report.pages.report import source_of_legs, write_report
    return write_report(partial(source_of_legs, [path]), target, replace=replace)


def result_of(
    paths: Sequence[Path], model: Path | None = None, *, verified: bool = True
) -> ResultScreen:
    """The screen of sessions, with the effects of a model; with a plan where it may be
    ``verified``.
    """
    result = solve_files(paths, model=model)
    return ResultScreen(result, plan_to_repeat(paths[0]) if verified else None, paths[0], model)
