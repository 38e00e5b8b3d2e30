"""The cells of the blind table: which sessions are made, without a single amount in them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from tests.blind.effects import BESIDE, EFFECT_IDS
from tests.blind.noise import NOISES

PROCEDURES = ("zero-max-min", "sweep", "two-station")
RICH = ("sweep", "two-station")
BARS = (1.0, 3.0)  # tolerances by which every bar is off
STRENGTHS = (0.5, 1.0, 2.0, 4.0)
SHAPES = ("cubic", "sawtooth", "product", "smooth")
# Effect and strength that no workshop has: a clearance of 0.3 mm, the largest that is drawn, leaves
# 2 to 4 µm in the readings of any procedure, less than four times the quietest noise (3.2 µm) but
# for a few lucky draws of one procedure.
TOO_STRONG = (("joint_clearance", 4.0),)
# Over a plane alone: parameters, zero and tilt of the plane imitate the others, of which 400 draws
# each gave no session of these strengths.
SHOWN_ALONE = ("straightness", "thermal_drift")
BLUNDERS = ("gauge_sign", "gauge_swap", "unit_mixup", "stand_slip", "label_error", "wild")
# Effects with an exact look-alike in Zero, Max, Min; which one exactly is worked out by the
# generator for every session.
LOOK_ALIKES = ("actuator_scale", "actuator_cyclic", "backlash", "straightness", "leg_bow")
USUAL_NOISES = ("gaussian", "gaussian", "gaussian", "quantised", "heavy", "unequal")

# Sessions of one combination at full count; the whole plan is about 5 000 sessions.
COUNTS = {
    "none": 56,
    "single": 11,
    "pair": 90,
    "look-alike": 10,
    "left-out": 6,
    "outside": 12,
    "beside": 4,
    "bars": 20,
    "blunder": 18,
    "blunder-and-effect": 10,
    "mislabelled": 40,
    "plane-none": 24,
    "plane": 5,
}


@dataclass(frozen=True)
class Case:
    """What one session hides. ``without`` is left out of the catalogue for its diagnosis,
    ``also`` is looked for as well. Each bar is off by ``bars`` tolerances, 0 for usual ones.

    ``homed`` is the direction in which homing ended: the table of readings does not tell it.
    """

    key: str
    cell: str
    procedure: str
    noise: str
    effects: tuple[str, ...] = ()
    strengths: tuple[float, ...] = ()
    blunder: str = ""
    shape: str = ""
    without: tuple[str, ...] = ()
    homed: float = 1.0
    also: tuple[str, ...] = ()
    bars: float = 0.0

    @property
    def session(self) -> str:
        """A name for the session file that tells nothing."""
        return hashlib.sha256(self.key.encode()).hexdigest()[:12]

    def generator(self, seed: int) -> np.random.Generator:
        """The case's own random numbers, the same in any order of work."""
        number = int.from_bytes(hashlib.sha256(self.key.encode()).digest()[:8], "big")
        return np.random.default_rng([seed, number])


def plan(share: float = 1.0) -> list[Case]:
    """All cases; ``share`` of the full count, at least one of each combination."""
    effects = (_none, _single, _pair, _look_alike, _left_out, _outside, _beside, _bars, _plane)
    mistakes = (_blunder, _mixed, _false)
    return [case for cell in (*effects, *mistakes) for case in cell(share)]


def _counted(cell: str, share: float) -> range:
    return range(max(1, round(COUNTS[cell] * share)))


def _usual(number: int) -> str:
    return USUAL_NOISES[number % len(USUAL_NOISES)]


def _none(share: float) -> Iterator[Case]:
    for procedure, noise, n in product(PROCEDURES, NOISES, _counted("none", share)):
        yield Case(f"none/{procedure}/{noise}/{n}", "none", procedure, noise)


def _single(share: float) -> Iterator[Case]:
    grid = product(PROCEDURES, EFFECT_IDS, STRENGTHS, _counted("single", share))
    for procedure, effect, k, n in grid:
        key = f"single/{procedure}/{effect}/{k}/{n}"
        yield Case(key, "single", procedure, _usual(n), (effect,), (k,))


