"""A simulated machine with simulated indicators: what demo and ``run --simulated`` measure."""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.measuring.indicators import SIMULATED
from app.version import program
from calib.observations import Conditions, Observations, conditions
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import ZERO_SPREAD_MM, Effect, Model, measure
from drivers.profile import LARGEST_MM, Profile
from drivers.rig import SimulatedRig
from drivers.twin_port import Transport
from protocols.errors import RecordError
from protocols.events import Opened, Reading
from protocols.machine import Instrument, Machine
from protocols.observations import to_observations
from protocols.procedure import Procedure, Step, default_mount, leg_number
from protocols.session import fold

OFFSET_LIMIT_MM = 2.0
LENGTH_SPREAD_MM = 0.03


@dataclass(frozen=True)
class BenchSettings:
    """How the simulated bench behaves; ``scatter_mm`` is that of a re-approach.

    ``effects`` are what the machine has beyond offsets and lengths; no record tells of them. For
    them ``clock_rate`` seconds pass in each second, so that a short demonstration shows slow ones.
    """

    resolution_mm: float = 0.001
    scatter_mm: float = 0.002
    motion_s: float = 0.0
    effects: tuple[Effect, ...] = ()
    clock_rate: float = 1.0


def hidden_machine(
    geometry: Geometry, seed: int, entered_offsets_mm: Sequence[float] = (0.0, 0.0, 0.0)
) -> Model:
    """A machine with joint offsets up to 2 mm and well made legs, to be found by measuring.

    Offsets that were entered in its controller no longer show.
    """
    generator = np.random.default_rng([seed, 1])
    offsets = generator.uniform(-OFFSET_LIMIT_MM, OFFSET_LIMIT_MM, 3) - entered_offsets_mm
    lengths = generator.normal(scale=LENGTH_SPREAD_MM, size=3)
    return Model(geometry, tuple(np.concatenate([offsets, lengths]).tolist()))


class SimulatedBench:
    """A machine whose indicators answer over real serial connections.

    Machine and zeros follow from the seed, so an interrupted simulated session goes on; the
    scatter differs from run to run.
    """

    def __init__(
        self,
        truth: Model,
        seed: int,
        run_name: str,
        profiles: list[Profile],
        transport: Transport,
        settings: BenchSettings,
    ) -> None:
        self._truth = replace(truth, effects=(*truth.effects, *settings.effects))
        self._seed = seed
        self._run = zlib.crc32(run_name.encode())
        self._scatter_mm = settings.scatter_mm
        self._visits = 0
        self._path = _Path(settings.clock_rate)
        self.rig = SimulatedRig(
            profiles,
            resolution_mm=settings.resolution_mm,
            transport=transport,
            motion_s=settings.motion_s,
            fastest_stream=settings.motion_s == 0.0,
        )

    def go(self, step: Step) -> None:
        """Move the machine to a step; each approach scatters a little."""
        exact = self._truth.readings(self._path.conditions_at(step))
        self._visits += 1
        generator = np.random.default_rng([self._seed, self._run, step.number, self._visits])
        zeros = [self._zero_mm(default_mount(step.leg, axis, step.station)) for axis in step.axes]
        scatter = generator.normal(scale=self._scatter_mm, size=len(zeros))
        self.rig.go((exact + zeros + scatter).tolist())

    def _zero_mm(self, mount: str) -> float:
        generator = np.random.default_rng([self._seed, 3, zlib.crc32(mount.encode())])
        return float(generator.normal(scale=ZERO_SPREAD_MM))

    def close(self) -> None:
        """Switch everything off."""
        self.rig.close()


class _Path:
    """Where the machine came from and how long it has been on: what some effects depend on."""

    def __init__(self, clock_rate: float) -> None:
        self._clock_rate = clock_rate
        self._before: Step | None = None
        self._approach = 0.0
        self._start_s = time.monotonic()

    def conditions_at(self, step: Step) -> Conditions:
        """The conditions of the step's readings; the first approach to a place is not known."""
        before, self._before = self._before, step
        if before is None or before.place != step.place:
            self._approach = 0.0
        else:
            moved = float(np.sign(step.displacement_mm - before.displacement_mm))
            self._approach = moved or self._approach
        count = len(step.axes)
        taken = conditions(
            [leg_number(step.leg)] * count,
            [leg_number(axis) for axis in step.axes],
            [step.displacement_mm] * count,
            station=step.station,
        )
        return replace(
            taken,
            approach=np.full(count, self._approach),
            time_s=np.full(count, (time.monotonic() - self._start_s) * self._clock_rate),
        )


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


def planned_readings(procedure: Procedure, machine: Machine) -> Observations:
    """Every reading of the procedure in order, its value without meaning."""
    opened, readings = simulated_session(
        procedure, machine, Model(machine.geometry()), seed=0, scatter_mm=0.0, resolution_mm=0.0
    )
    return to_observations([fold([opened, *readings])])
