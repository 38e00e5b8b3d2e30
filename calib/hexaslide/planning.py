"""How few postures of a Hexa Slide show all that a procedure can see, and which show most."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

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
from calib.design.identifiability import (
    AddedMeasurement,
    ClassicalQr,
    Examination,
    Identifiability,
    SeenBy,
    Sensitivity,
    analyse,
    classical_qr,
    seen_by,
)
from calib.errors import CalibrationError
from calib.hexaslide.derivatives import RowMaker, jacobian
from calib.hexaslide.geometry import HexaSlide, forward_near, inverse, motions, present, unit_of
from calib.hexaslide.procedures import (
    ANGLES,
    Procedure,
    ProcedureKind,
    held_postures,
    joint_radius,
)
from calib.hexaslide.residuals import read_at

PLENTY = 100
"""So many random postures reach the rank that the procedure can reach; twice for one row each."""


def sensitivity(procedure: Procedure, machine: HexaSlide, postures: FloatArray) -> Sensitivity:
    """Bare derivatives at postures ``(p, 6)``: no noise is known, metres and radians."""
    rows = jacobian(procedure, machine.geometry, postures, machine.link)
    names = procedure.parameters
    return Sensitivity(
        names=names,
        jacobian=rows.reshape(-1, len(names)),
        tolerance=np.ones(len(names)),
        motions=motions(machine, names),
        noise_known=False,
        blind=EXACT_BLIND,
    )


def enough_postures(procedure: Procedure, machine: HexaSlide, seed: int = 0) -> FloatArray:
    """Random postures ``(p, 6)`` that reach the rank of the procedure."""
    count = PLENTY * (2 if len(procedure.read) == 1 else 1)
    return held_postures(machine, count, seed)


def at_enough(procedure: Procedure, machine: HexaSlide) -> Sensitivity:
    """Derivatives at postures enough: all that the procedure can see."""
    return sensitivity(procedure, machine, enough_postures(procedure, machine))


def reachable(procedure: Procedure, machine: HexaSlide) -> Identifiability:
    """What the procedure sees there."""
    return analyse(at_enough(procedure, machine))


def fewest_postures(procedure: Procedure, machine: HexaSlide) -> int:
    """How many random postures are needed to see what the procedure can see at all."""
    full = at_enough(procedure, machine).jacobian
    rows_each, wanted_rank = len(procedure.read), rank_of(full, EXACT_BLIND)
    low, high = 1, len(full) // rows_each
    # another posture never lowers the rank: halving finds the first that is enough
    while low < high:
        middle = (low + high) // 2
        rank = rank_of(full[: middle * rows_each], EXACT_BLIND)
        low, high = (low, middle) if rank == wanted_rank else (middle + 1, high)
    return low


UNITS = "metres and radians, columns not scaled"
SCALED = "scaled"
SCALED_WORDS = "angles at the joints of the platform, columns by their size at random postures"

SIZES = {
    "m, rad": {"m": 1.0, "rad": 1.0},
    "mm, rad": {"m": 1e-3, "rad": 1.0},
    "m, °": {"m": 1.0, "rad": np.pi / 180.0},
}
"""Units of length and angle, in metres and radians."""


@dataclass(frozen=True, eq=False)
class Scale:
    """Factors of derivatives: of what is read ``(r,)`` and of the parameters ``(k,)``."""

    read: FloatArray
    parameters: FloatArray

    @staticmethod
    def in_units(procedure: Procedure, units: str) -> Scale:
        """The scale from metres and radians to ``units``, of `SIZES`."""
        sizes = SIZES[units] | {"m/m": 1.0}
        of_readings = [sizes["rad" if name in ANGLES else "m"] for name in procedure.read]
        parameters = [sizes[unit_of(name)] for name in procedure.parameters]
        return Scale(1.0 / np.array(of_readings), np.array(parameters))

    @staticmethod
    def of(procedure: Procedure, machine: HexaSlide) -> Scale:
        """The scale to no units: angles count at the joints of the platform, a parameter by the
        r.m.s. of what it does at postures enough. Raises as `sensitivity`.
        """
        radius = joint_radius(machine.geometry)
        of_readings = np.array([radius if name in ANGLES else 1.0 for name in procedure.read])
        rows = at_enough(procedure, machine).jacobian
        sizes = np.sqrt(((rows * np.resize(of_readings, len(rows))[:, None]) ** 2).mean(axis=0))
        return Scale(of_readings, 1.0 / np.where(sizes > 0.0, sizes, 1.0))

    def applied(self, rows: FloatArray) -> FloatArray:
        """Derivatives ``(n, k)`` of whole postures, metres and radians, so multiplied."""
        return rows * np.resize(self.read, len(rows))[:, None] * self.parameters


def rows_seen(procedure: Procedure, machine: HexaSlide, *, scaled: bool = False) -> RowMaker:
    """Rows of the combinations that the procedure can see at all.

    What is unidentifiable with postures enough is a motion of a frame, the same at every posture.
    """
    postures = reachable(procedure, machine)
    unseen = postures.unseen_vectors.reshape(-1, len(postures.names))
    if not scaled:
        return RowMaker(procedure, machine.geometry, machine.link, null_space(unseen))
    scale = Scale.of(procedure, machine)
    visible = scale.parameters[:, None] * null_space(unseen / scale.parameters)
    return RowMaker(procedure, machine.geometry, machine.link, visible, scale.read)


WRONG = {
    ProcedureKind.POSITION: "papers/001 counts 48; with exact derivatives it is 46: turning the "
    "frame of the platform about its origin changes no position. 48 is also its number of rows, "
    "16 × 3.",
    ProcedureKind.CONSTRAINT_LINK: "papers/001 counts 46; with exact derivatives it is 48: only "
    "motions of whole frames are lost, six of the platform, one of the base. 46 is also its row "
    "count.",
}


@dataclass(frozen=True)
class PublishedSet:
    """What papers/001 states of a procedure: its rank in table 1, and condition numbers of sets of
    ``count`` postures in a later ``table``.
    """

    case: str
    rank: int
    table: int
    count: int
    random: float
    best: float


PUBLISHED_SETS = {
    ProcedureKind.POSE_INVERSE: PublishedSet("I", 49, 3, 9, 2888.0, 140.2),
    ProcedureKind.POSE_FORWARD: PublishedSet("II", 49, 4, 9, 21530.0, 1537.3),
    ProcedureKind.POSITION: PublishedSet("III", 48, 5, 16, 33916.0, 2430.2),
    ProcedureKind.CONSTRAINT_LINK: PublishedSet("IV", 46, 6, 46, 6.012e5, 1.4523e5),
}


@dataclass(frozen=True, eq=False)
class HexaSlidePlanning:
    """A machine with a procedure, at postures ``given`` ``(p, 6)`` from somewhere, else at random
    ones: ``count`` of them, None: enough. ``name`` is that of the machine for people. Postures that
    are searched leave ``room_m`` to the ends of every travel.
    """

    procedure: Procedure
    machine: HexaSlide
    seed: int = 0
    count: int | None = None
    given: FloatArray | None = None
    source: str = ""
    name: str = "hexaslide"
    room_m: float = 0.0

    @property
    def with_room(self) -> HexaSlide:
        """The machine with its ends so far inside: calibrated, it has the same postures, too."""
        return self.machine.with_room(self.room_m)

    @property
    def usual(self) -> bool:
        """Whether the procedure is one of papers/001."""
        return self.procedure == Procedure.of(self.procedure.kind.value)

    def examine(self) -> Examination:
        """What the procedure sees at the postures."""
        postures = self.postures()
        # nothing is left out of what is told to be lost
        sensitivity_seen = replace(
            sensitivity(self.procedure, self.machine, postures), whole_shares=True
        )
        kind = self.procedure.kind
        return Examination(
            procedure=kind.value,
            sensitivity=sensitivity_seen,
            bare=sensitivity_seen.jacobian,
            measured=self.procedure.read,
            posture_count=len(postures),
            independent_count=len(sensitivity_seen.jacobian),
            minutes=0.0,
            units=UNITS,
            noise_words="not known, it decides nothing here",
            source=self.source or f"random in the box, seed {self.seed}",
            fewest_postures=fewest_postures(self.procedure, self.machine),
            reachable_rank=reachable(self.procedure, self.machine).rank,
            published_rank=PUBLISHED_SETS[kind].rank if self.usual else None,
            remark=WRONG.get(kind, "") if self.usual else "",
        )

    def postures(self) -> FloatArray:
        """The given postures, else random ones in the box ``(p, 6)``."""
        if self.given is not None:
            return self.given
        if self.count is None:
            return enough_postures(self.procedure, self.machine, self.seed)
        return held_postures(self.machine, self.count, self.seed)

    def added(self, vectors: Sequence[FloatArray]) -> tuple[AddedMeasurement | None, ...]:
        """None: what is lost is lost at every posture."""
        return (None,) * len(vectors)


def conditions_by_units(
    procedure: Procedure, rows: FloatArray, rank: int, scale: Scale
) -> dict[str, float]:
    """Condition number of what is seen in each unit and scaled, from rows ``(n, k)``, metres and
    radians.
    """
    scales = {units: Scale.in_units(procedure, units) for units in SIZES} | {SCALED: scale}
    return {units: condition(part.applied(rows), rank) for units, part in scales.items()}


def conditions_at(view: HexaSlideSeen, postures: FloatArray) -> dict[str, float]:
    """Condition numbers at postures ``(p, 6)``."""
    rows = sensitivity(view.procedure, view.machine, postures).jacobian
    scale = Scale.of(view.procedure, view.machine)
    return conditions_by_units(view.procedure, rows, view.seen.identifiability.rank, scale)


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
    def decided_by(self) -> Literal["geometry", "rows", "parameters", "postures"]:
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
        directions = self.seen.identifiability.unseen
        return tuple(
            direction.combination
            for direction in directions
            if np.linalg.norm(without(never, direction.vector)) < BLIND
        )

    @cached_property
    def rules(self) -> tuple[PaperRule, ...]:
        """The paper's rule at these postures and, for its own procedures, at as many as it has,
        where they could be taken.
        """
        procedure, postures = self.procedure, self.planned.postures()
        all_seen = reachable(procedure, self.machine).rank
        sets = [(postures, self.seen.identifiability.rank)]
        few = PUBLISHED_SETS[procedure.kind].count
        if self.planned.usual and len(postures) > few:
            subset = postures[:few]
            sets.append((subset, analyse(sensitivity(procedure, self.machine, subset)).rank))
        rules_found = []
        for subset, rank in sets:
            with suppress(CalibrationError):  # a step leaves the workspace: nothing to show
                rows = differenced(procedure, self.machine, subset)
                rules_found.append(_rule(rows, procedure.parameters, rank, all_seen))
        return tuple(rules_found)


def look_at(planning: HexaSlidePlanning) -> HexaSlideSeen:
    """Raises CalibrationError for postures that cannot be."""
    seen_parts = seen_by(planning)
    scale = Scale.of(planning.procedure, planning.machine)
    conditions = conditions_by_units(
        planning.procedure, seen_parts.examined.bare, seen_parts.identifiability.rank, scale
    )
    return HexaSlideSeen(planning, seen_parts, conditions)


DIFFERENCE_STEP = 1e-7
"""The paper's step, metres. By it combinations that nothing shows get singular values of 4e-10 to
1e-6, which the paper's rule, at 3e-14 to 2e-13, takes for sight."""


