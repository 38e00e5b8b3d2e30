"""Write exported files whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from app.exports.offsets import Written
from protocols.errors import RecordError


def write_files(path: Path, written: Written) -> list[Path]:
    """Write one file at ``path``, or several into the folder ``path``. Raises RecordError."""
    targets = {path / name if name else path: text for name, text in written.items()}
    try:
        for target, text in targets.items():
            target.parent.mkdir(parents=True, exist_ok=True)
            _replace(target, text)
    except OSError as problem:
        raise RecordError(
            f"writing {path}",
            problem.strerror or str(problem),
            "a place with write permission and free space",
        ) from problem
    return list(targets)


def _replace(target: Path, text: str) -> None:
    """Write beside the target, then rename: a reader sees the old file or the new one."""
    descriptor, name = tempfile.mkstemp(dir=target.parent, prefix=target.name, suffix=".part")
    part = Path(name)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        part.chmod(0o644)  # mkstemp makes it private
        part.replace(target)
    except OSError:
        part.unlink(missing_ok=True)
        raise
