"""What sort of cause an effect has, and what its parameters are."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Kind(StrEnum):
    """Where the cause of an effect lies."""

    MACHINE = "machine"
    INDICATOR = "indicator"
    ENVIRONMENT = "environment"
    BLUNDER = "blunder"  # a mistake in the data
    EMPIRICAL = "empirical"  # a law without a name


@dataclass(frozen=True)
class EffectParameter:
    """One parameter: name, unit, and a size in that unit that nobody would remark on."""

    name: str
    unit: str
    tolerance: float
