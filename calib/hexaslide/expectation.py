"""What the next posture should read: the machine's tolerances, and all postures read before.

Parameters are normal about the machine file, with its tolerances; with every posture the most
likely ones are found again, and the next is expected from them. Nothing of it enters a calibration.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np

from calib.arrays import FloatArray
from calib.errors import CalibrationError
from calib.hexaslide.geometry import CHAINS, HexaSlide
from calib.hexaslide.procedures import ANGLES, COMPONENTS, Procedure, ProcedureKind
from calib.hexaslide.residuals import Readings, postures_of, residuals
from calib.stats import variance_ratio_p_value

CURVED_M = 0.05
"""What is expected is not linear: a value that varies by so much is off by as much again."""

ASSUMED = 1e-4
"""Noise of a value where none is stated, metres or radians."""

STEPS = 3
"""Of Gauss and Newton, from the last result."""

UNKNOWN = 10.0
"""Standard deviation of a parameter without tolerance, radians or metres."""

DOUBTFUL = 1e-5
"""Below this p-value a posture is questioned: once in a thousand sessions of 100 good ones."""

PLAUSIBLE = 1e-2
"""From this p-value on another way of reading a posture explains it."""

FRAME_MOST = 1e-3
"""A frame that was laid over leaves no more of the squares of what had been off, nor of those of
the way that places are apart: in another unit they are far off, and hardly apart."""


@dataclass(frozen=True, eq=False)
class Departure:
    """How one posture departs: by how much what is read ``(r,)`` differs from what was expected,
    metres and radians, the standard deviations of that, and the p-value of all together.
    """

    names: tuple[str, ...]
    off: FloatArray
    deviation: FloatArray
    p_value: float

    @property
    def is_doubtful(self) -> bool:
        """Whether a person should look again."""
        return self.p_value < DOUBTFUL

    @property
    def worst(self) -> int:
        """The value that differs most for its deviation."""
        return int(np.abs(self.off / self.deviation).argmax())

    @property
    def shown(self) -> tuple[str, float, float, str]:
        """The value that departs most: its name, by how much, the deviation, and their unit, mm or
        °.
        """
        k = self.worst
        is_angle = self.names[k] in ANGLES
        size, unit = (float(np.degrees(1.0)), "°") if is_angle else (1000.0, "mm")
        return self.names[k], size * float(self.off[k]), size * float(self.deviation[k]), unit


class Expectation:
    """What is expected of a machine with tolerances ``(k,)`` of the procedure's parameters."""

    def __init__(self, procedure: Procedure, machine: HexaSlide, tolerances: FloatArray) -> None:
        if procedure.kind is ProcedureKind.POSE_INVERSE:  # sliders are set, postures are read
            procedure = Procedure.of(ProcedureKind.POSE_FORWARD).on(machine)
        self.procedure, self._nominal = procedure, machine
        self._tolerances = np.minimum(tolerances, UNKNOWN)
        self._begin = machine.parameters(procedure.parameters)
        self._machine, self._off = machine, np.zeros(len(tolerances))
        self._covariance = np.diag(self._tolerances**2)
        self._learnt: Readings | None = None
        self._stood = np.zeros((0, 6))

    def departure(self, readings: Readings) -> Departure | None:
        """How the first posture of readings departs; None where the machine has no such posture."""
        first = replace(_first(readings), procedure=self.procedure)
        try:
            residual, slopes = residuals(first, self._machine, postures_of(first, self._machine))
        except CalibrationError:
            return None
        off, row = residual.values[0], slopes[0]
        spread = np.sqrt((row @ self._covariance * row).sum(axis=1))
        curved = (spread * min(float(spread.max()) / CURVED_M, 1.0)) ** 2
        covariance = row @ self._covariance @ row.T + np.diag(curved + _noise(first) ** 2)
        joint = float(off @ np.linalg.solve(covariance, off)) / len(off)
        return Departure(
            self.procedure.read,
            off,
            np.sqrt(covariance.diagonal()),
            variance_ratio_p_value(joint, len(off), np.inf),
        )

    def learn(self, readings: Readings) -> None:
        """What readings tell of the next ones.

        Raises UnreachablePosture, CalibrationError for a posture that this machine has not.
        """
        new = replace(readings, procedure=self.procedure)
        machine, off, learnt = self._machine, self._off, self._learnt
        postures = np.concatenate([self._stood, postures_of(new, machine)])
        if learnt is not None:
            sliders = np.concatenate([learnt.sliders, new.sliders])
            measured = np.concatenate([learnt.measured, new.measured])
            new = replace(new, sliders=sliders, measured=measured)
        for _ in range(STEPS):
            postures = postures_of(new, machine, postures)
            residual, slopes = residuals(new, machine, postures)
            weights = np.tile(_noise(new), len(new.sliders)) ** -2
            rows = slopes.reshape(len(weights), -1)
            information = (rows.T * weights) @ rows + np.diag(self._tolerances**-2.0)
            pull = rows.T @ (weights * residual.values.ravel()) - off / self._tolerances**2
            off = off + np.linalg.solve(information, pull)
            machine = self._nominal.with_parameters(self.procedure.parameters, self._begin + off)
        self._learnt, self._machine, self._off, self._stood = new, machine, off, postures
        self._covariance = np.linalg.inv(information)


