"""A Hexa Slide that differs from its drawing, and what is measured on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.arrays import FloatArray
from calib.errors import CalibrationError
from calib.hexaslide.geometry import (
    MOST_DRAWN,
    Box,
    HexaSlide,
    first_of_draws,
    inverse,
    present,
    rotation,
)
from calib.hexaslide.procedures import ANGLES, Procedure, ProcedureKind
from calib.hexaslide.residuals import Readings, read_at, standing, stretch

MOST_ERROR = 0.02
"""Of a simulated machine where no tolerance is known, metres or radians."""

AROUND = 0.05
"""Metres and radians that a true machine is let out of the box of its file."""


def simulate(
    procedure: Procedure,
    nominal: HexaSlide,
    postures: FloatArray | int,
    seed: int,
    *,
    errors_m: float,
    length_noise_m: float,
    angle_noise_rad: float,
) -> tuple[Readings, HexaSlide]:
    """Readings of a machine that differs from its drawing by ``errors_m``, and that machine.

    Raises as `disturbed` and `measure`.
    """
    generator = np.random.default_rng(seed)
    truth = disturbed(nominal, procedure, errors_m, generator)
    readings = measure(
        procedure,
        nominal,
        truth,
        postures,
        generator,
        length_noise_m=length_noise_m,
        angle_noise_rad=angle_noise_rad,
    )
    return readings, truth


def disturbed(
    machine: HexaSlide, procedure: Procedure, size_m: float, generator: np.random.Generator
) -> HexaSlide:
    """The machine with a normal error of standard deviation ``size_m`` in every parameter of the
    procedure; components of rails by the same number, so that 1e-3 is 1 mm in 1 m.

    Raises CalibrationError where that is no machine any more.
    """
    names = procedure.parameters
    parameters = machine.parameters(names)
    return machine.with_parameters(
        names, parameters + generator.normal(0.0, size_m, len(parameters))
    )


def measure(
    procedure: Procedure,
    nominal: HexaSlide,
    truth: HexaSlide,
    postures: FloatArray | int,
    generator: np.random.Generator,
    *,
    length_noise_m: float = 0.0,
    angle_noise_rad: float = 0.0,
) -> Readings:
    """Readings at these postures ``(p, 6)``, or at so many random ones.

    The controller, which knows the nominal machine, goes to postures in the box; the true machine
    stands where these sliders put it, and is measured there with noise. A constraint link takes
    the platform along instead: the true machine stands on the link's sphere, the sliders are moved
    by it, and the noise is the play of the link; one with an indicator in it holds nothing. Scales
    of sliders are exact. Raises UnreachablePosture, and CalibrationError where the link's sphere
    misses the box.
    """
    if procedure.has_rigid_link:
        if isinstance(postures, int):
            reached = random_on_link(truth, postures, generator, length_noise_m)
        else:
            play = length_noise_m * generator.standard_normal(len(postures))
            reached = on_link(truth, postures, play)
        sliders = np.asarray(inverse(truth.geometry, reached))
    else:
        if isinstance(postures, int):
            postures = nominal.random(postures, generator)
        sliders = np.asarray(inverse(nominal.geometry, postures))
        reached = standing(truth, sliders, postures)
    measured = _measured(procedure, truth, reached, generator, length_noise_m, angle_noise_rad)
    return Readings(procedure, sliders, measured, length_noise_m, angle_noise_rad)


def _measured(
    procedure: Procedure,
    truth: HexaSlide,
    reached: FloatArray,
    generator: np.random.Generator,
    length_noise_m: float,
    angle_noise_rad: float,
) -> FloatArray:
    """What is measured ``(p, m)`` where the true machine stands."""
    names = procedure.measured
    if not names:
        return np.zeros((len(reached), 0))
    is_whole = procedure.kind is ProcedureKind.POSE_INVERSE
    stands = reached if is_whole else read_at(procedure, truth, reached)
    noise = [angle_noise_rad if name in ANGLES else length_noise_m for name in names]
    stands = stands[:, stands.shape[1] - len(names) :]
    return np.asarray(stands + noise * generator.standard_normal(stands.shape))


class SimulatedHexaSlide:
    """A machine that differs from its file by its tolerances ``(k,)``, behind who measures it.

    Its errors come from ``seed`` alone, unless the ``true`` machine is given; the noise of a
    reading from that, the number of its posture and how often it was taken: an interrupted session
    goes on with the same machine. Raises CalibrationError where the tolerances lead to no machine.
    """

    def __init__(
        self,
        procedure: Procedure,
        nominal: HexaSlide,
        tolerances: FloatArray,
        seed: int,
        true: HexaSlide | None = None,
    ) -> None:
        parameters = nominal.parameters(procedure.parameters)
        errors = np.random.default_rng(seed).normal(0.0, np.minimum(tolerances, MOST_ERROR))
        true = true or nominal.with_parameters(procedure.parameters, parameters + errors)
        # the true machine reaches a little farther than the box that its file allows
        around = Box(nominal.box.lower - AROUND, nominal.box.upper + AROUND)
        self.procedure, self.seed, self.truth = procedure, seed, replace(true, box=around)

    def read(
        self, posture: FloatArray, sliders: FloatArray, number: int, attempt: int, noise: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Sliders ``(6,)`` and values ``(m,)`` of a posture ``(6,)``, sent to ``sliders``; metres
        and radians. ``noise`` is that of a length and of an angle. Raises as `measure`.
        """
        generator = np.random.default_rng([self.seed, number, attempt])
        length_m, angle_rad = noise.tolist()
        procedure, commanded = self.procedure, posture[None]
        if procedure.has_rigid_link:
            reached = on_link(self.truth, commanded, length_m * generator.standard_normal(1))
            sliders = np.asarray(inverse(self.truth.geometry, reached))[0]
        else:
            reached = standing(self.truth, sliders[None], commanded)
        values = _measured(procedure, self.truth, reached, generator, length_m, angle_rad)
        return sliders, values[0]


