"""What a procedure can and cannot see of a machine's parameters. Knows no machine.

A machine and a procedure give a `Sensitivity`: named parameters and how every measured value,
divided by its noise, depends on them. In units of what is unremarkable for each parameter (its
tolerance scale) a singular value below 1 says that the data know the combination worse than one
knew it before; above, its inverse is the standard uncertainty. No bare numerical threshold decides.

To be planned for, a machine tells in arrays what a procedure sees (`Examination`) and what would
help (`AddedMeasurement`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal, Protocol

import numpy as np

from calib.arrays import BLIND, FloatArray, largest, named_inside, names_outside, svd_of_all
from calib.errors import NotIdentifiable
from calib.quantity import INTERNAL, Internal, Quantity

UNSEEN = 1.0
"""Standard uncertainty, in tolerances, from which on a combination is not seen."""

WEAK = 0.1
"""Standard uncertainty, in tolerances, from which on a combination is weak."""

WEAK_RATIO = 10.0
"""A combination is weak, too, when it is known so many times worse than the best known one."""

SMALL_SHARE = 0.25
"""Parameters with a smaller share of a combination are left out of its name."""


@dataclass(frozen=True, eq=False)
class Direction:
    """A combination of parameters ``vector`` ``(k,)``, its standard uncertainty, and what that does
    at the tool.

    In mm; infinite where the combination is not seen. Both belong to the combination as written.
    ``against`` is the same two parameters with the other sign, and its standard uncertainty.
    """

    combination: str
    vector: Annotated[FloatArray, Internal()] = field(metadata=INTERNAL)
    standard_uncertainty_mm: float
    tool_mm: float
    against: tuple[str, float] | None = field(default=None, metadata=INTERNAL)


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """How measured values depend on named parameters.

    ``jacobian`` ``(n_values, k)``: derivatives divided by the standard deviation of each value,
    nuisance parameters projected out; with ``noise_known`` False they have no absolute scale.
    ``tolerance`` ``(k,)`` holds an unremarkable size of each parameter in its own unit. ``cost``
    ``(m, k)`` are derivatives of the tool's coordinates all over the workspace.
    ``motions`` are combinations with a name of their own, such as a turned frame. ``blind`` is the
    relative singular value below which nothing is seen; exact derivatives allow a smaller one.
    With ``whole_shares`` combinations keep their small shares, which then are told in the name.
    A standard uncertainty above ``unseen``, in tolerances, is no sight of a combination.
    """

    names: tuple[str, ...]
    jacobian: FloatArray
    tolerance: FloatArray
    cost: FloatArray | None = None
    points: int = 1
    motions: tuple[tuple[str, FloatArray], ...] = ()
    noise_known: bool = True
    blind: float = BLIND
    whole_shares: bool = False
    unseen: float = UNSEEN


@dataclass(frozen=True, eq=False)
class Identifiability:
    """The answer: which combinations are seen, weak or not seen at all.

    ``singular_values`` ``(k,)`` belong to parameters in units of their tolerance. ``weak`` and
    ``unseen`` hold combinations as short as possible; ``individually_known`` the parameters that
    have no share in what is not seen.
    """

    names: tuple[str, ...]
    rank: int
    row_count: int
    singular_values: FloatArray
    condition_number: float
    weak: tuple[Direction, ...]
    unseen: tuple[Direction, ...]
    individually_known: tuple[str, ...]
    unseen_vectors: FloatArray = field(repr=False)


def analyse(sensitivity: Sensitivity) -> Identifiability:
    """Singular values against noise and tolerance, and names for what they tell."""
    scaled = sensitivity.jacobian * sensitivity.tolerance
    _, singular, vectors = svd_of_all(scaled)
    # in tolerances; without a noise only blindness can be told, all else counts as known alike
    with np.errstate(divide="ignore"):
        uncertainty = 1.0 / singular
    if not sensitivity.noise_known:
        uncertainty[:] = 0.1 * WEAK
    uncertainty[singular <= sensitivity.blind * singular[0]] = np.inf
    unseen = (uncertainty > sensitivity.unseen) | np.isinf(uncertainty)
    best = float(uncertainty.min())
    weak = ~unseen & ((uncertainty > WEAK_RATIO * best) | (uncertainty > WEAK))
    parts = vectors[~unseen] * uncertainty[~unseen, None] * sensitivity.tolerance
    covariance = np.asarray(parts.T @ parts)
    unidentifiable = vectors[unseen] * sensitivity.tolerance
    singular_visible = singular[~unseen]
    return Identifiability(
        names=sensitivity.names,
        rank=int((~unseen).sum()),
        row_count=len(scaled),
        singular_values=singular,
        condition_number=float(singular_visible[0] / singular_visible[-1])
        if len(singular_visible)
        else np.inf,
        weak=_named(vectors[weak] * sensitivity.tolerance, sensitivity, covariance),
        unseen=_named(unidentifiable, sensitivity, None),
        individually_known=names_outside(vectors[unseen].T, sensitivity.names),
        unseen_vectors=unidentifiable,
    )


def _named(
    vectors: FloatArray, sensitivity: Sensitivity, covariance: FloatArray | None
) -> tuple[Direction, ...]:
    """Short combinations that span ``vectors`` ``(r, k)``, with uncertainty and cost."""
    parts = []
    for combination, name in combinations(vectors, sensitivity):
        uncertainty = math.inf
        if covariance is not None:
            uncertainty = math.sqrt(max(float(combination @ covariance @ combination), 0.0))
        unit = combination / float(combination @ combination)
        cost = _cost(sensitivity, unit) * uncertainty
        against = _against(combination, sensitivity.names, covariance)
        parts.append(Direction(name, combination, uncertainty, cost, against))
    return tuple(parts)


def _against(
    combination: FloatArray, names: Sequence[str], covariance: FloatArray | None
) -> tuple[str, float] | None:
    """Two parameters with the second sign turned, and the standard uncertainty of that."""
    parts = np.flatnonzero(combination)
    if len(parts) != 2 or covariance is None:
        return None
    against = combination.copy()
    against[parts[1]] *= -1.0
    return _sum_of(against, names), math.sqrt(max(float(against @ covariance @ against), 0.0))


def _cost(sensitivity: Sensitivity, vector: FloatArray) -> float:
    """R.m.s. movement of the tool over the workspace for this change of the parameters."""
    if sensitivity.cost is None:
        return 0.0
    moved = sensitivity.cost @ vector
    return float(np.sqrt((moved**2).sum() / sensitivity.points))


def combinations(vectors: FloatArray, sensitivity: Sensitivity) -> list[tuple[FloatArray, str]]:
    """A basis of the space of ``vectors`` ``(r, k)`` in named motions and short sums.

    Motions that lie in the space come first; the rest is brought to echelon form, in which each
    combination has a parameter of its own, and small shares are left out of the name.
    """
    if not len(vectors):
        return []
    motions, basis = named_inside(np.linalg.qr(vectors.T)[0], sensitivity.motions)
    return motions + [_short(row, sensitivity) for row in _echelon(basis.T)]


def _short(row: FloatArray, sensitivity: Sensitivity) -> tuple[FloatArray, str]:
    """A combination and its name, both of the large shares unless all are wanted."""
    short = _clean(row)
    name = _sum_of(short, sensitivity.names)
    if not sensitivity.whole_shares:
        return short, name
    row_visible = np.where(np.abs(row) > sensitivity.blind, row, 0.0) * np.sign(row @ short)
    smaller = int(np.count_nonzero(row_visible) - np.count_nonzero(short))
    return row_visible, f"{name}, and smaller shares of {smaller} others" if smaller else name


def _echelon(rows: FloatArray) -> FloatArray:
    """Reduced echelon form of ``(r, k)`` with the largest pivots."""
    matrix = np.array(rows)
    pivots = np.zeros(matrix.shape[1], dtype=np.bool_)
    for k in range(len(matrix)):
        size = np.where(pivots, 0.0, np.abs(matrix[k:]))
        row, pivot = divmod(largest(size), matrix.shape[1])
        matrix[[k, k + row]] = matrix[[k + row, k]]
        pivots[pivot] = True
        matrix[k] /= matrix[k, pivot]
        other_rows = np.arange(len(matrix)) != k
        matrix[other_rows] -= np.outer(matrix[other_rows, pivot], matrix[k])
    return np.asarray(sorted(matrix, key=lambda row: int(np.flatnonzero(_clean(row))[0])))


def _clean(row: FloatArray) -> FloatArray:
    """Shares below a quarter of the largest dropped; those near ±1 made so; first one positive."""
    size = np.abs(row)
    large = np.where(size > SMALL_SHARE * size.max(), row, 0.0)
    large = np.where(np.abs(np.abs(large) - 1.0) < 0.1, np.sign(large), large)
    return np.asarray(large * np.sign(large[np.flatnonzero(large)[0]]))


def _sum_of(row: FloatArray, names: Sequence[str]) -> str:
    parts = [
        f"{'+' if value > 0 else '-'} {'' if abs(value) == 1.0 else f'{abs(value):.2f} '}{name}"
        for value, name in zip(row, names, strict=True)
        if value != 0.0
    ]
    return " ".join(parts).removeprefix("+ ")


def refuse_unseen(result: Identifiability, subject: str, next_step: str = "") -> None:
    """Raise NotIdentifiable where some combination of the parameters is not seen."""
    if result.unseen:
        blind = "; ".join(direction.combination for direction in result.unseen)
        raise NotIdentifiable(
            f"the set '{subject}' cannot be identified from these readings",
            f"{len(result.unseen)} of {len(result.names)} combinations not identifiable: {blind}",
            "every combination known better than its tolerance",
            next_step
            or "Choose another set with --subset, or a procedure that shows it: glidecal "
            "identifiability.",
        )


@dataclass(frozen=True)
class ClassicalQr:
    """Parameters whose diagonal entry of R is within the tolerance of zero.

    Which ones are flagged depends on the order of the columns, and neither noise nor size of the
    parameters has a say: `calib.design.identifiability` decides, this only compares.
    """

    tolerance: float
    flagged: tuple[str, ...]


def classical_qr(jacobian: FloatArray, names: Sequence[str]) -> ClassicalQr:
    """QR without pivoting of ``(m, k)``: ``|r_ii| <= k ε max|r_ii|`` is taken for zero.

    Parameters without a row of R of their own (fewer values than parameters) are flagged too.
    """
    diagonal = np.zeros(len(names))
    size = np.abs(np.linalg.qr(jacobian)[1].diagonal())
    diagonal[: len(size)] = size
    tolerance = len(names) * float(np.finfo(np.float64).eps) * float(diagonal.max(initial=0.0))
    flagged = tuple(name for name, r in zip(names, diagonal, strict=True) if r <= tolerance)
    return ClassicalQr(tolerance, flagged)


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

    posture: str
    standard_uncertainty_mm: float


class PlannedMachine(Protocol):
    """A machine with a procedure."""

    @property
    def name(self) -> str:
        """The name on the command line."""

    def examine(self) -> Examination:
        """What the procedure of the request sees."""

    def added(self, vectors: Sequence[FloatArray]) -> tuple[AddedMeasurement | None, ...]:
        """For each combination ``(k,)`` the best added posture; None where none is known."""


WHERE_SEEN = Quantity(words="null where lost")


@dataclass(frozen=True, eq=False)
class Combination:
    """A combination that is weak or unidentifiable, and what would help.

    Uncertainty and ``tool_mm`` are None where it is unidentifiable.
    """

    name: str
    combination: Annotated[dict[str, float], Quantity(words="shares of the parameters")]
    standard_uncertainty_mm: Annotated[float | None, WHERE_SEEN]
    tool_mm: Annotated[float | None, WHERE_SEEN]
    cure: AddedMeasurement | None


@dataclass(frozen=True, eq=False)
class SeenBy:
    """What a procedure can and cannot see, ready for words and documents."""

    machine: str
    examined: Examination
    identifiability: Identifiability
    unidentifiable: tuple[Combination, ...]
    weak: tuple[Combination, ...]
    qr: ClassicalQr

    @property
    def limited_by(self) -> Literal["nothing", "too-few-postures"]:
        """Too few values for the parameters, or nothing but the geometry."""
        reachable = self.examined.reachable_rank
        if reachable is not None:
            return "too-few-postures" if self.identifiability.rank < reachable else "nothing"
        few = self.examined.independent_count < len(self.identifiability.names)
        return "too-few-postures" if few else "nothing"


def seen_by(machine: PlannedMachine) -> SeenBy:
    """Rank, unidentifiable and weak combinations with what would help, and the classical test."""
    examined = machine.examine()
    names = examined.sensitivity.names
    analysis = analyse(examined.sensitivity)
    additions = machine.added(
        [direction.vector for direction in (*analysis.unseen, *analysis.weak)]
    )
    directions = tuple(
        Combination(
            name=direction.combination,
            combination={
                n: float(v) for n, v in zip(names, direction.vector, strict=True) if v != 0.0
            },
            standard_uncertainty_mm=_finite(direction.standard_uncertainty_mm),
            tool_mm=_finite(direction.tool_mm),
            cure=added,
        )
        for direction, added in zip((*analysis.unseen, *analysis.weak), additions, strict=True)
    )
    first_weak = len(analysis.unseen)
    return SeenBy(
        machine=machine.name,
        examined=examined,
        identifiability=analysis,
        unidentifiable=directions[:first_weak],
        weak=directions[first_weak:],
        qr=classical_qr(examined.bare, names),
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
