"""Machines drawn from nothing: no part of them is taken from the example H60; places aligned."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calib.arrays import FloatArray
from calib.hexaslide.derivatives import jacobian
from calib.hexaslide.geometry import Box, ConstraintLink, Geometry, HexaSlide
from calib.hexaslide.procedures import Procedure

SHAPES = ("any", "planar platform", "planar base", "parallel rails", "flat", "symmetric")
"""Flat: planar platform and base, parallel rails. Symmetric: a pair of chains, thrice."""

HALF = np.array([0.3, 0.3, 0.3, 0.26, 0.26, 0.52])
LEAST_LEAN_M = 0.2
STEP = 1e-30


def aligned_rms_m(places: FloatArray, others: FloatArray) -> float:
    """R.m.s. between places ``(p, 3)`` once a shift and a turn lay them over each other.

    By scipy's solution of Wahba's problem, not by the program's motions of frames.
    """
    first, second = (part - part.mean(axis=0) for part in (places, others))
    turned, _ = Rotation.align_vectors(second, first)
    return float(np.sqrt(((turned.apply(first) - second) ** 2).sum(axis=1).mean()))


def drawn_machine(seed: int, shape: str) -> HexaSlide:
    """A machine that reaches all of its box, however odd it looks."""
    generator = np.random.default_rng([seed, SHAPES.index(shape)])
    draw = _symmetric if shape == "symmetric" else _six
    base, rails, platform = draw(generator, shape)
    centre = generator.uniform(-1.0, 1.0, 6) * [1.0, 1.0, 1.0, 0.5, 0.5, 3.0]
    box = Box(centre - HALF, centre + HALF)
    links = _long_enough(base, rails, platform, box, generator, alike=shape == "symmetric")
    ends = generator.uniform(-0.3, 0.3, (2, 3))
    link = ConstraintLink(ends[0], centre[:3] + ends[1] + [0.0, 0.0, -1.0], 0.5)
    return HexaSlide(Geometry(base, rails, platform, links), box, link)


def _six(generator: np.random.Generator, shape: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Six chains without anything in common, but for what the shape says."""
    base = generator.uniform(-1.0, 1.0, (6, 3))
    base[0] = base[1, 1:] = 0.0
    rails = np.array([_direction(generator) for _ in range(6)])
    platform = generator.uniform(-0.4, 0.4, (6, 3))
    if shape in {"planar platform", "flat"}:
        platform[:, 2] = 0.0
    if shape in {"planar base", "flat"}:
        base[:, 2] = 0.0
    if shape in {"parallel rails", "flat"}:
        rails[:] = rails[0]
    return base, rails, platform


def _direction(generator: np.random.Generator) -> FloatArray:
    """Evenly on the sphere, but for level ones."""
    while True:
        vector = generator.standard_normal(3)
        vector /= np.linalg.norm(vector)
        if abs(vector[2]) > 0.1:
            return np.asarray(vector)


def _symmetric(generator: np.random.Generator, _: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mirrored pairs at 120°, the rails of a pair parallel; the platform planar."""
    radius, spacing, joint_radius, joint_spacing = generator.uniform(0.1, 0.8, 4)
    tilt = generator.uniform(0.2, 1.4)
    side = np.array([[-1.0], [1.0]]) * [0.5, 0.0, 0.0]
    turn = np.array([[-0.5, -np.sqrt(0.75), 0.0], [np.sqrt(0.75), -0.5, 0.0], [0.0, 0.0, 1.0]])
    pair = (
        [0.0, radius, 0.0] + spacing * side,
        np.tile([0.0, -np.cos(tilt), -np.sin(tilt)], (2, 1)),
        [0.0, 0.5 * joint_radius, 0.0] + 0.5 * joint_spacing * side,
    )
    thirds = [np.linalg.matrix_power(turn, k).T for k in range(3)]
    base, rails, platform = (np.concatenate([part @ third for third in thirds]) for part in pair)
    return base - base[0], rails, platform


def _long_enough(
    base: FloatArray,
    rails: FloatArray,
    platform: FloatArray,
    box: Box,
    generator: np.random.Generator,
    *,
    alike: bool,
) -> FloatArray:
    """Links that reach their rails from everywhere: no point moves further than the box is wide."""
    joints = box.centre[:3] + platform - base
    across = np.linalg.norm(np.cross(joints, rails), axis=1)
    reach = across + np.linalg.norm(HALF[:3]) + 2.0 * np.linalg.norm(platform, axis=1)
    links = np.hypot(reach, LEAST_LEAN_M) + generator.uniform(0.0, 0.5, 6)
    return np.full(6, links.max()) if alike else links


def jacobian_and_slopes(
    procedure: Procedure,
    geometry: Geometry,
    postures: FloatArray,
    link: ConstraintLink | None = None,
) -> tuple[FloatArray, FloatArray]:
    """The Jacobian ``(p, r, k)`` and, by the complex step, its derivatives ``(p, r, k, 6)``."""
    count = len(postures)
    stepped = postures[None] + 1j * STEP * np.eye(6)[:, None]
    rows = jacobian(procedure, geometry, stepped.reshape(-1, 6), link)
    split = rows.reshape(6, count, *rows.shape[1:])
    return split[0].real, np.moveaxis(split.imag / STEP, 0, -1)
