"""A tripod that goes from posture to posture, as a simulated session measures it.

Everything follows from the seed: the machine, the zero of a mounting by its name, the scatter of an
approach by the run, the step and how many approaches there were.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.observations import Conditions, conditions
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import ZERO_SPREAD_MM, Model

OFFSET_LIMIT_MM = 2.0
LENGTH_SPREAD_MM = 0.03


def hidden_machine(
    geometry: Geometry, seed: int, entered_offsets_mm: Sequence[float] = (0.0, 0.0, 0.0)
) -> Model:
    """A machine with joint offsets up to 2 mm and well made legs, to be found by measuring.

    Offsets that were entered in its controller no longer show.
    """
    generator = np.random.default_rng([seed, 1])
    offsets = generator.uniform(-OFFSET_LIMIT_MM, OFFSET_LIMIT_MM, 3) - entered_offsets_mm
    lengths = generator.normal(scale=LENGTH_SPREAD_MM, size=3)
    return Model(geometry, tuple(np.concatenate([offsets, lengths]).tolist()))


@dataclass(frozen=True)
class Target:
    """Where a machine is sent and what reads there: `TOOL` or a leg, and for each of ``axes`` the
    name of its mounting. A new leg, station or set of axes is a new place of the stand.
    """

    step: int
    leg: int
    axes: tuple[int, ...]
    station: float
    displacement_mm: float
    mounts: tuple[str, ...]

    @property
    def place(self) -> tuple[int, float, tuple[int, ...]]:
        """Where the stand is."""
        return self.leg, self.station, self.axes


@dataclass
class SimulatedMachine:
    """The machine ``truth`` on its way; ``scatter_mm`` is that of a re-approach."""

    truth: Model
    seed: int
    run_name: str
    scatter_mm: float
    _before: Target | None = field(default=None, init=False)
    _approach: float = field(default=0.0, init=False)
    _visits: int = field(default=0, init=False)

    def go(self, to: Target, time_s: float) -> list[float]:
        """Readings in mm, one for each of the target's axes, at a time since the start."""
        exact = self.truth.readings(self._conditions_at(to, time_s))
        self._visits += 1
        run = zlib.crc32(self.run_name.encode())
        generator = np.random.default_rng([self.seed, run, to.step, self._visits])
        zeros = [self._zero_mm(mount) for mount in to.mounts]
        scatter = generator.normal(scale=self.scatter_mm, size=len(zeros))
        values: list[float] = (exact + zeros + scatter).tolist()
        return values

    def _zero_mm(self, mount: str) -> float:
        generator = np.random.default_rng([self.seed, 3, zlib.crc32(mount.encode())])
        return float(generator.normal(scale=ZERO_SPREAD_MM))

    def _conditions_at(self, to: Target, time_s: float) -> Conditions:
        """The conditions of these readings; the first approach to a place is not known."""
        before, self._before = self._before, to
        if before is None or before.place != to.place:
            self._approach = 0.0
        else:
            moved = float(np.sign(to.displacement_mm - before.displacement_mm))
            self._approach = moved or self._approach
        count = len(to.axes)
        taken = conditions(
            [to.leg] * count, to.axes, [to.displacement_mm] * count, station=to.station
        )
        return replace(
            taken, approach=np.full(count, self._approach), time_s=np.full(count, time_s)
        )
