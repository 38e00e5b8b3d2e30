"""A Hexa Slide that differs from its drawing, and what is measured on it."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.errors import CalibrationError
from calib.hexaslide.geometry import Box, ConstraintLink, HexaSlide, inverse, present, rotation
from calib.hexaslide.procedures import ANGLES, Procedure, ProcedureKind
from calib.hexaslide.residuals import Readings, read_at, standing

MOST_ROUNDS = 50


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
    own = machine.parameters(names)
    return machine.with_parameters(names, own + generator.normal(0.0, size_m, len(own)))


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
    by it, and the noise is the play of the link. Scales of sliders are exact. Raises
    UnreachablePosture, and CalibrationError where the link's sphere misses the box.
    """
    if procedure.kind is ProcedureKind.CONSTRAINT_LINK:
        reached = _on_link(truth, postures, generator, length_noise_m)
        sliders = np.asarray(inverse(truth.geometry, reached))
    else:
        if isinstance(postures, int):
            postures = nominal.random(postures, generator)
        sliders = np.asarray(inverse(nominal.geometry, postures))
        reached = standing(truth, sliders, postures)
    names, measured = procedure.measured, np.zeros((len(reached), 0))
    if names:
        stands = read_at(Procedure.of(ProcedureKind.POSE_FORWARD, names), truth, reached)
        noise = [angle_noise_rad if name in ANGLES else length_noise_m for name in names]
        measured = stands + noise * generator.standard_normal(stands.shape)
    return Readings(procedure, sliders, measured, length_noise_m, angle_noise_rad)


def _on_link(
    truth: HexaSlide, postures: FloatArray | int, generator: np.random.Generator, play_m: float
) -> FloatArray:
    """Postures ``(p, 6)`` at which the ends are as far apart as the link is long."""
    link = present(truth.link)
    if not isinstance(postures, int):
        play = play_m * generator.standard_normal(len(postures))
        given = _held(truth.box, link, postures, play)
        if len(given) < len(postures):
            raise CalibrationError(
                "postures on the constraint link",
                f"{len(given)} of {len(postures)} that the link holds inside the box",
                "postures whose ends can be as far apart as the link is long",
                "Give other postures, or none: then random ones are held.",
            )
        return given
    count, held = postures, np.zeros((0, 6))
    for _ in range(MOST_ROUNDS):
        play = play_m * generator.standard_normal(count)
        free = truth.box.random(count, generator)
        held = np.vstack([held, _held(truth.box, link, free, play)])
        if len(held) >= count:
            return held[:count]
    raise CalibrationError(
        "constraint link",
        f"a length of {link.length_m:g} m that {len(held)} of "
        f"{MOST_ROUNDS * count} random postures keep",
        "ends and a length that let the platform move in the box",
    )


def _held(box: Box, link: ConstraintLink, free: FloatArray, play_m: FloatArray) -> FloatArray:
    """Postures ``(q, 6)`` lifted or lowered until the link holds them, those in the box."""
    ends = free[:, :3] + rotation(free[:, 3:]) @ link.platform_end
    apart = ends - link.base_end
    side = np.sign(box.centre[2] + link.platform_end[2] - link.base_end[2])
    square = (link.length_m + play_m) ** 2 - (apart[:, :2] ** 2).sum(axis=1)
    held = free[square > 0.0]
    height = side * np.sqrt(square[square > 0.0])
    held[:, 2] += height - apart[square > 0.0, 2]
    inside = (held[:, 2] >= box.lower[2]) & (held[:, 2] <= box.upper[2])
    return np.asarray(held[inside])
