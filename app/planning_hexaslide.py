"""The Hexa Slide's side of `app.planning`: what its procedures see in a box of postures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.planning import Cure, Examined, Pool, Request
from calib.errors import CalibrationError
from calib.hexaslide.procedures import COMPONENTS, Kind, Procedure
from calib.hexaslide_planning import HexaSlide, enough_postures, fewest_postures, sensitivity
from calib.observations import FloatArray
from protocols.errors import UsageError
from protocols.hexaslide_machine import load_hexaslide

PUBLISHED = {
    Kind.POSE_INVERSE: 49,
    Kind.POSE_FORWARD: 49,
    Kind.POSITION: 48,
    Kind.CONSTRAINT_LINK: 46,
}
"""Ranks that papers/001, table 1, states."""

WRONG = {
    Kind.POSITION: "papers/001 counts 48; with exact derivatives it is 46: turning the frame of the "
    "platform about its origin changes no position. 48 is also its number of rows, 16 × 3.",
    Kind.CONSTRAINT_LINK: "papers/001 counts 46; with exact derivatives it is 48: only motions of "
    "whole frames are lost, six of the platform and one of the base. 46 is also its number of rows.",
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
            units="metres and radians, columns not scaled",
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


def _not_yet() -> UsageError:
    return UsageError(
        "machine",
        "hexaslide",
        "orthoglide for choosing among postures",
        f"What a Hexa Slide reads: {', '.join(COMPONENTS)}; see glidecal identifiability.",
    )
