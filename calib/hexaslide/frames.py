"""How far two machines are apart at the platform, once frames that no reading shows are laid over.

A Hexa Slide whose platform frame is turned and shifted, or whose base is turned about X, with all
that belongs to it, measures the same where these are not seen. Such a difference is no error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.hexaslide.geometry import Geometry, Numbers, values, with_values
from calib.hexaslide.kinematics import rotation
from calib.hexaslide.procedures import STEP
from calib.linalg import EXACT_BLIND
from calib.observations import FloatArray

MOTIONS = (
    "platform frame turned about its X",
    "platform frame turned about its Y",
    "platform frame turned about its Z",
    "platform frame shifted along its X",
    "platform frame shifted along its Y",
    "platform frame shifted along its Z",
    "base turned about X",
)
"""As `calib.hexaslide.geometry.motions` names them."""

ROUNDS = 6
"""Each squares what is left: from hundredths to rounding."""

PAIRS = tuple((i, j) for i in range(6) for j in range(i + 1, 6))


@dataclass(frozen=True, eq=False)
class FramesApart:
    """Constant motions that lay one machine over the other, and what they leave.

    ``turned_rad`` and ``shifted_m`` are those of the platform's frame, ``base_turned_rad`` of the
    base. ``places_m`` ``(p,)`` and ``angles_rad`` ``(p,)`` are distances and angles left between
    the postures.
    """

    turned_rad: float
    shifted_m: float
    base_turned_rad: float
    places_m: FloatArray
    angles_rad: FloatArray

    @property
    def places_rms_m(self) -> float:
        """Root mean square of the distances."""
        return float(np.sqrt((self.places_m**2).mean()))

    @property
    def places_worst_m(self) -> float:
        """The largest distance."""
        return float(self.places_m.max())

    @property
    def angles_rms_rad(self) -> float:
        """Root mean square of the angles."""
        return float(np.sqrt((self.angles_rad**2).mean()))


def frames_apart(found: FloatArray, true: FloatArray, free: tuple[str, ...]) -> FramesApart:
    """Compare postures ``(p, 6)`` of two machines at the same sliders; ``free`` of `MOTIONS`."""
    columns = [k for k, name in enumerate(MOTIONS) if name in free]
    places, turns = found[:, :3], rotation(found[:, 3:])
    true_turns = rotation(true[:, 3:])
    total = np.zeros(7)
    for _ in range(ROUNDS if columns else 0):
        miss = np.concatenate([true[:, :3] - places, _vectors(true_turns, turns)], axis=1)
        design = _design(places, turns)[..., columns].reshape(miss.size, -1)
        change = np.zeros(7)
        change[columns] = np.linalg.lstsq(design, miss.ravel(), rcond=EXACT_BLIND)[0]
        base = _about(np.array([change[6], 0.0, 0.0]))
        places = (places + turns @ change[3:6]) @ base.T
        turns = base @ turns @ _about(change[:3])
        total += change
    left = _vectors(true_turns, turns)
    return FramesApart(
        turned_rad=float(np.linalg.norm(total[:3])),
        shifted_m=float(np.linalg.norm(total[3:6])),
        base_turned_rad=float(abs(total[6])),
        places_m=np.asarray(np.linalg.norm(true[:, :3] - places, axis=1)),
        angles_rad=np.asarray(np.linalg.norm(left, axis=1)),
    )


def _design(places: FloatArray, turns: FloatArray) -> FloatArray:
    """Movement and turn ``(p, 6)`` of postures for each of the seven motions ``(p, 6, 7)``."""
    design = np.zeros((len(places), 6, 7))
    design[:, 3:, :3] = turns
    design[:, :3, 3:6] = turns
    design[:, :3, 6] = np.cross(np.array([1.0, 0.0, 0.0]), places)
    design[:, 3, 6] = 1.0
    return design


def _vectors(true: FloatArray, turns: FloatArray) -> FloatArray:
    """Rotation vectors ``(p, 3)`` from one orientation to the other."""
    from scipy.spatial.transform import Rotation  # 0.1 s to import: only where used

    return np.asarray(Rotation.from_matrix(true @ np.swapaxes(turns, 1, 2)).as_rotvec())


def _about(vector: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def inner_lengths(geometry: Geometry) -> Numbers:
    """Lengths that no choice of frames changes ``(26,)`` in metres: between the joints of the
    platform (15, in the order of `PAIRS`), from the first rail's start to the other five, six
    links.
    """
    first, second = np.array(PAIRS).T
    apart = geometry.platform[first] - geometry.platform[second]
    between = np.sqrt((apart * apart).sum(axis=1))
    starts = np.sqrt((geometry.base[1:] * geometry.base[1:]).sum(axis=1))
    return np.concatenate([between, starts, geometry.links])


def inner_slopes(geometry: Geometry) -> FloatArray:
    """Derivatives of `inner_lengths` by the 49 parameters ``(26, 49)``."""
    own = values(geometry)
    columns = [
        inner_lengths(with_values(geometry, own + 1j * STEP * unit)).imag / STEP
        for unit in np.eye(len(own))
    ]
    return np.stack(columns, axis=1)
