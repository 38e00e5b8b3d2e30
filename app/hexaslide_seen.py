"""What ``glidecal identifiability hexaslide`` tells beyond what all machines do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.planning import Combination, Request, SeenBy, seen_by
from app.planning_hexaslide import HexaSlidePlanning
from calib.classical_qr import ClassicalQr, classical_qr
from calib.errors import CalibrationError
from calib.hexaslide.differences import differenced
from calib.hexaslide.procedures import Kind, Procedure
from calib.hexaslide.scaling import ALL_UNITS, in_units
from calib.hexaslide_planning import reachable, sensitivity
from calib.identifiability import analyse
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
