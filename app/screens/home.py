"""Home: what can be done, interrupted sessions first.

It imports nothing that needs scipy: the first picture need not wait for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.screen import Screen
from textual.widgets import Footer, OptionList, Static
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
from app.screens.fast_keys import LeftOnce, Title
from app.screens.interface import ChoiceDialog, HelpDialog, Interface, TextDialog
from app.screens.pages import apart

DEMO_FOLDER = Path("demo-sessions")
Job = Callable[[], Callable[[], object]]
"""Computes something, and gives back what shows it."""


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
        others: list[Option | None] = []
        for recent in self._recent:
            label = texts.session_label(recent)
            if recent.interrupted and not recent.empty and not self.app.read_only:
                going_on.append(Option(f"Continue  {label}", f"continue {recent.path}"))
            others.append(Option(label, f"session {recent.path}"))
        options = [*going_on, *(Option(words, name) for name, words in able)]
        return [*options, None, *others] if others else options

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        if self._working:
            return
        what, _, path = (event.option.id or "").partition(" ")
        session = next((r for r in self._recent if str(r.path) == path), None)
        if what == "session" and session is not None:
            self._ask_about(session)
        else:
            self._do(what, session)

    def _ask_about(self, session: SessionFile) -> None:
        """A small choice of what can be done with one session."""
        if session.problem:
            self.app.complain(session.problem)
            return
        choices = texts.session_choices(session, read_only=self.app.read_only)
        dialog = ChoiceDialog(texts.session_label(session), choices)
        self.app.ask(dialog, lambda what: self._do(what, session))

    def _do(self, what: str, session: SessionFile | None) -> None:
        """Carry a choice out, with a session or after asking which one."""
        with self.app.complaining():
            if what == "new":
                self.app.push_screen(self._form())
            elif what == "demo":
                self._demonstrate()
            elif what == "compare":
                self._compare(session)
            elif what == "history":
                self._start(self._show_history)
            elif look := next((one for one in self.app.looks if one.name == what), None):
                self.app.push_screen(look.screen())
            elif session is None:
                self._pick(texts.WHICH[what], partial(self._do, what))
            else:
                self._do_with(session.path, what)

    def _do_with(self, path: Path, what: str) -> None:
        if what == "continue":
            self._continue(path)
        elif what == "replay":
            self.app.push_screen(_replay(path))
        elif what == "diagnose":
            self.app.push_screen(self.app.diagnosis([path]))
        elif what == "export":
            job = partial(self._export, path)
            self._start(job, replacing=partial(job, replace=True))
        else:
            self._start(partial(self._show_result, path))

    def _form(self) -> Screen[None]:
        """The form that was left, as it was left."""
        from app.screens.prepare import PrepareScreen

        form = self.app.form
        if form is None or form in self.app.screen_stack:  # there a session began with it
            form = self.app.form = PrepareScreen()
            self.app.install_screen(form, f"form {id(form)}")  # it stays when it is left
        return form

    def _continue(self, path: Path, typed: str = "") -> None:
        """The instrument check, after asking for the ports of a record of another computer."""
        from app.measuring.indicators import parse_indicator
        from app.measuring.plan import PortsUnknown, plan_to_continue

        with self.app.complaining():
            try:
                plan = plan_to_continue(path, tuple(map(parse_indicator, typed.split())))
            except PortsUnknown as problem:
                dialog = TextDialog(texts.PORTS_QUESTION.format(problem.thing), texts.PORTS_HINT)
                self.app.ask(dialog, partial(self._continue, path))
            else:
                self.app.push_screen(self.app.check(plan))

    def _demonstrate(self) -> None:
        from app.measuring.demo import WATCHED, demo_plan
        from app.measuring.plan import writable_folder

        plan = demo_plan(writable_folder(DEMO_FOLDER), "zero-max-min", 1, WATCHED)
        self.app.push_screen(self.app.check(plan))

    def _pick(
        self,
        question: str,
        then: Callable[[SessionFile], None],
        proposed: SessionFile | None = None,
        left_out: SessionFile | None = None,
    ) -> None:
        sessions = [session for session in self._recent if session != left_out]
        self.app.ask(PickScreen(question, sessions, proposed), then)

    def _compare(self, session: SessionFile | None) -> None:
        """Find the two sessions; one that verifies another brings its partner."""
        from app.evaluating.comparison import partner_of

        if session is None:
            self._pick(texts.WHICH["before"], self._compare)
            return
        partner = partner_of(session.path, session.verifies)
        if partner is None:
            self._pick_after(session)
            return
        dialog = ChoiceDialog(texts.partner_question(session.path, partner), texts.PARTNER_CHOICES)

        def answered(answer: str) -> None:
            if answer == "both":
                self._start(partial(self._show_comparison, partner, session.path))
            else:
                self._pick_after(session)

        self.app.ask(dialog, answered)

    def _pick_after(self, before: SessionFile) -> None:
        def picked(after: SessionFile) -> None:
            self._start(partial(self._show_comparison, before.path, after.path))

        question = f"{before.path}\n{texts.WHICH['after']}"
        self._pick(question, picked, follow_up(before, self._recent), left_out=before)

    def _start(self, job: Job, replacing: Job | None = None) -> None:
        """Compute apart from the screen, which loads what the job needs there, too."""
        self._working = True
        self.query_one("#question", Static).update(texts.COMPUTING)
        self._finish(job, replacing)

    @work
    async def _finish(self, job: Job, replacing: Job | None) -> None:
        with self.app.complaining(replacing and partial(self._start, replacing)):
            show = await apart(self, job)
            show()
        self._working = False
        self.query_one("#question", Static).update(texts.HOME_QUESTION)

    def _show_result(self, path: Path) -> Callable[[], object]:
        from app.evaluating.solution import solve_files
        from app.measuring.plan import plan_to_repeat
        from app.screens.result import ResultScreen

        solved = solve_files([path]).work_out()
        plan = None if self.app.read_only else plan_to_repeat(path)

        def show() -> None:
            self.app.push_screen(ResultScreen(solved, plan, path))
            for warning in solved.warnings:
                self.app.notify(warning, severity="warning", markup=False)

        return show

    def _export(self, path: Path, *, replace: bool = False) -> Callable[[], object]:
        from app.evaluating.solution import solve_files
        from app.exports import export_offsets
        from app.report.text.result import export_caution, exported_text

        folder = path.with_suffix("")
        solved = solve_files([path])
        written = export_offsets(solved, folder, replace=replace)
        said, caution = exported_text(folder, written), export_caution(solved)
        if caution:  # stays until it is read
            return partial(self.app.push_screen, HelpDialog(f"{said}\n\nWARNING: {caution}"))
        return partial(self.app.notify, said, timeout=10, markup=False)

    def _show_history(self) -> Callable[[], object]:
        screen = _history(Path())
        return lambda: self.app.push_screen(screen)

    def _show_comparison(self, before: Path, after: Path) -> Callable[[], object]:
        from app.evaluating.comparison import compare_files
        from app.screens.result import CompareScreen

        comparison = compare_files(before, after)
        return lambda: self.app.push_screen(CompareScreen(comparison))


class PickScreen(LeftOnce[SessionFile]):
    """Recent sessions with their state, or the path of another one; none by Escape."""

    app: Interface
    HELP = (
        "Each session stands with its readings and its state.\n"
        "An unreadable file tells its reason when it is chosen.\n"
        "The last line takes the path of a session in another folder."
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "Back", id="pick.back"),
        Binding("f10", "app.quit", "Quit", id="pick.quit"),
    ]

    def __init__(
        self, question: str, sessions: Sequence[SessionFile], proposed: SessionFile | None = None
    ) -> None:
        super().__init__()
        self._question = question
        self._sessions = tuple(sessions)
        self._proposed = proposed

    def compose(self) -> ComposeResult:
        words = self._question if self._sessions else f"{self._question}\n{texts.NO_SESSIONS}"
        labels = [Option(texts.session_label(session)) for session in self._sessions]
        at = self._sessions.index(self._proposed) if self._proposed in self._sessions else 0
        options = [*labels, Option(texts.ELSEWHERE)]
        yield from _listing(f"{words}\n{texts.PICK_KEYS}", options, at)

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        if event.option_index < len(self._sessions):
            self._choose(self._sessions[event.option_index])
        else:
            self.app.ask(TextDialog("Type the path of a session file.", "path"), self._typed)

    def _typed(self, path: str) -> None:
        self._choose(look_at(Path(path).expanduser()))

    def _choose(self, session: SessionFile) -> None:
        if session.problem:
            self.app.complain(session.problem)
        else:
            self.dismiss(session)


class ReplayChoiceScreen(Screen[None]):
    """The sessions that were named, those of folders and their history, and no other ones."""

    app: Interface
    HELP = (
        "Arrow keys and Enter open a session; Escape comes back to this list.\n"
        f"Of a folder the newest {MOST_LISTED} sessions stand here, and its history."
    )
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
            self.app.push_screen(_replay(self._paths[number]))

    @work(exclusive=True)
    async def _read_history(self, folder: Path) -> None:
        with self.app.complaining():
            history = await apart(self, _history, folder)
            if self.is_current:
                self.app.push_screen(history)


def _listing(question: str, options: Sequence[Option], at: int = 0) -> ComposeResult:
    yield Title()
    yield Static(question, markup=False, id="question")
    choices = OptionList(*options, id="choices", markup=False)
    choices.highlighted = at
    yield choices
    yield Footer()


def _history(folder: Path) -> Screen[None]:
    from app.evaluating.history import read_history
    from app.screens.history import HistoryScreen

    return HistoryScreen(read_history(folder))


def _replay(path: Path) -> Screen[None]:
    from app.screens.replay import ReplayScreen

    return ReplayScreen(path)
