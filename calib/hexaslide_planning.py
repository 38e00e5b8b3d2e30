"""What a Hexa Slide's procedure sees, how few postures do, and the postures that show most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.criteria import Aim, Criterion
from calib.errors import NotIdentifiable
from calib.hexaslide.geometry import Box, ConstraintLink, Geometry
from calib.hexaslide.parameters import motions, unit_of
from calib.hexaslide.procedures import Procedure, jacobian, jacobian_and_slopes
from calib.identifiability import Identifiability, Sensitivity, analyse
from calib.observations import FloatArray
from calib.posture_refinement import Refined, refine

EXACT_BLIND = 1e-10
"""Relative singular value below which exact derivatives show nothing; gaps found are 1e9."""

PLENTY = 100
"""So many random postures reach the rank that the procedure can reach; twice for one row each."""

SHARPNESS = (8.0, 32.0, 128.0, 512.0)
"""The condition number is made smooth less and less."""


@dataclass(frozen=True, eq=False)
class HexaSlide:
    """A machine with the box of its postures."""

    geometry: Geometry
    box: Box
    link: ConstraintLink | None = None


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
    return machine.box.random(count, np.random.default_rng(seed))


def reachable(procedure: Procedure, machine: HexaSlide) -> Identifiability:
    """What the procedure sees with postures enough."""
    return analyse(sensitivity(procedure, machine, enough_postures(procedure, machine)))


def fewest_postures(procedure: Procedure, machine: HexaSlide) -> int:
    """How many random postures are needed to see what the procedure can see at all."""
    full = sensitivity(procedure, machine, enough_postures(procedure, machine)).jacobian
    each, wanted = len(procedure.read), _rank(full)
    low, high = 1, len(full) // each
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if _rank(full[: middle * each]) == wanted else (middle + 1, high)
    return low


def _rank(rows: FloatArray) -> int:
    singular = np.linalg.svd(rows, compute_uv=False)
    return int((singular > EXACT_BLIND * singular[0]).sum())


@dataclass(frozen=True, eq=False)
class BestPostures:
    """The best of several searches, with the condition number before and after it.

    ``values`` holds the criterion that each start came to, in their order; ``rank`` of ``count``
    parameters are seen, all figures are of those.
    """

    refined: Refined
    criterion: Criterion
    start_condition_number: float
    condition_number: float
    values: tuple[float, ...]
    rank: int


def best_postures(
    procedure: Procedure,
    machine: HexaSlide,
    count: int,
    criterion: Criterion = Criterion.CONDITION,
    *,
    seed: int = 0,
    starts: int = 8,
) -> BestPostures:
    """Postures moved in the box from random starts; what the procedure never sees is left out.

    Raises NotIdentifiable for fewer postures than the procedure needs.
    """
    fewest = fewest_postures(procedure, machine)
    if count < fewest:
        raise NotIdentifiable(
            "number of postures", f"{count}", f"{fewest} or more for {procedure.kind.value}"
        )
    seen = _seen_basis(reachable(procedure, machine))
    aim = Aim(criterion)

    def rows_at(postures: FloatArray) -> tuple[FloatArray, FloatArray]:
        rows, slopes = jacobian_and_slopes(procedure, machine.geometry, postures, machine.link)
        return rows @ seen, np.einsum("prkd,kn->prnd", slopes, seen, optimize=True)

    def condition(postures: FloatArray) -> float:
        rows = rows_at(postures)[0].reshape(-1, seen.shape[1])
        return float(np.linalg.cond(rows))

    generator, box = np.random.default_rng(seed), machine.box
    begins = [box.random(count, generator) for _ in range(starts)]
    found = [
        refine(rows_at, begin, box.lower, box.upper, aim, sharpness=SHARPNESS) for begin in begins
    ]
    sign = 1.0 if criterion.larger_is_better else -1.0
    best = max(range(starts), key=lambda k: sign * found[k].value)
    return BestPostures(
        refined=found[best],
        criterion=criterion,
        start_condition_number=condition(begins[best]),
        condition_number=condition(found[best].coordinates),
        values=tuple(one.value for one in found),
        rank=seen.shape[1],
    )


def _seen_basis(found: Identifiability) -> FloatArray:
    """Orthonormal basis ``(k, rank)`` of the combinations that are seen.

    What is lost with postures enough is a motion of a frame, the same at every posture.
    """
    count = len(found.names)
    lost = found.unseen_vectors.reshape(-1, count)
    return np.asarray(np.linalg.qr(lost.T, mode="complete")[0][:, len(lost) :])
