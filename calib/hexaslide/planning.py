"""How few postures of a Hexa Slide show all that a procedure can see, and which show most."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.clusters import in_parallel
from calib.design.criteria import Aim, Criterion, Observability, observability
from calib.design.identifiability import Identifiability, Sensitivity, analyse
from calib.design.refinement import Pull, RefinedPostures, count_on_bound, judged, refine
from calib.errors import NotIdentifiable
from calib.hexaslide.derivatives import RowMaker, jacobian
from calib.hexaslide.geometry import COORDINATES, HexaSlide, motions
from calib.hexaslide.procedures import Procedure, held_postures
from calib.linalg import EXACT_BLIND, null_space, rank_of
from calib.observations import FloatArray

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
