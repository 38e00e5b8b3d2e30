"""A closed terminal or a polite kill ends the interface as Ctrl-C does, record and ports first."""

from __future__ import annotations

import asyncio
import os
import signal
import stat
import sys
from collections.abc import Callable

SIGNALS = ("SIGTERM", "SIGHUP")
"""By name: Windows knows no SIGHUP."""


def on_signals(leave: Callable[[], object]) -> Callable[[], None]:
    """Call ``leave`` in the running loop for each of the signals; gives back how to undo that.

    Where a loop takes no signals (Windows, another thread than the main one) nothing happens.
    """
    loop = asyncio.get_running_loop()
    taken: list[signal.Signals] = []
    for name in SIGNALS:
        number = getattr(signal, name, None)
        if number is None:
            continue
        try:
            loop.add_signal_handler(number, _receive, number, leave)
        except (NotImplementedError, RuntimeError, ValueError):
            # Windows, or not the main thread: the terminal's own keys leave as before
            return lambda: None
        taken.append(number)

    def undo() -> None:
        for number in taken:
            loop.remove_signal_handler(number)

    return undo


def _receive(number: signal.Signals, leave: Callable[[], object]) -> None:
    if number.name == "SIGHUP":
        _write_nowhere()
    leave()


def _write_nowhere() -> None:
    """The terminal is gone: what is still to be shown must neither fail nor wait."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (sys.__stdout__, sys.__stderr__):
        # a lost terminal is still a character device, but isatty denies it
        if stream is not None and stat.S_ISCHR(os.fstat(stream.fileno()).st_mode):
            os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
