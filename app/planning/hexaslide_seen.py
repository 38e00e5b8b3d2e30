"""What ``glidecal identifiability hexaslide`` tells beyond what all machines do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from app.planning.hexaslide import BoxedPostures, HexaSlidePlanning, boxed_postures
from app.planning.machines import Combination, Request, SeenBy, seen_by
from calib.design.criteria import Criterion
from calib.design.identifiability import ClassicalQr, analyse, classical_qr
from calib.errors import CalibrationError
from calib.hexaslide.geometry import Box
from calib.hexaslide.planning import HexaSlide, reachable, sensitivity
from calib.hexaslide.procedures import ALL_UNITS, Kind, Procedure, differenced, in_units
from calib.linalg import BLIND, EXACT_BLIND, basis_of, condition, without
from calib.observations import FloatArray

PUBLISHED_COUNTS = {
    Kind.POSE_INVERSE: 9,
    Kind.POSE_FORWARD: 9,
    Kind.POSITION: 16,
    Kind.CONSTRAINT_LINK: 46,
}
"""Numbers of postures in papers/001, tables 3 to 6."""


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
    """What a procedure sees, with the figures that a judgement of papers/001 needs.

    ``always`` are names of combinations that no posture shows; ``conditions`` the condition number
    of what is seen in each unit; ``rules`` the paper's rule at these postures, then at as many as
    the paper has, where they could be taken.
    """

    seen: SeenBy
    always: tuple[str, ...]
    conditions: dict[str, float]
    rules: tuple[PaperRule, ...]


def hexaslide_seen(request: Request) -> HexaSlideSeen:
    """Raises UsageError, RecordError, and CalibrationError for postures that cannot be."""
    seen = seen_by("hexaslide", request)
    planned = HexaSlidePlanning.of(request)
    all_seen = reachable(planned.procedure, planned.machine)
    never = basis_of(all_seen.unseen_vectors.T, EXACT_BLIND)
    rows = seen.examined.bare
    conditions = {
        units.words: condition(in_units(planned.procedure, rows, units), seen.found.rank)
        for units in ALL_UNITS
    }
    always = tuple(one.name for one in seen.lost if _lies_in(never, one, seen.found.names))
    return HexaSlideSeen(seen, always, conditions, _rules(planned, seen.found.rank, all_seen.rank))


def _lies_in(space: FloatArray, one: Combination, names: tuple[str, ...]) -> bool:
    vector = np.array([one.shares.get(name, 0.0) for name in names])
    return bool(np.linalg.norm(without(space, vector)) < BLIND)


def _rules(planned: HexaSlidePlanning, rank: int, all_seen: int) -> tuple[PaperRule, ...]:
    """At the postures asked for and, for the paper's own procedures, at the paper's number."""
    procedure, machine = planned.procedure, planned.machine
    postures = planned.postures()
    sets = [(postures, rank)]
    few = PUBLISHED_COUNTS[procedure.kind]
    if procedure == Procedure.of(procedure.kind.value) and len(postures) > few:
        some = postures[:few]
        sets.append((some, analyse(sensitivity(procedure, machine, some)).rank))
    found = []
    for some, true in sets:
        try:
            rows = differenced(procedure, machine.geometry, some, machine.link)
        except CalibrationError:
            continue  # a step leaves the workspace: there is nothing to show
        found.append(_rule(rows, procedure.parameters, true, all_seen))
    return tuple(found)


def _rule(rows: FloatArray, names: tuple[str, ...], rank: int, all_seen: int) -> PaperRule:
    """The rule on derivatives ``(p, r, k)`` of which ``rank`` combinations are truly seen."""
    flat = rows.reshape(-1, len(names))
    qr = classical_qr(flat, names)
    feigned = np.linalg.svd(flat, compute_uv=False)[rank:] / qr.tolerance
    errors = (float(feigned.min()), float(feigned.max())) if len(feigned) else None
    return PaperRule(len(rows), len(flat), len(names), rank, all_seen, qr, errors)


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
