"""What a machine leaves of measured postures, for each of the four procedures of papers/001.

At every posture the six sliders are read, and their scales count as exact. Measured from outside
are components of the platform's posture, and angles in the joints on the carriages; a constraint
link keeps its length.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.arrays import FloatArray
from calib.errors import CalibrationError, UnreachablePosture
from calib.hexaslide.derivatives import jacobian, joint_angles
from calib.hexaslide.geometry import (
    ENCODERS,
    ConstraintLink,
    Geometry,
    HexaSlide,
    forward,
    forward_near,
    inverse,
    legs,
    present,
    rotation,
)
from calib.hexaslide.procedures import ANGLES, COMPONENTS, Procedure, ProcedureKind

CHECK = "Look for a wrong reading, order of the sliders, or unit: metres and radians."

SAME_M = 1e-4
"""Sliders that a link holds are read with noise: so near they are those of one posture."""


@dataclass(frozen=True, eq=False)
class Readings:
    """``p`` postures: sliders ``(p, 6)`` in metres, measured values ``(p, m)``, metres and radians.

    Measured is what the procedure measures, with a constraint link often nothing, ``(p, 0)``. The
    noise is the standard deviation of one measured value, or of the play of the link; 0: not
    stated, and then 1 m counts like 1 rad. ``numbers`` are those of the postures in messages,
    without them from 1.
    """

    procedure: Procedure
    sliders: FloatArray
    measured: FloatArray
    length_noise_m: float = 0.0
    angle_noise_rad: float = 0.0
    numbers: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        shape = (len(self.sliders), len(self.procedure.measured))
        right = self.sliders.shape == (len(self.sliders), 6) and self.measured.shape == shape
        if not right or not len(self.sliders):
            raise CalibrationError(
                "readings",
                f"shapes {self.sliders.shape} and {self.measured.shape}",
                f"six sliders and {len(self.procedure.measured)} values for each posture",
            )
        if not (np.isfinite(self.sliders).all() and np.isfinite(self.measured).all()):
            raise CalibrationError("readings", "a value that is not finite", "finite numbers")

    @property
    def noise_m(self) -> float | None:
        """Noise of a length; None where it is not stated."""
        return self.length_noise_m or None

    @property
    def value_noise(self) -> FloatArray:
        """Noise of what is measured at a posture, with the link's length before it ``(m,)``; only
        ratios where not stated.
        """
        length, angle = self.length_noise_m or 1.0, self.angle_noise_rad or 1.0
        inverse_kind = self.procedure.kind is ProcedureKind.POSE_INVERSE
        names = self.procedure.measured if inverse_kind else self.procedure.read
        return np.array([angle if name in ANGLES else length for name in names])

    def number(self, row: int) -> int:
        """The number of a posture in messages."""
        return self.numbers[row] if self.numbers else row + 1

    @property
    def different(self) -> int:
        """How many postures, those counted once that were read again."""
        return len(np.unique(np.round(self.sliders / SAME_M), axis=0))

    def take(self, rows: NDArray[np.bool_]) -> Readings:
        """Only the postures where ``rows`` ``(p,)`` is true, with their numbers."""
        numbers = tuple(self.number(int(row)) for row in np.flatnonzero(rows))
        sliders, measured = self.sliders[rows], self.measured[rows]
        return replace(self, sliders=sliders, measured=measured, numbers=numbers)

    def noisier(self, times: float) -> Readings:
        """The readings with so many times the noise."""
        noise_m, noise_rad = times * self.length_noise_m, times * self.angle_noise_rad
        return replace(self, length_noise_m=noise_m, angle_noise_rad=noise_rad)

    def without(self, numbers: Collection[int]) -> Readings:
        """All postures but those of these numbers."""
        kept_rows = [self.number(row) not in numbers for row in range(len(self.sliders))]
        return self.take(np.array(kept_rows, dtype=np.bool_))


@dataclass(frozen=True, eq=False)
class Residuals:
    """Measured less predicted ``(p, r)``; ``names`` are of the columns, ``angular`` those in rad.

    ``postures`` ``(p, 6)`` are where the machine stands by its own reckoning.
    """

    names: tuple[str, ...]
    values: FloatArray
    postures: FloatArray

    @property
    def angular(self) -> FloatArray:
        """Which columns are angles ``(r,)``."""
        return np.array([name in ANGLES for name in self.names])

    def rms(self, *, angles: bool) -> float | None:
        """R.m.s. of all lengths in metres, or of all angles in radians; None if there are none."""
        values = self.values[:, self.angular == angles]
        return float(np.sqrt((values**2).mean())) if values.size else None


def postures_of(
    readings: Readings, machine: HexaSlide, near: FloatArray | None = None
) -> FloatArray:
    """Where the platform stands ``(p, 6)``: as measured for pose-inverse, else from the sliders.

    ``near`` ``(p, 6)`` are postures of a machine that differs little. Raises UnreachablePosture
    naming the posture.
    """
    if readings.procedure.kind is ProcedureKind.POSE_INVERSE:
        return readings.measured
    try:
        return standing(machine, readings.sliders, near)
    except UnreachablePosture as problem:
        _name_posture(readings, readings.sliders, lambda sliders: standing(machine, sliders, None))
        raise UnreachablePosture(
            "postures", "sliders that hold no platform", "reachable ones", CHECK
        ) from problem


def standing(machine: HexaSlide, sliders: FloatArray, near: FloatArray | None) -> FloatArray:
    """Postures ``(p, 6)`` of sliders, followed from postures ``near`` them where that works.

    Raises UnreachablePosture.
    """
    if near is not None:
        with suppress(UnreachablePosture):
            return np.asarray(forward_near(machine.geometry, sliders, near))
    return np.asarray(forward(machine.geometry, sliders, machine.box))


def _name_posture(
    readings: Readings, rows: FloatArray, reach: Callable[[FloatArray], object]
) -> None:
    """Raises UnreachablePosture naming the first of the postures that cannot be reached."""
    for row, row_values in enumerate(rows):
        try:
            reach(row_values[None])
        except UnreachablePosture as problem:
            raise UnreachablePosture(
                f"posture {readings.number(row)}, {problem.thing}",
                problem.found,
                problem.allowed,
                CHECK,
            ) from problem


def residuals(
    readings: Readings, machine: HexaSlide, postures: FloatArray
) -> tuple[Residuals, FloatArray]:
    """Residuals ``(p, r)`` at postures, and derivatives of what is read ``(p, r, k)``.

    Raises UnreachablePosture naming the posture, CalibrationError at a singular one.
    """
    procedure = readings.procedure
    if procedure.kind is ProcedureKind.POSE_INVERSE:
        values = readings.sliders - _inverse(readings, machine.geometry)
    else:
        values = -read_at(procedure, machine, postures)
        values[:, len(procedure.read) - len(procedure.measured) :] += readings.measured
        angular = np.array([name in ANGLES for name in procedure.read])
        # between -π and π: a turn may be read on the other side of the cut
        values = np.where(angular, np.remainder(values + np.pi, 2.0 * np.pi) - np.pi, values)
    slopes = jacobian(procedure, machine.geometry, postures, machine.link)
    return Residuals(procedure.read, values, postures), np.asarray(slopes)


def _inverse(readings: Readings, geometry: Geometry) -> FloatArray:
    """Sliders ``(p, 6)`` of postures as measured."""
    try:
        return np.asarray(inverse(geometry, readings.measured))
    except UnreachablePosture:
        _name_posture(readings, readings.measured, lambda posture: inverse(geometry, posture))
        raise


def read_at(procedure: Procedure, machine: HexaSlide, postures: FloatArray) -> FloatArray:
    """What is read where the machine stands ``(p, r)``: sliders with pose-inverse; of a constraint
    link by how much its ends are farther apart than it is long. Raises CalibrationError.
    """
    geometry = machine.geometry
    if procedure.kind is ProcedureKind.POSE_INVERSE:
        return np.asarray(inverse(geometry, postures))
    columns = {name: postures[:, k] for k, name in enumerate(COMPONENTS)}
    if procedure.kind is ProcedureKind.CONSTRAINT_LINK:
        columns["length"] = -stretch(machine.link, postures)
    if set(procedure.measured) & set(ENCODERS):
        angles = joint_angles(geometry, postures) + machine.zeros_rad
        columns |= zip(ENCODERS, angles.T, strict=True)
    return np.stack([columns[name] for name in procedure.read], axis=-1)


def stretch(link: ConstraintLink | None, postures: FloatArray) -> FloatArray:
    """Length of the constraint link less the distance of its ends ``(p,)`` in metres."""
    link = present(link)
    apart = postures[:, :3] + rotation(postures[:, 3:]) @ link.platform_end - link.base_end
    return np.asarray(link.length_m - np.linalg.norm(apart, axis=1))


def variances(readings: Readings, geometry: Geometry) -> FloatArray:
    """Covariance of the residuals of each posture ``(p, r, r)`` from that of what is measured.

    With pose-inverse the measured posture carries the noise, the sliders differ by what it does
    to them: ``C = J S Jᵀ``.
    """
    of_values = np.diag(readings.value_noise**2)
    if readings.procedure.kind is not ProcedureKind.POSE_INVERSE:
        return np.tile(of_values, (len(readings.sliders), 1, 1))
    _inverse(readings, geometry)  # names the posture that cannot be
    slope = legs(geometry, readings.measured).arms.by_posture
    return np.asarray(slope @ of_values @ np.swapaxes(slope, 1, 2))


def whitening(readings: Readings, geometry: Geometry) -> FloatArray:
    """``(p, r, r)``: makes residuals independent, each as uncertain as one measured length."""
    length = readings.length_noise_m or 1.0
    root = np.linalg.cholesky(variances(readings, geometry) / length**2)
    return np.asarray(np.linalg.inv(root))


def shares(
    readings: Readings, geometry: Geometry, residual: Residuals
) -> tuple[FloatArray, FloatArray]:
    """Shares of the squares of residuals, each in units of its own noise: by column ``(r,)`` and by
    posture ``(p,)``; zeros where all are zero.
    """
    of_rows = np.diagonal(variances(readings, geometry), axis1=1, axis2=2)
    squares = residual.values**2 / of_rows
    total = float(squares.sum())
    if total <= 0.0:
        return np.zeros(squares.shape[1]), np.zeros(len(squares))
    return np.asarray(squares.sum(axis=0) / total), np.asarray(squares.sum(axis=1) / total)
