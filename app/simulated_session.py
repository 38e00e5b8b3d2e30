"""A whole session from the simulation in one go."""

from __future__ import annotations

import math

import numpy as np

from app.indicators import SIMULATED
from app.opening import program
from calib.orthoglide.model import Model
from calib.simulation import measure
from drivers.outcome import LARGEST_MM
from protocols.errors import RecordError
from protocols.events import Opened, Reading
from protocols.machine import Instrument, Machine
from protocols.observations import to_observations
from protocols.procedure import Procedure, default_mount
from protocols.session import fold

EXACT_DECIMALS = 15


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

    The record names the seed but not the model: nothing in it tells what is to be found. Raises
    RecordError for readings beyond what any indicator shows.
    """
    opened = Opened(
        program=program(),
        origin="simulated",
        machine=machine,
        procedure=procedure,
        instruments=(Instrument(profile=SIMULATED, resolution_mm=resolution_mm or None),)
        * (1 if procedure.plate else 2),
        seed=seed,
    )
    blank = _blank_readings(procedure, machine, resolution_mm)
    values = measure(
        truth,
        to_observations([fold([opened, *blank])]),
        scatter_mm=scatter_mm,
        resolution_mm=resolution_mm,
        generator=np.random.default_rng(seed),
    )
    if not np.all(np.abs(values) <= LARGEST_MM):  # nor anything that is no number
        raise RecordError(
            "simulated readings",
            f"{np.abs(values).max():g} mm",
            f"up to {LARGEST_MM:g} mm, what a record holds",
            "The model has an effect of impossible size.",
        )
    decimals = max(0, -math.floor(math.log10(resolution_mm))) if resolution_mm else EXACT_DECIMALS
    texts = [f"{value:.{decimals}f}" for value in values]
    return opened, tuple(
        reading.model_copy(update={"value_mm": float(text), "text": text})
        for reading, text in zip(blank, texts, strict=True)
    )


def _blank_readings(
    procedure: Procedure, machine: Machine, resolution_mm: float
) -> tuple[Reading, ...]:
    """Every reading of the procedure, its value still zero."""
    visits = [(step, axis) for step in procedure.steps(machine.geometry()) for axis in step.axes]
    return tuple(
        Reading(
            reading=number,
            step=step.number,
            leg=step.leg,
            axis=axis,
            displacement_mm=step.displacement_mm,
            position_mm=step.position_mm,
            lift_mm=procedure.plate.lift_mm or None if procedure.plate else None,
            value_mm=0.0,
            text="0",
            cycle=step.cycle,
            mount=default_mount(step.leg, axis, step.station),
            station=step.station,
            time_s=step.number * procedure.seconds_per_step,
            resolution_mm=resolution_mm or None,
        )
        for number, (step, axis) in enumerate(visits, start=1)
    )
