"""What a person asks a machine about."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Request:
    """What a person asks a machine about. ``noise_mm`` None: what the machine file states."""

    procedure: str
    machine_file: Path | None = None
    noise_mm: float | None = None
    minutes_per_mounting: float = 2.0
    measured: tuple[str, ...] = ()
    known: tuple[str, ...] | None = None
    postures: int | None = None
    posture_file: Path | None = None
    seed: int = 0
