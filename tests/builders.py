"""Observations of standard postures and of whole procedures for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.arrays import Conditions, FloatArray, Observations, conditions, observe
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from protocols.machine import Instrument, Machine, load_machine
from protocols.observations import to_observations
from protocols.procedure import default_mount, load_procedure
from protocols.session import Opened, Reading, fold
from protocols.table import opened_table

ZERO_MAX_MIN = (0.0, 60.0, -100.0)


def postures(
    levels: Sequence[float] = ZERO_MAX_MIN, *, repeats: int = 1, station: float = 0.5
) -> Conditions:
    """Every leg and axis in every level, repeated."""
    rows = [
        (leg, axis, level)
        for leg in range(3)
        for axis in range(3)
        if axis != leg
        for _ in range(repeats)
        for level in levels
    ]
    legs, axes, displacements = zip(*rows, strict=True)
    return conditions(legs, axes, displacements, station=station)


def observed(
    parameters_mm: Sequence[float],
    places: Conditions,
    *,
    scatter_mm: float = 0.0,
    seed: int = 0,
) -> Observations:
    """Readings of a machine with these parameters, arbitrary zeros and Gaussian scatter."""
    generator = np.random.default_rng(seed)
    zeros = generator.normal(size=places.mount_count)
    values: FloatArray = Model(parameters_mm=tuple(parameters_mm)).readings(places)
    return observe(
        places, values + zeros[places.mount] + generator.normal(size=len(places)) * scatter_mm
    )


def conditions_of(name: str) -> Observations:
    """Everything a procedure reads, every value zero, a step every 20 s."""
    procedure = load_procedure(name, Geometry())
    opened = Opened(
        program="test",
        origin="simulated",
        machine=Machine(),
        procedure=procedure,
        instruments=(Instrument(profile="a"), Instrument(profile="b")),
    )
    readings = [
        Reading(
            reading=k,
            step=step.number,
            leg=step.leg,
            axis=axis,
            displacement_mm=step.displacement_mm,
            value_mm=0.0,
            text="0",
            cycle=step.cycle,
            mount=default_mount(step.leg, axis, step.station),
            station=step.station,
            time_s=20.0 * step.number,
        )
        for k, (step, axis) in enumerate(
            ((s, a) for s in procedure.steps(Geometry()) for a in s.axes), start=1
        )
    ]
    return to_observations([fold([opened, *readings])])


def read_table(
    path: Path, machine: str | None = None
) -> tuple[tuple[Reading, ...], tuple[str, ...]]:
    """Readings of a table of a machine, the usual one where none is named, and unused columns."""
    _, events, unknown = opened_table(path, load_machine(machine), "test")
    return tuple(event for event in events if isinstance(event, Reading)), unknown
