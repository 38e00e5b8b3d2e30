"""What to measure: what the three planning verbs share. A machine plugs in through `MACHINES`.

A machine hands over arrays: what a procedure sees (`Examined`), what could be measured instead
(`Pool`) and how its postures are written down. Everything else, the choice and the documents, is
the same for all machines.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from app.exports.writing import write_files
from calib.classical_qr import ClassicalQr, classical_qr
from calib.criteria import Aim, Criterion, value_of, wanted_information
from calib.errors import NotIdentifiable
from calib.identifiability import Identifiability, Sensitivity, analyse, combinations
from calib.observations import FloatArray, IntArray
from calib.postures import Candidates, Choice, choose
from protocols.errors import UsageError

Coordinates = dict[str, float | str]
"""One posture: names with their unit, such as ``displacement_mm``."""


@dataclass(frozen=True)
class Request:
    """What a person asks a machine about. ``noise_mm`` None: what the machine file states."""

    procedure: str
    machine_file: Path | None = None
    noise_mm: float | None = None
    minutes_per_mounting: float = 2.0
    measured: tuple[str, ...] = ()
    postures: int | None = None
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Examined:
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
    published_rank: int | None = None
    remark: str = ""


@dataclass(frozen=True)
class Cure:
    """The added posture that helps one combination most, and its uncertainty then."""

    where: str
    standard_uncertainty: float


class Pool(Protocol):
    """Candidates of one machine."""

    @property
    def candidates(self) -> Candidates:
        """Rows ready for `calib.postures.choose`."""

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

    def files(self, chosen: Sequence[int]) -> dict[str, str]:
        """Runnable procedures as texts, by what is put before the suffix of the file's name."""


class PlannedMachine(Protocol):
    """A kind of machine that can be planned for."""

    @property
    def name(self) -> str:
        """The name on the command line."""

    def examine(self) -> Examined:
        """What the procedure of the request sees."""

    def pool(self) -> Pool:
        """What could be measured."""

    def metric(self) -> FloatArray:
        """Mean square at the tool for a change of the parameters ``(k, k)``."""

    def cures(self, vectors: Sequence[FloatArray]) -> tuple[Cure | None, ...]:
        """For each combination ``(k,)`` the best added posture; None where none is known."""


def _orthoglide(request: Request) -> PlannedMachine:
    from app.planning_orthoglide import OrthoglidePlanning

    if request.measured or request.postures is not None:
        raise UsageError(
            "--measured and --postures", "the machine orthoglide", "the machine hexaslide"
        )
    return OrthoglidePlanning.of(request)


def _hexaslide(request: Request) -> PlannedMachine:
    from app.planning_hexaslide import HexaSlidePlanning

    return HexaSlidePlanning.of(request)


MACHINES: dict[str, Callable[[Request], PlannedMachine]] = {
    "orthoglide": _orthoglide,
    "hexaslide": _hexaslide,
}


def planned_machine(name: str, request: Request) -> PlannedMachine:
    """The machine of that name. Raises UsageError for a name that is not known."""
    if name not in MACHINES:
        raise UsageError("machine", repr(name), ", ".join(sorted(MACHINES)))
    return MACHINES[name](request)


@dataclass(frozen=True, eq=False)
class Combination:
    """A combination that is weak or lost, and what would help.

    ``standard_uncertainty`` and ``tool_mm`` are None where it is lost.
    """

    name: str
    shares: dict[str, float]
    standard_uncertainty: float | None
    tool_mm: float | None
    cure: Cure | None


@dataclass(frozen=True, eq=False)
class SeenBy:
    """What a procedure can and cannot see, ready for words and documents."""

    machine: str
    examined: Examined
    found: Identifiability
    lost: tuple[Combination, ...]
    weak: tuple[Combination, ...]
    qr: ClassicalQr

    @property
    def limited_by(self) -> str:
        """Too few values for the parameters, or nothing but the geometry."""
        fewest = self.examined.fewest_postures
        if fewest is not None:
            return "too-few-postures" if self.examined.posture_count < fewest else "nothing"
        few = self.examined.independent_count < len(self.found.names)
        return "too-few-postures" if few else "nothing"


