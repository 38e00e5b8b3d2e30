"""Files as the record needs them: regular ones only, none through a link, one writer at a time."""

from __future__ import annotations

import errno
import io
import os
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from typing import Literal

NO_WAIT = getattr(os, "O_NONBLOCK", 0)
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
"""Windows has neither; there the file that was opened is compared with the one looked at."""

DISK_FAILS = (errno.EIO, errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))

FAR_BYTES = 0x7FFF_FFF0
"""Windows locks bytes that nobody else can read then: this one lies behind any record."""


def open_to_write(path: Path, mode: Literal["x+b", "r+b"]) -> io.FileIO:
    """A new file, or one that is there: regular and no link. Raises OSError."""
    before = None
    if mode == "r+b":
        before = path.lstat()
        if stat.S_ISLNK(before.st_mode):
            raise OSError(errno.ELOOP, f"a link to {path.resolve()}: name that file itself")
        _check_regular(before)
    file = io.FileIO(path, mode, opener=_opener(NO_LINK))
    if before and not os.path.samestat(before, os.fstat(file.fileno())):
        file.close()
        raise OSError(errno.ELOOP, "another file than a moment ago")
    return file


def open_to_read(path: Path) -> io.FileIO:
    """A regular file; a pipe or a device is refused at once. Raises OSError."""
    _check_regular(path.stat())
    file = io.FileIO(path, "rb", opener=_opener(0))
    try:
        _check_regular(os.fstat(file.fileno()))
    except OSError:
        file.close()
        raise
    return file


def write_all(file: io.FileIO, content: bytes) -> None:
    """Every byte, at the present place, and on the disk. Raises OSError."""
    left = memoryview(content)
    while left:
        written = file.write(left)
        if not written:
            raise OSError(errno.EIO, "nothing was written")
        left = left[written:]
    os.fsync(file.fileno())


def write_new(path: Path, content: bytes) -> io.FileIO:
    """A locked new file with this content, on the disk and read back; nothing where that fails.

    Raises OSError.
    """
    file = open_to_write(path, "x+b")
    try:
        lock(file)
        write_all(file, content)
        _check_content(file, content)
        sync_folder(path.parent)
    except BaseException:
        remove_own(path, file)
        raise
    return file


def _check_content(file: io.FileIO, content: bytes) -> None:
    file.seek(0)
    if file.readall() != content:
        raise OSError(errno.EIO, "other bytes on the disk than were written")


def remove_own(path: Path, file: io.FileIO) -> None:
    """Close a file and take its name away, if it still is the file of that name."""
    with suppress(OSError):  # else it stays, and the next one gets another name
        is_ours = leads_to(path, file)
        close(file)  # before: Windows removes no open file
        if is_ours:
            path.unlink()
    close(file)


def close(file: io.FileIO) -> None:
    """Let go; whatever matters was synced before, so that an error of closing says nothing."""
    with suppress(OSError):
        file.close()


def leads_to(path: Path, file: io.FileIO) -> bool:
    """Whether a name is that of an open file; somebody may have removed or replaced it."""
    try:
        return os.path.samestat(path.lstat(), os.fstat(file.fileno()))
    except FileNotFoundError:
        return False


def lock(file: io.FileIO) -> None:
    """Keep other writers out until the file is closed, by whatever name they come.

    Readers are not kept out. Raises BlockingIOError where another writer has it, another OSError
    where the file system has no locks.
    """
    if sys.platform == "win32":
        import msvcrt

        file.seek(FAR_BYTES)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except PermissionError as problem:
            raise BlockingIOError(errno.EAGAIN, "locked") from problem
    else:
        import fcntl

        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)


def sync_folder(folder: Path) -> None:
    """Make a new name itself durable where the system can. Raises OSError where the disk fails."""
    if os.name != "posix":
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as problem:
        if problem.errno in DISK_FAILS:  # not where a network file system knows no such thing
            raise


def unused_path(path: Path) -> Path:
    """The path, or the first numbered variant of it that does not exist yet, not even as a link."""
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(p for p in chain([path], numbered) if not os.path.lexists(p))


def _opener(extra: int) -> Callable[[str, int], int]:
    return lambda name, flags: os.open(name, flags | extra | NO_WAIT, 0o666)


def _check_regular(found: os.stat_result) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, "a folder")
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "a pipe or a device")
