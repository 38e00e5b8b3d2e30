"""A machine on six telescopic legs, computed from its definition alone, for tests and a bench.

A leg reads by how much the distance of its two joints is longer than its length at 0. Rotations are
those of scipy; no kinematics of the program take part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from protocols.hexaslide import load_hexaslide
from tests.conftest import ROOT

Array = NDArray[np.float64]

FILE = load_hexaslide(ROOT / "protocols" / "machines" / "gough-stewart.toml")
MACHINE = FILE.whole()
NOISE_M, NOISE_RAD = 1e-5, 2e-5
STEP, NEWTON_STEPS = 1e-5, 8


@dataclass
class Plain:
    """Joints on base and platform ``(6, 3)`` and lengths at 0 ``(6,)``, metres."""

    base: Array
    joint: Array
    zero: Array

    @staticmethod
    def of_file() -> Plain:
        chains = FILE.chain
        return Plain(
            np.array([chain.start_mm for chain in chains]) / 1000.0,
            np.array([chain.joint_mm for chain in chains]) / 1000.0,
            np.array([chain.link_mm for chain in chains]) / 1000.0,
        )

    def off(self, chance: np.random.Generator, size_m: float = 1e-3) -> Plain:
        """A machine that differs in everything but its base frame."""
        base, joint, zero = (
            values + chance.normal(0.0, size_m, values.shape)
            for values in (self.base, self.joint, self.zero)
        )
        base[0], base[1, 1:] = 0.0, 0.0
        return Plain(base, joint, zero)

    def reads(self, posture: Array) -> Array:
        """The drives at a posture ``(6,)``: x, y, z, then turns about Y, X and Z."""
        turn = Rotation.from_euler("YXZ", posture[3:])
        return np.asarray(
            np.linalg.norm(posture[:3] + turn.apply(self.joint) - self.base, axis=1) - self.zero
        )

    def stands(self, drives: Array, near: Array) -> Array:
        """The posture of drives ``(6,)`` next to another one: Newton with central differences."""
        posture = near
        for _ in range(NEWTON_STEPS):
            slopes = [
                (self.reads(posture + step) - self.reads(posture - step)) / (2.0 * STEP)
                for step in STEP * np.eye(6)
            ]
            miss = self.reads(posture) - drives
            posture = posture - np.linalg.solve(np.stack(slopes, axis=1), miss)
        return posture

    def with_value(self, name: str, step: float) -> Plain:
        """The same with one parameter changed."""
        base, joint, zero = self.base.copy(), self.joint.copy(), self.zero.copy()
        chain = int(name[-1]) - 1
        if name[0] == "l":
            zero[chain] += step
        else:
            (base if name[0] == "A" else joint)[chain, "xyz".index(name[1])] += step
        return Plain(base, joint, zero)


PLAIN = Plain.of_file()


def some(count: int, seed: int) -> Array:
    return MACHINE.random(count, np.random.default_rng(seed))
