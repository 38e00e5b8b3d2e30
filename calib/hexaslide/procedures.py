"""What the four procedures of papers/001, section 3, measure, and its exact derivatives.

At a posture every slider satisfies ``|reach - slider · rail| = link``; derivatives follow by the
theorem of implicit functions, without any differences.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from calib.errors import CalibrationError, ImpossibleRequest
from calib.hexaslide.geometry import (
    CHAINS,
    END_NAMES,
    FREE,
    LENGTH_NAME,
    NAMES,
    Box,
    ConstraintLink,
    Geometry,
    Numbers,
    unit_of,
    values,
    with_values,
)
from calib.hexaslide.kinematics import (
    forward_near,
    inverse,
    legs,
    pulls,
    rotation,
    rotation_and_slopes,
    words,
)
from calib.observations import FloatArray

COMPONENTS = ("x", "y", "z", "theta", "psi", "phi")

STEP = 1e-30
"""Complex step: nothing is subtracted, so it may be as small as numbers go."""

ENDS = {"c": END_NAMES[:3], "d": END_NAMES[3:], "length": (LENGTH_NAME,)}
"""What of a constraint link may be known: its end on the platform, that on the base, its length."""

ENDS_TOUCH_M = 1e-9
"""Ends of the constraint link that are nearer have no direction between them."""

WELL_HELD = 100.0
"""Condition number up to which the sliders hold the platform well."""

MOST_DRAWN = 20
"""Times as many postures are drawn at most to find well held ones."""

SINGULAR = 1e10
"""Condition number from which on the sliders do not hold the platform, metres and radians."""


class Kind(StrEnum):
    """What the residuals are."""

    POSE_INVERSE = "pose-inverse"
    POSE_FORWARD = "pose-forward"
    POSITION = "position"
    CONSTRAINT_LINK = "constraint-link"


@dataclass(frozen=True)
class Procedure:
    """A procedure on a machine. ``measured`` are components of the posture, for those that measure
    them; ``known`` is what is known of a constraint link, of `ENDS` (papers/001: the length).
    """

    kind: Kind
    measured: tuple[str, ...] = COMPONENTS
    known: tuple[str, ...] = ("length",)

    def __post_init__(self) -> None:
        if not set(self.known) <= set(ENDS) or len(set(self.known)) < len(self.known):
            raise ImpossibleRequest(
                "known parts of the link", _list(self.known), f"different ones of {_list(ENDS)}"
            )
        wrong = [name for name in self.measured if name not in COMPONENTS]
        if wrong or not self.measured or len(set(self.measured)) < len(self.measured):
            raise ImpossibleRequest(
                "measured components",
                _list(self.measured),
                f"different ones of {_list(COMPONENTS)}",
            )

    @staticmethod
    def of(
        name: str, measured: tuple[str, ...] = (), known: tuple[str, ...] | None = None
    ) -> Procedure:
        """The procedure of that name; ``measured`` replaces what it measures, ``known`` what is
        known of its link.

        Raises ImpossibleRequest for a name or component that is not known.
        """
        if name not in list(Kind):
            raise ImpossibleRequest("procedure", repr(name), ", ".join(Kind))
        kind = Kind(name)
        if measured and kind in (Kind.POSE_INVERSE, Kind.CONSTRAINT_LINK):
            raise ImpossibleRequest(
                f"measured components with {name}",
                _list(measured),
                f"none: {name} fixes what is measured",
                "Use --procedure pose-forward with --measured.",
            )
        if known is not None and kind is not Kind.CONSTRAINT_LINK:
            raise ImpossibleRequest(
                f"known parts of a link with {name}", _list(known), "constraint-link only"
            )
        usual = COMPONENTS[:3] if kind is Kind.POSITION else COMPONENTS
        return Procedure(kind, measured or usual, ("length",) if known is None else known)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the unknown parameters."""
        if self.kind is not Kind.CONSTRAINT_LINK:
            return NAMES
        return (*NAMES, *((*END_NAMES, LENGTH_NAME)[k] for k in self.link_columns))

    @property
    def link_columns(self) -> list[int]:
        """Which of cx, cy, cz, dx, dy, dz, L are unknown, by their place in this list."""
        sure = [name for part in self.known for name in ENDS[part]]
        return [k for k, name in enumerate((*END_NAMES, LENGTH_NAME)) if name not in sure]

    @property
    def read(self) -> tuple[str, ...]:
        """Names of the values of one posture."""
        if self.kind is Kind.POSE_INVERSE:
            return tuple(f"lambda{chain}" for chain in range(1, CHAINS + 1))
        return ("length",) if self.kind is Kind.CONSTRAINT_LINK else self.measured


