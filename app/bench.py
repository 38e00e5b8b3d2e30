"""A simulated machine with simulated indicators: what demo and ``run --simulated`` measure."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from calib.observations import conditions
from calib.orthoglide.geometry import Geometry
from calib.orthoglide.model import Model
from calib.simulation import ZERO_SPREAD_MM
from drivers.profile import Profile
from drivers.rig import SimulatedRig
from drivers.twin_port import Transport
from protocols.procedure import Step, default_mount, leg_number

OFFSET_LIMIT_MM = 2.0
LENGTH_SPREAD_MM = 0.03


@dataclass(frozen=True)
class BenchSettings:
    """How the simulated indicators behave; ``scatter_mm`` is that of a re-approach."""

    resolution_mm: float = 0.001
    scatter_mm: float = 0.002
    motion_s: float = 0.0


def hidden_machine(geometry: Geometry, seed: int) -> Model:
    """A machine with joint offsets up to 2 mm and well made legs, to be found by measuring."""
    generator = np.random.default_rng([seed, 1])
    offsets = generator.uniform(-OFFSET_LIMIT_MM, OFFSET_LIMIT_MM, 3)
    lengths = generator.normal(scale=LENGTH_SPREAD_MM, size=3)
    return Model(geometry, tuple(np.concatenate([offsets, lengths]).tolist()))


class SimulatedBench:
    """A machine whose indicators answer over real serial connections.

    Everything follows from the seed, so an interrupted simulated session goes on with the same
    zeros.
    """

    def __init__(
        self,
        truth: Model,
        seed: int,
        profiles: list[Profile],
        transport: Transport,
        settings: BenchSettings,
    ) -> None:
        self._truth = truth
        self._seed = seed
        self._scatter_mm = settings.scatter_mm
        self._visits = 0
        self.rig = SimulatedRig(
            profiles,
            resolution_mm=settings.resolution_mm,
            transport=transport,
            motion_s=settings.motion_s,
        )

    def go(self, step: Step) -> None:
        """Move the machine to a step; each approach scatters a little."""
        leg = [leg_number(step.leg)] * len(step.axes)
        axes = [leg_number(axis) for axis in step.axes]
        displacement = [step.displacement_mm] * len(step.axes)
        exact = self._truth.readings(conditions(leg, axes, displacement, station=step.station))
        self._visits += 1
        generator = np.random.default_rng([self._seed, 2, step.number, self._visits])
        zeros = [self._zero_mm(default_mount(step.leg, axis, step.station)) for axis in step.axes]
        scatter = generator.normal(scale=self._scatter_mm, size=len(zeros))
        self.rig.go((exact + zeros + scatter).tolist())

    def _zero_mm(self, mount: str) -> float:
        generator = np.random.default_rng([self._seed, 3, zlib.crc32(mount.encode())])
        return float(generator.normal(scale=ZERO_SPREAD_MM))

    def close(self) -> None:
        """Switch everything off."""
        self.rig.close()
