"""How few postures of a Hexa Slide show all that a procedure can see, and which show most."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import (
    BLIND,
    EXACT_BLIND,
    FloatArray,
    basis_of,
    condition,
    null_space,
    rank_of,
    without,
)
from calib.clusters import in_parallel
from calib.design.criteria import Aim, Criterion, Observability, observability
from calib.design.identifiability import (
    AddedMeasurement,
    ClassicalQr,
    Combination,
    Examination,
    Identifiability,
    SeenBy,
    Sensitivity,
    analyse,
    classical_qr,
    seen_by,
)
from calib.design.refinement import Pull, RefinedPostures, count_on_bound, judged, refine
from calib.errors import CalibrationError, NotIdentifiable
from calib.hexaslide.derivatives import RowMaker, jacobian
from calib.hexaslide.geometry import COORDINATES, HexaSlide, forward_near, inverse, motions, present
from calib.hexaslide.procedures import (
    ALL_UNITS,
    COMPONENTS,
    Kind,
    Procedure,
    held_postures,
    in_units,
)
from calib.hexaslide.residuals import stretch

PLENTY = 100
"""So many random postures reach the rank that the procedure can reach; twice for one row each."""

SHARPNESS = (8.0, 32.0, 128.0, 512.0, 2048.0)
"""Criteria of single singular values are made smooth, less and less."""


def sensitivity(procedure: Procedure, machine: HexaSlide, postures: FloatArray) -> Sensitivity:
    """Bare derivatives at postures ``(p, 6)``: no noise is known, metres and radians."""
    rows = jacobian(procedure, machine.geometry, postures, machine.link)
    names = procedure.parameters
    return Sensitivity(
        names=names,
        jacobian=rows.reshape(-1, len(names)),
        tolerance=np.ones(len(names)),
        motions=motions(machine.geometry, machine.link, names),
        noise_known=False,
        blind=EXACT_BLIND,
    )


def enough_postures(procedure: Procedure, machine: HexaSlide, seed: int = 0) -> FloatArray:
    """Random postures ``(p, 6)`` that reach the rank of the procedure."""
    count = PLENTY * (2 if len(procedure.read) == 1 else 1)
    return held_postures(machine.geometry, machine.box, count, seed)


def reachable(procedure: Procedure, machine: HexaSlide) -> Identifiability:
    """What the procedure sees with postures enough."""
    return analyse(sensitivity(procedure, machine, enough_postures(procedure, machine)))


def fewest_postures(procedure: Procedure, machine: HexaSlide) -> int:
    """How many random postures are needed to see what the procedure can see at all."""
    full = sensitivity(procedure, machine, enough_postures(procedure, machine)).jacobian
    each, wanted = len(procedure.read), rank_of(full, EXACT_BLIND)
    low, high = 1, len(full) // each
    # another posture never lowers the rank: halving finds the first that is enough
    while low < high:
        middle = (low + high) // 2
        rank = rank_of(full[: middle * each], EXACT_BLIND)
        low, high = (low, middle) if rank == wanted else (middle + 1, high)
    return low


@dataclass(frozen=True, eq=False)
class BestPostures:
    """The best of several searches; with ``values`` empty, postures that were only judged.

    ``values`` holds the criterion that each start came to, in their order; ``rank`` combinations
    of the parameters are seen, all figures are of those. ``begin`` ``(p, 6)`` is where the best
    search began, ``start`` and ``found`` are the criteria of papers/001 before and after,
    ``seconds`` are those of all searches, ``source`` tells where the first start came from.
    """

    procedure: Procedure
    criterion: Criterion
    begin: FloatArray
    refined: RefinedPostures
    start: Observability
    found: Observability
    start_on_bound: int
    values: tuple[float, ...]
    rank: int
    seed: int = 0
    seconds: float = 0.0
    source: str = "random"

    @property
    def coordinates(self) -> FloatArray:
        """The best postures ``(p, 6)``."""
        return self.refined.coordinates

    @property
    def postures(self) -> tuple[dict[str, float], ...]:
        """The same by the names of the coordinates, in metres and degrees."""
        rows = np.hstack([self.coordinates[:, :3], np.degrees(self.coordinates[:, 3:])])
        return tuple(dict(zip(COORDINATES, row, strict=True)) for row in rows.tolist())

    @property
    def start_condition_number(self) -> float:
        """At the start that came to be the best."""
        return self.start.condition_number

    @property
    def condition_number(self) -> float:
        """Of the postures found."""
        return self.found.condition_number


def best_postures(
    procedure: Procedure,
    machine: HexaSlide,
    count: int,
    criterion: Criterion = Criterion.CONDITION,
    *,
    seed: int = 0,
    starts: int = 8,
    given: FloatArray | None = None,
    watch: Callable[[], object] = lambda: None,
) -> BestPostures:
    """Postures moved in the box from random starts; what the procedure never sees is left out.

    ``given`` ``(count, 6)`` takes the place of the first start. ``watch`` is called before every
    step and ends the search by what it raises. Raises NotIdentifiable for fewer
    postures than the procedure needs, or a start that does not show enough.
    """
    began = time.perf_counter()
    _refuse_few(procedure, machine, count)
    rows_at, box, aim = rows_seen(procedure, machine), machine.box, Aim(criterion)
    generator = np.random.default_rng(seed)
    begins = [box.random(count, generator) for _ in range(starts)]
    # drawn all the same, so that the other starts are those of the seed
    begins[:1] = begins[:1] if given is None else [given]

    def watched(postures: FloatArray) -> tuple[FloatArray, Pull]:
        watch()
        return rows_at(postures)

    def refined(begin: FloatArray) -> RefinedPostures:
        return refine(watched, begin, box.lower, box.upper, aim, sharpness=SHARPNESS)

    found = list(in_parallel(refined, begins))
    sign = 1.0 if criterion.larger_is_better else -1.0
    best = max(range(starts), key=lambda k: sign * found[k].value)
    values = tuple(one.value for one in found)
    described = _described(rows_at, machine, criterion, begins[best], found[best], values)
    return replace(described, seed=seed, seconds=time.perf_counter() - began)


def judged_postures(
    procedure: Procedure,
    machine: HexaSlide,
    postures: FloatArray,
    criterion: Criterion = Criterion.CONDITION,
) -> BestPostures:
    """Postures ``(p, 6)`` as they are, in the box or not.

    Raises NotIdentifiable where they do not show all that the procedure can show, and
    UnreachablePosture.
    """
    _refuse_few(procedure, machine, len(postures))
    rows_at, box = rows_seen(procedure, machine), machine.box
    value = judged(rows_at(postures)[0], Aim(criterion))
    as_is = RefinedPostures(postures, value, value, count_on_bound(postures, box.lower, box.upper))
    return _described(rows_at, machine, criterion, postures, as_is, ())


def _refuse_few(procedure: Procedure, machine: HexaSlide, count: int) -> None:
    fewest = fewest_postures(procedure, machine)
    if count < fewest:
        raise NotIdentifiable(
            "number of postures", f"{count}", f"{fewest} or more for {procedure.kind.value}"
        )


def rows_seen(procedure: Procedure, machine: HexaSlide) -> RowMaker:
    """Rows of the combinations that the procedure can see at all.

    What is unidentifiable with postures enough is a motion of a frame, the same at every posture.
    """
    found = reachable(procedure, machine)
    seen = null_space(found.unseen_vectors.reshape(-1, len(found.names)))
    return RowMaker(procedure, machine.geometry, machine.link, seen)


def _described(
    rows_at: RowMaker,
    machine: HexaSlide,
    criterion: Criterion,
    begin: FloatArray,
    refined: RefinedPostures,
    values: tuple[float, ...],
) -> BestPostures:
    def figures(postures: FloatArray) -> Observability:
        rows = rows_at(postures)[0]
        singular = np.linalg.svd(rows.reshape(-1, rows.shape[-1]), compute_uv=False)
        return observability(np.asarray(singular, dtype=np.float64), len(postures))

    return BestPostures(
        procedure=rows_at.procedure,
        criterion=criterion,
        begin=begin,
        refined=refined,
        start=figures(begin),
        found=figures(refined.coordinates),
        start_on_bound=count_on_bound(begin, machine.box.lower, machine.box.upper),
        values=values,
        rank=rows_at.width,
    )


@dataclass(frozen=True)
class Found:
    """Searches so far: how many of the starts are done, and the best of them."""

    done: int
    starts: int
    best: BestPostures


class _NotWanted(Exception):
    """The search was left."""


def find_postures(
    procedure: Procedure,
    machine: HexaSlide,
    count: int,
    *,
    seed: int,
    starts: int,
    heard: Callable[[Found], None],
    going_on: Callable[[], bool],
) -> None:
    """Search from one start after the other, tell after each; end soon when not ``going_on``.

    Raises CalibrationError as `best_postures`.
    """

    def watch() -> None:
        if not going_on():
            raise _NotWanted

    best: BestPostures | None = None
    for k in range(starts):
        try:
            watch()
            found = best_postures(procedure, machine, count, seed=seed + k, starts=1, watch=watch)
        except _NotWanted:
            return
        if best is None or found.condition_number < best.condition_number:
            best = found
        heard(Found(k + 1, starts, best))


KINDS = tuple(Kind)
"""In the order of the cases of papers/001."""

UNITS = "metres and radians, columns not scaled"

PUBLISHED = {
    Kind.POSE_INVERSE: 49,
    Kind.POSE_FORWARD: 49,
    Kind.POSITION: 48,
    Kind.CONSTRAINT_LINK: 46,
}
"""Ranks that papers/001, table 1, states."""

WRONG = {
    Kind.POSITION: "papers/001 counts 48; with exact derivatives it is 46: turning the frame of "
    "the platform about its origin changes no position. 48 is also its number of rows, 16 × 3.",
    Kind.CONSTRAINT_LINK: "papers/001 counts 46; with exact derivatives it is 48: only motions "
    "of whole frames are lost, six of the platform, one of the base. 46 is also its row count.",
}


@dataclass(frozen=True)
class PublishedSet:
    """Condition numbers of one table of papers/001."""

    case: str
    table: int
    count: int
    random: float
    best: float


PUBLISHED_SETS = {
    Kind.POSE_INVERSE: PublishedSet("I", 3, 9, 2888.0, 140.2),
    Kind.POSE_FORWARD: PublishedSet("II", 4, 9, 21530.0, 1537.3),
    Kind.POSITION: PublishedSet("III", 5, 16, 33916.0, 2430.2),
    Kind.CONSTRAINT_LINK: PublishedSet("IV", 6, 46, 6.012e5, 1.4523e5),
}


@dataclass(frozen=True, eq=False)
class HexaSlidePlanning:
    """A machine with a procedure, at postures ``given`` ``(p, 6)`` from somewhere, else at random
    ones: ``count`` of them, None: enough.
    """

    procedure: Procedure
    machine: HexaSlide
    seed: int = 0
    count: int | None = None
    given: FloatArray | None = None
    source: str = ""

    @property
    def name(self) -> str:
        """The name on the command line."""
        return "hexaslide"

    @property
    def usual(self) -> bool:
        """Whether the procedure is one of papers/001."""
        return self.procedure == Procedure.of(self.procedure.kind.value)

    def examine(self) -> Examination:
        """What the procedure sees at the postures."""
        postures = self.postures()
        # nothing is left out of what is told to be lost
        seen = replace(sensitivity(self.procedure, self.machine, postures), whole_shares=True)
        kind = self.procedure.kind
        return Examination(
            procedure=kind.value,
            sensitivity=seen,
            bare=seen.jacobian,
            measured=self.procedure.read,
            posture_count=len(postures),
            independent_count=len(seen.jacobian),
            minutes=0.0,
            units=UNITS,
            noise_words="not known, it decides nothing here",
            source=self.source or f"random in the box, seed {self.seed}",
            fewest_postures=fewest_postures(self.procedure, self.machine),
            reachable_rank=reachable(self.procedure, self.machine).rank,
            published_rank=PUBLISHED[kind] if self.usual else None,
            remark=WRONG.get(kind, "") if self.usual else "",
        )

    def postures(self) -> FloatArray:
        """Those given, else random ones in the box ``(p, 6)``."""
        if self.given is not None:
            return self.given
        if self.count is None:
            return enough_postures(self.procedure, self.machine, self.seed)
        return held_postures(self.machine.geometry, self.machine.box, self.count, self.seed)

    def cures(self, vectors: Sequence[FloatArray]) -> tuple[AddedMeasurement | None, ...]:
        """None: what is lost is lost at every posture."""
        return (None,) * len(vectors)


def conditions_by_units(procedure: Procedure, rows: FloatArray, rank: int) -> dict[str, float]:
    """Condition number of what is seen in each unit, from rows ``(n, k)``, metres and radians."""
    return {units.words: condition(in_units(procedure, rows, units), rank) for units in ALL_UNITS}


def conditions_at(view: HexaSlideSeen, postures: FloatArray) -> dict[str, float]:
    """The same at postures ``(p, 6)``."""
    rows = sensitivity(view.procedure, view.machine, postures).jacobian
    return conditions_by_units(view.procedure, rows, view.seen.found.rank)


@dataclass(frozen=True, eq=False)
class PaperRule:
    """The test of papers/001 on derivatives by forward differences, as the paper took them.

    ``rank`` is what these postures show, ``reachable_rank`` what others show. ``errors`` are the
    least and the largest singular value of what is not seen, in tolerances of the rule: differences
    feign them. None where no row is left for them.
    """

    posture_count: int
    row_count: int
    parameter_count: int
    rank: int
    reachable_rank: int
    qr: ClassicalQr
    errors: tuple[float, float] | None

    @property
    def counted(self) -> int:
        """How many parameters the rule takes for identifiable."""
        return self.parameter_count - len(self.qr.flagged)

    @property
    def decided_by(self) -> str:
        """Whose number the rule gives: rows, parameters, postures, or rightly the geometry."""
        if self.counted == self.reachable_rank:
            return "geometry"
        if self.counted == self.parameter_count:
            return "parameters"
        return "rows" if self.counted == self.row_count else "postures"


@dataclass(frozen=True, eq=False)
class HexaSlideSeen:
    """What a procedure sees on a machine, with the figures that a judgement of papers/001 needs.

    ``conditions`` are condition numbers of what is seen at the postures, by units.
    """

    planned: HexaSlidePlanning
    seen: SeenBy
    conditions: dict[str, float]

    @property
    def procedure(self) -> Procedure:
        """What is read."""
        return self.planned.procedure

    @property
    def machine(self) -> HexaSlide:
        """The nominal one."""
        return self.planned.machine

    @property
    def fewest(self) -> int:
        """How few postures show all that the procedure can show."""
        return self.seen.examined.fewest_postures or 1

    @property
    def published(self) -> PublishedSet | None:
        """The paper's figures, for its own procedures only."""
        return PUBLISHED_SETS[self.procedure.kind] if self.planned.usual else None

    @cached_property
    def always(self) -> tuple[str, ...]:
        """Names of the combinations that no posture shows."""
        all_seen = reachable(self.procedure, self.machine)
        never = basis_of(all_seen.unseen_vectors.T, EXACT_BLIND)
        names = self.seen.found.names
        return tuple(one.name for one in self.seen.unidentifiable if _lies_in(never, one, names))

    @cached_property
    def rules(self) -> tuple[PaperRule, ...]:
        """The paper's rule at these postures and, for its own procedures, at as many as it has,
        where they could be taken.
        """
        procedure, postures = self.procedure, self.planned.postures()
        all_seen = reachable(procedure, self.machine).rank
        sets = [(postures, self.seen.found.rank)]
        few = PUBLISHED_SETS[procedure.kind].count
        if self.planned.usual and len(postures) > few:
            some = postures[:few]
            sets.append((some, analyse(sensitivity(procedure, self.machine, some)).rank))
        found = []
        for some, rank in sets:
            with suppress(CalibrationError):  # a step leaves the workspace: nothing to show
                rows = differenced(procedure, self.machine, some)
                found.append(_rule(rows, procedure.parameters, rank, all_seen))
        return tuple(found)


