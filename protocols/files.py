"""Files as the record needs them: regular ones only, none through a link, one writer at a time."""

from __future__ import annotations

import errno
import io
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from typing import Literal

from calib.errors import RecordError, UsageError

Contents = Mapping[str, str | bytes]
"""Contents of files by their names; '' is the path itself."""

STANDARD_OUTPUT = Path("-")
"""As an output: the stream. No file and no folder of this name is written."""


NO_WAIT = getattr(os, "O_NONBLOCK", 0)
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
"""Windows has neither; there the file that was opened is compared with the one looked at."""

DISK_FAILS = (errno.EIO, errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))

FAR_BYTES = 0x7FFF_FFF0
"""Windows locks bytes that nobody else can read then: this one lies behind any record."""


def reason_of(problem: OSError) -> str:
    """What the system says."""
    return problem.strerror or str(problem)


def unreadable(subject: str, problem: OSError) -> RecordError:
    """The error for a file that the system does not give."""
    next_step = "Name a file that exists and that you may read"
    return RecordError(subject, next_step=next_step, reason=reason_of(problem))


def open_to_write(path: Path, mode: Literal["x+b", "r+b"]) -> io.FileIO:
    """A new file, or one that is there: regular and no link. Raises OSError."""
    link_stat = None
    if mode == "r+b":
        link_stat = path.lstat()
        if stat.S_ISLNK(link_stat.st_mode):
            raise OSError(errno.ELOOP, f"a link to {path.resolve()}: name that file itself")
        _check_regular(link_stat)
    file = io.FileIO(path, mode, opener=_opener(NO_LINK))
    if link_stat and not os.path.samestat(link_stat, os.fstat(file.fileno())):
        file.close()
        raise OSError(errno.ELOOP, "another file than a moment ago")
    return file


def open_to_read(path: Path) -> io.FileIO:
    """A regular file; a pipe or a device is refused at once. Raises OSError."""
    try:
        _check_regular(path.stat())
    except ValueError as problem:
        raise OSError(errno.EINVAL, "a name that no file can have") from problem
    file = io.FileIO(path, "rb", opener=_opener(0))
    try:
        _check_regular(os.fstat(file.fileno()))
    except OSError:
        file.close()
        raise
    return file


def write_all(file: io.FileIO, content: bytes) -> None:
    """Every byte, at the present place, and on the disk. Raises OSError."""
    remaining = memoryview(content)
    while remaining:
        size = file.write(remaining)
        if not size:
            raise OSError(errno.EIO, "nothing was written")
        remaining = remaining[size:]
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
        remove_open(path, file)
        raise
    return file


def _check_content(file: io.FileIO, content: bytes) -> None:
    file.seek(0)
    if file.readall() != content:
        raise OSError(errno.EIO, "other bytes on the disk than were written")


def remove_open(path: Path, file: io.FileIO) -> None:
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


def _check_regular(status: os.stat_result) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "a folder")
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "a pipe or a device")


RECORD_START = b'{"line":1,'


class FilesThere(UsageError):
    """Files that stand where others are to be written: only a person may give them up."""

    def __init__(self, existing: Sequence[Path]) -> None:
        first, *further = existing
        names = [str(first), *(p.name if p.parent == first.parent else str(p) for p in further)]
        self.words = f"{', '.join(names)} {'are' if further else 'is'} there already"
        super().__init__(self.words, next_step="Give another name, or --force to replace")


def check_targets(targets: Iterable[Path], *, replace: bool) -> None:
    """Raises UsageError for a target that must not be replaced, FilesThere unless others may be."""
    paths = list(targets)
    if any(target.parts[:1] == STANDARD_OUTPUT.parts for target in paths):
        raise UsageError(
            "output",
            "'-', which is standard output",
            "the name of a file or folder",
            "Only a result that is one text goes to standard output.",
        )
    existing = [target for target in paths if os.path.lexists(target)]
    for target in existing:
        _refuse_to_replace(target)
    if existing and not replace:
        raise FilesThere(existing)


