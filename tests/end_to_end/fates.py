"""When a process dies: at a byte of a write, at a line of the file, or around a sync."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Literal, Protocol
from unittest import mock

from protocols import files

PAUSE = 60
"""Weight of a moment between two writes, beside a weight of one for each byte."""


class Fate(Protocol):
    """When a life ends."""

    def bytes_left(self, content: bytes) -> int | None:
        """How many bytes of this write still reach the file; None: all, and life goes on."""

    def pause(self) -> bool:
        """Whether it ends here, where nothing is being written."""


class Spared:
    """A life that is not taken."""

    def bytes_left(self, content: bytes) -> int | None:
        return None

    def pause(self) -> bool:
        return False


class RandomFate:
    """The end comes after so many bytes and moments."""

    def __init__(self, moments: int) -> None:
        self._left = moments

    def bytes_left(self, content: bytes) -> int | None:
        if self._left < len(content):
            return self._left
        self._left -= len(content)
        return None

    def pause(self) -> bool:
        self._left -= PAUSE
        return self._left < 0


class LineFate:
    """The end comes at a line of the file: behind its last byte, or inside it."""

    def __init__(self, line: int, inside: float | None) -> None:
        self._line = line
        self._inside = inside

    def bytes_left(self, content: bytes) -> int | None:
        lines = content.splitlines(keepends=True)
        if self._line > len(lines):
            self._line -= len(lines)
            return None
        before, last = sum(map(len, lines[: self._line - 1])), len(lines[self._line - 1])
        return before + (last if self._inside is None else 1 + int(self._inside * (last - 1)))

    def pause(self) -> bool:
        return False


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


class DoomedFile:
    """A file whose process dies in the middle of a write."""

    def __init__(self, file: IO[bytes], fate: Fate) -> None:
        self._file = file
        self._fate = fate

    def write(self, content: bytes) -> int:
        byte_count = self._fate.bytes_left(bytes(content))
        if byte_count is None:
            return self._file.write(content)
        self._file.write(content[:byte_count])
        self._file.flush()
        die()
        return byte_count

    def truncate(self, size: int) -> int:
        if self._fate.pause():
            die()
        return self._file.truncate(size)

    def __getattr__(self, name: str) -> object:
        return getattr(self._file, name)


@contextmanager
def doomed(fate: Fate) -> Iterator[None]:
    """Within this, the process dies as its fate wills: in a write, or around a sync."""
    real_open, real_sync = files.open_to_write, os.fsync

    def opened(path: Path, mode: Literal["x+b", "r+b"]) -> object:
        return DoomedFile(real_open(path, mode), fate)

    def sync(descriptor: int) -> None:
        if fate.pause():
            die()
        real_sync(descriptor)
        if fate.pause():
            die()

    with (
        mock.patch.object(files, "open_to_write", opened),
        mock.patch.object(os, "fsync", sync),
    ):
        yield
