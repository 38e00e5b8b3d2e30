"""What a machine hands over to be planned for, and what its procedures see.

A machine tells in arrays what a procedure sees (`Examination`) and what would help
(`AddedMeasurement`). The rest is the same for all machines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from calib.arrays import FloatArray
from calib.design.identifiability import (
    ClassicalQr,
    Identifiability,
    Sensitivity,
    analyse,
    classical_qr,
)


@dataclass(frozen=True, eq=False)
class Examination:
    """A procedure as its machine sees it.

    ``measured`` names what is read, ``row_count`` counts independent values; ``bare`` are the
    derivatives ``(n_values, k)`` in the parameters' own units; ``noise_words`` tell where the
    noise is from.
    """

    procedure: str
    sensitivity: Sensitivity
    bare: FloatArray
    measured: tuple[str, ...]
    posture_count: int
    independent_count: int
    minutes: float
    units: str
    noise_words: str
    source: str = "procedure"
    fewest_postures: int | None = None
    reachable_rank: int | None = None
    published_rank: int | None = None
    remark: str = ""


@dataclass(frozen=True)
class AddedMeasurement:
    """The added posture that helps one combination most, and its uncertainty then."""

    where: str
    standard_uncertainty: float


class PlannedMachine(Protocol):
    """A machine with a procedure."""

    @property
    def name(self) -> str:
        """The name on the command line."""

    def examine(self) -> Examination:
        """What the procedure of the request sees."""

    def cures(self, vectors: Sequence[FloatArray]) -> tuple[AddedMeasurement | None, ...]:
        """For each combination ``(k,)`` the best added posture; None where none is known."""


@dataclass(frozen=True, eq=False)
class Combination:
    """A combination that is weak or unidentifiable, and what would help.

    ``standard_uncertainty`` and ``tool_mm`` are None where it is unidentifiable.
    """

    name: str
    shares: dict[str, float]
    standard_uncertainty: float | None
    tool_mm: float | None
    cure: AddedMeasurement | None


@dataclass(frozen=True, eq=False)
class SeenBy:
    """What a procedure can and cannot see, ready for words and documents."""

    machine: str
    examined: Examination
    found: Identifiability
    unidentifiable: tuple[Combination, ...]
    weak: tuple[Combination, ...]
    qr: ClassicalQr

    @property
    def limited_by(self) -> str:
        """Too few values for the parameters, or nothing but the geometry."""
        reachable = self.examined.reachable_rank
        if reachable is not None:
            return "too-few-postures" if self.found.rank < reachable else "nothing"
        few = self.examined.independent_count < len(self.found.names)
        return "too-few-postures" if few else "nothing"


def seen_by(machine: PlannedMachine) -> SeenBy:
    """Rank, unidentifiable and weak combinations with what would help, and the classical test."""
    examined = machine.examine()
    names = examined.sensitivity.names
    found = analyse(examined.sensitivity)
    cures = machine.cures([one.vector for one in (*found.unseen, *found.weak)])
    every = tuple(
        Combination(
            name=one.combination,
            shares={n: float(v) for n, v in zip(names, one.vector, strict=True) if v != 0.0},
            standard_uncertainty=_finite(one.standard_uncertainty_mm),
            tool_mm=_finite(one.tool_mm),
            cure=cure,
        )
        for one, cure in zip((*found.unseen, *found.weak), cures, strict=True)
    )
    first_weak = len(found.unseen)
    return SeenBy(
        machine=machine.name,
        examined=examined,
        found=found,
        unidentifiable=every[:first_weak],
        weak=every[first_weak:],
        qr=classical_qr(examined.bare, names),
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
