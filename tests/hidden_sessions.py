"""Sessions of simulated machines that hide an effect, on the disk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from app.measuring.simulated import hidden_effect, planned_readings, simulated_session
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import Empirical
from calib.tripod.simulation import hidden_machine
from protocols.journal import write_whole
from protocols.machine import load_machine
from protocols.procedure import load_procedure

SCATTER_MM = 0.002
CUBE = EffectInstance(Empirical(("travel_cube_at_100mm",)), "x", (900.0,))


def write_session(
    path: Path,
    protocol: str,
    seed: int,
    effect: str = "",
    size: float = 0.0,
    *,
    unnamed: EffectInstance | None = None,
) -> Path:
    """A simulated session, with an effect hidden in its machine."""
    machine = load_machine(None)
    procedure = load_procedure(protocol, machine.geometry())
    truth = hidden_machine(machine.geometry(), seed)
    if effect:
        conditions = planned_readings(procedure, machine)
        hidden = hidden_effect(effect, truth, conditions, seed=seed, noise_mm=SCATTER_MM, size=size)
        truth = replace(truth, effects=hidden)
    if unnamed:
        truth = replace(truth, effects=(unnamed,))
    session = simulated_session(
        procedure, machine, truth, seed=seed, scatter_mm=SCATTER_MM, resolution_mm=0.001
    )
    write_whole(path, session.opened, [*session.readings])
    return path


def bowed_session(folder: Path) -> Path:
    """A bowed bar that a sweep shows without doubt; the name looks like markup."""
    return write_session(folder / "bow [x].jsonl", "sweep", 3, "leg_bow:xy", 0.25)


def doubtful_session(folder: Path) -> Path:
    """A wrong scale that weight on a soft bar would look like."""
    return write_session(folder / "doubt.jsonl", "zero-max-min", 4, "actuator_scale:y", 1.1)


def nameless_session(folder: Path) -> Path:
    """A carriage that is off with the cube of its travel: nothing of the catalogue."""
    return write_session(folder / "cube.jsonl", "sweep", 5, unnamed=CUBE)
