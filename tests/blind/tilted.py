"""Tripods whose drives are not square, read at their legs: written from geometry, sharing nothing.

An Orthoglide after its alignment, one tilted by a twentieth, three drives as a star, and two whose
bars lie along their drives at three places of the tool: upright towers, and towers that lean
inwards. Each machine is solved by Newton's method; the program reads the tables. As a script it
counts sessions::

    python -m tests.blind.tilted --count 200 [--shape towers]
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

BAR = 310.25
SECONDS = 12.0
WALKED = 200
"""Points on the way from posture to posture."""
LETTERS = "xyz"
STATIONS = (0.3, 0.7)
LEVELS = (0.0, 30.0, 45.0, 0.0, -50.0, -80.0, 0.0)
TOWER_LEVELS = (0.0, 30.0, 60.0, 90.0, 60.0, 30.0, 0.0)


@dataclass(frozen=True)
class Shape:
    """Directions ``(3, 3)`` of drives, any length, and where their lines miss the tool at Zero."""

    directions: tuple[tuple[float, float, float], ...]
    misses_mm: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),) * 3
    travel_mm: tuple[float, float] = (-90.0, 60.0)
    levels_mm: tuple[float, ...] = LEVELS

    @property
    def apart(self) -> bool:
        """Whether each bar lies along its drive at a place of its own."""
        return self.travel_mm != Shape.travel_mm

    def zero_mm(self, leg: int) -> FloatArray:
        """Where the tool stands as an indicator is set at a leg: nearest to Zero on its line."""
        if not self.apart:
            return np.zeros(3)
        miss, way = np.array(self.misses_mm[leg]), self.along[leg]
        return np.asarray(miss - (miss @ way) * way)

    def ways(self, leg: int) -> FloatArray:
        """Unit vectors across a drive that is one of these, away from the middle and round it."""
        out = self.zero_mm(leg) / np.linalg.norm(self.zero_mm(leg))
        return np.array([out, np.cross(self.along[leg], out)])

    @property
    def along(self) -> FloatArray:
        """Unit vectors of the drives."""
        way = np.array(self.directions)
        return np.asarray(way / np.linalg.norm(way, axis=1)[:, None])

    @property
    def file(self) -> str:
        """The machine file that its owner writes."""
        lines = ['schema = "glidecal.machine/1"', 'name = "tilted"']
        lines += [f"travel_min_mm = {self.travel_mm[0]}", f"travel_max_mm = {self.travel_mm[1]}"]
        for miss, way in zip(self.misses_mm, self.along.tolist(), strict=True):
            lines += ["[[drive]]", f"origin_mm = {list(miss)}", f"direction = {way}"]
        return "\n".join(lines) + "\n"


SHAPES = {
    "aligned": Shape(
        ((1.0, 0.0, 0.0), (0.005, 1.0, 0.0), (-0.003, 0.004, 1.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, -0.4), (0.2, 0.3, 0.0)),
    ),
    "tilted": Shape(((1.0, 0.0, 0.0), (0.05, 1.0, 0.0), (-0.05, 0.03, 1.0))),
    "star": Shape(((0.8, 0.0, -0.6), (-0.4, 0.69282, -0.6), (-0.4, -0.69282, -0.6))),
    "towers": Shape(
        ((0.0, 0.0, 1.0),) * 3,
        ((-129.904, -75.0, 0.0), (129.904, -75.0, 0.0), (0.0, 150.0, 0.0)),
        (-200.0, 120.0),
        TOWER_LEVELS,
    ),
    "leaning": Shape(
        ((0.13, 0.07506, 1.0), (-0.13, 0.07506, 1.0), (0.0, -0.15011, 1.0)),
        ((-147.224, -85.0, 0.0), (147.224, -85.0, 0.0), (0.0, 170.0, 0.0)),
        (-200.0, 150.0),
        TOWER_LEVELS,
    ),
}

EFFECTS = {
    "actuator_scale": 4e-4,
    "backlash": 0.02,
    "axis_squareness": 5e-4,
    "axis_offset": 0.1,
    "straightness": 0.02,
    "gauge_gain": 1e-2,
}
"""By the name that the program gives them, and what nobody would remark; mm, rad or parts."""


@dataclass(frozen=True)
class Hidden:
    """What the controller does not know: a name and its place and size beside offsets, lengths."""

    offset_mm: FloatArray
    length_mm: FloatArray
    effect: str = ""
    place: tuple[int, int] = (0, 1)
    size: float = 0.0
    way: str | None = None  # across towers: r or t

    @property
    def play_mm(self) -> FloatArray:
        """Of each carriage ``(3,)``."""
        only = np.arange(3) == self.place[0]
        return np.asarray(self.size * only if self.effect == "backlash" else np.zeros(3))

    @property
    def where(self) -> str:
        """The place as the program names it."""
        if self.effect in ("actuator_scale", "backlash"):
            return LETTERS[self.place[0]]
        return LETTERS[self.place[0]] + (LETTERS[self.place[1]] if self.way is None else self.way)


def commanded(shape: Shape, place: FloatArray) -> FloatArray:
    """Coordinates ``(3,)`` of the carriages that the controller reckons, for a tool at a place."""
    away = place - np.array(shape.misses_mm)
    along = (away * shape.along).sum(axis=1)
    return np.asarray(along + np.sqrt(BAR**2 - (away**2).sum(axis=1) + along**2))


def machine(
    shape: Shape, hidden: Hidden, place: FloatArray, behind_mm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Feet ``(3, 3)`` and tool ``(3,)`` where the controller wants the tool at a place.

    Play leaves each foot ``behind_mm`` ``(3,)`` its carriage.
    """
    along, command = shape.along, commanded(shape, place)
    travel = command - commanded(shape, np.zeros(3))
    carriage, sideways = command + hidden.offset_mm + behind_mm, np.zeros((3, 3))
    i, j = hidden.place
    if hidden.effect == "actuator_scale":
        carriage[i] += hidden.size * travel[i]
    elif hidden.effect == "axis_squareness":
        first = 0.5 if shape.apart else 0.7  # only of legs with one Zero the sum alone shows
        sideways[i] = first * hidden.size * carriage[i] * across(shape, i, j)
        sideways[j] = (1.0 - first) * hidden.size * carriage[j] * across(shape, j, i)
    elif hidden.effect in ("axis_offset", "straightness"):
        bent = hidden.effect == "straightness"
        if hidden.way is not None:
            way = shape.ways(i)["rt".index(hidden.way)]
        elif bent:
            way = across(shape, i, j)
        else:
            way = np.cross(along[i], along[j]) / np.linalg.norm(np.cross(along[i], along[j]))
        sideways[i] = hidden.size * ((travel[i] / 100.0) ** 2 if bent else 1.0) * way
    feet = np.array(shape.misses_mm) + carriage[:, None] * along + sideways
    tool = place.copy()
    for _ in range(20):
        bars = tool - feet
        residual = (bars**2).sum(axis=1) - (BAR + hidden.length_mm) ** 2
        tool = tool - np.linalg.solve(2.0 * bars, residual)
    return feet, tool


