"""A tripod that goes from posture to posture, as a simulated session measures it.

Everything follows from the seed: the machine, the zero of a mounting by its name, the scatter of an
approach by the run, the step and how many approaches there were.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.arrays import TOOL, Conditions, FloatArray
from calib.tripod.geometry import Geometry
from calib.tripod.movements import carriage_movement
from calib.tripod.pipeline import TILT_SPREAD, ZERO_SPREAD_MM, Model

OFFSET_LIMIT_MM = 2.0
LENGTH_SPREAD_MM = 0.03


def hidden_machine(
    geometry: Geometry, seed: int, entered_offsets_mm: Sequence[float] = (0.0, 0.0, 0.0)
) -> Model:
    """A machine with joint offsets up to 2 mm and well made legs, to be found by measuring.

    Offsets that were entered in its controller no longer show.
    """
    # a stream of numbers for each purpose: 3 zeros, 4 tilts, 5 hidden effects, 6 rails; one more
    # draw of one changes nothing of the others
    generator = np.random.default_rng([seed, 1])
    offsets = generator.uniform(-OFFSET_LIMIT_MM, OFFSET_LIMIT_MM, 3) - entered_offsets_mm
    lengths = generator.normal(scale=LENGTH_SPREAD_MM, size=3)
    return Model(geometry, tuple(np.concatenate([offsets, lengths]).tolist()))


@dataclass
class SimulatedMachine:
    """The machine ``truth`` on its way; ``scatter_mm`` is that of a re-approach.

    The tool lifts off by ``lift_mm`` along the axis before it is read; 0: it slides.
    """

    truth: Model
    seed: int
    run_name: str
    scatter_mm: float
    lift_mm: float = 0.0
    _before: Conditions | None = field(default=None, init=False)
    _approach: float = field(default=0.0, init=False)
    _movement: FloatArray = field(default_factory=lambda: np.zeros(3), init=False)
    _visits: int = field(default=0, init=False)

    def go(self, to: Conditions, mounts: Sequence[str], step: int, time_s: float) -> list[float]:
        """Readings in mm of one posture, one for each named mounting, so long after the start."""
        on_the_way = replace(
            to,
            movement=self._movement_to(to),
            approach=np.full(len(to), self._approach_to(to)),
            time_s=np.full(len(to), time_s),
        )
        exact = self.truth.readings(on_the_way)
        self._visits += 1
        run = zlib.crc32(self.run_name.encode())
        generator = np.random.default_rng([self.seed, run, step, self._visits])
        zeros = [
            self._of_mount(3, mount, ZERO_SPREAD_MM)
            + np.nan_to_num(self._of_mount(4, mount, TILT_SPREAD) * along)
            for mount, along in zip(mounts, to.along_mm.tolist(), strict=True)
        ]
        scatter = generator.normal(scale=self.scatter_mm, size=len(zeros))
        return [*(exact + zeros + scatter).tolist()]

    def _of_mount(self, purpose: int, mount: str, spread: float) -> float:
        """A mounting's zero, mm, or the tilt of the plane under it, by the stream's purpose."""
        generator = np.random.default_rng([self.seed, purpose, zlib.crc32(mount.encode())])
        return float(generator.normal(scale=spread))

    def _movement_to(self, to: Conditions) -> FloatArray:
        """Sign of each carriage's last movement ``(n, 3)`` of a tool that is read; else 0."""
        position_before = self._before
        if TOOL in to.leg and (self.lift_mm or position_before is not None):
            start = to.position_mm[:1] + self.lift_mm * np.eye(3)[to.axis[:1]]
            if position_before is not None and not self.lift_mm:
                start = position_before.position_mm[:1]
            shift = carriage_movement(self.truth.geometry, start, to.position_mm[:1])[0]
            self._movement = np.where(shift != 0.0, shift, self._movement)
        return np.tile(self._movement, (len(to), 1))

    def _approach_to(self, to: Conditions) -> float:
        """Sign of the last movement; the first approach to another leg, axis or station has none.

        What did not move keeps the approach that it had.
        """
        position_before, self._before = self._before, to
        names = ("leg", "axis") if to.over_plane.all() else ("leg", "axis", "station")
        if position_before is None or any(
            not np.array_equal(getattr(position_before, name), getattr(to, name))
            for name in (*names, "over_plane")
        ):
            self._approach = 0.0
        else:
            shift = float(np.sign(to.displacement_mm[0] - position_before.displacement_mm[0]))
            self._approach = shift or self._approach
        return self._approach
