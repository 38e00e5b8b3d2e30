"""The diagnosis of six telescopic legs against hidden machines, by a simulation of its own.

``python -m tests.blind.telescopic 120`` draws so many for each procedure: off their file by 1 mm in
everything, a third of them with nothing else, the others with one cause, from a third of an
ordinary size to ten of them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from calib.hexaslide.diagnosis import Names
from calib.hexaslide.procedures import Procedure
from calib.hexaslide.residuals import Readings
from tests.blind.hexaslide import diagnosed
from tests.calib.hexaslide.telescopic_draws import (
    FILE,
    MACHINE,
    NOISE_M,
    NOISE_RAD,
    PLAIN,
    Array,
    some,
)

SETS = (("pose-forward", 24), ("position", 40))
SCALE, PLAY_M, GROWTH, OF_NOISE = 1e-4, 2e-5, 5e-5, 5.0
"""Ordinary sizes, as `calib.hexaslide.diagnosis` has them; of a wrong posture in its noise."""

CAUSES = ("", "", "leg_scale", "leg_backlash", "thermal_growth", "wrong_posture")


@dataclass
class Score:
    """Counts of machines: all, with a cause, the truth in the set, named, wrongly, on nothing."""

    machines: int = 0
    hidden: int = 0
    in_set: int = 0
    named: int = 0
    wrong: int = 0
    on_nothing: int = 0


def drawn(kind: str, count: int, seed: int) -> tuple[Readings, Names]:
    """Readings of a hidden machine, and what is hidden in it."""
    chance = np.random.default_rng(1000 + seed)
    truth, postures = PLAIN.off(chance), some(count, 2000 + seed)
    read = np.array([PLAIN.reads(posture) for posture in postures])
    cause, leg = str(chance.choice(CAUSES)), int(chance.integers(0, 6))
    size = float(np.exp(chance.uniform(np.log(1 / 3), np.log(10.0))))
    stood = np.array(
        [truth.stands(*pair) for pair in zip(moved(read, cause, leg, size), postures, strict=True)]
    )
    noise = np.array([NOISE_M] * 3 + [NOISE_RAD] * 3)
    values = stood + noise * chance.normal(size=stood.shape)
    where = "all legs" if cause == "thermal_growth" else f"leg {leg + 1}"
    if cause == "wrong_posture":
        row = int(chance.integers(0, count))
        values[row] += OF_NOISE * size * noise * chance.normal(size=6)
        where = f"posture {row + 1}"
    procedure = Procedure.of(kind).on(MACHINE)
    values = values[:, : len(procedure.measured)]
    readings = Readings(procedure, read, values, NOISE_M, NOISE_RAD)
    return readings, ((cause, where),) if cause else ()


def moved(readings: Array, cause: str, leg: int, size: float) -> Array:
    """What the drives do ``(p, 6)`` where they read this, metres."""
    true = readings.copy()
    if cause == "leg_scale":
        true[:, leg] += size * SCALE * (readings[:, leg] - readings[:, leg].mean())
    elif cause == "leg_backlash":
        ways = np.sign(np.diff(readings[:, leg], prepend=readings[0, leg] - 1.0))
        true[:, leg] -= 0.5 * size * PLAY_M * ways
    elif cause == "thermal_growth":
        grown = np.linspace(0.0, size * GROWTH, len(readings))[:, None]
        true += grown * (readings + PLAIN.zero)
    return true


def scored(kind: str, count: int, machines: int) -> Score:
    """Of so many hidden machines, each in ``count`` postures."""
    score = Score()
    for seed in range(machines):
        readings, truth = drawn(kind, count, seed)
        diagnosis = diagnosed(readings, MACHINE, FILE.tolerances.of(readings.procedure.parameters))
        ids = {cause for claim in diagnosis.named for cause in claim.causes}
        score.machines += 1
        score.hidden += bool(truth)
        score.in_set += truth in [claim.causes for claim in diagnosis.claims]
        score.named += bool(truth) and ids == set(truth)
        score.wrong += bool(truth) and not ids <= set(truth)
        score.on_nothing += not truth and bool(ids)
    return score


def main(machines: int) -> None:
    """A row for each procedure."""
    for kind, count in SETS:
        score = scored(kind, count, machines)
        print(
            f"| {kind}, {count} | {score.machines} | {100.0 * score.in_set / machines:.0f} % | "
            f"{score.named} of {score.hidden} | {score.wrong} | {score.on_nothing} |"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]))
