"""What the four procedures of papers/001, section 3, measure, where, and in which units."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from calib.arrays import FloatArray
from calib.errors import ImpossibleRequest
from calib.hexaslide.geometry import (
    CHAINS,
    ENCODERS,
    END_NAMES,
    LENGTH_NAME,
    NAMES,
    TELESCOPIC_NAMES,
    Geometry,
    HexaSlide,
    legs,
)

COMPONENTS = ("x", "y", "z", "theta", "psi", "phi")
ANGLES = (*COMPONENTS[3:], *ENCODERS)
MEASURABLE = (*COMPONENTS, *ENCODERS)
MEASURABLE_WORDS = f"{', '.join(COMPONENTS)}, or encoders turn1, swing1 … swing{CHAINS}"

LINK_LENGTH = "length"
"""By how much the constraint link is longer than stated: 0 where it is rigid, what an indicator in
it reads where it is not.
"""

ENDS = {"c": END_NAMES[:3], "d": END_NAMES[3:], "length": (LENGTH_NAME,)}
"""What of a constraint link may be known: its end on the platform, that on the base, its length."""

WELL_HELD = 100.0
"""Condition number up to which the sliders hold the platform well."""

MOST_DRAWN = 20
"""Times as many postures are drawn at most to find well held ones."""


class ProcedureKind(StrEnum):
    """What the residuals are."""

    POSE_INVERSE = "pose-inverse"
    POSE_FORWARD = "pose-forward"
    POSITION = "position"
    CONSTRAINT_LINK = "constraint-link"


@dataclass(frozen=True)
class Procedure:
    """A procedure on a machine. ``measured`` are components of the posture and encoders in joints
    (`MEASURABLE`), beside a constraint link none or some, `LINK_LENGTH` the first of them where an
    indicator in the link reads; ``known`` is what is known of that link, of `ENDS` (papers/001: the
    length). ``telescopic`` legs have no rails, so no parameters of them.
    """

    kind: ProcedureKind
    measured: tuple[str, ...] = COMPONENTS
    known: tuple[str, ...] = ("length",)
    telescopic: bool = False

    def __post_init__(self) -> None:
        if not set(self.known) <= set(ENDS) or len(set(self.known)) < len(self.known):
            raise ImpossibleRequest(
                "known parts of the link", _list(self.known), f"different ones of {_list(ENDS)}"
            )
        names = self.measured[1:] if self.reads_length else self.measured
        wrong = [name for name in names if name not in MEASURABLE]
        is_empty = not self.measured and self.kind is not ProcedureKind.CONSTRAINT_LINK
        if wrong or is_empty or len(set(self.measured)) < len(self.measured):
            raise ImpossibleRequest(
                "measured components",
                _list(wrong or self.measured),
                f"different ones of {MEASURABLE_WORDS}",
            )

    @staticmethod
    def of(
        name: str, measured: tuple[str, ...] = (), known: tuple[str, ...] | None = None
    ) -> Procedure:
        """The procedure of that name; ``measured`` replaces what it measures, ``known`` what is
        known of its link.

        Raises ImpossibleRequest for a name or component that is not known.
        """
        if name not in list(ProcedureKind):
            raise ImpossibleRequest("procedure", repr(name), ", ".join(ProcedureKind))
        kind = ProcedureKind(name)
        if measured and kind is ProcedureKind.POSE_INVERSE:
            raise ImpossibleRequest(
                f"measured components with {name}",
                _list(measured),
                f"none: {name} defines the measured components",
                "Use --procedure pose-forward with --measured.",
            )
        if known is not None and kind is not ProcedureKind.CONSTRAINT_LINK:
            raise ImpossibleRequest(
                f"known parts of a link with {name}", _list(known), "constraint-link only"
            )
        usual = {ProcedureKind.POSITION: COMPONENTS[:3], ProcedureKind.CONSTRAINT_LINK: ()}.get(
            kind, COMPONENTS
        )
        return Procedure(kind, measured or usual, ("length",) if known is None else known)

    @property
    def reads_length(self) -> bool:
        """Whether an indicator reads the length of the link, which then holds nothing."""
        linked = self.kind is ProcedureKind.CONSTRAINT_LINK
        return linked and self.measured[:1] == (LINK_LENGTH,)

    @property
    def measures_places(self) -> bool:
        """Whether a tracker, with a frame of its own, measures where the platform is."""
        return {*COMPONENTS[:3]} <= {*self.measured}

    @property
    def has_rigid_link(self) -> bool:
        """Whether a link holds the platform, so that the sliders themselves are what is read."""
        return self.kind is ProcedureKind.CONSTRAINT_LINK and not self.reads_length

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the unknown parameters."""
        zeros = [f"zero_{name}" for name in self.measured if name in ENCODERS]
        own_names = TELESCOPIC_NAMES if self.telescopic else NAMES
        if self.kind is not ProcedureKind.CONSTRAINT_LINK:
            return (*own_names, *zeros)
        sure = [name for part in self.known for name in ENDS[part]]
        link = [name for name in (*END_NAMES, LENGTH_NAME) if name not in sure]
        return (*own_names, *link, *zeros)

    def on(self, machine: HexaSlide) -> Procedure:
        """The procedure on a machine, whose legs decide on the parameters.

        Raises ImpossibleRequest for encoders in joints about rails that are not there.
        """
        encoders = [name for name in self.measured if name in ENCODERS]
        if machine.geometry.telescopic and encoders:
            raise ImpossibleRequest(
                "measured components",
                f"{_list(encoders)} of telescopic legs",
                f"different ones of {_list(COMPONENTS)}",
            )
        return replace(self, telescopic=machine.geometry.telescopic)

    @property
    def read(self) -> tuple[str, ...]:
        """Names of the values of one posture."""
        if self.kind is ProcedureKind.POSE_INVERSE:
            return tuple(f"lambda{chain}" for chain in range(1, CHAINS + 1))
        return (LINK_LENGTH, *self.measured) if self.has_rigid_link else self.measured


