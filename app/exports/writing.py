"""Write exported files whole or not at all, and never over a record."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from app.exports.offsets import Written
from protocols.errors import RecordError, UsageError

RECORD_START = b'{"line":1,'


def write_files(path: Path, written: Written) -> list[Path]:
    """Write one file at ``path``, or several into the folder ``path``: all of them or none.

    Several are never old and new side by side, not even if the program is killed: the old ones
    are out of the way before the first new one has its name. Raises RecordError where the disk
    refuses, which tells what stands there if the old ones could not be put back, and UsageError
    for a target that must not be replaced.
    """
    targets = {path / name if name else path: text for name, text in written.items()}
    for target in targets:
        _refuse_to_replace(target)
    staged: dict[Path, Path] = {}
    try:
        for target, text in targets.items():
            target.parent.mkdir(parents=True, exist_ok=True)
            behind = target.resolve()  # behind a link, the file itself
            staged[behind] = _stage(behind, text)
        _swap(staged)
    except OSError as problem:
        for part in staged.values():
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
        raise RecordError(
            f"writing {path}",
            problem.strerror or str(problem),
            "a place with write permission and free space",
            *getattr(problem, "__notes__", ()),
        ) from problem
    return list(targets)


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
            if target.exists():
                _move(target, _aside(part), moved)
        for target, part in staged.items():
            _move(part, target, moved)
    except OSError as problem:
        try:
            for before, after in reversed(moved):
                after.replace(before)
        except OSError:
            problem.add_note(_what_stands_there(staged))
        raise
    for part in staged.values():
        with contextlib.suppress(OSError):
            _aside(part).unlink(missing_ok=True)


def _move(before: Path, after: Path, moved: list[tuple[Path, Path]]) -> None:
    before.replace(after)
    moved.append((before, after))


def _aside(part: Path) -> Path:
    """The name of an old file while the new one comes; nobody else's, as that of the part is."""
    return part.with_suffix(".old")


def _what_stands_there(staged: dict[Path, Path]) -> str:
    """Which files are new, and which old ones have another name: for a person to put right."""
    new = [target.name for target, part in staged.items() if not part.exists()]
    aside = [old.name for part in staged.values() if (old := _aside(part)).exists()]
    return (
        f"What was there could not be put back. New: {', '.join(new) or 'none'}. Old, under "
        f"another name: {', '.join(aside) or 'none'}. Export again before the controller reads them"
    )


def _refuse_to_replace(target: Path) -> None:
    if not target.exists():
        return
    if not target.is_file():
        raise UsageError("output", f"{target}, not an ordinary file", "a file to write")
    with contextlib.suppress(OSError), target.open("rb") as file:
        if file.read(len(RECORD_START)) == RECORD_START:
            raise UsageError("output", f"{target}, a session", "another file: records are kept")


def _stage(target: Path, text: str) -> Path:
    """The text beside its target under another name, safe on the disk."""
    descriptor, name = tempfile.mkstemp(dir=target.parent, prefix=target.name, suffix=".part")
    part = Path(name)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        part.chmod(0o644)  # mkstemp makes it private
    except OSError:
        part.unlink(missing_ok=True)
        raise
    return part