def _noise(readings: Readings) -> FloatArray:
    """Noise of each value that is read ``(r,)``; `ASSUMED` where none is stated."""
    if readings.noise_m is None:
        return np.full(len(readings.procedure.read), ASSUMED)
    return readings.value_noise


def _first(readings: Readings) -> Readings:
    return readings.take(np.arange(len(readings.sliders)) == 0)


def other_ways(readings: Readings) -> Iterator[tuple[str, Readings]]:
    """The first posture as it would be after one mistake of who measured, with its words."""
    first = _first(readings)
    names = first.procedure.measured
    for i, j in combinations(range(CHAINS), 2):
        sliders = _exchanged(first.sliders, i, j)
        yield f"sliders {i + 1} and {j + 1} exchanged", replace(first, sliders=sliders)
    for k, name in enumerate(names):
        flipped = first.measured.copy()
        flipped[:, k] *= -1.0
        yield f"{name} with the other sign", replace(first, measured=flipped)
        for m in range(k + 1, len(names)):
            if (name in ANGLES) == (names[m] in ANGLES):
                swapped = _exchanged(first.measured, k, m)
                yield f"{name} and {names[m]} exchanged", replace(first, measured=swapped)


def _exchanged(values: FloatArray, i: int, j: int) -> FloatArray:
    order = np.arange(values.shape[1])
    order[[i, j]] = j, i
    return np.asarray(values[:, order])


def explanations(
    expectation: Expectation,
    readings: Readings,
    elsewhere: Sequence[tuple[str, FloatArray]] = (),
) -> tuple[str, ...]:
    """Mistakes, each of which alone would make a doubtful posture an expected one; ``elsewhere``
    are other sliders ``(6,)`` in which the machine may have stood, with their words.
    """
    first, ways = _first(readings), []
    readings_elsewhere = ((label, replace(first, sliders=row[None])) for label, row in elsewhere)
    for label, readings_beside in chain(other_ways(first), readings_elsewhere):
        departure = expectation.departure(readings_beside)
        if departure is not None and departure.p_value > PLAUSIBLE:
            ways.append(label)
    return tuple(ways)


@dataclass(frozen=True, eq=False)
class OtherFrame:
    """What makes the machine's places the measured ones: a turn by ``turned_deg`` about the unit
    vector ``axis`` ``(3,)``, then a shift by ``shifted_m`` ``(3,)``.
    """

    turned_deg: float
    axis: FloatArray
    shifted_m: FloatArray


def other_frame(readings: Readings, machine: HexaSlide) -> OtherFrame | None:
    """The frame in which all measured places would be those of the machine, None where no other
    frame explains them. Places alone are looked at. Raises UnreachablePosture.
    """
    if not readings.procedure.measures_places or len(readings.sliders) < 4:
        return None
    from scipy.spatial.transform import Rotation  # 0.1 s to import: only where used

    names = readings.procedure.measured
    columns = [names.index(name) for name in COMPONENTS[:3]]
    forward = replace(readings, procedure=Procedure.of(ProcedureKind.POSE_FORWARD, names))
    expected = postures_of(forward, machine)[:, :3]
    places = readings.measured[:, columns]
    centre, far = expected.mean(axis=0), places.mean(axis=0)
    left_vectors, _, right = np.linalg.svd((places - far).T @ (expected - centre))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left_vectors @ right))])
    turn = right.T @ mirror @ left_vectors.T
    remainder = places @ turn.T + (centre - turn @ far) - expected
    squares = [(part**2).sum() for part in (remainder, places - expected, expected - centre)]
    if squares[0] > FRAME_MOST * min(squares[1:]):
        return None
    vector = Rotation.from_matrix(turn.T).as_rotvec()
    angle = float(np.linalg.norm(vector))
    return OtherFrame(float(np.degrees(angle)), vector / (angle or 1.0), far - turn.T @ centre)
