"""The Textual application: it owns the open session, the screens only show it."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Coroutine, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from rich.cells import cell_len
from rich.segment import Segment
from textual.actions import ActionParseResult
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.color import Color
from textual.containers import Vertical, VerticalScroll
from textual.dom import DOMNode
from textual.events import Event, InputEvent, Key, MouseDown, Paste, Resize
from textual.filter import LineFilter
from textual.geometry import Size
from textual.notifications import SeverityLevel
from textual.screen import ModalScreen, Screen, ScreenResultType
from textual.widget import Widget
from textual.widgets import Input, OptionList, Static

from app.exit_codes import Exit
from app.measuring.motion_keys import MotionKeys
from app.report.streams import heed_signals
from app.report.text import home as texts
from app.report.text.tables import copied_text, keyed
from app.screens import Look
from app.screens.fast_keys import LeftOnce, lacks_parts, ready
from app.screens.keys import settings_for_screens, usual_key
from app.screens.pages import Message, last_lines, legible, signalled
from app.settings import Settings, save_theme, settings_path, split
from calib.errors import GlidecalError
from calib.printable import HIDDEN
from protocols.files import FilesThere, unused_path, write_files

if TYPE_CHECKING:
    from app.measuring.session import GuidedSession, Indicators

Answer = TypeVar("Answer")


class MainScreen(LeftOnce[ScreenResultType]):
    """A screen that is no dialog: what its keys can do, what happened last, questions over it."""

    app: Glidecal
    heading = ""

    def compose(self) -> ComposeResult:
        yield Static(self.heading, id="heading", markup=False)
        yield from self.content()
        yield from last_lines()

    def content(self) -> ComposeResult:
        """What stands between the heading and what happened last."""
        yield from ()

    def why_not(self, action: str) -> str:
        """Why an action cannot be done now; empty where it can."""
        return ""

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """What cannot be done is not offered; its key says why."""
        return not self.why_not(action)

    def say(self, text: str, *, wrong: bool = False) -> None:
        """What happened last, in a line that lies over no table."""
        for line in self.query(Message):  # none where the screen goes
            line.tell(text, wrong=wrong)

    async def ask(self, dialog: Screen[Answer]) -> Answer | None:
        """Ask from a worker of the screen; None where another question came before."""
        if not self.is_current:
            return None
        waiting = self.app.push_screen_wait(dialog)
        return await waiting

    async def choice(
        self, question: str, answers: Sequence[tuple[Answer, str]], at: int = 0
    ) -> Answer | None:
        return await self.ask(ChoiceDialog(question, answers, at))

    async def line(
        self, question: str, hint: str, without: str = "", default: str = ""
    ) -> str | None:
        return await self.ask(TextDialog(question, hint, default, without))

    async def written(self, job: Callable[..., Answer]) -> Answer | None:
        """Run a job that writes files in a thread, from a worker; None where it writes nothing.

        Where files are there already a person is asked, and it is called again with ``replace``.
        """
        with self.app.complaining():
            try:
                return await asyncio.to_thread(job, replace=False)
            except FilesThere as problem:
                dialog = ChoiceDialog(f"{problem.words}.", texts.REPLACE_CHOICES)
                if await self.app.push_screen_wait(dialog) == "replace":
                    return await asyncio.to_thread(job, replace=True)
        return None


def once(
    group: str, *, outlives: bool = False
) -> Callable[[Callable[..., Coroutine[Any, Any, None]]], Callable[..., None]]:
    """A worker of a screen for a key that may be held: one of a group at a time.

    It is cancelled where the screen is left, but for one that ``outlives`` it. Errors are shown.
    """

    def decorated(action: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
        async def doing(app: Glidecal, screen: MainScreen[Any], *arguments: object) -> None:
            with app.complaining():
                await action(screen, *arguments)

        def begin_once(screen: MainScreen[Any], *arguments: object) -> None:
            node = screen.app if outlives else screen
            workers = [worker for worker in node.workers if worker.group == group]
            if all(worker.is_finished for worker in workers if worker.node is node):
                node.run_worker(
                    doing(screen.app, screen, *arguments), group=group, description=group
                )

        return begin_once

    return decorated


class Dialog(ModalScreen[ScreenResultType], LeftOnce[ScreenResultType]):
    """A dialog that goes once."""

    app: Glidecal


class TextDialog(Dialog[str | None]):
    """One line of text; where ``without`` says what happens without it, Enter alone gives none."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "Cancel", id="dialog.cancel")
    ]

    def __init__(self, question: str, hint: str, default: str = "", without: str = "") -> None:
        super().__init__()
        self._question, self._without = question, without
        self._hint, self._proposed = hint, default

    def compose(self) -> ComposeResult:
        accepts = "Enter accepts, {dialog.cancel} cancels."
        ends = f"{{dialog.cancel}}: {self._without}" if self._without else accepts
        with Vertical(classes="dialog"):
            yield Static(self.app.keyed(f"{self._question} {ends}"), markup=False)
            yield Input(self._proposed, placeholder=self._hint)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        text = event.value.strip()
        if text or not self._without:
            self.dismiss(text)
        else:
            self.app.bell()
            cancel = self.app.keyed("{dialog.cancel}")
            event.input.placeholder = f"{self._hint}: none yet, write one, or {cancel}"


