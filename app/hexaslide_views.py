"""What a Hexa Slide's procedure sees and the search for postures, as data for screens and pages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from app.planning import Request, SeenBy, seen_by
from app.planning_hexaslide import BoxedPostures, HexaSlidePlanning, boxed_postures
from calib.criteria import Criterion
from calib.hexaslide.geometry import Box
from calib.hexaslide.procedures import Kind, Procedure
from calib.hexaslide.scaling import ALL_UNITS, in_units
from calib.hexaslide_planning import HexaSlide, sensitivity
from calib.linalg import condition
from calib.observations import FloatArray

KINDS = tuple(Kind)
"""In the order of the cases of papers/001."""


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
class View:
    """A procedure on a machine; ``conditions`` of the random postures by their units."""

    request: Request
    procedure: Procedure
    machine: HexaSlide
    seen: SeenBy
    conditions: dict[str, float]

    @property
    def fewest(self) -> int:
        """How few postures show all that the procedure can show."""
        return self.seen.examined.fewest_postures or 1

    @property
    def published(self) -> PublishedSet | None:
        """The paper's figures, for its own procedures only."""
        usual = self.procedure == Procedure.of(self.procedure.kind.value)
        return PUBLISHED_SETS[self.procedure.kind] if usual else None


def look_at(request: Request) -> View:
    """What ``glidecal identifiability hexaslide`` finds. Raises UsageError, RecordError."""
    planned = HexaSlidePlanning.of(request)
    seen = seen_by("hexaslide", request)
    rows = seen.examined.sensitivity.jacobian
    conditions = conditions_by_units(planned.procedure, rows, seen.found.rank)
    return View(request, planned.procedure, planned.machine, seen, conditions)


def conditions_by_units(procedure: Procedure, rows: FloatArray, rank: int) -> dict[str, float]:
    """Condition number of what is seen in each unit, from rows ``(n, k)``, metres and radians."""
    return {units.words: condition(in_units(procedure, rows, units), rank) for units in ALL_UNITS}


def conditions_at(view: View, postures: FloatArray) -> dict[str, float]:
    """The same at postures ``(p, 6)``."""
    rows = sensitivity(view.procedure, view.machine, postures).jacobian
    return conditions_by_units(view.procedure, rows, view.seen.found.rank)


@dataclass(frozen=True, eq=False)
class Found:
    """Searches so far: how many are done, and the best of them with where it began ``(p, 6)``."""

    done: int
    starts: int
    begin: FloatArray
    best: BoxedPostures

    @property
    def postures(self) -> FloatArray:
        """The best postures ``(p, 6)``."""
        return self.best.best.refined.coordinates


def find_postures(
    view: View,
    count: int,
    *,
    starts: int,
    heard: Callable[[Found], None],
    going_on: Callable[[], bool],
) -> None:
    """Search from one start after the other, tell after each; end soon when not ``going_on``.

    Raises UsageError, RecordError, NotIdentifiable as ``glidecal postures hexaslide`` does.
    """

    def watch() -> None:
        if not going_on():
            raise _NotWanted

    found: Found | None = None
    for k in range(starts):
        seed = view.request.seed + k
        try:
            best = _one_start(view, count, seed, watch)
        except _NotWanted:
            return
        if found is None or best.best.condition_number < found.best.best.condition_number:
            found = Found(k + 1, starts, begin_of(view.machine.box, count, seed), best)
        found = replace(found, done=k + 1)
        heard(found)


class _NotWanted(Exception):
    """The search was left."""


def _one_start(view: View, count: int, seed: int, watch: Callable[[], object]) -> BoxedPostures:
    watch()
    return boxed_postures(
        view.request, count, Criterion.CONDITION, seed=seed, starts=1, watch=watch
    )


def begin_of(box: Box, count: int, seed: int) -> FloatArray:
    """The postures ``(count, 6)`` at which the search of one start with this seed begins."""
    return box.random(count, np.random.default_rng(seed))
