"""A whole session from the simulation in one go."""

from __future__ import annotations

import math

import numpy as np

from app.opening import SIMULATED, program
from calib.observations import conditions
from calib.orthoglide.model import Model
from calib.simulation import measure
from protocols.events import Instrument, Opened, Reading
from protocols.machine import Machine
from protocols.procedure import Procedure, default_mount, leg_number

EXACT_DECIMALS = 15
SECONDS_PER_READING = 1.0


def simulated_session(
    procedure: Procedure,
    machine: Machine,
    truth: Model,
    *,
    seed: int,
    scatter_mm: float,
    resolution_mm: float,
) -> tuple[Opened, tuple[Reading, ...]]:
    """First line and readings of a session that the simulation measured.

    The record names the seed but not the model: nothing in it tells what is to be found.
    """
    visits = [(step, axis) for step in procedure.steps(machine.geometry()) for axis in step.axes]
    mounts = [default_mount(step.leg, axis, step.station) for step, axis in visits]
    order = {name: k for k, name in enumerate(dict.fromkeys(mounts))}
    taken = conditions(
        [leg_number(step.leg) for step, _ in visits],
        [leg_number(axis) for _, axis in visits],
        [step.displacement_mm for step, _ in visits],
        station=[step.station for step, _ in visits],
        mount=[order[name] for name in mounts],
    )
    values = measure(
        truth,
        taken,
        scatter_mm=scatter_mm,
        resolution_mm=resolution_mm,
        generator=np.random.default_rng(seed),
    )
    decimals = -math.floor(math.log10(resolution_mm)) if resolution_mm > 0 else EXACT_DECIMALS
    readings = tuple(
        Reading(
            reading=number,
            step=step.number,
            leg=step.leg,
            axis=axis,
            displacement_mm=step.displacement_mm,
            value_mm=float(f"{value:.{decimals}f}"),
            text=f"{value:.{decimals}f}",
            cycle=step.cycle,
            mount=mount,
            station=step.station,
            time_s=step.number * procedure.seconds_per_step,
            resolution_mm=resolution_mm or None,
        )
        for number, ((step, axis), mount, value) in enumerate(
            zip(visits, mounts, values, strict=True), start=1
        )
    )
    opened = Opened(
        program=program(),
        origin="simulated",
        machine=machine,
        procedure=procedure,
        instruments=(Instrument(profile=SIMULATED, resolution_mm=resolution_mm or None),) * 2,
        seed=seed,
    )
    return opened, readings