def differenced(procedure: Procedure, machine: HexaSlide, postures: FloatArray) -> FloatArray:
    """Derivatives ``(p, r, k)`` as `derivatives.jacobian`, each wrong by about 1e-7.

    Raises CalibrationError where a step leaves what can be reached, or without a link to read.
    """
    names, kind = procedure.parameters, procedure.kind
    if kind is ProcedureKind.CONSTRAINT_LINK:
        present(machine.link)
    sliders, start = inverse(machine.geometry, postures), machine.parameters(names)

    def read(parameters: FloatArray) -> FloatArray:
        changed = machine.with_parameters(names, parameters)
        if kind is ProcedureKind.POSE_INVERSE:
            return read_at(procedure, changed, postures)
        moved = forward_near(changed.geometry, sliders, postures)
        return read_at(procedure, changed, np.asarray(moved))

    values, steps = read(start), DIFFERENCE_STEP * np.eye(len(start))
    return np.stack([(read(start + step) - values) / DIFFERENCE_STEP for step in steps], axis=-1)


def _rule(rows: FloatArray, names: tuple[str, ...], rank: int, all_seen: int) -> PaperRule:
    """The rule on derivatives ``(p, r, k)`` of which ``rank`` combinations are truly seen."""
    flat = rows.reshape(-1, len(names))
    qr = classical_qr(flat, names)
    feigned = np.linalg.svd(flat, compute_uv=False)[rank:] / qr.tolerance
    errors = (float(feigned.min()), float(feigned.max())) if len(feigned) else None
    return PaperRule(len(rows), len(flat), len(names), rank, all_seen, qr, errors)
