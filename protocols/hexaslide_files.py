"""How measured postures of a Hexa Slide are known from other files, without any of its modules."""

from __future__ import annotations

from pathlib import Path

from protocols.files import open_to_read

MARK = b"glidecal.hexaslide-measurements"
"""Stands near the beginning of every such file, whole or cut."""

BEGINNING_BYTES = 400


def is_measurements(path: Path) -> bool:
    """Whether the file begins as one; False where it cannot be read."""
    try:
        with open_to_read(path) as file:
            return MARK in file.read(BEGINNING_BYTES)
    except OSError:
        return False
