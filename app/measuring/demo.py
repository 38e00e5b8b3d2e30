"""The demonstration: a simulated machine with its hidden errors, behind indicators that answer."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

from app.measuring.indicators import DEFAULT_PROFILE, profile_of, simulated_indicators
from app.measuring.plan import (
    QUICK_INTERVAL_S,
    SIMULATED_INTERVAL_S,
    Plan,
    session_name,
    writable_folder,
)
from app.measuring.simulated import BenchSettings, hidden_effect, planned_readings
from calib.arrays import conditions
from calib.tripod.pipeline import StageEffect
from calib.tripod.simulation import SimulatedMachine, hidden_machine
from drivers.motion.headless import HeadlessLinuxCnc, SimulatedJoints, check_linuxcnc
from drivers.motion.twins import LinuxCncTwin, SimulatedAxes
from drivers.profile import Spindle
from drivers.twins import IndicatorTwin, SimulatedRig, TwinPort, default_transport
from protocols.documents import Triple, read_text
from protocols.machine import Machine, MotionLimits, load_machine
from protocols.motion import box_mm, tool_at, zero_mm
from protocols.procedure import Step, default_mount, leg_number, procedure_on

WATCHED = BenchSettings(motion_s=0.6)
"""Where somebody looks at it, spindles glide."""

COMPRESSED_STEP_S, WATCHED_STEP_S = 0.01, 3.0
"""About how long a step of the demonstration takes, unattended and on the screen."""

HURRIED_STEP_S, SELF_MOVING_STEP_S = 0.2, 4.0
"""The same on a machine that moves itself."""

HURRY, HURRIED_WINDOW_S = 30.0, 0.05
"""Of an unattended demonstration that moves itself: as much faster, and so short a rest."""


def demo_plan(
    folder: Path,
    protocol: str | None,
    seed: int,
    bench: BenchSettings = BenchSettings(),
    profiles: Sequence[str] = (),
    machine_name: str | None = None,
    *,
    by_itself: Literal["twin", "linuxcnc"] | None = None,
    effect: str | None = None,
) -> Plan:
    """A session on a machine whose errors are hidden behind the seed.

    Without a protocol the machine's own. ``by_itself``: behind a simulated controller or LinuxCNC,
    in a hurry where nobody looks. An ``effect`` (id, or id:where) is in the machine, too, and the
    record does not tell it. Raises RecordError, and UsageError, also where LinuxCNC cannot be
    started, and for an effect that is not known or that the procedure cannot see.
    """
    machine, watched = load_machine(machine_name), bench.motion_s > 0.0
    procedure = procedure_on(machine, protocol)
    if by_itself == "linuxcnc":
        check_linuxcnc()
        machine = behind_linuxcnc(machine, hurried=not watched)
    step_s, window_s = WATCHED_STEP_S if watched else COMPRESSED_STEP_S, None
    if by_itself and watched:
        step_s = SELF_MOVING_STEP_S
    elif by_itself:
        step_s, window_s = HURRIED_STEP_S, HURRIED_WINDOW_S
        bench = replace(bench, hurry=max(bench.hurry, HURRY))
    if effect is not None:
        hidden = hidden_effect(
            effect,
            hidden_machine(machine.geometry(), seed),
            planned_readings(procedure, machine),
            seed=seed,
            noise_mm=math.hypot(bench.scatter_mm, bench.resolution_mm),
        )
        bench = replace(bench, effects=hidden, clock_rate=procedure.seconds_per_step / step_s)
    return Plan(
        path=session_name(folder, "demo"),
        machine=machine,
        procedure=procedure,
        instruments=simulated_indicators(profiles or [DEFAULT_PROFILE]),
        operator="demo",
        seed=seed,
        bench=bench,
        interval_s=SIMULATED_INTERVAL_S if watched else QUICK_INTERVAL_S,
        window_s=window_s,
        by_itself=by_itself,
    )


def watched_plan(folder: Path) -> Plan:
    """The demonstration that home offers. Raises RecordError where nothing can be written."""
    return demo_plan(writable_folder(folder), "zero-max-min", 1, WATCHED)


class Bench:
    """The simulated machine of a plan, and what its indicators show at a step.

    Machine and zeros follow from the seed, so an interrupted simulated session goes on; the
    scatter differs from run to run.
    """

    def __init__(self, plan: Plan) -> None:
        machine, settings = plan.machine, plan.bench
        truth = hidden_machine(machine.geometry(), plan.seed, machine.entered_offsets_mm)
        lift_mm = plan.procedure.plate.lift_mm if plan.procedure.plate else 0.0
        self.machine = SimulatedMachine(
            truth.with_effects(settings.effects),
            plan.seed,
            plan.path.name,
            settings.scatter_mm,
            lift_mm,
        )
        self._clock_rate, self._start_s = settings.clock_rate, time.monotonic()
        self.shown_mm = [0.0] * len(plan.instruments)

    def read(self, step: Step, along_mm: float, position_mm: Sequence[float] | None) -> None:
        """Move the indicators of the step to where the machine is: along a leg, and beside it."""
        n, leg = len(step.axes), leg_number(step.leg)
        axes = [leg_number(axis) for axis in step.axes]
        to = conditions(
            [leg] * n, axes, [along_mm] * n, station=step.station, position_mm=position_mm
        )
        if step.over_plane:
            covered = self.machine.truth.geometry.covered_mm[leg]
            to = replace(to, along_mm=to.displacement_mm + step.station * covered)
        mounts = [default_mount(step.leg, axis, step.place[1]) for axis in step.axes]
        time_s = (time.monotonic() - self._start_s) * self._clock_rate
        values = self.machine.go(to, mounts, step.number, time_s)
        for number, value in zip(step.indicators, values, strict=True):
            self.shown_mm[number] = value


class SimulatedBench(Bench):
    """A machine that goes where it is sent; its indicators answer over real serial connections."""

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan)
        self.rig = SimulatedRig(
            [profile_of(instrument) for instrument in plan.instruments],
            resolution_mm=plan.bench.resolution_mm,
            transport=default_transport(),
            motion_s=plan.bench.motion_s,
            fastest_stream=plan.bench.motion_s == 0.0,
        )
        self.ports, self.close = self.rig.ports, self.rig.close

    def go(self, step: Step) -> None:
        """Move the machine to a step; each approach scatters a little."""
        self.read(step, step.displacement_mm, step.position_mm)
        self.rig.go(self.shown_mm)

    def turn(self, moved: StageEffect, step: Step) -> None:
        """A rail is moved while the indicators stand as for a step."""
        truth = self.machine.truth
        self.machine.truth = truth.with_effects((*truth.effects, moved))
        self.go(step)


PLACE_DECIMALS = 3
"""A controller tells its place in seven digits or so: Zero would be 0.05 µm to one side of Zero,
and the carriages beside would have come from the side that they did not come from."""


class SelfMovingBench(Bench):
    """The simulated machine behind a controller: its indicators follow where that moves it.

    They show what they do where the machine is at that very moment, also on its way: the last of
    the places that were passed, if it had no errors; those before tell from which side it came.
    ``set_up`` puts the stand where a step needs it. Raises RecordError, UsageError or MotionError
    for a LinuxCNC that cannot be had.
    """

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan)
        self._known = plan.machine
        self.controller: LinuxCncTwin | HeadlessLinuxCnc
        if plan.by_itself == "twin":
            axes = SimulatedAxes(hurry=plan.bench.hurry)
            self.controller = LinuxCncTwin(axes, plan.machine.mdi)
        else:  # homed with the offsets that are entered
            exported = plan.path.with_name(plan.verifies).with_suffix("") if plan.verifies else None
            self.controller = HeadlessLinuxCnc(simulated_joints(plan.machine, exported))
        self._lock = threading.Lock()
        self._step: Step | None = None
        self._place: Triple | None = None
        profiles = [profile_of(instrument) for instrument in plan.instruments]
        self._ports = [
            TwinPort(
                IndicatorTwin(profile, Spindle(partial(self._shows, k), plan.bench.resolution_mm)),
                default_transport(),
                stream_s=profile.stream_s,
            )
            for k, profile in enumerate(profiles)
        ]
        self.ports = tuple(port.url for port in self._ports)

    def set_up(self, step: Step) -> None:
        """What an operator does by hand before a step."""
        with self._lock:
            self._follow()  # what was passed belongs to the set-up before
            self._step, self._place = step, None
            self._follow()

    def _follow(self) -> None:
        for passed_mm in self.controller.axes.passed_mm():
            x, y, z = tool_at(passed_mm, self._known)
            place = (round(x, PLACE_DECIMALS), round(y, PLACE_DECIMALS), round(z, PLACE_DECIMALS))
            if self._step is not None and place != self._place:
                self._place = place
                self._stand_at(self._step, place)

    def _stand_at(self, step: Step, tool_mm: Triple) -> None:
        """The tool is there: so far along the leg that is set up, and so far beside it."""
        if step.leg == "tool":
            self.read(step, 0.0, tool_mm)
            return
        way = self.machine.truth.geometry.direction[leg_number(step.leg)]
        along_mm = sum(a * b for a, b in zip(way, tool_mm, strict=True))
        stand_mm = [place - along_mm * part for place, part in zip(tool_mm, way, strict=True)]
        self.read(step, along_mm, stand_mm)

    def _shows(self, number: int) -> float:
        with self._lock:
            self._follow()
            return self.shown_mm[number]

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
    machine_of_controller: Machine = machine.model_copy(
        update={"mdi": "joint", "joints": None, "home_offset_mm": None, "position_endstop_mm": None}
    )
    changes: dict[str, object] = {
        "home_offset_mm": simulated_joints(machine_of_controller, None).home_offset_mm
    }
    if hurried:
        fast = {"feed_mm_min": HURRIED_MM_MIN}
        changes["motion"] = (machine.motion or MotionLimits()).model_copy(update=fast)
        changes["fastest_feed_mm_min"] = max(HURRIED_MM_MIN, machine.fastest_feed_mm_min)
    return machine_of_controller.model_copy(update=changes)


def simulated_joints(machine: Machine, exported: Path | None) -> SimulatedJoints:
    """The joints of that LinuxCNC; its file includes what was ``exported`` for it to a folder.

    Where that is nothing, what the machine file holds is entered in it. Motors are mounted so that
    carriages stand right where the entered offsets are those of the machine. Raises RecordError.
    """
    zero, (low, high) = zero_mm(machine), box_mm(machine)
    x, y, z = (a + b for a, b in zip(zero, machine.entered_offsets_mm, strict=True))
    files = sorted(exported.glob("calib_joint?.inc")) if exported else []
    switch = machine.travel_max_mm + SWITCH_MM
    home_mm = (zero[0] + switch, zero[1] + switch, zero[2] + switch)
    return SimulatedJoints(
        zero_mm=zero,
        low_mm=low,
        high_mm=high,
        home_offset_mm=home_mm if files else machine.home_offset_mm or home_mm,
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
