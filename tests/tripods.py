"""Translational tripods of several shapes, for tests of what holds for all of them."""

from __future__ import annotations

from dataclasses import replace

from calib.tripod.geometry import Geometry, Three, Triple
from protocols.machine import load_machine

ORTHOGLIDE = Geometry()
DELTA = load_machine("linear-delta").geometry()


def _round(vectors: Three) -> Three:
    """The vectors turned by 120° about the diagonal: no drive stays along its own coordinate."""
    x, y, z = ((c, a, b) for a, b, c in vectors)
    return x, y, z


STAR: Three = ((0.8, 0.0, -0.6), (-0.4, 0.4 * 3**0.5, -0.6), (-0.4, -0.4 * 3**0.5, -0.6))
ENDS: Three = ((30.0, 0.0, 0.0), (-15.0, 26.0, 0.0), (-15.0, -26.0, 0.0))
LEAN = (0.05, (1.0 - 0.05**2) ** 0.5)
SKEW: Triple = (0.6, 0.0, 0.8)

TRIPODS: dict[str, Geometry] = {
    "orthoglide": ORTHOGLIDE,
    "unequal-bars": replace(ORTHOGLIDE, leg_length_mm=(310.0, 300.0, 330.0)),
    "platform": replace(
        ORTHOGLIDE, platform_mm=((20.0, 0.0, 0.0), (0.0, 15.0, 3.0), (0.0, -4.0, 10.0))
    ),
    "turned": replace(ORTHOGLIDE, direction=_round(ORTHOGLIDE.direction)),
    "skew": replace(ORTHOGLIDE, direction=(SKEW, (0.0, 1.0, 0.0), (-0.6, 0.0, 0.8))),
    "tilted": replace(
        ORTHOGLIDE,
        direction=((1.0, 0.0, 0.0), (*LEAN, 0.0), (0.0, -LEAN[0], LEAN[1])),
        origin_mm=((0.0, 0.0, 0.0), (0.0, 0.0, -0.4), (0.2, 0.3, 0.0)),
    ),
    "star": replace(ORTHOGLIDE, direction=STAR, origin_mm=ENDS, platform_mm=ENDS),
    "linear-delta": DELTA,
}
"""By name; the first four are of the Orthoglide's kind, with drives square to each other; legs are
read on all: those of the delta each at a Zero of its own."""
