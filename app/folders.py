"""Folders that sessions are written to."""

from __future__ import annotations

from pathlib import Path

from protocols.errors import RecordError


def writable_folder(folder: Path) -> Path:
    """The folder, made where it is missing. Raises RecordError where that is impossible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise RecordError(
            f"folder {folder}", problem.strerror or str(problem), "a folder with write permission"
        ) from problem
    return folder
