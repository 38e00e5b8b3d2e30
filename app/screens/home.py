"""Home: what can be done, interrupted sessions first.

It imports nothing that needs scipy: the first picture need not wait for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from textual import work
from textual.app import ComposeResult
from textual.screen import Screen
from textual.widgets import OptionList, Static
from textual.widgets.option_list import Option

from app.measuring.recorded import (
    MOST_LISTED,
    SessionFile,
    follow_up,
    look_at,
    recent_sessions,
    sessions_below,
)
from app.report.text import home as texts
from app.screens import Look, look_of
from app.screens.interface import ChoiceDialog, MainScreen, TextDialog
from app.screens.pages import Found, Given, apart

if TYPE_CHECKING:
    from app.screens.result import ResultScreen

HISTORY_S = 2.0
"""So long one part of a history is worked out; then what there is by now is shown."""

DEMO_FOLDER = Path("demo-sessions")


class HomeScreen(MainScreen[None]):
    """The first screen."""

    HELP = texts.HOME_HELP
    heading = "glidecal"
    AUTO_FOCUS = "#choices"

    def __init__(self) -> None:
        super().__init__()
        self._recent: list[SessionFile] = []
        self._working = False

    def content(self) -> ComposeResult:
        yield Static(self.question(), markup=False, id="question")
        yield OptionList(id="choices", markup=False)

    def question(self) -> str:
        return texts.HOME_QUESTION

    def sessions(self) -> list[SessionFile]:
        return recent_sessions(Path(), DEMO_FOLDER)

    def on_screen_resume(self) -> None:
        """Sessions may have come or gone on while another screen was open."""
        self._recent = self.sessions()
        choices = self.query_one("#choices", OptionList)
        before = choices.highlighted_option.id if choices.highlighted_option else None
        choices.clear_options()
        choices.add_options(self.options())
        ids = [option.id for option in choices.options]
        choices.highlighted = ids.index(before) if before in ids else 0

    def options(self) -> Iterator[Option | None]:
        """What is listed; None is a line between."""
        own = [(look.name, look.choice) for look in self.app.looks]
        rows = texts.home_rows(self._recent, own, read_only=self.app.read_only)
        return (row and Option(*row) for row in rows)

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        if not self._working:
            self._working = True
            self._begin(*(event.option.id or "").partition(" ")[::2])

    @work
    async def _begin(self, what: str, path: str) -> None:
        with self.app.complaining():
            if what == "history":
                history = await self._computed(_history, Path(path), self.app.looks)
                self.app.push_screen(history)
            else:
                await self._do(what, next((s for s in self._recent if str(s.path) == path), None))
        self._working = False
        self.query_one("#question", Static).update(self.question())

    async def _do(self, what: str, session: SessionFile | None) -> None:
        """Carry a choice out, with a session or after asking which one."""
        app = self.app
        opens = {"new": self._form, "demo": self._demonstration}
        opens |= {look.name: look.screen for look in app.looks}
        if session is not None and session.problem:
            app.complain(session.problem)
        elif what in opens:
            app.push_screen(opens[what]())
        elif session is None:
            which = texts.WHICH["before" if what == "compare" else what]
            if picked := await self._picked(which, self._recent):
                await self._do(what, picked)
        elif what == "session":
            choices = texts.session_choices(session, read_only=app.read_only)
            dialog = ChoiceDialog(texts.session_label(session), choices)
            if answer := await self.ask(dialog):
                await self._do(answer, session)
        elif what == "compare":
            await self._compare(session)
        else:
            await self._do_with(session.path, what)

    async def _picked(
        self, question: str, sessions: Sequence[SessionFile], proposed: SessionFile | None = None
    ) -> SessionFile | None:
        """One of these sessions or one whose path is typed, as long as it can be read."""
        rows: list[tuple[SessionFile | str, str]] = [(s, texts.session_label(s)) for s in sessions]
        rows.append((texts.ELSEWHERE, texts.ELSEWHERE))
        at = sessions.index(proposed) if proposed in sessions else 0
        words = question if sessions else f"{question}\n{texts.NO_SESSIONS}"
        while answer := await self.ask(ChoiceDialog(words, rows, at)):
            if isinstance(answer, str):
                path = await self.ask(TextDialog(texts.WHICH_PATH, "path"))
                if not path:
                    continue
                answer = look_at(Path(path).expanduser())
            if not answer.problem:
                return answer
            words = f"{answer.problem}\n\n{question}"
        return None

    async def _do_with(self, path: Path, what: str) -> None:
        if look := look_of(path, self.app.looks):  # its screen writes what is exported, too
            self.app.push_screen(look.opened(path, what))
        elif what == "continue":
            await self._continue(path)
        elif what == "replay":
            self.app.push_screen(replay_screen(path, ()))
        elif what == "diagnose":
            self.app.push_screen(self.app.diagnosis([path]))
        else:
            result = await self._computed(_result, path, self.app.read_only)
            await self.app.push_screen(result)
            for warning in result.solved.warnings:
                self.app.notify(warning, severity="warning")
            if what == "export":
                result.action_export()

    async def _computed(
        self, job: Callable[Given, Found], *given: Given.args, **named: Given.kwargs
    ) -> Found:
        """What a job gives, apart from the screen; it loads what it needs there, too."""
        self.query_one("#question", Static).update(self.app.keyed(texts.COMPUTING))
        return await apart(self, job, *given, **named)

    def _form(self) -> Screen[None]:
        """The form that was left, as it was left."""
        from app.screens.prepare import PrepareScreen

        form = self.app.form
        if form is None or form in self.app.screen_stack:  # there a session began with it
            form = self.app.form = PrepareScreen()
            self.app.install_screen(form, f"form {id(form)}")  # it stays when it is left
        return form

    async def _continue(self, path: Path, typed: str = "") -> None:
        """The instrument check, after asking for the ports of a record of another computer."""
        from app.measuring.indicators import parse_indicator
        from app.measuring.plan import PortsUnknown, plan_to_continue

        try:
            plan = plan_to_continue(path, tuple(map(parse_indicator, typed.split())))
        except PortsUnknown as problem:
            dialog = TextDialog(texts.PORTS_QUESTION.format(problem.thing), texts.PORTS_HINT)
            if answer := await self.ask(dialog):
                await self._continue(path, answer)
        else:
            self.app.push_screen(self.app.check(plan))

    def _demonstration(self) -> Screen[None]:
        from app.measuring.demo import WATCHED, demo_plan
        from app.measuring.plan import writable_folder

        plan = demo_plan(writable_folder(DEMO_FOLDER), "zero-max-min", 1, WATCHED)
        return self.app.check(plan)

    async def _compare(self, session: SessionFile) -> None:
        """With the session after it; one that verifies another brings its partner."""
        from app.evaluating.comparison import partner_of

        if session.own_form:
            self.app.complain(texts.NO_COMPARISON)
            return
        pair: tuple[Path, Path] | None = None
        if partner := partner_of(session.path, session.verifies):
            question = texts.partner_question(session.path, partner)
            dialog = ChoiceDialog(question, texts.PARTNER_CHOICES)
            answer = await self.ask(dialog)
            if answer is None:
                return
            pair = (partner, session.path) if answer == "both" else None
        if pair is None:
            other_sessions = [recent for recent in self._recent if recent != session]
            question = f"{session.path}\n{texts.WHICH['after']}"
            after = await self._picked(question, other_sessions, follow_up(session, self._recent))
            if after is None:
                return
            pair = session.path, after.path
        self.app.push_screen(await self._computed(_comparison, *pair))


def _result(path: Path, read_only: bool) -> ResultScreen:
    from app.screens.result import result_of

    screen = result_of([path], verified=not read_only)
    screen.solved.work_out()
    return screen


def _comparison(before: Path, after: Path) -> Screen[None]:
    from app.evaluating.comparison import compare_files
    from app.screens.history import CompareScreen

    return CompareScreen(compare_files(before, after))


def _history(folder: Path, looks: Sequence[Look]) -> Screen[None]:
    from app.evaluating.history import read_history
    from app.screens.history import HistoryScreen

    job = partial(read_history, folder, of_postures=looks, within_s=HISTORY_S)
    return HistoryScreen(job(), job)


class ReplayChoiceScreen(HomeScreen):
    """The sessions that were named, those of folders and their history, and no other ones."""

    HELP = texts.REPLAY_CHOICE_HELP

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__()
        self._folders = [path for path in dict.fromkeys(paths) if path.is_dir()]
        files = [path for path in paths if path not in self._folders]
        for folder in self._folders:
            files += sessions_below(folder)[:MOST_LISTED]
        self._paths = tuple(dict.fromkeys(files))

    def question(self) -> str:
        served = f"\n{texts.REPORTS_SERVED}" if self.app.read_only else ""
        return f"{texts.REPLAY_QUESTION}{served}"

    def sessions(self) -> list[SessionFile]:
        return list(map(look_at, self._paths))

    def options(self) -> Iterator[Option | None]:
        return (Option(*row) for row in texts.replay_rows(self._folders, self._recent))


def replay_screen(path: Path, looks: Iterable[Look]) -> Screen[None]:
    """A session played once more; one with its own form is looked at. Raises RecordError."""
    if look := look_of(path, looks):
        return look.opened(path, "replay")
    from app.screens.replay import ReplayScreen

    return ReplayScreen(path)
