"""The result: text, plot, export, verification, and the comparison after it."""

from __future__ import annotations

import asyncio
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.widgets import Footer, Static, TabbedContent, TabPane

from app.evaluating.comparison import Comparison, partner_of
from app.evaluating.diagnosis import resize
from app.evaluating.solution import SessionSolution, solve_sessions
from app.evaluating.what_if import Choice, choices, trial_of
from app.exports import export_offsets
from app.measuring.plan import Plan, verification_plan
from app.report.charts.legs import leg_figures
from app.report.charts.results import before_and_after, measured_and_predicted
from app.report.text import result as texts
from app.report.text import what_if as what_if_texts
from app.report.text.glance import Done, glance_text
from app.report.text.home import REPORTS_SERVED
from app.screens.fast_keys import Title
from app.screens.paged import PagedScreen, page_keys
from app.screens.pages import apart, is_left, signalled
from app.screens.plot import ChartPlot, LegPlots
from app.screens.what_if import WhatIfScreen, ask_effect
from calib.errors import extra
from calib.identify.solution import Subset
from protocols.model_file import EffectEntry, ModelFile, read_model_file

RESULT, DETAILS, PLOT, LEGS = "tab-result", "tab-details", "tab-plot", "tab-legs"
COMPARISON = "tab-comparison"


