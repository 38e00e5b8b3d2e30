"""What a machine hands over to be planned for, and what its procedures see.

A machine tells in arrays what a procedure sees (`Examination`), what could be measured instead
(`Pool`) and what would help (`AddedMeasurement`). The rest is the same for all machines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from calib.design.criteria import Aim
from calib.design.exchange import Candidates, Choice
from calib.design.identifiability import (
    ClassicalQr,
    Identifiability,
    Sensitivity,
    analyse,
    classical_qr,
    combinations,
)
from calib.observations import FloatArray, IntArray

Coordinates = dict[str, float | str]
"""One posture: names with their unit, such as ``displacement_mm``."""

Orders = dict[tuple[int, float], list[float]]
"""Displacements in mm to visit for each mounting (leg, station)."""


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


class Pool(Protocol):
    """Candidates of one machine."""

    @property
    def candidates(self) -> Candidates:
        """Rows ready for `calib.design.exchange.choose`."""

    @property
    def wanted(self) -> tuple[int, ...]:
        """The machine's parameters among the columns."""

    def coordinates(self, chosen: Sequence[int]) -> tuple[Coordinates, ...]:
        """Postures with names and units, in the order to measure."""

    def on_bound(self, chosen: Sequence[int]) -> int:
        """How many coordinates of the chosen postures stand on a bound."""

    def minutes(self, chosen: Sequence[int]) -> float:
        """Time for the chosen postures with all set-up."""

    def reduced(self, chosen: Sequence[int]) -> IntArray | None:
        """Candidates left when the least useful set-up is given up; None where one is left."""

    def symmetric(self, count: int, aim: Aim, seed: int) -> Sequence[Choice]:
        """Sets of this size that treat equal parts of the machine alike, or none."""

    def take(self, kept: IntArray) -> Pool:
        """Only these candidates."""

    def moved(self, chosen: Sequence[int], aim: Aim) -> Pool:
        """The chosen postures alone, moved off the grid where that is better, in their order."""

    def orders(self, chosen: Sequence[int]) -> Orders:
        """What to visit one after the other."""


class PlannedMachine(Protocol):
    """A machine with a procedure."""

    @property
    def name(self) -> str:
        """The name on the command line."""

    def examine(self) -> Examination:
        """What the procedure of the request sees."""

    def cures(self, vectors: Sequence[FloatArray]) -> tuple[AddedMeasurement | None, ...]:
        """For each combination ``(k,)`` the best added posture; None where none is known."""


class PooledMachine(PlannedMachine, Protocol):
    """One whose postures are chosen from a list."""

    def pool(self) -> Pool:
        """What could be measured."""

    def metric(self) -> FloatArray:
        """Mean square at the tool for a change of the parameters ``(k, k)``."""


@dataclass(frozen=True, eq=False)
class Combination:
    """A combination that is weak or lost, and what would help.

    ``standard_uncertainty`` and ``tool_mm`` are None where it is lost.
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
    lost: tuple[Combination, ...]
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
    """Rank, lost and weak combinations with their cures, and the classical test."""
    examined = machine.examine()
    sensitivity = examined.sensitivity
    found = analyse(sensitivity)
    lost = combinations(found.unseen_vectors, sensitivity)
    weak = combinations(found.weak_vectors, sensitivity)
    cures = machine.cures([vector for vector, _ in (*lost, *weak)])
    return SeenBy(
        machine=machine.name,
        examined=examined,
        found=found,
        lost=tuple(
            Combination(words, _shares(vector, sensitivity.names), None, None, cure)
            for (vector, words), cure in zip(lost, cures[: len(lost)], strict=True)
        ),
        weak=tuple(
            Combination(
                words,
                _shares(vector, sensitivity.names),
                direction.standard_uncertainty_mm,
                direction.tool_mm,
                cure,
            )
            for (vector, words), direction, cure in zip(
                weak, found.weak, cures[len(lost) :], strict=True
            )
        ),
        qr=classical_qr(examined.bare, sensitivity.names),
    )


def _shares(vector: FloatArray, names: Sequence[str]) -> dict[str, float]:
    return {name: float(v) for name, v in zip(names, vector, strict=True) if v != 0.0}