def gone(
    shape: Shape, play_mm: FloatArray, way: tuple[FloatArray, FloatArray], behind_mm: FloatArray
) -> FloatArray:
    """How far feet are behind ``(3,)`` after a straight way of the tool, gone in small steps.

    A carriage that turns takes its foot along when it has gone through the play, not before.
    """
    if not play_mm.any():
        return behind_mm
    places = (way[0] + part * (way[1] - way[0]) for part in np.linspace(0.0, 1.0, WALKED))
    carriages = np.array([commanded(shape, place) for place in places])
    for step in np.diff(carriages, axis=0):
        behind_mm = np.clip(behind_mm - step, 0.0, play_mm)
    return behind_mm


def across(shape: Shape, leg: int, axis: int) -> FloatArray:
    """The unit vector across the drive of a leg, in the plane of both drives."""
    along = shape.along
    way = along[axis] - (along[axis] @ along[leg]) * along[leg]
    if np.linalg.norm(way) < 1e-9:  # parallel to it: from line to line
        way = np.array(shape.misses_mm[axis]) - np.array(shape.misses_mm[leg])
        way = way - (way @ along[leg]) * along[leg]
    return np.asarray(way / np.linalg.norm(way))


def table(shape: Shape, hidden: Hidden, rng: np.random.Generator, scatter_mm: float) -> str:
    """A table to import, as a display with steps of 1 µm shows it."""
    lines = ["leg,axis,displacement_mm,station,value_mm,cycle,time_s"]
    clock = 0
    for leg, station in product(range(3), STATIONS):
        stand: dict[int, tuple[float, float]] = {}
        start = shape.zero_mm(leg)
        behind_mm, before = np.zeros(3), start
        foot, tool = machine(shape, hidden, start, behind_mm)
        there = tool + station * (foot[leg] - tool)
        for cycle, level in product((1, 2, 3), shape.levels_mm):
            place = start + level * shape.along[leg]
            behind_mm = gone(shape, hidden.play_mm, (before, place), behind_mm)
            before, clock = place, clock + 1
            foot, tool = machine(shape, hidden, place, behind_mm)
            bar = foot[leg] - tool
            part = (there - tool) @ shape.along[leg] / (bar @ shape.along[leg])
            for axis in {0, 1, 2} - {leg}:
                value = (tool + part * bar - there) @ across(shape, leg, axis)
                if hidden.effect == "gauge_gain" and hidden.place == (leg, axis):
                    value *= 1.0 + hidden.size
                zero, _ = stand.setdefault(axis, (float(rng.normal(scale=0.3)), 0.0))
                value += zero + rng.normal(scale=scatter_mm)
                lines.append(
                    f"{LETTERS[leg]},{LETTERS[axis]},{level:.3f},{station},{value:.3f},{cycle},"
                    f"{SECONDS * clock:.0f}"
                )
    return "\n".join(lines) + "\n"


