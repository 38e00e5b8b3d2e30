"""What a Hexa Slide keeps at its platform: ``python -m tests.blind.hexaslide_correction 200``.

Hidden machines as in `tests.blind.hexaslide`. The controller gets the parameters of a plain fit, or
the machine that the program enters; spheres about the carriages, the hidden cause with them, say
where the platform then truly stands, at places that the program does not see. `law` is the plain
fit of the same machine's readings, with the same noise, on which the hidden cause did not act: of
who knows the cause and its size, and enters nothing against it.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from scipy.optimize import fsolve

from calib.hexaslide.calibration import calibrate
from calib.hexaslide.checked import frames_apart
from calib.hexaslide.correction import correction_of
from calib.hexaslide.diagnosis import weighed
from calib.hexaslide.geometry import HexaSlide, inverse
from protocols.hexaslide import load_hexaslide
from tests.blind.hexaslide import (
    LEAD_M,
    POSTURES,
    Array,
    Hidden,
    Plain,
    diagnosed,
    hidden,
    measured,
    moved,
)

PLACES, SEEDS = 300, 50_000


@dataclass(frozen=True)
class Remaining:
    """R.m.s. at the platform with each machine, and the stated bound, mm."""

    cause: str
    plain_mm: float
    entered_mm: float
    law_mm: float
    bound_mm: float


def off_mm(
    entered: HexaSlide, true: Plain, cause: Hidden, middle: Array, free: tuple[str, ...]
) -> float:
    """Truly over the box, frames that no reading shows laid over; ``middle`` ``(6,)`` is that of
    the sliders when the cause was measured.
    """
    chance = np.random.default_rng(77)
    aims = chance.uniform(entered.box.lower, entered.box.upper, (PLACES, 6))
    goal = np.asarray(inverse(entered.geometry, aims))
    around = goal - goal.mean(axis=0) + middle  # moved takes a cause about the mean
    shift = moved(true, goal, cause)
    if cause.cause in ("rail_scale", "straightness"):
        shift = moved(true, np.vstack([goal, goal + 2.0 * (around - goal)]), cause)[:PLACES]
    if cause.cause == "backlash":  # a place is come to from either side
        shift = np.zeros_like(shift)
        half = 0.5 * cause.size * chance.choice([-1.0, 1.0], PLACES)
        shift[:, cause.place] = half[:, None] * true.rail[cause.place]
    if cause.cause == "thermal_growth":  # as warm as in the middle of the session
        shift = 0.5 * cause.size * goal[:, :, None] * true.rail
    offset = np.zeros(6)
    if cause.cause == "joint_offset":
        offset[cause.place] = cause.size
    stands = [
        fsolve(true.off, aim, (true.start + at[:, None] * true.rail + off, offset), xtol=1e-12)
        for aim, at, off in zip(aims, goal, shift, strict=True)
    ]
    return 1000.0 * frames_apart(aims, np.array(stands), free).places_rms_m


def remaining(kind: str, seed: int, cause: Hidden | None = None) -> Remaining:
    """One hidden machine, measured and corrected; ``cause`` is hidden, None: by chance."""
    chance = np.random.default_rng(SEEDS + seed)
    file = load_hexaslide()
    cause = cause or hidden(chance, POSTURES[kind])
    true, nominal = Plain(file, chance), file.whole()
    same_noise = deepcopy(chance)
    readings = measured(true, file, kind, cause, chance)
    middle = readings.sliders.mean(axis=0)
    tolerances = file.tolerances.of(readings.procedure.parameters)
    plain = calibrate(readings, nominal)
    wrong = diagnosed(readings, nominal, tolerances, LEAD_M).wrong_postures
    models = weighed(readings.without(wrong), nominal, tolerances, LEAD_M)
    correction = correction_of(models, nominal)
    assert correction is not None
    free = plain.laid_over
    law = calibrate(measured(true, file, kind, Hidden(None), same_noise), nominal)
    plain_mm, entered_mm, law_mm = (
        off_mm(machine, true, cause, middle, free)
        for machine in (plain.machine, correction.machine, law.machine)
    )
    bound_m = correction.platform.bound_m
    bound_mm = np.inf if bound_m is None else 1000.0 * bound_m
    return Remaining(cause.cause or "nothing", plain_mm, entered_mm, law_mm, bound_mm)


def main(count: int, first: int = 0) -> None:
    """The table, with the median of the bound over the error."""
    print(
        "| procedure | hidden | machines | plain fit, mm | entered, mm | law, mm | bound held "
        "| bound over error |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for kind in POSTURES:
        by_cause: dict[str, list[Remaining]] = defaultdict(list)
        for seed in range(first, first + count):
            machine = remaining(kind, seed)
            by_cause[machine.cause].append(machine)
        for cause, machines in by_cause.items():
            errors = [(m.plain_mm, m.entered_mm, m.law_mm) for m in machines]
            plain, entered, law = np.sqrt(np.mean(np.square(errors), axis=0)).tolist()
            within = sum(m.entered_mm <= m.bound_mm for m in machines)
            row = (kind, cause, len(machines), *(f"{mm:.4f}" for mm in (plain, entered, law)))
            ratio = np.median([m.bound_mm / m.entered_mm for m in machines])
            print(f"| {' | '.join(map(str, row))} | {within} | {ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