class ChoiceDialog(Dialog[Answer | None]):
    """One of several answers, each with its words, by arrow keys and Enter or by its number."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "Cancel", id="dialog.cancel"),
        *((str(number), f"pick({number})", "") for number in range(1, 10)),
    ]

    def __init__(
        self,
        question: str,
        choices: Sequence[tuple[Answer, str]],
        highlighted: int = 0,
        leaving: str = "{dialog.cancel} cancels.",
    ) -> None:
        super().__init__()
        self._question, self._leaving = question, leaving
        self._choices, self._highlighted = tuple(choices), highlighted

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog"):
            yield Static(self._question, markup=False)
            numbered = enumerate(self._choices, 1)
            options = (f"{n if n < 10 else ' '}  {label}" for n, (_, label) in numbered)
            yield OptionList(*options, markup=False)
            ends = f"{texts.LIST_KEYS}, or the number. {self._leaving}"
            yield Static(self.app.keyed(ends), markup=False)

    def on_mount(self) -> None:
        options = self.query_one(OptionList)
        options.highlighted = self._highlighted if self._choices else None
        options.focus()

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        self.dismiss(self._choices[event.option_index][0])

    def action_pick(self, number: int) -> None:
        if number <= len(self._choices):
            self.dismiss(self._choices[number - 1][0])


class HelpDialog(Dialog[None]):
    """Words about the present screen and the panel that has the focus."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,f1,enter", "dismiss(None)", "Close", id="help.close")
    ]

    def __init__(self, text: str) -> None:
        super().__init__()
        self._text = text

    def compose(self) -> ComposeResult:
        with VerticalScroll(classes="dialog"):
            yield Static(signalled(f"{self._text}\n\n{self.app.keyed('{help.close}')} closes."))


GO, VIEW = ("measure.go", "g"), ("measure.plot", "v")
"""Their ids in the settings, and the usual key."""

LEAVING = ("ctrl+c", "ctrl+q", "f10")

WIDE = 110
"""Columns from which text and plot stand side by side."""

PLAIN = ("textual-dark", "textual-light")
"""Themes that are listed first."""

LEAST_SIZE = Size(80, 24)


class PrintableRows(LineFilter):
    """Every row of every widget passes here last: nothing hidden reaches the terminal.

    What takes room there is replaced, what takes none is left out: the row keeps its width.
    """

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        if all(segment.text.isprintable() for segment in segments):
            return segments
        return [
            Segment(HIDDEN.sub(lambda match: "�" * cell_len(match[0]), segment.text), segment.style)
            for segment in segments
        ]


PRINTABLE_ROWS = PrintableRows()


def screen_of(name: str, *arguments: object, **options: object) -> Screen[Any]:
    """A screen by its module and what makes it, as "home.HomeScreen", loaded when asked for."""
    module, _, kind = name.partition(".")
    screen: Screen[Any] = getattr(import_module(f"app.screens.{module}"), kind)(
        *arguments, **options
    )
    return screen