def drawn(effect: str, rng: np.random.Generator, shape: Shape) -> Hidden:
    """A machine with offsets and lengths as they are before any calibration, and one effect."""
    offsets, lengths = rng.uniform(-1.0, 1.0, 3), 0.03 * rng.standard_normal(3)
    i, j = rng.permutation(3)[:2].tolist()
    if effect == "axis_squareness":
        i, j = sorted((i, j))
    elif effect == "axis_offset":
        j = (i + 1) % 3
    size = EFFECTS.get(effect, 0.0) * float(rng.uniform(2.0, 8.0))
    sign = 1.0 if effect == "backlash" else float(rng.choice([-1.0, 1.0]))
    across_tower = shape.apart and effect in ("axis_offset", "straightness")
    way = str(rng.choice(["r", "t"])) if across_tower else None
    return Hidden(offsets, lengths, effect, (i, j), sign * size, way)


@dataclass(frozen=True)
class Score:
    """A session, what it hid and the verdict, and whether that is among the names or agreement."""

    shape: str
    effect: str
    verdict: str
    right: bool

    @property
    def names(self) -> bool:
        """Whether the verdict names anything; the others say that they cannot, or see nothing."""
        return self.verdict in ("explained", "ambiguous", "partly-explained")


def scores(count: int, seed: int, only: str | None = None) -> Iterator[Score]:
    """So many sessions, the shapes and effects in turn; nothing is hidden in each seventh."""
    from app.commands.sessions import import_files
    from app.evaluating.diagnosis import diagnose_files

    kinds = list(product([only] if only else SHAPES, ["", *EFFECTS]))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(count):
            shape, effect = kinds[number % len(kinds)]
            rng = np.random.default_rng([seed, number])
            hidden = drawn(effect, rng, SHAPES[shape])
            source, path = folder / f"{number}.csv", folder / f"{number}.jsonl"
            file = folder / f"{shape}.toml"
            file.write_text(SHAPES[shape].file, encoding="utf-8")
            text = table(SHAPES[shape], hidden, rng, float(rng.uniform(0.001, 0.003)))
            source.write_text(text, encoding="utf-8")
            import_files([source], path, machine=str(file), resolution=0.001)
            diagnosis = diagnose_files([path]).diagnosis
            names = [(effect.id, effect.where) for effect in diagnosis.effects]
            for named in diagnosis.effects:
                names += [(rival.id, rival.where) for rival in named.indistinguishable_from]
            right = diagnosis.verdict == "agrees"
            if effect:  # a place of one axis contains its pairs
                alike = [set(where) for name, where in names if name == effect]
                right = any(where <= set(hidden.where) for where in alike)
            yield Score(shape, effect, diagnosis.verdict, right)


def main() -> None:
    """Count sessions and print the rates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=210)
    parser.add_argument("--seed", type=int, default=29)
    parser.add_argument("--shape", choices=list(SHAPES))
    options = parser.parse_args()
    all_scores = list(scores(options.count, options.seed, options.shape))
    for shape in [options.shape] if options.shape else SHAPES:
        scores_of_shape = [score for score in all_scores if score.shape == shape]
        hidden = [score for score in scores_of_shape if score.effect]
        nothing = [score for score in scores_of_shape if not score.effect]
        with_names = [score for score in hidden if score.names]
        alone = [score for score in scores_of_shape if score.verdict == "explained"]
        print(
            f"{shape}: truth among the names {sum(s.right for s in with_names)} of "
            f"{len(with_names)} named, "
            f"{len(hidden)} hidden; one wrong name alone {sum(not s.right for s in alone)} of "
            f"{len(scores_of_shape)}; nothing hidden agrees {sum(s.right for s in nothing)} of "
            f"{len(nothing)}"
        )
    for score in all_scores:
        if not score.right:
            print(score)


if __name__ == "__main__":
    main()
