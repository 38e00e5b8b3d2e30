"""Home: what can be done, interrupted sessions first.

It imports nothing that needs scipy: the first picture need not wait for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
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
from app.screens.fast_keys import Title
from app.screens.interface import ChoiceDialog, HelpDialog, Interface, TextDialog
from app.screens.pages import Found, Given, apart, last_lines

DEMO_FOLDER = Path("demo-sessions")


class HomeScreen(Screen[None]):
    """The first screen."""

    app: Interface
    HELP = texts.HOME_HELP
    AUTO_FOCUS = "#choices"
    BINDINGS: ClassVar[list[BindingType]] = [Binding("f10", "app.quit", "Quit", id="home.quit")]

    def __init__(self) -> None:
        super().__init__()
        self._recent: list[SessionFile] = []
        self._working = False

    def compose(self) -> ComposeResult:
        yield from _listing(texts.HOME_QUESTION, ())

    def on_screen_resume(self) -> None:
        """Sessions may have come or gone on while another screen was open."""
        self._recent = recent_sessions(Path(), DEMO_FOLDER)
        choices = self.query_one("#choices", OptionList)
        before = choices.highlighted_option.id if choices.highlighted_option else None
        choices.clear_options()
        choices.add_options(self._options())
        ids = [option.id for option in choices.options]
        choices.highlighted = ids.index(before) if before in ids else 0

    def _options(self) -> list[Option | None]:
        """What is listed; None is a line between."""
        looks = [(look.name, look.choice) for look in self.app.looks]
        able = [
            c
            for c in (*texts.HOME_CHOICES, *looks)
            if c[0] in texts.READING_ONLY or not self.app.read_only
        ]
        going_on: list[Option | None] = []
        other_options: list[Option | None] = []
        for recent in self._recent:
            label = texts.session_label(recent)
            if recent.interrupted and not recent.empty and not self.app.read_only:
                going_on.append(Option(f"Continue  {label}", f"continue {recent.path}"))
            other_options.append(Option(label, f"session {recent.path}"))
        options = [*going_on, *(Option(words, name) for name, words in able)]
        return [*options, None, *other_options] if other_options else options

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        if not self._working:
            self._working = True
            what, _, path = (event.option.id or "").partition(" ")
            self._begin(what, next((r for r in self._recent if str(r.path) == path), None))

    @work
    async def _begin(self, what: str, session: SessionFile | None) -> None:
        with self.app.complaining():
            await self._do(what, session)
        self._working = False
        self.query_one("#question", Static).update(texts.HOME_QUESTION)

    async def _do(self, what: str, session: SessionFile | None) -> None:
        """Carry a choice out, with a session or after asking which one."""
        app = self.app
        opens = {"new": self._form, "demo": self._demonstration}
        opens |= {look.name: look.screen for look in app.looks}
        if session is not None and session.problem:
            app.complain(session.problem)
        elif what in opens:
            app.push_screen(opens[what]())
        elif what == "history":
            app.push_screen(await self._computed(_history, Path(), app.looks))
        elif session is None:
            which = texts.WHICH["before" if what == "compare" else what]
            if picked := await self._picked(which, self._recent):
                await self._do(what, picked)
        elif what == "session":
            choices = texts.session_choices(session, read_only=app.read_only)
            dialog = ChoiceDialog(texts.session_label(session), choices)
            if answer := await app.push_screen_wait(dialog):
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
        while (
            answer := await self.app.push_screen_wait(ChoiceDialog(words, rows, at))
        ) is not None:
            if isinstance(answer, str):
                path = await self.app.push_screen_wait(TextDialog(texts.WHICH_PATH, "path"))
                if not path:
                    continue
                answer = look_at(Path(path).expanduser())
            if not answer.problem:
                return answer
            self.app.complain(answer.problem)
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
        elif what == "export":
            self._say_computing()
            if text := await self.app.written(partial(_export, path)):
                await self.app.push_screen_wait(HelpDialog(text))  # stays until it is read
        else:
            screen, warnings = await self._computed(_result, path, self.app.read_only)
            self.app.push_screen(screen)
            for warning in warnings:
                self.app.notify(warning, severity="warning", markup=False)

    def _say_computing(self) -> None:
        self.query_one("#question", Static).update(self.app.keyed(texts.COMPUTING))

    async def _computed(
        self, job: Callable[Given, Found], *given: Given.args, **named: Given.kwargs
    ) -> Found:
        """What a job gives, apart from the screen; it loads what it needs there, too."""
        self._say_computing()
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
            if answer := await self.app.push_screen_wait(dialog):
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
            answer = await self.app.push_screen_wait(dialog)
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


def _result(path: Path, read_only: bool) -> tuple[Screen[None], tuple[str, ...]]:
    from app.screens.result import result_of

    screen = result_of([path], verified=not read_only)
    return screen, tuple(screen.solved.work_out().warnings)


def _export(path: Path, *, replace: bool) -> str:
    from app.evaluating.solution import solve_files
    from app.exports import export_offsets
    from app.report.text.result import export_caution, exported_text

    folder = path.with_suffix("")
    solved = solve_files([path])
    text = exported_text(folder, export_offsets(solved, folder, replace=replace))
    caution = export_caution(solved)
    return f"{text}\n\nWARNING: {caution}" if caution else text


def _comparison(before: Path, after: Path) -> Screen[None]:
    from app.evaluating.comparison import compare_files
    from app.screens.history import CompareScreen

    return CompareScreen(compare_files(before, after))


def _history(folder: Path, looks: Sequence[Look]) -> Screen[None]:
    from app.evaluating.history import read_history
    from app.screens.history import HistoryScreen

    return HistoryScreen(read_history(folder, of_postures=looks))


class ReplayChoiceScreen(Screen[None]):
    """The sessions that were named, those of folders and their history, and no other ones."""

    app: Interface
    HELP = texts.REPLAY_CHOICE_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f10", "app.quit", "Quit", id="replay-choice.quit")
    ]

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__()
        self._folders = tuple(path for path in paths if path.is_dir())
        self._paths = [path for path in paths if path not in self._folders]
        for folder in self._folders:
            self._paths += sessions_below(folder)[:MOST_LISTED]

    def compose(self) -> ComposeResult:
        served = f"\n{texts.REPORTS_SERVED}" if self.app.read_only else ""
        histories = (Option(texts.HISTORY_OF.format(folder.name)) for folder in self._folders)
        labels = (Option(texts.session_label(look_at(path))) for path in self._paths)
        yield from _listing(f"{texts.REPLAY_QUESTION}{served}", [*histories, *labels])

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        number = event.option_index - len(self._folders)
        if number < 0:
            self.app.notify(texts.READING_HISTORY, markup=False)
            self._read_history(self._folders[event.option_index])
            return
        with self.app.complaining():
            self.app.push_screen(replay_screen(self._paths[number], self.app.looks))

    @work(exclusive=True)
    async def _read_history(self, folder: Path) -> None:
        with self.app.complaining():
            history = await apart(self, _history, folder, self.app.looks)
            if self.is_current:
                self.app.push_screen(history)


def _listing(question: str, options: Iterable[Option]) -> ComposeResult:
    yield Title()
    yield Static(question, markup=False, id="question")
    yield OptionList(*options, id="choices", markup=False)
    yield from last_lines()


def replay_screen(path: Path, looks: Iterable[Look]) -> Screen[None]:
    """A session played once more; one with its own form is looked at. Raises RecordError."""
    if look := look_of(path, looks):
        return look.opened(path, "replay")
    from app.screens.replay import ReplayScreen

    return ReplayScreen(path)
