"""The Hexa Slide's side of `app.planning`: what its procedures see in a box of postures."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.planning import Cure, Examined, Pool, Request
from calib.criteria import Criterion
from calib.errors import CalibrationError
from calib.hexaslide.procedures import COMPONENTS, Kind, Procedure
from calib.hexaslide_planning import (
    BestPostures,
    HexaSlide,
    best_postures,
    enough_postures,
    fewest_postures,
    sensitivity,
)
from calib.observations import FloatArray
from protocols.errors import UsageError
from protocols.hexaslide_machine import load_hexaslide

UNITS = "metres and radians, columns not scaled"
COORDINATES = ("x_m", "y_m", "z_m", "theta_deg", "psi_deg", "phi_deg")

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


@dataclass(frozen=True, eq=False)
class HexaSlidePlanning:
    """One machine with one procedure."""

    request: Request
    procedure: Procedure
    machine: HexaSlide

    @staticmethod
    def of(request: Request) -> HexaSlidePlanning:
        """Raises UsageError for a procedure or component, RecordError for a machine file."""
        try:
            procedure = Procedure.of(request.procedure, request.measured)
        except CalibrationError as problem:
            raise UsageError(
                problem.thing, problem.found, problem.allowed, problem.next_step
            ) from problem
        if request.noise_mm is not None:
            raise UsageError("--noise", "the machine hexaslide", "the machine orthoglide")
        own = load_hexaslide(request.machine_file)
        if procedure.kind is Kind.CONSTRAINT_LINK and own.constraint_link is None:
            raise UsageError("machine file", "no [constraint_link]", "one for constraint-link")
        machine = HexaSlide(own.geometry(), own.posture_box(), own.link())
        return HexaSlidePlanning(request, procedure, machine)

    @property
    def name(self) -> str:
        """The name on the command line."""
        return "hexaslide"

    def examine(self) -> Examined:
        """What the procedure sees from random postures in the box."""
        postures = self._postures()
        seen = sensitivity(self.procedure, self.machine, postures)
        kind = self.procedure.kind
        usual = self.procedure == Procedure.of(kind.value)
        return Examined(
            procedure=kind.value,
            sensitivity=seen,
            bare=seen.jacobian,
            measured=self.procedure.read,
            posture_count=len(postures),
            independent_count=len(seen.jacobian),
            minutes=0.0,
            units=UNITS,
            noise_words="not known, it decides nothing here",
            source=f"random in the box, seed {self.request.seed}",
            fewest_postures=fewest_postures(self.procedure, self.machine),
            published_rank=PUBLISHED[kind] if usual else None,
            remark=WRONG.get(kind, "") if usual else "",
        )

    def _postures(self) -> FloatArray:
        if self.request.postures is None:
            return enough_postures(self.procedure, self.machine, self.request.seed)
        generator = np.random.default_rng(self.request.seed)
        return self.machine.box.random(self.request.postures, generator)

    def pool(self) -> Pool:
        """Raises UsageError: its postures are no list to choose from."""
        raise _not_yet()

    def metric(self) -> FloatArray:
        """Raises UsageError: its postures are no list to choose from."""
        raise _not_yet()

    def cures(self, vectors: Sequence[FloatArray]) -> tuple[Cure | None, ...]:
        """None: what is lost is lost at every posture."""
        return (None,) * len(vectors)


@dataclass(frozen=True, eq=False)
class BoxedPostures:
    """The best postures found in the box, and how long all searches took."""

    procedure: Procedure
    best: BestPostures
    seed: int
    seconds: float


def boxed_postures(
    request: Request, count: int, criterion: Criterion, *, seed: int, starts: int
) -> BoxedPostures:
    """The best ``count`` postures. Raises UsageError, RecordError, NotIdentifiable for too few."""
    if criterion is Criterion.TOOL_VARIANCE:
        raise UsageError("--criterion", criterion.value, "the other five for the hexaslide")
    planned = HexaSlidePlanning.of(request)
    begin = time.perf_counter()
    best = best_postures(
        planned.procedure, planned.machine, count, criterion, seed=seed, starts=starts
    )
    return BoxedPostures(planned.procedure, best, seed, time.perf_counter() - begin)


def boxed_document(found: BoxedPostures) -> dict[str, Any]:
    """Schema ``glidecal.postures/1``."""
    best = found.best
    return {
        "schema": "glidecal.postures/1",
        "machine": "hexaslide",
        "procedure": found.procedure.kind.value,
        "count": len(best.refined.coordinates),
        "criterion": best.criterion.value,
        "value": best.refined.value,
        "rank": best.rank,
        "condition_number": best.condition_number,
        "start_condition_number": best.start_condition_number,
        "units": UNITS,
        "postures": [_coordinates(posture) for posture in best.refined.coordinates],
        "coordinates_on_bound": best.refined.on_bound,
        "seconds": found.seconds,
        "starts": len(best.values),
        "values_of_starts": list(best.values),
        "seed": found.seed,
    }


def _coordinates(posture: FloatArray) -> dict[str, float]:
    places = [*posture[:3], *np.degrees(posture[3:])]
    return {name: float(value) for name, value in zip(COORDINATES, places, strict=True)}


def _not_yet() -> UsageError:
    return UsageError(
        "machine",
        "hexaslide",
        "orthoglide for choosing among postures",
        f"What a Hexa Slide reads: {', '.join(COMPONENTS)}; see glidecal identifiability.",
    )
