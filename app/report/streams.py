"""Where text leaves the program for a terminal or a pipe: nothing hidden goes out."""

from __future__ import annotations

import codecs
import io
import os
import signal
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import TextIO

from calib.errors import UsageError
from calib.printable import printable

LAYOUT = "\n\t"


class PrintableStream(io.TextIOBase):
    """Hands text on to another stream with hidden characters shown.

    It offers no ``buffer``, so that nobody who looks for one gets past it.
    """

    def __init__(self, behind: TextIO) -> None:
        self._behind = behind

    @property
    def encoding(self) -> str:  # type: ignore[override]  # typeshed has an attribute
        """Encoding of the stream behind."""
        return self._behind.encoding

    def write(self, text: str) -> int:
        """Hand on; the count is of what was given."""
        self._behind.write(printable(text, keep=LAYOUT))
        return len(text)

    def flush(self) -> None:
        """Flush the stream behind; in a closed one nothing waits.

        Python flushes what it collects, in any order, and since 3.13 says where that fails.
        """
        if not self._behind.closed:
            self._behind.flush()

    def isatty(self) -> bool:
        """Whether the stream behind is a terminal."""
        return self._behind.isatty()

    def fileno(self) -> int:
        """File number of the stream behind."""
        return self._behind.fileno()


PLAIN = "glidecal.plain"
SPELLINGS = {
    "−": "-",
    "–": "-",
    "±": "+-",
    "×": "x",
    "→": "->",
    "≤": "<=",
    "≥": ">=",
    "µ": "u",
    "°": "deg",
    "…": "...",
    "─": "-",
    "│": "|",
    "█": "#",
    "’": "'",
}
"""What consoles without UTF-8 get for characters that they do not have; for others "?"."""


def _spelled(problem: UnicodeError) -> tuple[str | bytes, int]:
    """A text that the console can show in place of one that it cannot, and where to go on."""
    if not isinstance(problem, UnicodeEncodeError):
        raise problem
    strange = problem.object[problem.start : problem.end]
    return "".join(SPELLINGS.get(letter, "?") for letter in strange), problem.end


codecs.register_error(PLAIN, _spelled)


def guard_standard_streams() -> None:
    """Make everything printable that is printed from here on.

    The interface and the progress bar draw on ``sys.__stdout__`` and ``sys.__stderr__``, the
    interface through a filter of its own (app/screens/interface.py).
    """
    _replace_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=PLAIN)
    if not isinstance(sys.stdout, PrintableStream):
        sys.stdout = PrintableStream(sys.stdout)
        sys.stderr = PrintableStream(sys.stderr)


def _replace_closed_streams() -> None:
    """Streams for those that the caller closed, in the place of which Python has None.

    They take the free numbers, which no record gets then. Nothing is read, messages go nowhere, and
    a result cannot be written: that is an OSError.
    """
    sys.stdin = sys.stdin or os.fdopen(os.open(os.devnull, os.O_RDONLY))
    if sys.stdout is None:
        number = os.open(os.devnull, os.O_RDONLY)
        sys.stdout = os.fdopen(number, "w", encoding="utf-8", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")


def write_nowhere() -> None:
    """The terminal is gone: what is still to be shown must neither fail nor wait."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (sys.__stdout__, sys.__stderr__):
        # a lost terminal is still a character device, but isatty denies it
        if stream is not None and stat.S_ISCHR(os.fstat(stream.fileno()).st_mode):
            os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


SIGNALS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Windows knows no SIGHUP."""


def heed_signals(leave: Callable[[], object] | None) -> None:
    """Call this in the running loop at each of the signals; None: they end the program again.

    Where a loop takes no signals (Windows, another thread than the main one) nothing happens: the
    terminal's own keys leave as before.
    """
    import asyncio  # loaded where there is a loop

    loop = asyncio.get_running_loop()

    def receive(number: signal.Signals) -> None:
        if number.name == "SIGHUP":
            write_nowhere()
        if leave is not None:
            leave()

    with suppress(NotImplementedError, RuntimeError, ValueError):
        for number in SIGNALS:
            if leave is None:
                loop.remove_signal_handler(number)
            else:
                loop.add_signal_handler(number, receive, number)


def need_terminal(subject: str, instead: str) -> None:
    """Raises UsageError where there is no terminal to show a screen on."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise UsageError(subject, "no terminal", f"a terminal, or {instead}")
