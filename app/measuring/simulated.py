"""A simulated machine with simulated indicators: what demo and ``run --simulated`` measure."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

from app.evaluating.own_effects import known_effects
from app.measuring.indicators import SIMULATED
from app.version import program
from calib.arrays import TOOL, Conditions, Observations, conditions, descending
from calib.errors import RecordError, UsageError
from calib.tripod.effects import BESIDE_CATALOGUE
from calib.tripod.effects.candidates import candidates
from calib.tripod.effects.effect import Effect, EffectInstance
from calib.tripod.effects.hidden import hidden_among
from calib.tripod.pipeline import Model, StageEffect, measure
from calib.tripod.planning import excursion_mm
from calib.tripod.simulation import SimulatedMachine
from drivers.motion.headless import SimulatedJoints
from drivers.profile import LARGEST_MM, Profile, Spindle
from drivers.twins import SimulatedRig, Transport, TwinPort, twin_of
from protocols.documents import Triple, read_text
from protocols.machine import Instrument, Machine, MotionLimits, load_machine
from protocols.model_file import read_model
from protocols.motion import box_mm, zero_mm
from protocols.observations import to_observations
from protocols.procedure import (
    Leg,
    Procedure,
    Step,
    Touched,
    default_mount,
    leg_number,
    load_procedure,
)
from protocols.session import Opened, Reading, fold


def hidden_effect(
    wanted: str,
    truth: Model,
    taken: Conditions,
    *,
    effects: Sequence[Effect],
    seed: int,
    noise_mm: float,
    size: float | None = None,
) -> tuple[EffectInstance, ...]:
    """The effect ``wanted`` (id, or id:where) for the machine ``truth``; see `hidden_among`.

    Raises UsageError where it is not known, or these readings cannot show it.
    """
    effect_id, _, where = wanted.partition(":")
    effects = (*effects, *BESIDE_CATALOGUE)
    if effect_id not in {effect.id for effect in effects}:
        raise UsageError("effect", repr(effect_id), ", ".join(dict.fromkeys(x.id for x in effects)))
    of_it = [
        c for c in candidates(truth, taken, effects) if c.id == effect_id and "," not in c.where
    ]
    if not of_it:
        raise _not_seen(effect_id, taken)
    here = [c for c in of_it if where in ("", c.where)]
    if not here:
        places = ", ".join(dict.fromkeys(c.where for c in of_it))
        raise UsageError(f"place of effect {effect_id}", repr(where), places)
    found = hidden_among(here, truth, taken, seed=seed, noise_mm=noise_mm, size=size)
    if not found:
        raise _not_seen(wanted, taken)
    return found


def _not_seen(effect: str, taken: Conditions) -> UsageError:
    return UsageError(
        f"effect {effect}",
        "nothing to see of it beside offsets and lengths with this procedure",
        "a procedure that shows it",
        "Give --size." if TOOL in taken.leg else "Try --protocol two-station, or give --size.",
    )


@dataclass(frozen=True)
class BenchSettings:
    """How the simulated bench behaves; ``scatter_mm`` is that of a re-approach.

    ``effects`` are what the machine has beyond offsets and lengths; no record tells of them. For
    them ``clock_rate`` seconds pass in each second, so that a short demonstration shows slow ones.
    Behind a simulated controller it moves ``hurry`` times as fast as it is told.
    """

    resolution_mm: float = 0.001
    scatter_mm: float = 0.002
    motion_s: float = 0.0
    effects: tuple[StageEffect, ...] = ()
    clock_rate: float = 1.0
    hurry: float = 1.0


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
        lift_mm: float = 0.0,
    ) -> None:
        truth = truth.with_effects((*truth.effects, *settings.effects))
        self._machine = SimulatedMachine(truth, seed, run_name, settings.scatter_mm, lift_mm)
        self._clock_rate, self._start_s = settings.clock_rate, time.monotonic()
        self._geometry, self._shown_mm = truth.geometry, [0.0] * len(profiles)
        self.rig = SimulatedRig(
            profiles,
            resolution_mm=settings.resolution_mm,
            transport=transport,
            motion_s=settings.motion_s,
            fastest_stream=settings.motion_s == 0.0,
        )

    def go(self, step: Step) -> None:
        """Move the machine to a step; each approach scatters a little."""
        to = conditions(
            [leg_number(step.leg)] * len(step.axes),
            [leg_number(axis) for axis in step.axes],
            [step.displacement_mm] * len(step.axes),
            station=step.station,
            position_mm=step.position_mm,
        )
        if step.over_plane:
            covered = self._geometry.covered_mm[leg_number(step.leg)]
            to = replace(to, along_mm=to.displacement_mm + step.station * covered)
        mounts = [default_mount(step.leg, axis, step.place[1]) for axis in step.axes]
        time_s = (time.monotonic() - self._start_s) * self._clock_rate
        values = self._machine.go(to, mounts, step.number, time_s)
        for number, value in zip(step.indicators, values, strict=True):
            self._shown_mm[number] = value
        self.rig.go(self._shown_mm)

    def turn(self, moved: StageEffect, step: Step) -> None:
        """A rail is moved while the indicators stand as for a step."""
        truth = self._machine.truth
        self._machine.truth = truth.with_effects((*truth.effects, moved))
        self.go(step)

    def close(self) -> None:
        """Switch everything off."""
        self.rig.close()


class MovingController(Protocol):
    """What moves a simulated machine."""

    told: str
    """What names it to `drivers.motion.controller_of`."""

    def close(self) -> None:
        """Let go of all that it is."""


class SelfMovingBench:
    """The same machine behind a controller: its indicators follow where that moves it.

    They show what they do where the machine is at that very moment, also on its way: the last of
    ``passed_mm``, if it had no errors; those before tell from which side it came. ``set_up`` puts
    the stand where a step needs it.
    """

    def __init__(
        self,
        machine: SimulatedMachine,
        profiles: Sequence[Profile],
        transport: Transport,
        settings: BenchSettings,
        controller: MovingController,
        passed_mm: Callable[[], Sequence[Triple]],
    ) -> None:
        self._machine, self.controller, self._passed_mm = machine, controller, passed_mm
        self._clock_rate, self._start_s = settings.clock_rate, time.monotonic()
        self._lock = threading.Lock()
        self._step: Step | None = None
        self._shown: tuple[Triple | None, list[float]] = (None, [0.0] * len(profiles))
        self._ports = [
            TwinPort(
                twin_of(profile, Spindle(partial(self._shows, k), settings.resolution_mm)),
                transport,
                stream_s=profile.stream_s,
            )
            for k, profile in enumerate(profiles)
        ]
        self.ports = tuple(port.url for port in self._ports)

    def set_up(self, step: Step) -> None:
        """What an operator does by hand before a step."""
        with self._lock:
            self._follow()  # what was passed belongs to the set-up before
            self._step, self._shown = step, (None, self._shown[1])
            self._follow()

    def _follow(self) -> None:
        for place in self._passed_mm():
            if self._step is not None and place != self._shown[0]:
                self._shown = place, self._values(self._step, place)

    def _shows(self, number: int) -> float:
        with self._lock:
            self._follow()
            return self._shown[1][number]

    def _values(self, step: Step, tool_mm: Triple) -> list[float]:
        """Of every indicator on the leg, or at the tool, that is set up."""
        n, leg = len(step.axes), leg_number(step.leg)
        along_mm = 0.0 if step.leg == "tool" else self._along(leg, tool_mm)
        beside = tool_mm if step.leg == "tool" else self._beside(leg, tool_mm, along_mm)
        axes = [leg_number(axis) for axis in step.axes]
        to = conditions([leg] * n, axes, [along_mm] * n, station=step.station, position_mm=beside)
        mounts = [default_mount(step.leg, axis, step.place[1]) for axis in step.axes]
        time_s = (time.monotonic() - self._start_s) * self._clock_rate
        values, shown = self._machine.go(to, mounts, step.number, time_s), list(self._shown[1])
        for k, value in zip(step.indicators, values, strict=True):
            shown[k] = value
        return shown

    def _along(self, leg: int, tool_mm: Triple) -> float:
        """How far the tool is along a leg."""
        way = self._machine.truth.geometry.direction[leg]
        return sum(a * b for a, b in zip(way, tool_mm, strict=True))

    def _beside(self, leg: int, tool_mm: Triple, along_mm: float) -> list[float]:
        """What of the tool's place is not along a leg."""
        way = self._machine.truth.geometry.direction[leg]
        return [place - along_mm * part for place, part in zip(tool_mm, way, strict=True)]

    def close(self) -> None:
        """Switch everything off."""
        for port in self._ports:
            port.close()
        self.controller.close()


