"""A machine of its own for the blind bench: written from the theory, sharing nothing with calib.

Lengths mm, angles rad, times s. A hidden machine is a set of named arrays of amounts; a hidden
effect is some of their entries. Everything is nonlinear and exact but for the sag of the legs,
which is iterated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
Hypothesis = tuple[str, tuple[int, ...]]

LEG_MM = 310.25
DOWN = np.array([0.0, 0.0, -1.0])
SAG_ROUNDS = 3
LOOSE = 0.03  # part of the weight that friction holds in a joint with clearance

# What each entry means; [leg, towards] and [leg, axis] are 3 × 3.
SHAPES: dict[str, tuple[int, ...]] = {
    "offset": (3,),  # mm, true joint coordinate minus commanded one
    "length": (3,),  # mm
    "lean": (3, 3),  # rad, axis of a leg towards another
    "shift": (3, 3),  # mm, axis of a leg moved sideways
    "curve": (3, 3),  # 1/mm, foot leaves its line with the square of travel
    "scale": (3,),  # mm/mm of travel
    "sine": (3,),  # mm
    "cosine": (3,),  # mm
    "lost": (3,),  # mm that the foot stays back when going down
    "sag": (3,),  # mm that a leg shortens under the whole weight
    "drift": (3,),  # mm/s for each measuring axis
    "taper": (3, 3),  # mm/mm along the bar from tool to foot
    "bow": (3, 3),  # 1/mm, from the middle of the bar
    "gain": (3, 3),
    "tilt": (3, 3),  # rad, towards the other lateral axis
    "s_guide": (3, 3),  # mm at 100 mm of travel, foot leaves its line with its cube
    "clearance": (3,),  # mm that a leg is longer pulled than pressed
    "round": (3, 3),  # 1/mm, bar under a plain tip, by the side that is touched
    "lag": (3, 3),  # mm between up and down of an indicator
    "stand": (3, 3),  # mm/s of a stand
    "cubic": (3,),  # mm at 100 mm of travel
    "saw": (3,),  # mm from tooth to tooth
    "product": (3, 3),  # mm, travel of a leg times travel of another / 1000 mm²
    "smooth": (3, 3),  # mm, any smooth function of displacement
    "plane": (3, 3),  # rad, a plane under a leg across an axis, upwards from the tool
}


@dataclass(frozen=True, eq=False)
class Rows:
    """How each reading was taken; arrays of ``(n,)``, ``moved`` ``(n, 3)``.

    ``moved`` is the sign of each carriage's last movement; ``visit`` numbers the postures driven
    to, so readings of one visit were taken without moving.
    """

    leg: IntArray
    axis: IntArray
    displacement_mm: FloatArray
    station: FloatArray
    time_s: FloatArray
    cycle: IntArray
    visit: IntArray
    mount: IntArray
    moved: FloatArray
    plane: NDArray[np.bool_] | None = None

    @property
    def over_plane(self) -> NDArray[np.bool_]:
        """Read over a plane: the stand slides to the station in the posture itself."""
        return np.zeros(len(self), dtype=np.bool_) if self.plane is None else self.plane

    def __len__(self) -> int:
        return len(self.leg)


def _nothing() -> dict[str, FloatArray]:
    return {name: np.zeros(shape) for name, shape in SHAPES.items()}


@dataclass(frozen=True, eq=False)
class Hidden:
    """One machine with its indicators: amounts, and settings that no amount scales."""

    amounts: dict[str, FloatArray] = field(default_factory=_nothing)
    lead_mm: float = 5.0
    saw_period_mm: float = 23.0
    waves: tuple[tuple[float, float], ...] = ((0.021, 0.3), (0.047, 1.9))

    def plus(self, changes: Sequence[tuple[Hypothesis, float]]) -> Hidden:
        """The same machine with these entries larger by so much."""
        amounts = {name: array.copy() for name, array in self.amounts.items()}
        for (name, index), amount in changes:
            amounts[name][index] += amount
        return Hidden(amounts, self.lead_mm, self.saw_period_mm, self.waves)


def carriages(tool_mm: FloatArray) -> FloatArray:
    """What the controller commands for tool points ``(n, 3)``: nominal joints ``(n, 3)``."""
    squares = tool_mm**2
    return np.asarray(tool_mm + np.sqrt(LEG_MM**2 - squares.sum(axis=1, keepdims=True) + squares))


def three_spheres(centres: FloatArray, radii: FloatArray) -> FloatArray:
    """The common point ``(n, 3)`` on the near side; centres ``(n, 3, 3)``, radii ``(n, 3)``.

    Raises ValueError where the spheres do not meet.
    """
    a, b, c = centres[:, 0], centres[:, 1], centres[:, 2]
    ab = np.linalg.norm(b - a, axis=1)
    along = (b - a) / ab[:, None]
    reach = _dots(along, c - a)
    across = c - a - reach[:, None] * along
    height = np.linalg.norm(across, axis=1)
    across = across / height[:, None]
    x = (radii[:, 0] ** 2 - radii[:, 1] ** 2 + ab**2) / (2 * ab)
    y = (radii[:, 0] ** 2 - radii[:, 2] ** 2 + reach**2 + height**2 - 2 * reach * x) / (2 * height)
    square = radii[:, 0] ** 2 - x**2 - y**2
    if not np.all(square > 0):
        raise ValueError("three legs of these lengths cannot meet: use smaller errors")
    plane = a + x[:, None] * along + y[:, None] * across
    normal = np.cross(along, across)
    outward = normal * np.sign(_dots(normal, plane))[:, None]
    return np.asarray(plane - np.sqrt(square)[:, None] * outward)


def _dots(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray((a * b).sum(axis=1))


def feet_of(hidden: Hidden, commanded: FloatArray, moved: FloatArray) -> FloatArray:
    """Feet of the three legs ``(n, 3, 3)`` for commanded joints ``(n, 3)``."""
    amounts = hidden.amounts
    travel = commanded - LEG_MM
    joint = commanded + amounts["offset"] + _travel_error(hidden, travel)
    joint = joint + amounts["lost"] * (moved < 0)
    directions = np.eye(3) + amounts["lean"]
    sideways = amounts["shift"] + amounts["curve"] * travel[:, :, None] ** 2
    sideways = sideways + amounts["s_guide"] * (travel[:, :, None] / 100.0) ** 3
    return np.asarray(joint[:, :, None] * directions + sideways)


def _travel_error(hidden: Hidden, travel: FloatArray) -> FloatArray:
    amounts = hidden.amounts
    turns = 2 * np.pi * travel / hidden.lead_mm
    teeth = travel / hidden.saw_period_mm
    products = travel @ amounts["product"].T / 1000.0
    return np.asarray(
        amounts["scale"] * travel
        + amounts["sine"] * np.sin(turns)
        + amounts["cosine"] * np.cos(turns)
        + amounts["cubic"] * (travel / 100.0) ** 3
        + amounts["saw"] * (teeth - np.floor(teeth))
        + travel * products
    )


def tool_of(hidden: Hidden, feet: FloatArray) -> FloatArray:
    """The tool ``(n, 3)`` where the legs, shortened by the weight they carry, meet."""
    lengths = np.broadcast_to(LEG_MM + hidden.amounts["length"], feet.shape[:2])
    tool = three_spheres(feet, lengths)
    sag, clearance = hidden.amounts["sag"], hidden.amounts["clearance"]
    if not sag.any() and not clearance.any():
        return tool
    for _ in range(SAG_ROUNDS):
        pushes = (tool[:, None, :] - feet) / lengths[:, :, None]
        weight = np.broadcast_to(-DOWN[:, None], (len(feet), 3, 1))
        carried = np.linalg.solve(np.swapaxes(pushes, 1, 2), weight)[:, :, 0]
        shorter = sag * carried + clearance / 2.0 * np.tanh(carried / LOOSE)
        tool = three_spheres(feet, lengths - shorter)
    return tool


def _touched(hidden: Hidden, rows: Rows) -> FloatArray:
    """The point of the bar ``(n, 3)`` at which each indicator was set up, at Zero."""
    feet = feet_of(hidden, np.full((1, 3), LEG_MM), np.zeros((1, 3)))
    tool = tool_of(hidden, feet)[0]
    return np.asarray(tool + rows.station[:, None] * (feet[0] - tool)[rows.leg])


def readings(rows: Rows, hidden: Hidden) -> FloatArray:
    """What every indicator shows, mm, ``(n,)``, without noise and without its own zero."""
    point = np.zeros((len(rows), 3))
    indices = np.arange(len(rows))
    point[indices, rows.leg] = rows.displacement_mm
    feet = feet_of(hidden, carriages(point), rows.moved)
    tool = tool_of(hidden, feet)
    foot = feet[indices, rows.leg]
    stands = _touched(hidden, rows)
    part = (stands - tool)[indices, rows.leg] / (foot - tool)[indices, rows.leg]
    part = np.where(rows.over_plane, rows.station, part)
    line = tool + part[:, None] * (foot - tool)
    bar = (part - 0.5) * np.linalg.norm(foot - tool, axis=1)
    leaning = hidden.amounts["plane"][rows.leg, rows.axis] * line[indices, rows.leg]
    sideways = (line - stands)[indices, 3 - rows.leg - rows.axis]
    return _shown(rows, hidden, line, bar, sideways) + leaning * rows.over_plane


def _shown(
    rows: Rows, hidden: Hidden, line: FloatArray, bar: FloatArray, sideways: FloatArray
) -> FloatArray:
    """``sideways`` ``(n,)`` is what the bar moved under the tip, square to it, since Zero."""
    amounts, leg, axis = hidden.amounts, rows.leg, rows.axis
    third = 3 - leg - axis
    along = _surface(amounts, leg, axis, line, bar) - amounts["round"][leg, axis] * sideways**2 / 2
    across = _surface(amounts, leg, third, line, bar)
    tilt = amounts["tilt"][leg, axis]
    moved = np.cos(tilt) * along + np.sin(tilt) * across
    wave = sum(np.sin(k * rows.displacement_mm + phase) for k, phase in hidden.waves)
    return _lagging(
        rows,
        amounts["lag"],
        (1 + amounts["gain"][leg, axis]) * moved
        + (amounts["drift"][axis] + amounts["stand"][leg, axis]) * rows.time_s
        + amounts["smooth"][leg, axis] * wave,
    )


def _lagging(rows: Rows, lag: FloatArray, true: FloatArray) -> FloatArray:
    """What indicators with play show, each from reading to reading: it follows only beyond it.

    Before its first reading it was pushed in.
    """
    if not lag.any():
        return true
    reading = true.copy()
    for mount in range(int(rows.mount.max()) + 1):
        gauge_rows = np.flatnonzero(rows.mount == mount)
        half = float(lag[rows.leg[gauge_rows[0]], rows.axis[gauge_rows[0]]]) / 2.0
        at = true[gauge_rows[0]] - half
        for k in gauge_rows:
            at = min(max(at, true[k] - half), true[k] + half)
            reading[k] = at
    return reading


def _surface(
    amounts: dict[str, FloatArray],
    leg: IntArray,
    axis: IntArray,
    line: FloatArray,
    bar: FloatArray,
) -> FloatArray:
    """The bar's surface along an axis: its line, and how it departs from the line."""
    profile = amounts["taper"][leg, axis] * bar + amounts["bow"][leg, axis] * bar**2
    return np.asarray(line[np.arange(len(leg)), axis] + profile)
