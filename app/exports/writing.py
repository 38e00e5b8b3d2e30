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

    Raises RecordError where the disk refuses and UsageError for a target that must not be replaced.
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
        for behind, part in staged.items():
            part.replace(behind)
    except OSError as problem:
        for part in staged.values():
            part.unlink(missing_ok=True)
        raise RecordError(
            f"writing {path}",
            problem.strerror or str(problem),
            "a place with write permission and free space",
        ) from problem
    return list(targets)


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