def write_files(path: Path, contents: Contents, *, replace: bool = False) -> list[Path]:
    """Write one file at ``path``, or several into the folder ``path``: all of them or none.

    Every file that a person asks for is written here. None is written through a link: a target
    that is one is refused, and what takes its name later is a file beside it that gets that name,
    which replaces a link and never what it leads to.

    Several are never old and new side by side, not even if the program is killed: the old ones
    are out of the way before the first new one has its name. Raises as `check_targets`, and
    RecordError where the disk refuses, which tells what stands there if the old ones could not be
    put back.
    """
    targets = targets_of(path, contents)
    check_targets(targets, replace=replace)
    staged: dict[Path, Path] = {}
    new_folders: list[Path] = []
    try:
        for target, content in targets.items():
            folders = (target.parent, *target.parent.parents)
            new_folders += [folder for folder in folders if not folder.exists()]
            target.parent.mkdir(parents=True, exist_ok=True)
            staged[target] = stage(target, content)
        _check_for_links(targets)  # once more: one that came meanwhile is not ours to replace
        _swap(staged)
    except OSError as problem:
        for part in staged.values():
            with suppress(OSError):
                part.unlink(missing_ok=True)
        for folder in new_folders:  # each before the one that it is in
            with suppress(OSError):
                folder.rmdir()
        raise RecordError(
            f"writing {path}",
            "",
            "a place with write permission and free space",
            *getattr(problem, "__notes__", ()),
            reason=reason_of(problem),
        ) from problem
    return list(targets)


def _check_for_links(targets: Iterable[Path]) -> None:
    """Raises OSError for a target that is a link."""
    for target in targets:
        if target.is_symlink():
            raise OSError(errno.ELOOP, f"{target} has become a link")


def _swap(staged: dict[Path, Path]) -> None:
    """Give the staged files their names. Raises OSError when everything is as before.

    Where that could not be reached, a note of the error says what stands there.
    """
    if len(staged) == 1:
        ((target, part),) = staged.items()
        part.replace(target)
        return
    moved: list[tuple[Path, Path]] = []
    try:
        for target, part in staged.items():
            if os.path.lexists(target):
                _move(target, _aside(part), moved)
        for target, part in staged.items():
            _move(part, target, moved)
    except OSError as problem:
        try:
            for source, destination in reversed(moved):
                destination.replace(source)
        except OSError:
            problem.add_note(_what_stands_there(staged))
        raise
    for part in staged.values():
        with suppress(OSError):
            _aside(part).unlink(missing_ok=True)


def _move(source: Path, destination: Path, moved: list[tuple[Path, Path]]) -> None:
    source.replace(destination)
    moved.append((source, destination))


def _aside(part: Path) -> Path:
    """The name of an old file while the new one comes; nobody else's, as that of the part is."""
    return part.with_suffix(".old")


def _what_stands_there(staged: dict[Path, Path]) -> str:
    """Which files are new, and which old ones have another name: for a person to put right."""
    new = [target.name for target, part in staged.items() if not part.exists()]
    moved = [old.name for part in staged.values() if (old := _aside(part)).exists()]
    return (
        f"The old files could not be restored. New: {', '.join(new) or 'none'}. Old, under "
        f"another name: {', '.join(moved) or 'none'}. Export again before the controller reads them"
    )


def targets_of(path: Path, contents: Contents) -> dict[Path, str | bytes]:
    """The contents by the paths of their files."""
    return {path / name if name else path: content for name, content in contents.items()}


def _refuse_to_replace(target: Path) -> None:
    if target.is_symlink():
        raise UsageError(
            "output",
            f"{target}, a link to {target.readlink()}",
            "a name that is not a link",
            "Name that file itself, or remove the link.",
        )
    if not target.is_file():
        raise UsageError("output", f"{target}, not an ordinary file", "a file to write")
    with suppress(OSError), target.open("rb") as file:
        if file.read(len(RECORD_START)) == RECORD_START:
            raise UsageError("output", f"{target}, a session", "another file: records are kept")


def stage(target: Path, content: str | bytes) -> Path:
    """The content beside its target under another name, safe on the disk."""
    descriptor, name = tempfile.mkstemp(dir=target.parent, prefix=target.name, suffix=".part")
    part = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            if sys.platform != "win32":  # by its number: its name may be another file's by now
                os.fchmod(file.fileno(), 0o644)  # mkstemp makes it private
            os.fsync(file.fileno())
    except OSError:
        part.unlink(missing_ok=True)
        raise
    return part
