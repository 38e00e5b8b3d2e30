"""What the page on the Hexa Slide tells of each procedure: computed once, shown in many tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.hexaslide_views import KINDS, PUBLISHED_SETS, View, conditions_by_units, look_at
from app.planning import Request
from app.planning_hexaslide import BoxedPostures, boxed_postures
from calib.criteria import Criterion
from calib.hexaslide.procedures import Kind
from calib.hexaslide_planning import sensitivity
from calib.observations import FloatArray
from protocols.hexaslide_machine import load_hexaslide

SEED = 0

MORE_POSTURES = {
    Kind.POSE_INVERSE: (10, 12, 16, 24, 48),
    Kind.POSE_FORWARD: (10, 12, 16, 24, 48),
    Kind.POSITION: (17, 20, 24, 32, 64),
    Kind.CONSTRAINT_LINK: (50, 55, 64, 96),
}


@dataclass(frozen=True)
class Effort:
    """How much is computed."""

    random_sets: int
    starts: int
    more_starts: int


FULL = Effort(random_sets=400, starts=20, more_starts=2)
QUICK = Effort(random_sets=8, starts=1, more_starts=0)


@dataclass(frozen=True, eq=False)
class Studied:
    """One procedure: what it sees, random sets ``(n,)`` in each unit, the best set."""

    view: View
    random: dict[str, FloatArray]
    random_of_paper: FloatArray
    best: BoxedPostures
    more: dict[int, float]

    @property
    def kind(self) -> Kind:
        """Which procedure."""
        return self.view.procedure.kind

    @property
    def postures(self) -> FloatArray:
        """The best postures ``(p, 6)``."""
        return self.best.best.refined.coordinates


def kinds_of(asked: Request) -> tuple[Kind, ...]:
    """The procedures that this machine allows: without a link none that uses it."""
    linked = load_hexaslide(asked.machine_file).link() is not None
    return tuple(kind for kind in KINDS if linked or kind is not Kind.CONSTRAINT_LINK)


def study(request: Request, effort: Effort) -> Studied:
    """Everything that the page tells of a procedure."""
    view = look_at(request)
    kind = view.procedure.kind
    random = random_conditions(view, view.fewest, effort.random_sets)
    paper = PUBLISHED_SETS[kind].count
    same = random if paper == view.fewest else random_conditions(view, paper, effort.random_sets)
    best = searched(view, view.fewest, effort.starts)
    more = {
        count: searched(view, count, effort.more_starts).best.condition_number
        for count in (MORE_POSTURES[kind] if effort.more_starts else ())
    }
    return Studied(view, random, same["m, rad"], best, more)


def searched(view: View, count: int, starts: int) -> BoxedPostures:
    """As ``glidecal postures hexaslide --criterion condition``."""
    return boxed_postures(view.request, count, Criterion.CONDITION, seed=SEED, starts=starts)


def random_conditions(view: View, count: int, sets: int) -> dict[str, FloatArray]:
    """Condition numbers ``(sets,)`` in each unit, of what so many random postures see."""
    generator = np.random.default_rng(SEED)
    found = []
    for _ in range(sets):
        postures = view.machine.box.random(count, generator)
        rows = sensitivity(view.procedure, view.machine, postures).jacobian
        rank = min(view.seen.found.rank, len(rows))
        found.append(conditions_by_units(view.procedure, rows, rank))
    return {units: np.array([one[units] for one in found]) for units in found[0]}
