"""The result: text, plot, export, verification, and the comparison after it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.screen import Screen
from textual.widgets import Footer, Static, TabbedContent, TabPane

from app.evaluating.comparison import Comparison, partner_of
from app.evaluating.diagnosis import resize
from app.evaluating.solution import SessionSolution, solve_sessions
from app.evaluating.what_if import Choice, choices, trial_of
from app.exports import export_offsets
from app.measuring.plan import Plan, verification_plan
from app.report.charts.results import before_and_after, measured_and_predicted
from app.report.text import result as texts
from app.report.text import what_if as what_if_texts
from app.report.text.home import REPORTS_SERVED
from app.screens.fast_keys import Title
from app.screens.interface import Interface
from app.screens.pages import PagedScreen, signalled
from app.screens.plot import ChartPlot
from calib.errors import GlidecalError, extra
from calib.identify.solution import Subset
from protocols.files import FilesThere
from protocols.model_file import EffectEntry, ModelFile, read_model_file

CHOICES: dict[str, Subset] = {
    "1": "joint-offsets",
    "2": "leg-lengths",
    "3": "both",
    "4": "with-tolerances",
}
RESULT, PLOT, COMPARISON = "tab-result", "tab-plot", "tab-comparison"


class ResultScreen(PagedScreen):
    """One solution; with the plan of its session it can be verified."""

    app: Interface
    HELP = texts.RESULT_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("e", "export", "Export", id="result.export"),
        Binding("v", "verify", "Verify", id="result.verify"),
        Binding("r", "report", "Report", id="result.report"),
        Binding("e", "refuse_export", show=False),
        Binding("v", "refuse_verify", show=False),
        Binding("r", "refuse_report", show=False),
        Binding("1", "choose('1')", "Offsets", show=False, id="result.offsets"),
        Binding("2", "choose('2')", "Legs", show=False, id="result.lengths"),
        Binding("3", "choose('3')", "Both", show=False, id="result.both"),
        Binding("4", "choose('4')", "Tolerances", show=False, id="result.tolerances"),
        Binding("tab,right", "turn_to(1)", "Next", show=False, id="result.next"),
        Binding("shift+tab,left", "turn_to(-1)", "Previous", show=False, id="result.previous"),
        Binding("d", "diagnose", "Diagnose", id="result.diagnose"),
        Binding("w", "what_if", "What if", id="result.what_if"),
        Binding("y", "copy", "Copy", show=False, id="result.copy"),
        Binding("h", "home", "Home", show=False, id="result.home"),
        Binding("escape", "back", "Back", id="result.back"),
        Binding("f10", "app.quit", "Quit", id="result.quit"),
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
        self.caution = ""

    def compose(self) -> ComposeResult:
        with TabbedContent(initial=COMPARISON if self.before else RESULT):
            with TabPane("Result", id=RESULT), Horizontal():
                with VerticalScroll(id="result"):
                    yield Static("", id="text", markup=False)
                yield ChartPlot(plot_id="beside")
            with TabPane("Plot", id=PLOT):
                yield ChartPlot(plot_id="plot")
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
        self._show()

    def _show(self) -> None:
        text = texts.result_text(
            self.solved,
            self.before,
            exports=not self.app.read_only,
            measures=self.plan is not None,
            caution=self.caution,
        )
        self.query_one("#text", Static).update(signalled(text))
        chart = measured_and_predicted(self.solved.solution)
        for name in ("#beside", "#plot"):
            self.query_one(name, ChartPlot).show(chart)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Nothing is offered that this program will not do; its key says why."""
        if action in ("export", "report", "home"):
            return not self.app.read_only
        if action == "verify":
            return not self.app.read_only and self.plan is not None
        return True

    def action_refuse_export(self) -> None:
        self.app.complain(texts.ONLY_SHOWN)

    def action_refuse_report(self) -> None:
        self.app.complain(f"{texts.ONLY_SHOWN} {REPORTS_SERVED}")

    def action_refuse_verify(self) -> None:
        self.app.complain(texts.ONLY_SHOWN if self.app.read_only else texts.NO_PLAN)

    def action_choose(self, key: str) -> None:
        """Show another set of parameters."""
        with self.app.complaining():
            self.solved = self.solved.with_subset(CHOICES[key])
            self._show()

    def action_export(self) -> None:
        """Write the offsets in every format beside the session."""
        self._export()

    @work(thread=True, group="export")
    def _export(self, *, replace: bool = False) -> None:
        folder = self.path.with_suffix("")
        try:
            offsets = self._joint_offsets()
            written, refused = export_offsets(offsets, folder, replace=replace)
            said = texts.exported_text(folder, written)
            caution = texts.export_caution(offsets, refused)
        except FilesThere as problem:
            again = partial(self._export, replace=True)
            self.app.call_from_thread(self.app.ask_to_replace, problem, again)
        except GlidecalError as problem:
            self.app.call_from_thread(self.app.complain, problem)
        else:
            self.app.call_from_thread(self._exported, said, caution)

    def _exported(self, said: str, caution: str) -> None:
        """What was written is said in passing, what to beware of stays on the page."""
        self.app.notify(said, timeout=10, markup=False)
        self.caution = caution
        self._show()

    def _joint_offsets(self) -> SessionSolution:
        return self.solved.with_subset("joint-offsets")

    def action_verify(self) -> None:
        """The same procedure again, after the offsets were entered in the controller."""
        if self.plan is None:
            return
        with self.app.complaining():
            plan = verification_plan(self.plan, self._joint_offsets())
            self.app.push_screen(self.app.check(plan))

    def action_report(self) -> None:
        """Write the report beside the session; after a verification that of both sessions."""
        self.app.notify(texts.WRITING_REPORT, markup=False)
        self._report()

    @work(thread=True, group="export")
    def _report(self, *, replace: bool = False) -> None:
        first = partner_of(self.path, self.solved.sessions[0].opened.verifies)
        target = self.path.with_suffix(".html")
        try:
            with extra("glidecal report", "report"):
                from app.report.pages.report import write_report
            write_report(
                [first or self.path], target, after=self.path if first else None, replace=replace
            )
        except FilesThere as problem:
            again = partial(self._report, replace=True)
            self.app.call_from_thread(self.app.ask_to_replace, problem, again)
        except GlidecalError as problem:
            self.app.call_from_thread(self.app.complain, problem)
        else:
            said = texts.REPORT_WRITTEN.format(target)
            self.app.call_from_thread(partial(self.app.notify, said, timeout=10, markup=False))

    @work(thread=True, group="what-if", exclusive=True)
    def action_what_if(self) -> None:
        """Ask for an effect, then show what it does at any size beside the set that is shown."""
        try:
            known = read_model_file(self.model) if self.model else None
            listed = choices(self.solved.sessions, known)
        except GlidecalError as problem:
            self.app.call_from_thread(self.app.complain, problem)
        else:
            self.app.call_from_thread(self._ask_which, listed, known)

    def _ask_which(self, listed: Sequence[Choice], known: ModelFile | None) -> None:
        asked = [(one, what_if_texts.choice_words(one)) for one in listed]
        if self.is_current and asked:
            self.app.ask_which(what_if_texts.WHICH, asked, partial(self._try, known))
        elif self.is_current:
            self.app.complain(what_if_texts.NOTHING_TO_TRY)

    def _try(self, known: ModelFile | None, choice: Choice) -> None:
        solved = self.solved
        subset = solved.solution.subset
        trial = trial_of(choice, solved.sessions, known, subset)
        screen = self.app.what_if(
            choice, trial, self._adopt_tried, model=self.model, mistakes=False
        )
        self.app.push_screen(screen)

    def _adopt_tried(self, choice: Choice, entry: EffectEntry) -> None:
        """An effect of the model gets this size; any other one is for the diagnosis to adopt."""
        if choice.standing != "model" or self.model is None:
            self.app.complain(what_if_texts.DIAGNOSE_FIRST)
            return
        self.app.notify(what_if_texts.RESIZING, markup=False)
        self._resize(self.model, entry)

    @work(thread=True, group="what-if", exclusive=True)
    def _resize(self, model: Path, entry: EffectEntry) -> None:
        sessions, subset = self.solved.sessions, self.solved.subset
        try:
            written = resize(sessions, model, entry)
            solved = solve_sessions(sessions, subset=subset, model=written)
        except GlidecalError as problem:
            self.app.call_from_thread(self.app.complain, problem)
        else:
            self.app.call_from_thread(self._resized, solved, model)

    def _resized(self, solved: SessionSolution, model: Path) -> None:
        said = what_if_texts.RESIZED.format(model)
        self.app.notify(said, timeout=10, markup=False)
        if self.is_attached:  # nobody left it meanwhile
            self.solved = solved
            self._show()

    def action_diagnose(self) -> None:
        self.app.push_screen(self.app.diagnosis([self.path]))

    def action_copy(self) -> None:
        compared = self.query_one(TabbedContent).active == COMPARISON
        text = str(self.query_one("#compared" if compared else "#text", Static).content)
        self.app.copy(text)

    def action_back(self) -> None:
        """To the screen below, or home; from a served page nowhere else."""
        if len(self.app.screen_stack) > 2:
            self.app.pop_screen()
        else:
            self.action_home()

    def action_home(self) -> None:
        """Home offers other files and real indicators: not to somebody who only looks."""
        if not self.app.read_only:
            self.app.go_to(self.app.home())


class CompareScreen(Screen[None]):
    """Two sessions side by side."""

    app: Interface
    HELP = texts.COMPARISON_HELP
    AUTO_FOCUS = "#compare-words"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("g", "plot", "Plot", id="compare.plot"),
        Binding("y", "copy", "Copy", id="compare.copy"),
        Binding("escape", "app.pop_screen", "Back", id="compare.back"),
        Binding("f10", "app.quit", "Quit", id="compare.quit"),
    ]

    def __init__(self, comparison: Comparison) -> None:
        super().__init__()
        self._comparison = comparison
        self._text = texts.comparison_report(comparison)

    def compose(self) -> ComposeResult:
        yield Title()
        before, after = self._comparison.before.solution, self._comparison.after.solution
        with Horizontal(id="compare"):
            with VerticalScroll(id="compare-words"):
                yield Static(self._text, id="compare-text", markup=False)
            yield ChartPlot(before_and_after(before, after), plot_id="compare-chart")
        yield Footer()

    def action_plot(self) -> None:
        """The plot instead of the text, where there is no room for both."""
        self.toggle_class("plotted")

    def action_copy(self) -> None:
        self.app.copy(self._text)