def _pair(share: float) -> Iterator[Case]:
    """Two effects, equal and 3:1, at once; all pairs of ids in turn."""
    pairs = list(combinations(EFFECT_IDS, 2))
    for procedure, (first, second), n in product(
        PROCEDURES, ((2.0, 2.0), (3.0, 1.0)), _counted("pair", share)
    ):
        first_effect, second_effect = pairs[(7 * n + 3) % len(pairs)]
        pair = (first_effect, second_effect) if n % 2 else (second_effect, first_effect)
        key = f"pair/{procedure}/{first:g}-{second:g}/{n}"
        yield Case(key, "pair", procedure, _usual(n), pair, (first, second))


def _look_alike(share: float) -> Iterator[Case]:
    for effect, k, n in product(LOOK_ALIKES, (1.0, 2.0), _counted("look-alike", share)):
        key = f"look-alike/{effect}/{k}/{n}"
        yield Case(key, "look-alike", "zero-max-min", _usual(n), (effect,), (k,))


def _left_out(share: float) -> Iterator[Case]:
    grid = product(PROCEDURES, EFFECT_IDS, (2.0, 4.0), _counted("left-out", share))
    for procedure, effect, k, n in grid:
        key = f"left-out/{procedure}/{effect}/{k}/{n}"
        yield Case(key, "left-out", procedure, _usual(n), (effect,), (k,), without=(effect,))


def _outside(share: float) -> Iterator[Case]:
    grid = product(PROCEDURES, SHAPES, (1.0, 2.0, 4.0), _counted("outside", share))
    for procedure, shape, k, n in grid:
        key = f"outside/{procedure}/{shape}/{k}/{n}"
        yield Case(key, "outside", procedure, _usual(n), (), (k,), shape=shape)


def _beside(share: float) -> Iterator[Case]:
    """Physics beside the catalogue, not looked for and looked for with everything like it."""
    grid = product(PROCEDURES, BESIDE, (2.0, 4.0), _counted("beside", share))
    for procedure, effect, k, n in grid:
        if (effect, k) in TOO_STRONG:
            continue
        for also, cell in (((), "beside"), (tuple(BESIDE), "beside-named")):
            key = f"{cell}/{procedure}/{effect}/{k}/{n}"
            yield Case(key, cell, procedure, _usual(n), (effect,), (k,), also=also)


def _plane(share: float) -> Iterator[Case]:
    """Legs over a plane, beside readings from Zero and alone: nothing else, and single effects."""
    beside, alone = ("plane", "zero-max-min-plane"), ("plane-alone", "plane")
    for (cell, procedure), effects in ((beside, EFFECT_IDS), (alone, SHOWN_ALONE)):
        for noise, n in product(NOISES, _counted("plane-none", share)):
            yield Case(f"{cell}-none/{noise}/{n}", f"{cell}-none", procedure, noise)
        for effect, k, n in product(effects, (2.0, 4.0), _counted("plane", share)):
            yield Case(f"{cell}/{effect}/{k}/{n}", cell, procedure, _usual(n), (effect,), (k,))


def _bars(share: float) -> Iterator[Case]:
    for procedure, off, n in product(PROCEDURES, BARS, _counted("bars", share)):
        yield Case(f"bars/{procedure}/{off}/{n}", "bars", procedure, _usual(n), bars=off)


def _blunder(share: float) -> Iterator[Case]:
    for procedure, blunder, n in product(PROCEDURES, BLUNDERS, _counted("blunder", share)):
        key = f"blunder/{procedure}/{blunder}/{n}"
        yield Case(key, "blunder", procedure, _usual(n), blunder=blunder)


def _mixed(share: float) -> Iterator[Case]:
    grid = product(PROCEDURES, BLUNDERS, _counted("blunder-and-effect", share))
    for number, (procedure, blunder, n) in enumerate(grid):
        key = f"blunder-and-effect/{procedure}/{blunder}/{n}"
        effect = EFFECT_IDS[number % len(EFFECT_IDS)]
        noise = _usual(n)
        yield Case(key, "blunder-and-effect", procedure, noise, (effect,), (2.0,), blunder)


def _false(share: float) -> Iterator[Case]:
    """Repeats in place that the table calls re-approached."""
    for procedure, n in product(PROCEDURES, _counted("mislabelled", share)):
        yield Case(f"mislabelled/{procedure}/{n}", "mislabelled", procedure, "locked")
