"""What a Hexa Slide's procedure sees, how few postures do, and the postures that show most."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.clusters import in_parallel
from calib.design.criteria import Aim, Criterion, Observability, observability
from calib.design.identifiability import Identifiability, Sensitivity, analyse
from calib.design.refinement import Pull, RefinedPostures, count_on_bound, judged, refine
from calib.errors import NotIdentifiable
from calib.hexaslide.geometry import Box, HexaSlide, motions, unit_of
from calib.hexaslide.gradients import RowMaker
from calib.hexaslide.procedures import Procedure, held_postures, jacobian
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
        units=tuple(unit_of(name) for name in names),
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
    while low < high:
        middle = (low + high) // 2
        rank = rank_of(full[: middle * each], EXACT_BLIND)
        low, high = (low, middle) if rank == wanted else (middle + 1, high)
    return low


@dataclass(frozen=True, eq=False)
class BestPostures:
    """The best of several searches; with ``values`` empty, postures that were only judged.

    ``values`` holds the criterion that each start came to, in their order; ``rank`` combinations
    of the parameters are seen, all figures are of those. ``start`` and ``found`` are those of
    papers/001 before and after.
    """

    refined: RefinedPostures
    criterion: Criterion
    start: Observability
    found: Observability
    start_on_bound: int
    values: tuple[float, ...]
    rank: int

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
    _refuse_few(procedure, machine, count)
    rows_at, box, aim = rows_seen(procedure, machine), machine.box, Aim(criterion)
    generator = np.random.default_rng(seed)
    begins = [box.random(count, generator) for _ in range(starts)]
    begins[:1] = begins[:1] if given is None else [given]

    def watched(postures: FloatArray) -> tuple[FloatArray, Pull]:
        watch()
        return rows_at(postures)

    def refined(begin: FloatArray) -> RefinedPostures:
        return refine(watched, begin, box.lower, box.upper, aim, sharpness=SHARPNESS)

    found = list(in_parallel(refined, begins))
    sign = 1.0 if criterion.larger_is_better else -1.0
    best = max(range(starts), key=lambda k: sign * found[k].value)
    return _described(rows_at, box, criterion, begins[best], found[best], [f.value for f in found])


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
    kept = RefinedPostures(postures, value, value, count_on_bound(postures, box.lower, box.upper))
    return _described(rows_at, box, criterion, postures, kept, [])


def _refuse_few(procedure: Procedure, machine: HexaSlide, count: int) -> None:
    fewest = fewest_postures(procedure, machine)
    if count < fewest:
        raise NotIdentifiable(
            "number of postures", f"{count}", f"{fewest} or more for {procedure.kind.value}"
        )


def rows_seen(procedure: Procedure, machine: HexaSlide) -> RowMaker:
    """Rows of the combinations that the procedure can see at all."""
    seen = _seen_basis(reachable(procedure, machine))
    return RowMaker(procedure, machine.geometry, machine.link, seen)


def _described(
    rows_at: RowMaker,
    box: Box,
    criterion: Criterion,
    begin: FloatArray,
    refined: RefinedPostures,
    values: Sequence[float],
) -> BestPostures:
    def figures(postures: FloatArray) -> Observability:
        rows = rows_at(postures)[0]
        singular = np.linalg.svd(rows.reshape(-1, rows.shape[-1]), compute_uv=False)
        return observability(np.asarray(singular, dtype=np.float64), len(postures))

    return BestPostures(
        refined=refined,
        criterion=criterion,
        start=figures(begin),
        found=figures(refined.coordinates),
        start_on_bound=count_on_bound(begin, box.lower, box.upper),
        values=tuple(values),
        rank=rows_at.width,
    )


def _seen_basis(found: Identifiability) -> FloatArray:
    """Orthonormal basis ``(k, rank)`` of the combinations that are seen.

    What is lost with postures enough is a motion of a frame, the same at every posture.
    """
    return null_space(found.unseen_vectors.reshape(-1, len(found.names)))