SWITCH_MM = 10.0
"""Beyond the joint limits: where the switches are that a demonstration's LinuxCNC homes on."""

HURRIED_MM_MIN = 30_000.0


def behind_linuxcnc(machine: Machine, *, hurried: bool) -> Machine:
    """The machine as a LinuxCNC of its own holds it: told joints, homed on a switch for each."""
    told: Machine = machine.model_copy(
        update={
            "mdi": "joint",
            "joints": None,
            "home_offset_mm": None,
            "position_endstop_mm": None,
        }
    )
    held: dict[str, object] = {"home_offset_mm": simulated_joints(told, None).home_offset_mm}
    if hurried:
        fast = {"feed_mm_min": HURRIED_MM_MIN}
        held["motion"] = (machine.motion or MotionLimits()).model_copy(update=fast)
        held["fastest_feed_mm_min"] = max(HURRIED_MM_MIN, machine.fastest_feed_mm_min)
    return told.model_copy(update=held)


def simulated_joints(machine: Machine, exported: Path | None) -> SimulatedJoints:
    """The joints of that LinuxCNC; its file includes what was ``exported`` for it to a folder.

    Where that is nothing, what the machine file holds is entered in it. Motors are mounted so that
    carriages stand right where the entered offsets are those of the machine. Raises RecordError.
    """
    zero, (low, high) = zero_mm(machine), box_mm(machine)
    x, y, z = (a + b for a, b in zip(zero, machine.entered_offsets_mm, strict=True))
    files = sorted(exported.glob("calib_joint?.inc")) if exported else []
    switch = machine.travel_max_mm + SWITCH_MM
    held = (zero[0] + switch, zero[1] + switch, zero[2] + switch)
    return SimulatedJoints(
        zero_mm=zero,
        low_mm=low,
        high_mm=high,
        home_offset_mm=held if files else machine.home_offset_mm or held,
        switch_mm=switch,
        mounted_mm=(x, y, z),
        includes={path.name: read_text(path, "include of LinuxCNC") for path in files},
    )