def _list(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def slider_slopes(geometry: Geometry, postures: Numbers) -> tuple[Numbers, Numbers]:
    """Derivatives of sliders by postures ``(p, 6, 6)`` and by the 49 parameters ``(p, 6, 49)``."""
    at = legs(geometry, postures)
    turned = rotation_and_slopes(postures[:, 3:])[0]
    per_lean = at.links / at.lean[..., None]
    by_posture = pulls(geometry, postures, at.links) / at.lean[..., None]
    rails = geometry.rails
    tilt = per_lean[..., :2] - per_lean[..., 2:] * rails[:, :2] / rails[:, 2:]
    own = np.concatenate(
        [
            per_lean @ turned,
            -per_lean,
            -at.sliders[..., None] * tilt,
            -(geometry.links / at.lean)[..., None],
        ],
        axis=-1,
    )
    full = np.zeros((len(postures), CHAINS, CHAINS, own.shape[-1]), dtype=own.dtype)
    chain = np.arange(CHAINS)
    full[:, chain, chain] = own
    return by_posture, full.reshape(len(postures), CHAINS, -1)[..., list(FREE)]


def jacobian(
    procedure: Procedure, geometry: Geometry, postures: Numbers, link: ConstraintLink | None = None
) -> Numbers:
    """Derivatives ``(p, r, k)`` of what is read by the parameters, metres and radians.

    Raises UnreachablePosture, and CalibrationError at a singular posture or without a link.
    """
    by_posture, by_parameter = slider_slopes(geometry, postures)
    if procedure.kind is Kind.POSE_INVERSE:
        return by_parameter
    _refuse_singular(by_posture.real, postures)
    moved = -np.linalg.solve(by_posture, by_parameter)
    if procedure.kind is Kind.CONSTRAINT_LINK:
        return _link_slopes(procedure, postures, moved, link)
    return np.asarray(moved[:, [COMPONENTS.index(name) for name in procedure.measured]])


def held_postures(geometry: Geometry, box: Box, count: int, seed: int) -> FloatArray:
    """Random postures ``(count, 6)`` in a box, those left out that are next to singular ones.

    No machine is measured there, and a few large rows would drown all the others. Where hardly any
    posture is held well, the best held ones. Raises UnreachablePosture.
    """
    generator = np.random.default_rng(seed)
    drawn = box.random(count, generator)
    worst = _looseness(geometry, drawn)
    while (worst < WELL_HELD).sum() < count and len(drawn) < MOST_DRAWN * count:
        drawn = np.concatenate([drawn, box.random(count, generator)])
        worst = np.append(worst, _looseness(geometry, drawn[-count:]))
    held = np.flatnonzero(worst < WELL_HELD)
    chosen = held if len(held) >= count else np.argsort(worst, kind="stable")
    return np.asarray(drawn[chosen[:count]])


def _looseness(geometry: Geometry, postures: FloatArray) -> FloatArray:
    """Condition numbers ``(p,)`` of sliders by postures, turns measured where the joints are."""
    size = float(np.sqrt((geometry.platform**2).sum(axis=1).mean())) or 1.0
    by_posture = slider_slopes(geometry, postures)[0] / [1.0, 1.0, 1.0, size, size, size]
    return np.asarray(np.nan_to_num(np.linalg.cond(by_posture), nan=np.inf))


def _refuse_singular(by_posture: FloatArray, postures: Numbers) -> None:
    """Raises CalibrationError for a posture at which the platform can move, sliders kept."""
    worst = np.linalg.cond(by_posture)
    if not (worst < SINGULAR).all():
        at = int(np.nan_to_num(worst, nan=np.inf).argmax())
        raise CalibrationError(
            f"posture {words(postures[at])}",
            "a singular one",
            "postures at which the sliders hold the platform",
            "Choose another box, or check the joints and rails of the geometry.",
        )


def _link_slopes(
    procedure: Procedure, postures: Numbers, moved: Numbers, link: ConstraintLink | None
) -> Numbers:
    """Distance of the link's ends less its length, ``(p, 1, k)``."""
    if link is None:
        raise CalibrationError("constraint link", "none", "one in the machine file")
    turned, slopes = rotation_and_slopes(postures[:, 3:])
    apart = postures[:, :3] + turned @ link.platform_end - link.base_end
    length = np.sqrt((apart * apart).sum(axis=-1))
    if not (np.abs(length) > ENDS_TOUCH_M).all():
        raise CalibrationError(
            "constraint link", "a posture where its ends touch", "postures that keep them apart"
        )
    along = apart / length[:, None]
    by_angle = np.einsum("pi,paij,j->pa", along, slopes, link.platform_end, optimize=True)
    by_posture = np.concatenate([along, by_angle], axis=-1)
    moving = np.einsum("px,pxk->pk", by_posture, moved)
    ends = [np.einsum("pi,pij->pj", along, turned), -along, -np.ones((len(postures), 1))]
    own = np.concatenate(ends, axis=-1)[:, procedure.link_columns]
    return np.concatenate([moving, own], axis=-1)[:, None]


DIFFERENCE_STEP = 1e-7
"""The paper's step, metres."""


def differenced(
    procedure: Procedure, geometry: Geometry, postures: FloatArray, link: ConstraintLink | None
) -> FloatArray:
    """Derivatives ``(p, r, k)`` as `procedures.jacobian`, each wrong by about 1e-7.

    Raises CalibrationError where a step leaves what can be reached.
    """
    sliders = inverse(geometry, postures)
    start = np.concatenate([values(geometry), _link_values(procedure, link)])
    own = [*range(len(NAMES)), *(len(NAMES) + k for k in procedure.link_columns)]
    if procedure.kind is not Kind.CONSTRAINT_LINK:
        own = own[: len(NAMES)]

    def read(parameters: FloatArray) -> FloatArray:
        changed = with_values(geometry, parameters[: len(NAMES)])
        if procedure.kind is Kind.POSE_INVERSE:
            return np.asarray(inverse(changed, postures))
        moved = forward_near(changed, sliders, postures)
        if procedure.kind is Kind.CONSTRAINT_LINK:
            return _misses(moved, parameters[len(NAMES) :])
        return np.asarray(moved[:, [COMPONENTS.index(name) for name in procedure.measured]])

    before = read(start)
    steps = DIFFERENCE_STEP * np.eye(len(start))[own]
    return np.stack([(read(start + step) - before) / DIFFERENCE_STEP for step in steps], axis=-1)


def _link_values(procedure: Procedure, link: ConstraintLink | None) -> FloatArray:
    """Both ends and the length ``(7,)``; none where there is no link to read."""
    if procedure.kind is not Kind.CONSTRAINT_LINK:
        return np.zeros(0)
    if link is None:
        raise CalibrationError("constraint link", "none", "one in the machine file")
    return np.concatenate([link.platform_end, link.base_end, [link.length_m]])


def _misses(postures: FloatArray, link: FloatArray) -> FloatArray:
    """How much longer than the link its ends are apart ``(p, 1)``."""
    ends = postures[:, :3] + rotation(postures[:, 3:]) @ link[:3] - link[3:6]
    return np.asarray(np.sqrt((ends * ends).sum(axis=1)) - link[6])[:, None]


ANGLES = ("theta", "psi", "phi")


@dataclass(frozen=True)
class Units:
    """A unit of length in metres and one of angle in radians."""

    words: str
    length_m: float
    angle_rad: float


METRES = Units("m, rad", 1.0, 1.0)
MILLIMETRES = Units("mm, rad", 1e-3, 1.0)
DEGREES = Units("m, °", 1.0, np.pi / 180.0)
ALL_UNITS = (METRES, MILLIMETRES, DEGREES)


def in_units(procedure: Procedure, rows: FloatArray, units: Units) -> FloatArray:
    """Derivatives ``(n, k)`` in metres and radians, of whole postures, as they are in ``units``."""
    read = [units.angle_rad if name in ANGLES else units.length_m for name in procedure.read]
    each = np.resize(read, len(rows))
    lengths = [unit_of(name) == "m" for name in procedure.parameters]
    own = np.where(lengths, units.length_m, 1.0)
    return np.asarray(rows * own / each[:, None])