def _list(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def held_postures(machine: HexaSlide, count: int, seed: int) -> FloatArray:
    """Random postures ``(count, 6)`` in a box, those left out that are next to singular ones.

    No machine is measured there, and a few large rows would drown all the others. Where hardly any
    posture is held well, the best held ones. Raises UnreachablePosture, and as `HexaSlide.random`.
    """
    generator = np.random.default_rng(seed)
    candidates = machine.random(count, generator)
    worst = looseness(machine.geometry, candidates)
    while (worst < WELL_HELD).sum() < count and len(candidates) < MOST_DRAWN * count:
        candidates = np.concatenate([candidates, machine.random(count, generator)])
        worst = np.append(worst, looseness(machine.geometry, candidates[-count:]))
    rows_held = np.flatnonzero(worst < WELL_HELD)
    order = rows_held if len(rows_held) >= count else np.argsort(worst, kind="stable")
    return np.asarray(candidates[order[:count]])


def joint_radius(geometry: Geometry) -> float:
    """R.m.s. distance of the joints from the platform's origin, metres; 1 where there is none."""
    return float(np.sqrt((geometry.platform**2).sum(axis=1).mean())) or 1.0


def at_joints(geometry: Geometry) -> FloatArray:
    """Sizes of coordinates ``(6,)`` where turns are measured at the joints."""
    return np.repeat([1.0, joint_radius(geometry)], 3)


def looseness(geometry: Geometry, postures: FloatArray) -> FloatArray:
    """Condition numbers ``(p,)`` of sliders by postures, turns measured where the joints are."""
    by_posture = legs(geometry, postures).arms.by_posture / at_joints(geometry)
    return np.asarray(np.nan_to_num(np.linalg.cond(by_posture), nan=np.inf))