def seen_by(name: str, request: Request) -> SeenBy:
    """Rank, lost and weak combinations with their cures, and the classical test."""
    machine = planned_machine(name, request)
    examined = machine.examine()
    sensitivity = examined.sensitivity
    found = analyse(sensitivity)
    lost = combinations(found.unseen_vectors, sensitivity)
    weak = combinations(found.weak_vectors, sensitivity)
    cures = machine.cures([vector for vector, _ in (*lost, *weak)])
    return SeenBy(
        machine=name,
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


@dataclass(frozen=True)
class Figures:
    """One set of postures judged: None where it does not see all parameters."""

    value: float | None
    condition_number: float | None
    smallest_singular_value: float | None
    tool_mm: float | None
    minutes: float
    count: int


@dataclass(frozen=True, eq=False)
class Chosen:
    """Optimum postures beside the procedure that they were asked for."""

    machine: str
    procedure: str
    criterion: Criterion
    before: Figures
    after: Figures
    start_condition_number: float | None
    postures: tuple[Coordinates, ...]
    coordinates_on_bound: int
    seconds: float
    starts: int
    seed: int
    exchanges: int
    noise_words: str
    files: dict[str, str]


def optimum_postures(
    name: str,
    request: Request,
    count: int,
    *,
    criterion: Criterion = Criterion.DETERMINANT,
    budget_min: float | None = None,
    seed: int = 0,
    starts: int = 8,
    repeats: bool = False,
    common: bool = False,
) -> Chosen:
    """The best set of ``count`` postures that fits into the budget.

    ``common`` allows only sets that treat equal parts of the machine alike: one procedure file.

    Raises UsageError for an impossible count or budget, NotIdentifiable where so few postures
    cannot determine the parameters.
    """
    machine = planned_machine(name, request)
    examined, pool, metric = machine.examine(), machine.pool(), machine.metric()
    _check_count(count, len(pool.candidates.rows), repeats=repeats)
    aim = Aim(criterion, pool.wanted, metric)
    begin = time.perf_counter()
    search = _Search(count, aim, seed, starts, repeats=repeats, common=common)
    pool, found = _within_budget(pool, search, budget_min)
    seconds = time.perf_counter() - begin
    whitened = examined.sensitivity.jacobian
    information = pool.candidates.information(np.array(found.chosen, dtype=np.intp))
    left = wanted_information(information, aim)
    plain = Aim(criterion, None, metric)
    return Chosen(
        machine=name,
        procedure=examined.procedure,
        criterion=criterion,
        before=_figures(whitened.T @ whitened, plain, examined.minutes, examined.posture_count),
        after=_figures(left, plain, pool.minutes(found.chosen), count),
        start_condition_number=found.start_condition_number,
        postures=pool.coordinates(found.chosen),
        coordinates_on_bound=pool.on_bound(found.chosen),
        seconds=seconds,
        starts=starts,
        seed=seed,
        exchanges=found.exchanges,
        noise_words=examined.noise_words,
        files=pool.files(found.chosen),
    )


@dataclass(frozen=True)
class _Search:
    """How to choose from any pool."""

    count: int
    aim: Aim
    seed: int
    starts: int
    repeats: bool
    common: bool

    def best_of(self, pool: Pool) -> Choice:
        """Raises UsageError where no common set has this size."""
        symmetric = pool.symmetric(self.count, self.aim, self.seed)
        if not self.common:
            return choose(
                pool.candidates,
                self.count,
                self.aim,
                seed=self.seed,
                starts=self.starts,
                repeats=self.repeats,
                begin_with=[np.array(one.chosen, dtype=np.intp) for one in symmetric],
            )
        if not symmetric:
            raise UsageError(
                "--count",
                f"{self.count} with --common",
                "a multiple of the number of legs that determines the parameters",
            )
        sign = 1.0 if self.aim.criterion.larger_is_better else -1.0
        return max(symmetric, key=lambda one: sign * one.value)


def _within_budget(pool: Pool, search: _Search, budget_min: float | None) -> tuple[Pool, Choice]:
    """Set-ups are given up, the least used first, until the time is enough."""
    found = search.best_of(pool)
    while budget_min is not None and (needed := pool.minutes(found.chosen)) > budget_min:
        kept = pool.reduced(found.chosen)
        if kept is None or (len(kept) < search.count and not search.repeats):
            raise _too_little_time(budget_min, needed, search.count)
        pool = pool.take(kept)
        try:
            found = search.best_of(pool)
        except NotIdentifiable as problem:
            raise _too_little_time(budget_min, needed, search.count) from problem
    return pool, found


def _too_little_time(budget_min: float, needed_min: float, count: int) -> UsageError:
    return UsageError(
        "--budget",
        f"{budget_min:g} min",
        f"about {needed_min:.0f} min for {count} postures",
        "Ask for fewer postures or give more time.",
    )


def _check_count(count: int, size: int, *, repeats: bool) -> None:
    if count < 1 or (count > size and not repeats):
        raise UsageError(
            "--count", f"{count}", f"1 to {size}, the number of candidates", "Or add --repeats."
        )


def _figures(information: FloatArray, aim: Aim, minutes: float, count: int) -> Figures:
    def judged(criterion: Criterion) -> float | None:
        try:
            return value_of(information, Aim(criterion, None, aim.metric))
        except NotIdentifiable:
            return None

    variance = judged(Criterion.TOOL_VARIANCE)
    return Figures(
        value=judged(aim.criterion),
        condition_number=judged(Criterion.CONDITION),
        smallest_singular_value=judged(Criterion.SMALLEST_SINGULAR_VALUE),
        tool_mm=None if variance is None else variance**0.5,
        minutes=minutes,
        count=count,
    )


def write_procedures(chosen: Chosen, path: Path) -> list[Path]:
    """Write the procedure, or one for each mounting with its name before the suffix.

    Raises UsageError for a path that ``run --protocol`` would not take, RecordError where the disk
    refuses.
    """
    if path.suffix != ".toml":
        raise UsageError("--output", f"{path}", "a path that ends with .toml")
    if list(chosen.files) == [""]:
        return write_files(path, chosen.files)
    named = {f"{path.stem}{name}.toml": text for name, text in chosen.files.items()}
    return write_files(path.parent, named)
