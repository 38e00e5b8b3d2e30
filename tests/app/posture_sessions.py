"""Sessions of postures of a hidden machine, for tests of what shows them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from app.evaluating.hexaslide_calibration import calibrate_file
from app.exports.hexaslide import write_calibrated
from app.measuring.hexaslide import PostureTaking, measure_simulated
from app.version import program
from protocols.hexaslide import HexaSlideMachine, load_hexaslide
from protocols.hexaslide_session import (
    PosturesOpened,
    load_posture_procedure,
    read_postures,
    simulated_truth,
)

TOLERANCE_MM = 0.1


def quiet(_words: str) -> None:
    """Nothing is said."""


def posture_session(
    path: Path,
    procedure: str,
    seed: int,
    machine: HexaSlideMachine | None = None,
    truth: HexaSlideMachine | None = None,
    random: int = 0,
) -> Path:
    """A closed session of a simulated machine, its file with a tolerance of the platform.

    In so many ``random`` postures, 0: in those of the procedure.
    """
    machine = machine or load_hexaslide().model_copy(update={"platform_tolerance_mm": TOLERANCE_MM})
    stated = load_posture_procedure(procedure)
    if random:
        stated = stated.with_postures(machine.whole().random(random, np.random.default_rng(seed)))
    opened = PosturesOpened(
        program=program(),
        origin="simulated",
        machine=machine,
        machine_file="machine.toml",
        procedure=stated,
        seed=seed,
        truth=truth,
    )
    taking = PostureTaking.begin(path, opened)
    measure_simulated(taking, seed, quiet)
    taking.close()
    return path


def before_and_after(folder: Path) -> tuple[Path, Path]:
    """A session, and one with the calibrated machine entered, of the same hidden machine."""
    before = posture_session(folder / "before.jsonl", "position", 12)
    write_calibrated(calibrate_file(before, None, 0.0), folder / "entered", replace=False)
    entered = load_hexaslide(folder / "entered" / "machine.toml")
    truth = simulated_truth(read_postures(before)[0])
    return before, posture_session(folder / "after.jsonl", "position", 13, entered, truth)