def rehearsed(steps: Sequence[Step], typed: Iterable[str]) -> Iterator[Step]:
    """The first step, then for each line the step of that number, without one the following."""
    at = 1
    yield steps[0]
    for line in typed:
        at = int(line) if line.isdecimal() and line.isascii() else at + 1
        at = min(max(at, 1), len(steps))
        yield steps[at - 1]


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
    RecordError for points off the bars and for readings beyond what any indicator shows.
    """
    procedure.check_bars(machine.geometry())
    opened = Opened(
        program=program(),
        origin="simulated",
        machine=machine,
        procedure=procedure,
        instruments=(Instrument(profile=SIMULATED, resolution_mm=resolution_mm or None),)
        * (2 if procedure.levels else 1),
        seed=seed,
    )
    blank = _blank_readings(procedure, machine, resolution_mm)
    values = measure(
        truth,
        to_observations([fold([opened, *blank])]),
        scatter_mm=scatter_mm,
        resolution_mm=resolution_mm,
        generator=seed,
    )
    largest_mm = float(abs(values).max())
    if not largest_mm <= LARGEST_MM:  # nor anything that is no number
        raise RecordError(
            "simulated readings",
            f"{largest_mm:g} mm",
            f"up to {LARGEST_MM:g} mm, what a record holds",
            "The model has an effect of impossible size.",
        )
    decimals = max(0, -math.floor(math.log10(resolution_mm))) if resolution_mm else EXACT_DECIMALS
    texts = [f"{value:.{decimals}f}" for value in values]
    return opened, tuple(
        reading.model_copy(update={"value_mm": float(text), "text": text})
        for reading, text in zip(blank, texts, strict=True)
    )


def simulated_of_files(
    procedure: str | None,
    machine: str | Path | None,
    model: Path | None,
    *,
    effect: str | None = None,
    size: float | None = None,
    seed: int,
    scatter_mm: float,
    resolution_mm: float,
) -> tuple[Opened, tuple[Reading, ...]]:
    """As `simulated_session`, of names and files, None: the usual ones.

    An ``effect`` (id, or id:where) of this ``size`` is hidden in the machine. Raises UsageError and
    RecordError.
    """
    if size is not None and effect is None:
        raise UsageError("--size", "no --effect", "the size of an effect: both options, or none")
    if model and machine:
        raise UsageError("--model and --machine", "both", "one: a model brings its own machine")
    real, known = _real(machine, model)
    planned = load_procedure(procedure or known.usual_procedure, known.geometry())
    if effect is not None:
        hidden = hidden_effect(
            effect,
            real,
            planned_readings(planned, known),
            effects=known_effects(),
            seed=seed,
            noise_mm=max(scatter_mm, resolution_mm),
            size=size,
        )
        real = real.with_effects((*real.effects, *hidden))
    return simulated_session(
        planned, known, real, seed=seed, scatter_mm=scatter_mm, resolution_mm=resolution_mm
    )


def _real(machine: str | Path | None, model: Path | None) -> tuple[Model, Machine]:
    if model:
        return read_model(model, known_effects())
    known = load_machine(machine)
    return Model(known.geometry()), known


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
            mount=default_mount(step.leg, axis, step.place[1]),
            station=step.station,
            over_plane=step.over_plane or None,
            time_s=step.number * procedure.seconds_per_step,
            resolution_mm=resolution_mm or None,
        )
        for number, (step, axis) in enumerate(visits, start=1)
    )


def short_travels(
    procedure: Procedure, machine: Machine, instruments: Sequence[Instrument]
) -> list[tuple[Instrument, float, str]]:
    """Indicators whose travel may not do, with the most that is needed in mm, and where."""
    if procedure.plate is not None or all(one.travel_mm is None for one in instruments):
        return []
    geometry = machine.geometry()
    places: dict[tuple[Touched, float, tuple[Leg, ...]], list[Step]] = {}
    for step in procedure.steps(geometry, [one.axes for one in instruments]):
        places.setdefault(step.place, []).append(step)
    tolerance_mm, found = machine.tolerances_mm(), []
    for k, instrument in enumerate(instruments):
        needed = []
        for steps in places.values():
            first = steps[0]
            if k not in first.indicators:
                continue
            axis = first.axes[first.indicators.index(k)]
            read = leg_number(first.leg), leg_number(axis)
            where = f"along {axis.upper()} of leg {first.leg.upper()}, "
            at = [(step.displacement_mm, step.station) for step in steps]
            tilt = machine.plane_tilt_mrad if first.over_plane else None
            moved_mm = excursion_mm(geometry, tolerance_mm, read, at, tilt)
            where += "over the plane" if first.over_plane else f"station {first.station:g}"
            needed.append((instrument, moved_mm, where))
        worst = descending(needed, lambda one: one[1])[0]
        if instrument.travel_mm is not None and worst[1] > instrument.travel_mm:
            found.append(worst)
    return found


def planned_readings(procedure: Procedure, machine: Machine) -> Observations:
    """Every reading of the procedure in order, its value without meaning."""
    opened, readings = simulated_session(
        procedure, machine, Model(machine.geometry()), seed=0, scatter_mm=0.0, resolution_mm=0.0
    )
    return to_observations([fold([opened, *readings])])
