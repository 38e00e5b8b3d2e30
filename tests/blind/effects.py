"""The effects of the contract as entries of the hidden machine, with every place they can have."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations

from tests.blind.forward import Hypothesis

LETTERS = "xyz"
PAIRS = ((0, 1), (0, 2), (1, 2))
Direction = tuple[tuple[Hypothesis, float], ...]

MACHINE_IDS = (
    "axis_squareness",
    "axis_offset",
    "straightness",
    "actuator_scale",
    "actuator_cyclic",
    "backlash",
    "gravity_sag",
    "leg_taper",
    "leg_bow",
)
EFFECT_IDS = (*MACHINE_IDS, "thermal_drift", "gauge_gain", "gauge_tilt")
LATERAL = {"straightness": "curve", "leg_taper": "taper", "leg_bow": "bow"}
BESIDE = {
    "straightness_cubic": "s_guide",
    "joint_clearance": "clearance",
    "tip_on_round_bar": "round",
    "gauge_hysteresis": "lag",
    "stand_drift": "stand",
}
"""Physics that the program can simulate and does not look for."""

AXIAL = {"actuator_scale": ("scale",), "backlash": ("lost",), "actuator_cyclic": ("sine", "cosine")}
GAUGE = {"gauge_gain": "gain", "gauge_tilt": "tilt"}

# Larger than this no workshop would have it: another place or other amounts are drawn.
LARGEST = {
    "lean": 0.02,
    "tilt": 0.15,
    "gain": 0.2,
    "scale": 0.02,
    "taper": 0.02,
    "sag": 3.0,
    "sine": 0.1,
    "cosine": 0.1,
    "lost": 0.3,
    "clearance": 0.3,
    "round": 0.5,
    "lag": 0.05,
}


@dataclass(frozen=True)
class Candidate:
    """One effect at one place: the directions of entries that its parameters scale."""

    id: str
    where: str
    directions: tuple[Direction, ...]
    lead_mm: float = 5.0


def candidates() -> tuple[Candidate, ...]:
    """Every effect at every place."""
    return (*_squareness(), *_offset(), *_lateral(), *_axial(), *_gauge(), *_environment())


def beside() -> tuple[Candidate, ...]:
    """What the catalogue lacks, at every place; an S-shaped guide one way or both."""
    single = []
    for name, entry in BESIDE.items():
        if entry == "clearance":
            single += [Candidate(name, LETTERS[leg], (_one(entry, leg),)) for leg in range(3)]
            continue
        for leg, side in permutations(range(3), 2):
            place = LETTERS[leg] if entry == "s_guide" else LETTERS[leg] + LETTERS[side]
            single.append(Candidate(name, place, (_one(entry, leg, side),)))
    return tuple(single)


def everywhere() -> Candidate:
    """Every stand drifting at a rate of its own: what all do alike, it does as well."""
    return Candidate(
        "stand_drift",
        ",".join(LETTERS),
        tuple(_one("stand", leg, side) for leg, side in permutations(range(3), 2)),
    )


def rivals() -> tuple[Candidate, ...]:
    """What a diagnosis has to choose from: both indicators of a leg can err at once, too."""
    pairs = []
    for name, entry in GAUGE.items():
        for leg in range(3):
            sides = tuple(_one(entry, leg, side) for side in range(3) if side != leg)
            pairs.append(Candidate(name, LETTERS[leg], sides))
    return (*candidates(), *pairs)


def _one(name: str, *index: int) -> Direction:
    return (((name, index), 1.0),)


def visible(direction: Direction) -> Direction:
    """Of two axes that are not square either may lean: each is given half."""
    if direction[0][0][0] != "lean":
        return direction
    turned = tuple(((name, index[::-1]), weight) for (name, index), weight in direction)
    return tuple((entry, weight / 2.0) for entry, weight in (*direction, *turned))


def _squareness() -> Iterator[Candidate]:
    """A pair's sum of leans is the parameter; the second axis of the pair leans."""
    for i, j in PAIRS:
        yield Candidate("axis_squareness", LETTERS[i] + LETTERS[j], (_one("lean", i, j),))
    leans = tuple((("lean", pair), 1.0) for pair in PAIRS)
    yield Candidate("axis_squareness", "all", (leans,))


def _offset() -> Iterator[Candidate]:
    """One axis shifted both ways or one way, or all of them turning.

    Readings see distances between neighbours: an axis that is shifted towards a second one misses
    the third. All shifted as mirror images miss nothing.
    """
    for i, j in permutations(range(3), 2):
        yield Candidate("axis_offset", neighbours(i, 3 - i - j), (_one("shift", i, j),))
    for i in range(3):
        sides = tuple(_one("shift", i, j) for j in range(3) if j != i)
        yield Candidate("axis_offset", LETTERS[i], sides)
    yield Candidate(
        "axis_offset", "all", (tuple((("shift", (i, (i + 1) % 3)), 1.0) for i in range(3)),)
    )


def neighbours(i: int, j: int) -> str:
    """A pair of axes from one to the next: xy, yz or zx."""
    return LETTERS[i] + LETTERS[j] if (j - i) % 3 == 1 else LETTERS[j] + LETTERS[i]


def _lateral() -> Iterator[Candidate]:
    for name, entry in LATERAL.items():
        for leg in range(3):
            sides = tuple(_one(entry, leg, side) for side in range(3) if side != leg)
            yield Candidate(name, LETTERS[leg], sides)
            for direction, side in zip(sides, (s for s in range(3) if s != leg), strict=True):
                yield Candidate(name, LETTERS[leg] + LETTERS[side], (direction,))
        right = tuple(((entry, (i, (i + 1) % 3)), 1.0) for i in range(3))
        backward = tuple(((entry, (i, (i + 2) % 3)), 1.0) for i in range(3))
        turning = right + tuple((key, -weight) for key, weight in backward)
        yield Candidate(name, "all", (right + backward, turning))


def _axial() -> Iterator[Candidate]:
    for name, entries in AXIAL.items():
        for lead_mm in (5.0, 10.0) if name == "actuator_cyclic" else (5.0,):
            for leg in range(3):
                alone = tuple(_one(entry, leg) for entry in entries)
                yield Candidate(name, LETTERS[leg], alone, lead_mm)
            alike = tuple(tuple(((entry, (i,)), 1.0) for i in range(3)) for entry in entries)
            yield Candidate(name, "all", alike, lead_mm)


def _gauge() -> Iterator[Candidate]:
    for name, entry in GAUGE.items():
        for leg in range(3):
            for axis in range(3):
                if axis != leg:
                    place = LETTERS[leg] + LETTERS[axis]
                    yield Candidate(name, place, (_one(entry, leg, axis),))


def _environment() -> Iterator[Candidate]:
    weight = tuple((("sag", (leg,)), 1.0) for leg in range(3))
    yield Candidate("gravity_sag", "all", (weight,))
    for leg in range(3):  # one bar softer than the others
        yield Candidate("gravity_sag", LETTERS[leg], (weight[leg : leg + 1],))
    rates = tuple(_one("drift", axis) for axis in range(3))
    yield Candidate("thermal_drift", "all", rates)
    for axis in range(3):
        yield Candidate("thermal_drift", LETTERS[axis], (rates[axis],))
