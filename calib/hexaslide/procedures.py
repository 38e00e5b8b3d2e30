"""What the four procedures of papers/001, section 3, measure, and its exact derivatives.

At a posture every slider satisfies ``|reach - slider · rail| = link``; derivatives follow by the
theorem of implicit functions, without any differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from calib.errors import CalibrationError
from calib.hexaslide.geometry import CHAINS, ConstraintLink, Geometry, Numbers
from calib.hexaslide.kinematics import legs, pulls, rotation_and_slopes
from calib.hexaslide.parameters import END_NAMES, FREE, LENGTH_NAME, NAMES
from calib.observations import FloatArray

COMPONENTS = ("x", "y", "z", "theta", "psi", "phi")
STEP = 1e-30
"""Complex step: nothing is subtracted, so it may be as small as numbers go."""


class Kind(StrEnum):
    """What the residuals are."""

    POSE_INVERSE = "pose-inverse"
    POSE_FORWARD = "pose-forward"
    POSITION = "position"
    CONSTRAINT_LINK = "constraint-link"


@dataclass(frozen=True)
class Procedure:
    """A procedure on a machine. ``measured`` are components of the posture, for those that measure
    them; ends and length of a constraint link may be known or not (papers/001: ends not, length
    known).
    """

    kind: Kind
    measured: tuple[str, ...] = COMPONENTS
    ends_known: bool = False
    length_known: bool = True

    def __post_init__(self) -> None:
        wrong = [name for name in self.measured if name not in COMPONENTS]
        if wrong or not self.measured or len(set(self.measured)) < len(self.measured):
            raise CalibrationError(
                "measured components",
                ", ".join(self.measured) or "none",
                f"different ones of {', '.join(COMPONENTS)}",
            )

    @staticmethod
    def of(name: str, measured: tuple[str, ...] = ()) -> Procedure:
        """The procedure of that name; ``measured`` replaces what it measures.

        Raises CalibrationError for a name or component that is not known.
        """
        if name not in list(Kind):
            raise CalibrationError("procedure", repr(name), ", ".join(Kind))
        kind = Kind(name)
        if measured and kind in (Kind.POSE_INVERSE, Kind.CONSTRAINT_LINK):
            raise CalibrationError(
                f"measured components with {name}",
                ", ".join(measured),
                f"none: {name} fixes what is measured",
                "Use --procedure pose-forward with --measured.",
            )
        usual = COMPONENTS[:3] if kind is Kind.POSITION else COMPONENTS
        return Procedure(kind, measured or usual)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the unknown parameters."""
        if self.kind is not Kind.CONSTRAINT_LINK:
            return NAMES
        ends = () if self.ends_known else END_NAMES
        return (*NAMES, *ends, *(() if self.length_known else (LENGTH_NAME,)))

    @property
    def read(self) -> tuple[str, ...]:
        """Names of the values of one posture."""
        if self.kind is Kind.POSE_INVERSE:
            return tuple(f"lambda{chain}" for chain in range(1, CHAINS + 1))
        return ("length",) if self.kind is Kind.CONSTRAINT_LINK else self.measured


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
    try:
        moved = -np.linalg.solve(by_posture, by_parameter)
    except np.linalg.LinAlgError as problem:
        raise CalibrationError(
            "postures", "a singular one", "postures at which the sliders hold the platform"
        ) from problem
    if procedure.kind is Kind.CONSTRAINT_LINK:
        return _link_slopes(procedure, postures, moved, link)
    return np.asarray(moved[:, [COMPONENTS.index(name) for name in procedure.measured]])


def _link_slopes(
    procedure: Procedure, postures: Numbers, moved: Numbers, link: ConstraintLink | None
) -> Numbers:
    """Distance of the link's ends less its length, ``(p, 1, k)``."""
    if link is None:
        raise CalibrationError("constraint link", "none", "one in the machine file")
    turned, slopes = rotation_and_slopes(postures[:, 3:])
    apart = postures[:, :3] + turned @ link.platform_end - link.base_end
    along = apart / np.sqrt((apart * apart).sum(axis=-1))[:, None]
    by_angle = np.einsum("pi,paij,j->pa", along, slopes, link.platform_end, optimize=True)
    by_posture = np.concatenate([along, by_angle], axis=-1)
    parts = [np.einsum("px,pxk->pk", by_posture, moved)]
    if not procedure.ends_known:
        parts += [np.einsum("pi,pij->pj", along, turned), -along]
    if not procedure.length_known:
        parts.append(-np.ones((len(postures), 1)))
    return np.concatenate(parts, axis=-1)[:, None]


def jacobian_and_slopes(
    procedure: Procedure,
    geometry: Geometry,
    postures: FloatArray,
    link: ConstraintLink | None = None,
) -> tuple[FloatArray, FloatArray]:
    """The Jacobian ``(p, r, k)`` and its derivatives by the postures ``(p, r, k, 6)``."""
    count = len(postures)
    stepped = postures[None] + 1j * STEP * np.eye(6)[:, None]
    found = jacobian(procedure, geometry, stepped.reshape(-1, 6), link)
    split = found.reshape(6, count, *found.shape[1:])
    return split[0].real, np.moveaxis(split.imag / STEP, 0, -1)