class Glidecal(App[str]):
    """Screens over one session at a time. The result of `run` is a line for after the end."""

    TITLE = "glidecal"
    CSS_PATH = "glidecal.tcss"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+c", "interrupt", "Stop", show=False, priority=True),
        Binding("f10", "quit", "Quit", id="app.quit"),
        Binding("f1", "help", "Help", id="app.help"),
    ]

    def __init__(
        self,
        first: Screen[None],
        *,
        settings: Settings | None = None,
        read_only: bool = False,
        looks: Sequence[Look] = (),
    ) -> None:
        super().__init__()
        self.HORIZONTAL_BREAKPOINTS = [(WIDE, "wide")]  # a class of every screen so wide
        # rows from which panels have room for more than their digits
        self.VERTICAL_BREAKPOINTS = [(30, "tall")]
        self._first = first
        self.read_only = read_only
        self.looks = looks
        self._settings = settings or Settings()
        self._remembered = self._settings.theme or self.theme
        if not self._settings.animations:
            self.animation_level = "none"
        self.indicators: Indicators | None = None
        self.guided: GuidedSession | None = None
        self._motion_keys = MotionKeys()
        self._cramped = False  # the window is too small, and that was said

        self.form: Screen[None] | None = None
        """Of the preparation, as it was left."""
        self._status = Exit.DONE

    def on_mount(self) -> None:
        heed_signals(lambda: self.run_worker(self.action_interrupt()))
        if self._settings.theme:
            self.theme = self._settings.theme
        self.set_keymap(self._settings.keys)
        self.push_screen(self._first)

    def on_ready(self) -> None:
        """Load what the next screens need, once the first picture is there."""
        for name in ("prepare", "measure"):
            self.call_after_refresh(import_module, f"app.screens.{name}")

    async def on_event(self, event: Event) -> None:
        """Input that comes when the last screen is gone is nobody's; some of it stops a machine."""
        arguments = isinstance(event, InputEvent | Paste)
        if arguments and (not self.screen_stack or (not event.is_forwarded and self._stops(event))):
            return
        await super().on_event(event)

    def _stops(self, event: Event) -> bool:
        """Whether this input stopped a machine, or was a key that is still held, and no more.

        Whatever screen or dialog lies on top; only who leaves leaves.
        """
        owner = self.guided or self.indicators
        mover = owner.mover if owner else None
        if mover is None or not isinstance(event, Key | MouseDown | Paste):
            return False
        key = event.key if isinstance(event, Key) else ""
        goes, views = (key in split(self._settings.keys.get(*keys)) for keys in (GO, VIEW))
        return self._motion_keys.ends_here(mover, goes=goes, views=views) and key not in LEAVING

    async def run_action(
        self,
        action: str | ActionParseResult,
        default_namespace: DOMNode | None = None,
        namespaces: Mapping[str, DOMNode] | None = None,
    ) -> bool:
        """What a key does; nothing where it comes before its screen is ready, or too late."""
        ends = self.return_code is not None or not self.is_running
        if ends or not ready(default_namespace):
            return False
        if isinstance(default_namespace, MainScreen) and (
            why_not := default_namespace.why_not(str(action).partition("(")[0])
        ):
            self.complain(why_not)
            return True
        return await super().run_action(action, default_namespace, namespaces)

    def _handle_exception(self, error: Exception) -> None:
        if not lacks_parts(error):
            super()._handle_exception(error)

    def action_command_palette(self) -> None:
        """What an operator can use, no tools of the developer, in a list like any other."""
        jobs = (self.search_themes, self._save_screenshot, self._show_keys, self.action_quit)
        rows = [*zip(jobs, texts.PALETTE, strict=True)]
        self._choose(texts.WHICH_COMMAND, [rows[0], *rows[2:]] if self.read_only else rows)

    def search_themes(self) -> None:
        names = sorted(self.available_themes, key=lambda name: (name not in PLAIN, name))
        rows = [(partial(setattr, self, "theme", name), name) for name in names]
        self._choose(texts.WHICH_THEME, rows, names.index(self.theme))

    def _choose(
        self, question: str, rows: Sequence[tuple[Callable[[], object], str]], highlighted: int = 0
    ) -> None:
        """Do one of these things; not over another question."""
        if not isinstance(self.screen, ModalScreen):
            # after a refresh: by then the list is gone, and the screen below is the one shown
            later = [(partial(self.call_after_refresh, job), label) for job, label in rows]
            dialog = ChoiceDialog(question, later, highlighted)
            self.push_screen(dialog, lambda begin: None if begin is None else begin())

    def get_css_variables(self) -> dict[str, str]:
        self.theme_variables = (variables := super().get_css_variables()) | legible(variables)
        return self.theme_variables

    def on_resize(self, event: Resize) -> None:
        """Smaller than every screen is made for: said after each change, until it is larger."""
        cramped = event.size.width < LEAST_SIZE.width or event.size.height < LEAST_SIZE.height
        if cramped:
            warning = texts.TOO_SMALL.format(*event.size, *LEAST_SIZE)
            self.notify(warning, severity="warning")
        elif self._cramped:
            self.notify("")
        self._cramped = cramped

    def get_line_filters(self) -> Sequence[LineFilter]:
        return [*super().get_line_filters(), PRINTABLE_ROWS]

    def watch_theme(self, theme: str) -> None:
        """A theme that was chosen here is remembered for the next time."""
        if self.read_only or not self.is_running or theme == self._remembered:
            return
        self._remembered = theme
        with self.complaining():
            save_theme(settings_path(), theme)

    def _save_screenshot(self) -> None:
        path = unused_path(Path(f"glidecal_{datetime.now():%Y-%m-%d_%H%M%S}.svg"))
        with self.complaining():
            write_files(path, {"": self.export_screenshot()})
            self.notify(f"Written: {path.absolute()}")

    def _show_keys(self) -> None:
        entries = [entry for entry in self.screen.active_bindings.values() if entry.enabled]
        entries.sort(key=lambda entry: not isinstance(entry.node, Screen))
        keys = ((self.get_key_display(e.binding), e.binding.description) for e in entries)
        self.push_screen(HelpDialog(texts.key_list_text(keys)))

    def action_help(self) -> None:
        """Words about the focused panel, then about the screen."""
        panels = (self.focused or self.screen).ancestors_with_self  # the screen is the last of them
        helps = [p.HELP or str(p.tooltip or "") for p in panels if isinstance(p, Widget)]
        help_text = texts.help_text(helps, [look.words for look in self.looks])
        if not isinstance(self.screen, HelpDialog):
            self.push_screen(HelpDialog(self.keyed(help_text)))

    def key(self, key_id: str) -> str | None:
        """The first key of a binding by its id, as in force now; None for what is no such id."""
        key_name = self._settings.keys.get(key_id)
        key = split(key_name)[0] if key_name else usual_key(key_id)
        return key and texts.key_words(key)

    def keyed(self, text: str) -> str:
        """The text with keys in the place of the ids in it, such as ``{measure.take}``."""
        return keyed(text, self.key)

    def notify(
        self,
        message: str,
        *,
        title: str = "",
        severity: SeverityLevel = "information",
        timeout: float | None = None,
        markup: bool = True,
    ) -> None:
        """Show a message in the line that the screen has for it; nothing lies over a table."""
        screens = [place for place in self.screen_stack if not isinstance(place, ModalScreen)]
        screen = screens[-1] if screens else None
        if not isinstance(screen, MainScreen):
            super().notify(message, severity=severity, markup=False)
        elif screen.is_mounted:
            screen.say(message, wrong=severity == "error")
        else:  # it comes before its screen, which says it as soon as it has lines
            screen.call_later(screen.say, message, wrong=severity == "error")

    def copy(self, text: str) -> None:
        self.copy_to_clipboard(text)
        self.notify(copied_text(text))

    def complain(self, problem: GlidecalError | str) -> None:
        self.notify(str(problem), severity="error")

    @contextmanager
    def complaining(self) -> Iterator[None]:
        """Within this an error is shown, and what would follow it there is left out."""
        try:
            yield
        except GlidecalError as problem:
            self.complain(problem)

    async def action_quit(self) -> None:
        self.notify("Finishing …")
        self.exit(await self._leave(), return_code=self._status)

    def action_go_back(self) -> None:
        """Go to the screen below, or home: not for those who only look, it offers other files."""
        if len(self.screen_stack) > 2:  # Textual's blank one is the first
            self.pop_screen()
        elif not self.read_only:
            self.go_to(screen_of("home.HomeScreen"))

    async def pause_session(self) -> None:
        text = await self._leave()
        self.go_to(screen_of("home.HomeScreen"))
        self.notify(text)

    async def action_interrupt(self) -> None:
        """Ctrl-C and signals: as quit, with the exit status of an interruption."""
        with self.batch_update():  # the terminal may be gone
            self.exit(await self._leave(), return_code=Exit.INTERRUPTED)

    async def on_unmount(self) -> None:
        """However the interface ends, ports and record are let go.

        What is still computed in a thread then is waited for: a signal may end that.
        """
        heed_signals(None)
        await self._leave()

    async def _leave(self) -> str:
        guided, indicators = self.guided, self.indicators
        self.guided = self.indicators = None
        if guided is not None and guided.closed:
            return f"The session is complete: {guided.path}"
        if guided is not None:
            from app.report.text.session import left_text  # loaded with the measuring screen

            try:
                await asyncio.to_thread(guided.leave)
            except GlidecalError as problem:
                self._status = Exit.RECORD
                return str(problem)
            return left_text(guided)
        if indicators is not None:
            await asyncio.to_thread(indicators.close)
        return ""

    def go_to(self, screen: Screen[Any]) -> None:
        """Replace the present screen; what was asked over it goes with it."""
        while isinstance(self.screen, ModalScreen):
            self.pop_screen()
        self.switch_screen(screen)


def open_screen(first: Screen[None], looks: Sequence[Look], *, read_only: bool = False) -> int:
    """The interface with this screen; ``looks`` are what home offers of machines.

    Returns the exit status.
    """
    settings = settings_for_screens(settings_path())
    interface = Glidecal(first, settings=settings, read_only=read_only, looks=looks)
    if message := interface.run():
        print(message, file=sys.stderr)
    return interface.return_code or 0