def link_postures(
    machine: HexaSlide, postures: FloatArray, play_m: FloatArray | float = 0.0
) -> FloatArray:
    """Postures ``(p, 6)`` lifted or lowered until the ends of the constraint link are as far apart
    as it is long, and ``play_m`` ``(p,)`` more; their z is NaN where none does that, and may leave
    the box. Raises CalibrationError for a machine without link.
    """
    box, link = machine.box, present(machine.link)
    ends = postures[:, :3] + rotation(postures[:, 3:]) @ link.platform_end
    apart = ends - link.base_end
    side = np.sign(box.centre[2] + link.platform_end[2] - link.base_end[2])
    square = (link.length_m + play_m) ** 2 - (apart[:, :2] ** 2).sum(axis=1)
    on_link = postures.copy()
    on_link[:, 2] += side * np.sqrt(np.where(square > 0.0, square, np.nan)) - apart[:, 2]
    return np.asarray(on_link)


def between(box: Box, postures: FloatArray) -> NDArray[np.bool_]:
    """Which postures ``(p,)`` are neither below nor above the box."""
    return np.asarray((box.lower[2] <= postures[:, 2]) & (postures[:, 2] <= box.upper[2]))


def on_link(
    machine: HexaSlide, postures: FloatArray, play_m: FloatArray | float = 0.0
) -> FloatArray:
    """`link_postures`. Raises CalibrationError naming the first that the link cannot hold inside
    the box, and the lengths with which it could.
    """
    on_link = link_postures(machine, postures, play_m)
    box, link = machine.box, present(machine.link)
    outside = np.flatnonzero(~between(box, on_link))
    if len(outside):
        ends = np.tile(postures[outside[0]], (2, 1))
        ends[:, 2] = box.lower[2], box.upper[2]
        least, greatest = np.sort(1000.0 * (link.length_m - stretch(link, ends)))
        raise CalibrationError(
            f"posture {outside[0] + 1}",
            f"a constraint link of {1000.0 * link.length_m:g} mm",
            f"{least:.1f} to {greatest:.1f} mm there, between the lower and the upper end of "
            "the box",
        )
    return on_link


def random_on_link(
    machine: HexaSlide, count: int, generator: np.random.Generator, play_m: float = 0.0
) -> FloatArray:
    """Random postures ``(count, 6)`` of the box that the link holds, its play normal with this
    standard deviation. Raises CalibrationError where hardly any is.
    """

    def draw() -> FloatArray:
        play = play_m * generator.standard_normal(count)
        on_link = link_postures(machine, machine.box.random(count, generator), play)
        return np.asarray(on_link[between(machine.box, on_link)])

    postures = first_of_draws(draw, count)
    if len(postures) < count:
        raise CalibrationError(
            "constraint link",
            f"a length of {present(machine.link).length_m:g} m that {len(postures)} of "
            f"{MOST_DRAWN * count} random postures keep",
            "ends and a length that let the platform move in the box",
        )
    return postures
