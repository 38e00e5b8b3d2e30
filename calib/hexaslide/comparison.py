"""Whether a machine is the same in two sessions: at its platform, and in lengths of its own.

Each session has its machine from all of its models: parameters beside what may be missing, and
that. Machines are laid over each other by motions of frames that no reading of either shows; a
tracker that stands where it stood shows more than one that is set up anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.hexaslide.calibration import Calibration
from calib.hexaslide.checked import KnownValues, frames_apart, lengths_alone
from calib.hexaslide.correction import lengths_of, moved_by, over_all
from calib.hexaslide.diagnosis import FEWEST_SPARE, WeighedCauses
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.platform import Places, root_of
from calib.stats import variance_ratio_p_value

CHANGED = 0.01
"""Chance of a difference so large, below which the machine is taken as changed."""

SHOWN = 1e-6
"""Singular values, by the largest, of parameters that move the platform over the box."""


@dataclass(frozen=True, eq=False)
class MeasuredMachine:
    """What a session tells of its machine; without ``models`` parameters alone."""

    calibration: Calibration
    models: WeighedCauses | None

    def at(self, places: Places) -> tuple[FloatArray, FloatArray | None]:
        """What the platform does beside the calibrated parameters there ``(q,)``, and a root of the
        covariance of all of it ``(q, r)``; None where no noise is known.
        """
        models, calibrated = self.models, self.calibration
        if models is None:
            if calibrated.covariance is None:
                return np.zeros(len(places.moved)), None
            root = self._inflation * root_of(calibrated.covariance)
            return np.zeros(len(places.moved)), places.moved @ root[: places.moved.shape[1]]
        acting = moved_by(models, places) @ models.given_way + over_all(models, places)
        by_noise = moved_by(models, places) @ models.directions.inverse
        mean, covariance = models.mixture()
        return acting @ mean, self._inflation * np.hstack([by_noise, acting @ root_of(covariance)])

    @property
    def lengths_m(self) -> KnownValues:
        """`inner_lengths` ``(26,)``, of all models where there are any."""
        return lengths_alone(self.calibration) if self.models is None else lengths_of(self.models)

    @property
    def tells(self) -> bool:
        """Whether readings leave nothing open but frames, and would show what bends the rest."""
        return not self.calibration.left_open and self.calibration.free_values >= FEWEST_SPARE

    @property
    def _inflation(self) -> float:
        """More than noise is left: everything is known so much worse."""
        lack_of_fit = self.calibration.lack_of_fit or 1.0
        if self.models is not None:
            lack_of_fit = self.models.excess
        return float(max(1.0, lack_of_fit) ** 0.5)


@dataclass(frozen=True, eq=False)
class MachinesApart:
    """How far two machines are apart at the platform over the box, r.m.s. and largest, metres;
    ``chance_m`` what the noise of both makes of one machine at most, 95 %, r.m.s.; ``p_value`` of
    such a difference, by all movements that are determined. None where no noise is known, and where
    a machine is not determined.

    ``lengths_m`` ``(2, 26)`` are those that no frame changes, ``expanded_m`` ``(26,)`` 95 %
    uncertainties of their differences. ``free`` are the motions that were laid over.
    """

    rms_m: float
    largest_m: float
    chance_m: float | None
    p_value: float | None
    lengths_m: FloatArray
    expanded_m: FloatArray | None
    free: tuple[str, ...]

    @property
    def changed(self) -> bool | None:
        """None where that cannot be determined."""
        return None if self.p_value is None else self.p_value < CHANGED


def apart(reference: HexaSlide, first: MeasuredMachine, second: MeasuredMachine) -> MachinesApart:
    """How far apart machines are where a controller that holds ``reference`` sends them.

    Raises UnreachablePosture, CalibrationError.
    """
    machines = first, second
    free = tuple(
        dict.fromkeys(name for machine in machines for name in machine.calibration.unidentifiable)
    )
    places = [Places.of(reference, machine.calibration.machine, free) for machine in machines]
    effects, roots = zip(
        *(machine.at(at) for machine, at in zip(machines, places, strict=True)), strict=True
    )
    shift = frames_apart(places[0].postures, places[1].postures, free).apart_m.ravel()
    off = places[0].without_frames(shift + effects[1] - effects[0])
    square = (off.reshape(-1, 3) ** 2).sum(axis=1)
    chance_m = p_value = None
    is_determined = all(machine.tells for machine in machines)
    roots_of_noise = [root for root in roots if root is not None]
    if is_determined and len(roots_of_noise) == len(machines):
        spread = np.hstack(roots_of_noise)
        chance_m = places[0].bound_m(spread)
        # what parameters do: what rarely acts beside them is no normal of its covariance
        vectors, sizes, _ = np.linalg.svd(places[0].moved, full_matrices=False)
        vectors = vectors[:, sizes > SHOWN * sizes[0]]
        along, root = vectors.T @ off, vectors.T @ spread
        ratio = float(along @ np.linalg.solve(root @ root.T, along)) / len(along)
        freedom = min(machine.calibration.degrees_of_freedom for machine in machines)
        p_value = variance_ratio_p_value(ratio, len(along), freedom)
    lengths = [machine.lengths_m for machine in machines]
    halves = [length.expanded for length in lengths if length.expanded is not None]
    return MachinesApart(
        rms_m=float(np.sqrt(square.mean())),
        largest_m=float(np.sqrt(square.max())),
        chance_m=chance_m,
        p_value=p_value,
        lengths_m=np.array([length.values for length in lengths]),
        expanded_m=np.hypot(*halves) if is_determined and len(halves) == len(machines) else None,
        free=free,
    )
