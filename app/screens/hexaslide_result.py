"""The result of a session of postures, its diagnosis and readings, and what if of a cause."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import ClassVar

from textual.binding import Binding, BindingType

from app.evaluating.hexaslide import CausesToTry, PostureResult, causes_to_try, posture_result
from app.exports.hexaslide import write_calibrated
from app.report.charts.hexaslide import drawn_machine, left_with, residual_charts
from app.report.text import hexaslide_result as texts
from app.report.text.help import help_of
from app.screens.interface import once
from app.screens.paged import Page, PagedScreen
from app.screens.pages import apart
from app.screens.what_if import SIZE_KEYS, SizesScreen
from calib.errors import extra
from calib.hexaslide.what_if import CauseAtSize, PostureTrial
from calib.quantity import Sizes


class HexaSlideResultScreen(PagedScreen[None]):
    """One session of postures; the calibrated machine and the report can be written."""

    HELP = help_of("posture-result")
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("e", "export", "Export", id="postures.export"),
        Binding("r", "report", "Report", id="postures.report"),
        Binding("d", "show_page('diagnosis')", "Diagnose", id="postures.diagnose"),
        Binding("w", "what_if", "What if", id="postures.what_if"),
    ]
    WRITES = ("export", "report")
    NEEDS = ("export", "report", "what_if")
    LOOKING, NOTHING = texts.LOOKING, texts.NO_RESULT
    PAGES = (
        Page("result", "Result", charts=2, beside=True),
        Page("details", "Details"),
        Page("left", "What is left", charts=2),
        Page("diagnosis", "Diagnosis"),
        Page("readings", "Readings"),
    )

    def __init__(self, path: Path, first: str = "") -> None:
        super().__init__()
        self.path = path
        self.first = first
        self.result: PostureResult | None = None
        self.folder = ""

    def begin(self) -> None:
        heading, job = texts.heading_text(self.path, None), partial(posture_result, self.path)
        self.look(heading, texts.LOOKING, job, self._show, texts.problem_text)

    def _show(self, result: PostureResult) -> None:
        self.result = result
        machine = result.calibration.source.machine.whole()
        self.head(texts.heading_text(self.path, result))
        drawings = drawn_machine(machine, machine.box.centre)
        self.put("result", None, *drawings)
        self._show_glance()
        self.put("details", texts.details_text(result))
        self.put("left", texts.left_text(result), *residual_charts(result.calibration))
        self.put("diagnosis", texts.missing_text(result))
        self.put("readings", texts.readings_text(result))

    def _show_glance(self) -> None:
        if self.result is not None:
            columns, only = min(self.size.width, 80) - 4, self.app.read_only
            text = texts.glance_text(self.result, columns, read_only=only, folder=self.folder)
            self.put("result", text)

    def on_resize(self) -> None:
        """The bars are as long as there is room."""
        self._show_glance()

    @once("what-if")
    async def action_what_if(self) -> None:
        if self.result is None:
            return
        causes = await apart(self, causes_to_try, self.result.calibration.source)
        words_of = texts.cause_words
        listed = [(name, words_of(name, weight)) for name, weight in causes.likely.items()]
        name = await self.choice(texts.WHICH_CAUSE, listed)
        if name is not None:
            await self.ask(PostureWhatIfScreen(self.path, causes, name))

    @once("write")
    async def action_export(self) -> None:
        result, folder = self.result, self.path.with_suffix("")
        if result is not None and (
            paths := await self.written(partial(write_calibrated, result.calibration, folder))
        ):
            self.app.notify(texts.exported_text(paths))
            self.folder = folder.name
            self._show_glance()

    @once("write")
    async def action_report(self) -> None:
        choices = [(ending, f"{self.path.with_suffix(ending).name}") for ending in texts.ENDINGS]
        ending = await self.choice(texts.WHICH_REPORT, choices)
        if ending is None:
            return
        assert self.result is not None, "offered with a result alone"
        if path := await self.written(partial(_report, self.result, self.path.with_suffix(ending))):
            self.app.notify(texts.REPORT_WRITTEN.format(path))


def _report(result: PostureResult, target: Path, *, replace: bool) -> Path:
    with extra("the report", "report"):
        from app.report.pages.hexaslide import source_of_postures
        from app.report.pages.report import write_report
    source = partial(source_of_postures, result.record.path, result=result)
    return write_report(source, target, replace=replace)


class PostureWhatIfScreen(SizesScreen[None, CauseAtSize]):
    """One cause beside the parameters; nothing is written."""

    HELP = help_of("posture-what-if")
    BINDINGS: ClassVar[list[BindingType]] = [*SIZE_KEYS]
    PAGES = (Page("left", "What is left", charts=1, text=False),)
    trial: PostureTrial
    """From when it is begun."""

    def __init__(self, path: Path, causes: CausesToTry, name: tuple[str, str]) -> None:
        super().__init__(texts.what_if_heading(name, path))
        self._causes, self._cause = causes, name

    def begun(self) -> Sizes:
        self.trial = self._causes.trial(self._cause)
        return self.trial.sizes

    def outcome(self, values: tuple[float, ...]) -> CauseAtSize:
        return self.trial.at(values)

    def show(self, outcome: CauseAtSize) -> str:
        nominal, readings = self.trial.at([0.0] * len(outcome.values)), self.trial.models.readings
        numbers = [readings.number(row) for row in range(len(readings.sliders))]
        self.follow("left", left_with(numbers, nominal, outcome))
        return texts.what_if_text(nominal, outcome)
