"""The parameters of papers/001, section 2.3, and motions of frames that may stay unseen.

Chain by chain: joint on the platform, start of the rail, x and y of the rail's direction, length of
the link. The base frame fixes five of the 54; a constraint link adds its two ends and its length.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.hexaslide.geometry import CHAINS, ConstraintLink, Geometry, Numbers
from calib.observations import FloatArray

PER_CHAIN = ("Bx", "By", "Bz", "Ax", "Ay", "Az", "ax", "ay", "l")
ALL_NAMES = tuple(f"{part}{chain}" for chain in range(1, CHAINS + 1) for part in PER_CHAIN)
FIXED = ("Ax1", "Ay1", "Az1", "Ay2", "Az2")
FREE = tuple(k for k, name in enumerate(ALL_NAMES) if name not in FIXED)
NAMES = tuple(ALL_NAMES[k] for k in FREE)
END_NAMES = ("cx", "cy", "cz", "dx", "dy", "dz")
LENGTH_NAME = "L"


def unit_of(name: str) -> str:
    """The unit of a parameter: components of directions have none."""
    return "1" if name[:2] in {"ax", "ay"} else "m"


def values(geometry: Geometry) -> Numbers:
    """The 49 parameters of a geometry."""
    parts = [geometry.platform, geometry.base, geometry.rails[:, :2], geometry.links[:, None]]
    return np.concatenate(parts, axis=1).reshape(-1)[list(FREE)]


def with_values(geometry: Geometry, parameters: Numbers) -> Geometry:
    """The geometry with these 49 parameters; rails keep the sign of their z."""
    full = np.zeros(len(ALL_NAMES), dtype=parameters.dtype)
    full[list(FREE)] = parameters
    rows = full.reshape(CHAINS, len(PER_CHAIN))
    level = rows[:, 6:8]
    sign = np.sign(geometry.rails[:, 2].real)
    z = sign * np.sqrt(1.0 - (level * level).sum(axis=1))
    rails = np.column_stack([level, z])
    return Geometry(rows[:, 3:6], rails, rows[:, :3], rows[:, 8])


def motions(
    geometry: Geometry, link: ConstraintLink | None, names: tuple[str, ...]
) -> tuple[tuple[str, FloatArray], ...]:
    """Frames moved as wholes, as changes of the named parameters, each of unit length.

    The platform's frame may be turned and shifted with all that is fixed to it; where the end of
    the link on it is known, turned about that end. The base, held by its frame, may only be turned
    about X. Which of them a procedure loses, its derivatives tell.
    """
    end = np.zeros(3) if link is None else link.platform_end
    about_its, about_end = "platform frame turned about its", "platform frame turned about"
    found = [(f"{about_its} {axis}", turn) for axis, turn in _turns(geometry, end, np.zeros(3))]
    for axis, unit in zip("XYZ", np.eye(3), strict=True):
        shifted = _points("B", np.tile(unit, (CHAINS, 1))) | _point("c", unit)
        found.append((f"platform frame shifted along its {axis}", shifted))
    if link is not None and "cx" not in names:
        turns = _turns(geometry, end, end)
        found += [(f"{about_end} the link's end, {axis}", turn) for axis, turn in turns]
    about = np.array([1.0, 0.0, 0.0])
    base = _points("A", np.cross(about, geometry.base))
    base |= _points("a", np.cross(about, geometry.rails))
    far = np.zeros(3) if link is None else link.base_end
    found.append(("base turned about X", base | _point("d", np.cross(about, far))))
    return tuple((name, _vector(shares, names)) for name, shares in found)


def _turns(
    geometry: Geometry, end: FloatArray, centre: FloatArray
) -> Iterator[tuple[str, dict[str, float]]]:
    """The platform's joints and its end of the link turned about each axis through a point."""
    for axis, unit in zip("XYZ", np.eye(3), strict=True):
        joints = _points("B", np.cross(unit, geometry.platform - centre))
        yield axis, joints | _point("c", np.cross(unit, end - centre))


def _points(letter: str, points: FloatArray) -> dict[str, float]:
    found: dict[str, float] = {}
    for chain, point in enumerate(points, start=1):
        found |= {f"{name}{chain}": value for name, value in _point(letter, point).items()}
    return found


def _point(letter: str, point: FloatArray) -> dict[str, float]:
    return {f"{letter}{axis}": float(value) for axis, value in zip("xyz", point, strict=True)}


def _vector(shares: dict[str, float], names: tuple[str, ...]) -> FloatArray:
    vector = np.array([shares.get(name, 0.0) for name in names])
    return np.asarray(vector / np.linalg.norm(vector))
