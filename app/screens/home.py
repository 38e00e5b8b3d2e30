"""Home: what can be done, interrupted sessions first.

It imports nothing that needs scipy: the first picture need not wait for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from textual.app import ComposeResult
from textual.screen import Screen
from textual.widgets import OptionList, Static
from textual.widgets.option_list import Option

from app.dialogue.sessions import SessionChoice, plan_to_go_on
from app.measuring import recorded
from app.report.text import home as texts
from app.report.text.help import help_of
from app.screens import Look, look_of
from app.screens.interface import MainScreen, once, screen_of
from app.screens.pages import apart

if TYPE_CHECKING:
    from app.screens.result import ResultScreen

Shown = TypeVar("Shown", bound=Screen[Any])


class HomeScreen(MainScreen[None]):
    """The first screen."""

    HELP = help_of("home")
    heading = "glidecal"
    AUTO_FOCUS = "#choices"
    _recent: Sequence[recorded.SessionFile] = ()

    def content(self) -> ComposeResult:
        yield Static(self.question(), markup=False, id="question")
        yield OptionList(id="choices", markup=False)

    def question(self) -> str:
        return texts.HOME_QUESTION

    def sessions(self) -> list[recorded.SessionFile]:
        return recorded.recent_sessions(Path(), recorded.DEMO_FOLDER)

    def rows(self) -> Iterator[texts.ListRow | None]:
        """What is listed; None is a line between."""
        looks = [(look.name, look.choice) for look in self.app.looks]
        return texts.home_rows(self._recent, looks, read_only=self.app.read_only)

    def on_screen_resume(self) -> None:
        """Sessions may have come or gone on while another screen was open."""
        self._recent = self.sessions()
        choices = self.query_one("#choices", OptionList)
        highlighted_id = choices.highlighted_option.id if choices.highlighted_option else None
        choices.set_options(row and Option(*row) for row in self.rows())
        ids = [option.id for option in choices.options]
        choices.highlighted = ids.index(highlighted_id) if highlighted_id in ids else 0

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        self._begin(*(event.option.id or "").partition(" ")[::2])

    @once("choice")
    async def _begin(self, verb: str, path: str) -> None:
        app = self.app
        opens = {"new": self._form, "demo": self._demonstration}
        opens |= {look.name: look.screen for look in app.looks}
        choice = SessionChoice(self, self._recent, app.read_only)
        with app.complaining():
            if verb in opens:
                app.push_screen(opens[verb]())
            elif verb == "history":
                await self._computed(partial(_history, Path(path), app.looks))
            elif errand := await choice.errand(verb, path):
                await self._do(*errand)
        self.query_one("#question", Static).update(self.question())

    async def _do(self, errand: str, path: Path, later_path: Path | None) -> None:
        if later_path is not None:
            await self._computed(partial(_comparison, path, later_path))
        elif look := look_of(path, self.app.looks):  # its screen writes what is exported, too
            self.app.push_screen(look.opened(path, errand))
        elif errand == "continue":
            if plan := await plan_to_go_on(self, path):
                self.app.push_screen(screen_of("check.CheckScreen", plan))
        elif errand == "replay":
            self.app.push_screen(replay_screen(path, ()))
        elif errand == "diagnose":
            self.app.push_screen(screen_of("diagnose.DiagnoseScreen", [path]))
        else:
            result = await self._computed(partial(_result, path, self.app.read_only))
            for warning in result.result.warnings:
                self.app.notify(warning, severity="warning")
            if errand == "export":
                result.action_export()

    async def _computed(self, job: Callable[[], Shown]) -> Shown:
        """Show what a job gives, apart from the screen; it loads what it needs there, too."""
        self.query_one("#question", Static).update(self.app.keyed(texts.COMPUTING))
        screen = await apart(self, job)
        await self.app.push_screen(screen)
        return screen

    def _form(self) -> Screen[None]:
        """The form that was left, as it was left."""
        form = self.app.form
        if form is None or form in self.app.screen_stack:  # there a session began with it
            form = self.app.form = screen_of("prepare.PrepareScreen")
            self.app.install_screen(form, f"form {id(form)}")  # it stays when it is left
        return form

    def _demonstration(self) -> Screen[None]:
        from app.measuring.demo import watched_plan

        return screen_of("check.CheckScreen", watched_plan(recorded.DEMO_FOLDER))


def _result(path: Path, read_only: bool) -> ResultScreen:
    from app.screens.result import result_of

    screen = result_of([path], verified=not read_only)
    screen.result.work_out()
    return screen


def _comparison(earlier_path: Path, later_path: Path) -> Screen[None]:
    from app.evaluating.comparison import compare_files

    return screen_of("history.CompareScreen", compare_files(earlier_path, later_path))


def _history(folder: Path, looks: Sequence[Look]) -> Screen[None]:
    from app.evaluating.history import PART_S, read_history

    job = partial(read_history, folder, of_postures=looks, within_s=PART_S)
    return screen_of("history.HistoryScreen", job(), job)


class ReplayChoiceScreen(HomeScreen):
    """The sessions that were named, those of folders and their history, and no other ones."""

    HELP = texts.REPLAY_CHOICE_HELP

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__()
        self._folders, self._files = recorded.named_sessions(paths)

    def question(self) -> str:
        return texts.replay_question(served=self.app.read_only)

    def sessions(self) -> list[recorded.SessionFile]:
        return list(map(recorded.look_at, self._files))

    def rows(self) -> Iterator[texts.ListRow | None]:
        return texts.replay_rows(self._folders, self._recent)


def replay_screen(path: Path, looks: Iterable[Look]) -> Screen[None]:
    """A session played once more; one with its own form is looked at. Raises RecordError."""
    look = look_of(path, looks)
    return look.opened(path, "replay") if look else screen_of("replay.ReplayScreen", path)


def first_replay(paths: Sequence[Path], looks: Iterable[Look], *, served: bool) -> Screen[None]:
    """A recorded session again, or a list of several. Raises RecordError for a bad file.

    Folders may be among them where they are ``served`` to others.
    """
    for path in () if served else paths:
        recorded.check_session(path)
    alone = len(paths) == 1 and not paths[0].is_dir()
    return replay_screen(paths[0], looks) if alone else ReplayChoiceScreen(paths)