class ResultScreen(PagedScreen):
    """One solution; with the plan of its session it can be verified."""

    HELP = texts.RESULT_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("e", "export", "Export", id="result.export"),
        Binding("v", "verify", "Verify", id="result.verify"),
        Binding("r", "report", "Report", id="result.report"),
        Binding("e", "refuse('export')", show=False),
        Binding("v", "refuse('verify')", show=False),
        Binding("r", "refuse('report')", show=False),
        Binding("1", "choose('joint-offsets')", "Offsets", show=False, id="result.offsets"),
        Binding("2", "choose('leg-lengths')", "Legs", show=False, id="result.lengths"),
        Binding("3", "choose('both')", "Both", show=False, id="result.both"),
        Binding("4", "choose('with-tolerances')", "Tolerances", show=False, id="result.tolerances"),
        Binding("plus", "leg(1)", "Next leg", show=False, id="result.next_leg"),
        Binding("minus", "leg(-1)", "Leg before", show=False, id="result.leg_before"),
        Binding("d", "diagnose", "Diagnose", id="result.diagnose"),
        Binding("w", "what_if", "What if", id="result.what_if"),
        Binding("h", "home", "Home", show=False, id="result.home"),
        *page_keys("result"),
    ]

    def __init__(
        self, solved: SessionSolution, plan: Plan | None, path: Path, model: Path | None = None
    ) -> None:
        super().__init__()
        self.model = model
        self.solved = solved
        self.plan = plan
        self.path = path
        self.before = plan.before if plan else None
        self.done: set[Done] = set()

    def compose(self) -> ComposeResult:
        with TabbedContent(initial=COMPARISON if self.before else RESULT):
            with TabPane("Result", id=RESULT), Horizontal():
                with VerticalScroll(id="first"):
                    yield Static("", id="glance", markup=False)
                yield ChartPlot(plot_id="beside")
            with TabPane("Details", id=DETAILS), VerticalScroll(id="result"):
                yield Static("", id="text", markup=False)
            with TabPane("Plot", id=PLOT):
                yield ChartPlot(plot_id="plot")
            with TabPane("Legs", id=LEGS):
                yield LegPlots()
            if self.before is not None:
                with TabPane("Before/after", id=COMPARISON), Horizontal():
                    yield from self._compose_comparison(self.before)
        yield Footer(compact=True, show_command_palette=False)

    def _compose_comparison(self, before: SessionSolution) -> ComposeResult:
        now = self.solved.solution
        with VerticalScroll(id="comparison"):
            yield Static(texts.comparison_text(before.solution, now), id="compared", markup=False)
        yield ChartPlot(before_and_after(before.solution, now), plot_id="before-after")

    def on_mount(self) -> None:
        self._begin()

    @work(exclusive=True)
    async def _begin(self) -> None:
        """What takes long is worked out apart, once for all that the keys show."""
        if not self.solved.is_worked_out:
            self.query_one("#glance", Static).update(texts.WORKING_OUT)
            with self.app.complaining():
                await apart(self, self.solved.work_out)
        self._show()
        self._show_legs()

    @work(group="legs", exclusive=True)
    async def _show_legs(self) -> None:
        self.query_one(LegPlots).show(await apart(self, leg_figures, self.solved))

    def action_leg(self, by: int) -> None:
        """Another leg or axis on its page."""
        self.action_page(LEGS)
        self.query_one(LegPlots).turn(by)

    def _show(self) -> None:
        if not self.solved.is_worked_out:  # shown when it is
            return
        self._show_glance()
        text = texts.solution_text(self.solved)
        self.query_one("#text", Static).update(signalled(text))
        chart = measured_and_predicted(self.solved.solution)
        for name in ("#beside", "#plot"):
            self.query_one(name, ChartPlot).show(chart)

    def _show_glance(self) -> None:
        text = glance_text(
            self.solved,
            self.before,
            self.done,
            min(self.size.width, 80) - 4,  # beside it the plot, where there is more room
            exports=not self.app.read_only,
            measures=self.plan is not None,
        )
        self.query_one("#glance", Static).update(signalled(self.app.keyed(text)))

    def on_resize(self) -> None:
        """The bars are as long as there is room."""
        if self.solved.is_worked_out:
            self._show_glance()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Nothing is offered that this program will not do; its key says why."""
        if action == "verify" and self.plan is None:
            return False
        return action not in ("export", "report", "verify", "home") or not self.app.read_only

    def action_refuse(self, action: str) -> None:
        said = texts.ONLY_SHOWN if self.app.read_only else texts.NO_PLAN
        self.app.complain(f"{said} {REPORTS_SERVED}" if action == "report" else said)

    def action_choose(self, subset: Subset) -> None:
        """Show another set of parameters, which is a view: what to enter stays."""
        with self.app.complaining():
            if self.query_one(TabbedContent).active == RESULT:
                self.action_page(DETAILS)
            self.solved = self.solved.with_subset(subset)
            self._show()

    def action_export(self, *, replace: bool = False) -> None:
        """Write the offsets in every format beside the session."""
        self.app.run_worker(self._export(replace=replace))

    async def _export(self, *, replace: bool) -> None:
        """What was written is said in passing, what to beware of stays on the page."""
        folder = self.path.with_suffix("")
        with self.app.complaining(partial(self.action_export, replace=True)):
            solved = self.solved
            written = await asyncio.to_thread(export_offsets, solved, folder, replace=replace)
            self.app.notify(texts.exported_text(folder, written), timeout=10, markup=False)
            self.done.add(Done.EXPORTED)
            if not is_left(self):
                self._show_glance()

    def action_verify(self) -> None:
        """The same procedure again, after the offsets were entered in the controller."""
        if self.plan is None:
            return
        if not self.solved.is_worked_out:
            self.app.complain(texts.WORKING_OUT)
            return
        with self.app.complaining():
            plan = verification_plan(self.plan, self.solved)
            self.app.push_screen(self.app.check(plan))

    def action_report(self) -> None:
        """Write the report beside the session; after a verification that of both sessions."""
        self.app.notify(texts.WRITING_REPORT, markup=False)
        self._begin_report()

    def _begin_report(self, *, replace: bool = False) -> None:
        self.app.run_worker(self._report(replace=replace))

    async def _report(self, *, replace: bool) -> None:
        target = self.path.with_suffix(".html")
        with self.app.complaining(partial(self._begin_report, replace=True)):
            await asyncio.to_thread(self._write_report, target, replace=replace)
            self.app.notify(texts.REPORT_WRITTEN.format(target), timeout=10, markup=False)

    def _write_report(self, target: Path, *, replace: bool) -> None:
        with extra("glidecal report", "report"):
            from app.report.pages.report import write_report
        first = partner_of(self.path, self.solved.sessions[0].opened.verifies)
        after = self.path if first else None
        write_report([first or self.path], target, after=after, replace=replace)

    @work(exclusive=True)
    async def action_what_if(self) -> None:
        """Ask for an effect, then show what it does at any size beside the set that is shown."""
        with self.app.complaining():
            known = await apart(self, read_model_file, self.model) if self.model else None
            listed = await apart(self, choices, self.solved.sessions, known)
            if self.is_current:
                ask_effect(self.app, listed, partial(self._try, known))

    def _try(self, known: ModelFile | None, choice: Choice) -> None:
        solved = self.solved
        subset = solved.solution.subset
        trial = trial_of(choice, solved.sessions, known, subset)
        self.app.push_screen(WhatIfScreen(choice, trial, self._adopt_tried, model=self.model))

    def _adopt_tried(self, choice: Choice, entry: EffectEntry) -> None:
        """An effect of the model gets this size; any other one is for the diagnosis to adopt."""
        if choice.standing != "model" or self.model is None:
            self.app.complain(what_if_texts.DIAGNOSE_FIRST)
            return
        self.app.notify(what_if_texts.RESIZING, markup=False)
        self.app.run_worker(self._resize(self.model, entry))

    async def _resize(self, model: Path, entry: EffectEntry) -> None:
        sessions, subset = self.solved.sessions, self.solved.subset
        with self.app.complaining():
            written = await asyncio.to_thread(resize, sessions, model, entry)
            solved = await asyncio.to_thread(solve_sessions, sessions, subset=subset, model=written)
            await asyncio.to_thread(solved.work_out)
            self.app.notify(what_if_texts.RESIZED.format(model), timeout=10, markup=False)
            if not is_left(self):
                self.solved = solved
                self._show()
                self._show_legs()

    def action_diagnose(self) -> None:
        self.done.add(Done.DIAGNOSED)
        if self.solved.is_worked_out:
            self._show_glance()
        self.app.push_screen(self.app.diagnosis([self.path]))

    def action_home(self) -> None:
        self.app.go_to(self.app.home())


class CompareScreen(PagedScreen):
    """Two sessions side by side."""

    HELP = texts.COMPARISON_HELP
    BINDINGS: ClassVar[list[BindingType]] = page_keys("compare")

    def __init__(self, comparison: Comparison) -> None:
        super().__init__()
        self._comparison = comparison
        self._text = texts.comparison_report(comparison)

    def compose(self) -> ComposeResult:
        yield Title()
        chart = before_and_after(self._comparison.before.solution, self._comparison.after.solution)
        with TabbedContent():
            with TabPane("Comparison"), Horizontal():
                with VerticalScroll(id="compare-words"):
                    yield Static(self._text, id="compare-text", markup=False)
                yield ChartPlot(chart, plot_id="compare-beside")
            with TabPane("Plot"):
                yield ChartPlot(chart, plot_id="compare-chart")
        yield Footer()
