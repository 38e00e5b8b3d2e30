"""Lines of a Hexa Slide and of its box of postures, in metres and radians, to be drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.hexaslide.geometry import Box, HexaSlide, legs

RAIL_POINTS, EDGE_POINTS = 24, 12


@dataclass(frozen=True, eq=False)
class Lines:
    """The machine at a posture: rails ``(6, n, 3)`` as far as the sliders go in the box, none of
    telescopic legs, carriages ``(6, 3)``, links ``(6, 2, 3)``, and the platform ``(7, 3)``, its
    joints in their order around it and the first one once more.
    """

    rails: FloatArray
    carriages: FloatArray
    links: FloatArray
    platform: FloatArray


def lines_at(machine: HexaSlide, posture: FloatArray) -> Lines:
    """The machine at a posture ``(6,)``. Raises UnreachablePosture."""
    geometry = machine.geometry
    sliders = legs(geometry, machine.box.grid()).sliders
    first, last = np.minimum(sliders.min(axis=0), 0.0), sliders.max(axis=0)
    along = np.linspace(first, last, RAIL_POINTS, axis=1)
    at = legs(geometry, posture[None])
    carriages = geometry.base + at.sliders[0, :, None] * geometry.rails
    platform = posture[:3] + at.arms.arm[0]
    apart = geometry.platform - geometry.platform.mean(axis=0)
    order = np.argsort(np.arctan2(apart[:, 1], apart[:, 0]))
    rails = geometry.base[:, None] + along[..., None] * geometry.rails[:, None]
    return Lines(
        rails=rails[:0] if geometry.telescopic else rails,
        carriages=carriages,
        links=np.stack([carriages, platform], axis=1),
        platform=platform[[*order, order[0]]],
    )


def outline(box: Box, axes: tuple[int, int]) -> FloatArray:
    """Points ``(48, 2)`` on the edges of the box, seen in two of its coordinates."""
    steps = np.linspace(0.0, 1.0, EDGE_POINTS)
    sides = [np.column_stack([steps, np.full(EDGE_POINTS, end)]) for end in (0.0, 1.0)]
    unit = np.concatenate([*sides, *(side[:, ::-1] for side in sides)])
    lower, upper = box.lower[list(axes)], box.upper[list(axes)]
    return np.asarray(lower + unit * (upper - lower))