def look_at(planned: HexaSlidePlanning) -> HexaSlideSeen:
    """Raises CalibrationError for postures that cannot be."""
    seen = seen_by(planned)
    conditions = conditions_by_units(planned.procedure, seen.examined.bare, seen.found.rank)
    return HexaSlideSeen(planned, seen, conditions)


def _lies_in(space: FloatArray, one: Combination, names: tuple[str, ...]) -> bool:
    vector = np.array([one.shares.get(name, 0.0) for name in names])
    return bool(np.linalg.norm(without(space, vector)) < BLIND)


DIFFERENCE_STEP = 1e-7
"""The paper's step, metres."""


def differenced(procedure: Procedure, machine: HexaSlide, postures: FloatArray) -> FloatArray:
    """Derivatives ``(p, r, k)`` as `derivatives.jacobian`, each wrong by about 1e-7.

    Raises CalibrationError where a step leaves what can be reached, or without a link to read.
    """
    names, kind = procedure.parameters, procedure.kind
    if kind is Kind.CONSTRAINT_LINK:
        present(machine.link)
    sliders, start = inverse(machine.geometry, postures), machine.parameters(names)

    def read(parameters: FloatArray) -> FloatArray:
        changed = machine.with_parameters(names, parameters)
        if kind is Kind.POSE_INVERSE:
            return np.asarray(inverse(changed.geometry, postures))
        moved = forward_near(changed.geometry, sliders, postures)
        if kind is Kind.CONSTRAINT_LINK:
            return -stretch(changed.link, moved)[:, None]
        return np.asarray(moved[:, [COMPONENTS.index(name) for name in procedure.measured]])

    before = read(start)
    steps = DIFFERENCE_STEP * np.eye(len(start))
    return np.stack([(read(start + step) - before) / DIFFERENCE_STEP for step in steps], axis=-1)


def _rule(rows: FloatArray, names: tuple[str, ...], rank: int, all_seen: int) -> PaperRule:
    """The rule on derivatives ``(p, r, k)`` of which ``rank`` combinations are truly seen."""
    flat = rows.reshape(-1, len(names))
    qr = classical_qr(flat, names)
    feigned = np.linalg.svd(flat, compute_uv=False)[rank:] / qr.tolerance
    errors = (float(feigned.min()), float(feigned.max())) if len(feigned) else None
    return PaperRule(len(rows), len(flat), len(names), rank, all_seen, qr, errors)
