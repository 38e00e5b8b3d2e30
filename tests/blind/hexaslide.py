"""The diagnosis of a Hexa Slide against hidden machines: ``python -m tests.blind.hexaslide 300``.

The simulation is of this file alone: spheres about carriages, met by Newton's method of scipy. A
third of the machines hide nothing; the others hide one cause, from what hardly shows to what
nobody overlooks. Prints the table of docs/hexaslide.md; ``300 3000 position`` takes the machines
from number 3000 on, of one procedure.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from calib.hexaslide.diagnosis import HexaSlideDiagnosis, diagnosis_from, weighed
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.procedures import Procedure
from calib.hexaslide.residuals import Readings
from protocols.hexaslide import HexaSlideMachine, load_hexaslide

Array = NDArray[np.float64]
NOISE_M, NOISE_RAD, LEAD_M = 1e-5, float(np.radians(1e-3)), 0.005
POSTURES = {"pose-forward": 24, "position": 40, "constraint-link": 90}
CAUSES = {
    "rail_scale": 1e-4,
    "backlash": 2e-5,
    "joint_offset": 5e-5,
    "straightness": 1e-4,
    "rail_wave": 1e-5,
    "thermal_growth": 5e-5,
    "wrong_posture": 1e-4,
}
"""Ordinary sizes, in 1 or metres; hidden are 0.3 to 10 times as much."""


@dataclass(frozen=True)
class Hidden:
    """One cause, None: nothing; the rail, from 0, or the posture; its size, and a direction."""

    cause: str | None
    place: int = 0
    size: float = 0.0
    angle: float = 0.0

    @property
    def truth(self) -> tuple[tuple[str, str], ...]:
        """As the diagnosis would name it."""
        if self.cause is None:
            return ()
        if self.cause == "thermal_growth":
            return ((self.cause, "all rails"),)
        kind = "posture" if self.cause == "wrong_posture" else "rail"
        return ((self.cause, f"{kind} {self.place + 1}"),)


class Plain:
    """A machine off its file by 1 mm in everything, metres and radians; None: by nothing."""

    def __init__(self, file: HexaSlideMachine, chance: np.random.Generator | None) -> None:
        def off(values: object, unit: float = 1e-3) -> Array:
            array = unit * np.array(values, dtype=float)
            return array if chance is None else array + chance.normal(0.0, 1e-3, array.shape)

        chains, ends = file.chain, file.constraint_link
        assert ends is not None
        self.start = off([chain.start_mm for chain in chains])
        self.start[0], self.start[1, 1:] = 0.0, 0.0
        level = off([chain.rail[:2] for chain in chains if chain.rail], 1.0)
        self.rail = np.column_stack([level, -np.sqrt(1.0 - (level**2).sum(axis=1))])
        self.joint = off([chain.joint_mm for chain in chains])
        self.link = off([chain.link_mm for chain in chains])
        self.ends = off([ends.platform_end_mm, ends.base_end_mm])
        self.length = ends.length_mm / 1e3

    def joints(self, posture: Array) -> Array:
        """Ends of the links on the platform ``(6, 3)``."""
        return np.asarray(posture[:3] + self.turn(posture).apply(self.joint))

    @staticmethod
    def turn(posture: Array) -> Rotation:
        """R = Ry(theta) Rx(psi) Rz(phi)."""
        return Rotation.from_euler("YXZ", posture[3:])

    def off(self, posture: Array, carriages: Array, offset: Array) -> Array:
        """How much too long each link is; ``offset`` ``(6,)`` is that of its universal joint."""
        joints = self.joints(posture)
        across = joints - carriages
        across = across - (across * self.rail).sum(axis=1)[:, None] * self.rail
        across = across / np.linalg.norm(across, axis=1)[:, None]
        at = carriages + offset[:, None] * across
        return np.asarray(np.linalg.norm(joints - at, axis=1) - self.link)

    def carried(self, posture: Array, near: Array, shift: Array, offset: Array) -> Array:
        """Where sliders ``(6,)`` are for a posture, carriages being off their rails by a shift."""

        def off(sliders: Array) -> Array:
            carriages = self.start + sliders[:, None] * self.rail + shift
            return self.off(posture, carriages, offset)

        return np.asarray(fsolve(off, near, xtol=1e-10))

    def sliders(self, posture: Array) -> Array:
        """Where the carriages of the sound machine are for a posture ``(6,)``."""
        to = self.joints(posture) - self.start
        along = (to * self.rail).sum(axis=1)
        return np.asarray(along - np.sqrt(self.link**2 - (to * to).sum(axis=1) + along**2))


def hidden(chance: np.random.Generator, count: int) -> Hidden:
    """Nothing in one of three machines, else one cause anywhere."""
    if chance.random() < 1 / 3:
        return Hidden(None)
    cause = str(chance.choice(list(CAUSES)))
    size = CAUSES[cause] * float(np.exp(chance.uniform(np.log(0.3), np.log(10.0))))
    places = count if cause == "wrong_posture" else 6
    return Hidden(cause, int(chance.integers(places)), size, float(chance.uniform(0, 2 * np.pi)))


def moved(true: Plain, goal: Array, cause: Hidden) -> Array:
    """How far carriages are from where sliders ``(p, 6)`` say ``(p, 6, 3)``."""
    shift = np.zeros((*goal.shape, 3))
    k, size = min(cause.place, 5), cause.size
    rail, way = true.rail[k], goal[:, k] - goal[:, k].mean()
    side = np.cross(rail, [0.0, 0.0, 1.0])
    side = side / np.linalg.norm(side)
    bowed = np.cos(cause.angle) * side + np.sin(cause.angle) * np.cross(rail, side)
    ways = np.sign(np.diff(goal[:, k], prepend=goal[0, k] - 1.0))
    of_rail = {
        "rail_scale": np.outer(size * way, rail),
        "backlash": np.outer(-0.5 * size * ways, rail),
        "rail_wave": np.outer(size * np.sin(2 * np.pi * goal[:, k] / LEAD_M + cause.angle), rail),
        "straightness": np.outer(size * (way / 0.5) ** 2, bowed),
    }
    if cause.cause in of_rail:
        shift[:, k] = of_rail[cause.cause]
    elif cause.cause == "thermal_growth":
        share = np.linspace(0.0, 1.0, len(goal))[:, None, None]
        shift = size * share * goal[:, :, None] * true.rail
    return shift


def measured(
    true: Plain, file: HexaSlideMachine, kind: str, cause: Hidden, chance: np.random.Generator
) -> Readings:
    """What a controller commands or shows, and what is measured."""
    count, linked = POSTURES[kind], kind == "constraint-link"
    box = file.whole().box
    nominal = Plain(file, None)
    targets = chance.uniform(box.lower, box.upper, (count, 6))
    if linked:
        targets = np.array([on_link(true, posture) for posture in targets])
    goal = np.array([(true if linked else nominal).sliders(posture) for posture in targets])
    shift, offset = moved(true, goal, cause), np.zeros(6)
    k, size = cause.place, cause.size
    if cause.cause == "joint_offset":
        offset[k] = size
    stands, encoder = [], goal.copy()
    for row, near in enumerate(targets):
        if linked:  # the platform is where the link holds it; carriages follow
            encoder[row] = true.carried(near, goal[row], shift[row], offset)
            continue
        carriages = true.start + goal[row][:, None] * true.rail + shift[row]
        stands.append(fsolve(true.off, near, (carriages, offset), xtol=1e-13))
    if linked:
        encoder += chance.normal(0.0, 1e-9, encoder.shape)
        values = np.zeros((count, 0))
    else:
        values = np.array(stands)[:, : 3 if kind == "position" else 6]
        noise = np.array([NOISE_M] * 3 + [NOISE_RAD] * 3)[: values.shape[1]]
        values = values + noise * chance.standard_normal(values.shape)
    if cause.cause == "wrong_posture":
        spoilt = encoder if linked else values
        spoilt[k, int(chance.integers(spoilt.shape[1] if linked else 3))] += size
    return Readings(Procedure.of(kind), encoder, values, NOISE_M, NOISE_RAD)


def on_link(true: Plain, posture: Array) -> Array:
    """Lifted until the ends are as far apart as the link is long, give or take its play."""
    platform, base = true.ends
    play = np.random.default_rng(abs(int(1e9 * posture[0]))).normal(0.0, NOISE_M)
    end = posture[:3] + true.turn(posture).apply(platform)
    level = ((end - base)[:2] ** 2).sum()
    lifted = posture.copy()
    lifted[2] += base[2] + np.sqrt((true.length + play) ** 2 - level) - end[2]
    return lifted


def diagnosed(
    readings: Readings, nominal: HexaSlide, tolerances: Array, lead_m: float | None = None
) -> HexaSlideDiagnosis:
    """As the program diagnoses them."""
    return diagnosis_from(weighed(readings, nominal, tolerances, lead_m))


def case(kind: str, seed: int) -> tuple[Hidden, HexaSlideDiagnosis]:
    """One hidden machine, diagnosed."""
    chance = np.random.default_rng(seed)
    file = load_hexaslide()
    cause = hidden(chance, POSTURES[kind])
    readings = measured(Plain(file, chance), file, kind, cause, chance)
    tolerances = file.tolerances.of(readings.procedure.parameters)
    return cause, diagnosed(readings, file.whole(), tolerances, LEAD_M)


def main(count: int, first: int, kinds: tuple[str, ...]) -> None:
    """The table, and what was wrong; the share of truths in the set with its 95 % interval."""
    print(
        "| procedure, postures | machines | truth in the set | named | wrong name "
        "| name on nothing |"
    )
    print("|---|---|---|---|---|---|")
    for kind in kinds:
        score: Counter[str] = Counter()
        for seed in range(first, first + count):
            what, diagnosis = case(kind, seed)
            causes = tuple(sorted(cause for claim in diagnosis.named for cause in claim.causes))
            inside = what.truth in {claim.causes for claim in diagnosis.claims}
            wrong = bool(set(causes) - set(what.truth)) and diagnosis.verdict == "explained"
            score["inside"] += inside
            score["right"] += what.cause is not None and causes == what.truth
            score["hidden"] += what.cause is not None
            score["wrong"] += wrong and what.cause is not None
            score["nothing"] += wrong and what.cause is None
            score["claims"] += len(diagnosis.claims)
            if wrong or not inside:
                print(
                    f"  {kind} {seed}: {what}: {diagnosis.verdict}, {diagnosis.claims[:3]}",
                    file=sys.stderr,
                )
        interval = binomtest(score["inside"], count).proportion_ci()
        print(
            f"| {kind}, {POSTURES[kind]} | {count} | {100 * score['inside'] / count:.1f} % "
            f"({100 * interval.low:.1f} to {100 * interval.high:.1f}) | {score['right']} of "
            f"{score['hidden']} | {score['wrong']} | {score['nothing']} |",
            flush=True,
        )
        print(f"  {kind}: {score['claims'] / count:.0f} claims in a set", file=sys.stderr)


if __name__ == "__main__":
    machines, first_machine = int(sys.argv[1]), int(sys.argv[2]) if sys.argv[2:] else 0
    main(machines, first_machine, tuple(sys.argv[3:]) or tuple(POSTURES))
