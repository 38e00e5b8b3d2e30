"""From what the operator asks for to a session that can be measured."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Literal

from app.evaluating.comparison import partner_of
from app.evaluating.own_effects import known_effects
from app.evaluating.solution import SessionSolution, solve_for_controller
from app.measuring.aligning import rail_moved
from app.measuring.gauges import Gauge
from app.measuring.indicators import (
    DEFAULT_PROFILE,
    SIMULATED,
    asked_of,
    check_indicators,
    from_file,
    profile_of,
    remember,
    simulated_indicators,
    this_computer,
)
from app.measuring.moving import Mover, open_mover
from app.measuring.session import GuidedSession
from app.measuring.simulated import (
    BenchSettings,
    SelfMovingBench,
    SimulatedBench,
    behind_linuxcnc,
    hidden_effect,
    planned_readings,
    simulated_joints,
)
from app.version import program
from calib.errors import GlidecalError, IndicatorError, RecordError, UsageError
from calib.tripod.alignment import misaligned
from calib.tripod.pipeline import Model, StageEffect
from calib.tripod.simulation import SimulatedMachine, hidden_machine
from drivers.motion.headless import HeadlessLinuxCnc, check_linuxcnc
from drivers.motion.twins import LinuxCncTwin, SimulatedAxes
from drivers.twins import default_transport
from protocols.documents import Triple
from protocols.files import reason_of, unused_path
from protocols.journal import Journal
from protocols.machine import Instrument, Machine, load_machine
from protocols.motion import timed, tool_at
from protocols.procedure import Leg, Procedure, Step, load_procedure
from protocols.record import read_record
from protocols.session import Opened, fold

SIMULATED_INTERVAL_S, QUICK_INTERVAL_S = 0.05, 0.01
"""Simulated indicators may be asked faster than real ones, and faster still where nobody looks;
without any pause they take the processor from all the rest."""

SIMULATED_WINDOW_S = 0.4
"""How long simulated readings must stand still; real ones as the procedure says."""


@dataclass(frozen=True)
class Plan:
    """Everything known before the first reading.

    ``before`` is the solution whose offsets this session verifies, ``verifies`` its file name.
    ``continued``: the record is there and goes on. With ``reference`` the rails are aligned to that
    one between rounds of measuring. ``motion`` names the controller that moves the machine;
    with ``by_itself`` a simulated machine is moved, by a simulated controller or a real LinuxCNC.
    """

    path: Path
    machine: Machine
    procedure: Procedure
    instruments: tuple[Instrument, ...]
    operator: str = ""
    temperature_c: float | None = None
    note: str = ""
    seed: int = 1
    before: SessionSolution | None = None
    verifies: str | None = None
    continued: bool = False
    bench: BenchSettings = BenchSettings()
    interval_s: float = SIMULATED_INTERVAL_S
    window_s: float | None = None
    reference: Leg | None = None
    motion: str | None = None
    by_itself: Literal["twin", "linuxcnc"] | None = None

    def __post_init__(self) -> None:
        """Against a plate, or over planes alone, the first indicator reads that may along it.

        Steps take as long as the machine needs where it moves itself.
        """
        if not self.procedure.levels:
            read = self.procedure.indicators_used(self.instruments)
            object.__setattr__(self, "instruments", read)
        if self.motion and not self.continued:
            machine_time = timed(self.procedure, self.machine, self.axes)
            object.__setattr__(self, "procedure", machine_time)

    @property
    def simulated(self) -> bool:
        """The machine and its indicators are simulated."""
        return all(instrument.port == SIMULATED for instrument in self.instruments)

    @property
    def axes(self) -> tuple[str, ...]:
        """For each indicator the directions it may measure along."""
        return tuple(instrument.axes for instrument in self.instruments)


def opened_event(plan: Plan) -> Opened:
    """The first line of the record."""
    return Opened(
        program=program(),
        origin="simulated" if plan.simulated else "measured",
        machine=plan.machine,
        procedure=plan.procedure,
        instruments=plan.instruments,
        seed=plan.seed if plan.simulated else None,
        operator=plan.operator,
        temperature_c=plan.temperature_c,
        verifies=plan.verifies,
        aligned_to=plan.reference,
        computer=None if plan.simulated else this_computer(),
    )


class PortsUnknown(UsageError):
    """The ports of a record are those of another computer."""


@dataclass(frozen=True)
class Indicators:
    """Indicators that answer, and how to move the machine where that can be done."""

    gauges: tuple[Gauge, ...]
    go: Callable[[Step], None] | None = None  # the operator moves a real machine
    close_bench: Callable[[], None] = lambda: None
    turn: Callable[[StageEffect, Step], None] | None = None  # a screw of a simulated machine
    mover: Mover | None = None

    def close(self) -> None:
        """Let go of a controller, close every port, then switch a simulated machine off."""
        if self.mover is not None:
            self.mover.close()
        for gauge in self.gauges:
            gauge.close()
        self.close_bench()


def open_indicators(plan: Plan) -> Indicators:
    """Open every port, all or none. Raises UsageError before, IndicatorError at a port."""
    check_indicators(plan.instruments, legs=bool(plan.procedure.levels))
    profiles = [profile_of(instrument) for instrument in plan.instruments]
    ports = tuple(instrument.port for instrument in plan.instruments)
    with ExitStack() as undo:
        interval_s, window_s = None, plan.procedure.window_s
        bench: SimulatedBench | None = None
        moving: SelfMovingBench | None = None
        told = plan.motion
        if plan.simulated and plan.by_itself:
            moving = self_moving_bench(plan)
            undo.callback(moving.close)
            ports, told = moving.ports, moving.controller.told
        elif plan.simulated:
            bench = simulated_bench(plan)
            undo.callback(bench.close)
            ports = bench.rig.ports
        if plan.simulated:
            interval_s, window_s = plan.interval_s, SIMULATED_WINDOW_S
        gauges = tuple(
            Gauge(
                profile,
                port,
                asked_of(known),
                interval_s=interval_s,
                window_s=plan.window_s or window_s,
                tolerance_mm=plan.procedure.tolerance_mm,
            )
            for profile, port, known in zip(profiles, ports, plan.instruments, strict=True)
        )
        for gauge in gauges:
            gauge.start()
            undo.callback(gauge.close)
        mover = None
        if told is not None:
            mover = open_mover(told, plan.procedure, plan.machine, plan.axes)
        undo.pop_all()
    if bench is not None:
        return Indicators(gauges, bench.go, bench.close, bench.turn)
    if moving is not None and mover is not None:
        mover.on_set_up = moving.set_up
        return Indicators(gauges, close_bench=moving.close, mover=mover)
    return Indicators(gauges, mover=mover)


def simulated_bench(plan: Plan) -> SimulatedBench:
    """The simulated machine of a plan, with its indicators switched on."""
    profiles = [profile_of(instrument) for instrument in plan.instruments]
    known = (_truth(plan), plan.seed, plan.path.name, profiles, default_transport(), plan.bench)
    return SimulatedBench(*known, _lift_mm(plan))


def self_moving_bench(plan: Plan) -> SelfMovingBench:
    """The same machine behind a controller, homed with the offsets that are entered.

    Raises RecordError, UsageError or MotionError for a LinuxCNC that cannot be had.
    """
    truth, bench = _truth(plan), plan.bench
    truth = truth.with_effects((*truth.effects, *bench.effects))
    name, lift_mm = plan.path.name, _lift_mm(plan)
    machine = SimulatedMachine(truth, plan.seed, name, bench.scatter_mm, lift_mm)
    profiles = [profile_of(instrument) for instrument in plan.instruments]
    controller: LinuxCncTwin | HeadlessLinuxCnc
    if plan.by_itself == "twin":
        controller = LinuxCncTwin(SimulatedAxes(hurry=bench.hurry))
    else:
        exported = plan.path.with_name(plan.verifies).with_suffix("") if plan.verifies else None
        controller = HeadlessLinuxCnc(simulated_joints(plan.machine, exported))
    known = machine, profiles, default_transport(), bench, controller

    def passed_mm() -> list[Triple]:
        return [tool_at(place, plan.machine) for place in controller.axes.passed_mm()]

    return SelfMovingBench(*known, passed_mm)


def _truth(plan: Plan) -> Model:
    return hidden_machine(plan.machine.geometry(), plan.seed, plan.machine.entered_offsets_mm)


def _lift_mm(plan: Plan) -> float:
    return plan.procedure.plate.lift_mm if plan.procedure.plate else 0.0


def first_step(plan: Plan) -> Step | None:
    """The step that is measured first. Raises RecordError or UsageError."""
    if plan.continued:
        return fold(read_record(plan.path).events).next_step()
    return plan.procedure.steps(plan.machine.geometry(), plan.axes)[0]


def begin(plan: Plan, indicators: Indicators) -> GuidedSession:
    """Start the record of a plan, or go on with it. Raises RecordError or UsageError."""
    if plan.continued:
        journal = Journal.resume(plan.path, program())
    else:
        plan.procedure.steps(plan.machine.geometry(), plan.axes)
        plan.procedure.check_bars(plan.machine.geometry())
        journal = Journal.create(plan.path, opened_event(plan))
    guided = GuidedSession(
        journal, indicators.gauges, indicators.go, indicators.close, mover=indicators.mover
    )
    guided.turn = indicators.turn
    if plan.note and not plan.continued:
        guided.note(plan.note)
    if not plan.simulated:
        with suppress(RecordError):  # a proposal for the next time: no session fails for it
            remember(plan.machine.name, plan.instruments)
    return guided


def start_session(plan: Plan) -> GuidedSession:
    """Open the indicators and begin. Raises IndicatorError, RecordError or UsageError."""
    indicators = open_indicators(plan)
    try:
        return begin(plan, indicators)
    except GlidecalError:
        indicators.close()
        raise


def plan_to_continue(
    path: Path, instruments: tuple[Instrument, ...] = (), *, whole: bool = False
) -> Plan:
    """The plan of an interrupted session, on the same indicators unless others are named.

    Of a ``whole`` one that more set-ups follow. Raises RecordError where the record is altered,
    closed or imported, PortsUnknown where it is of another computer and no indicators are named.
    """
    record = read_record(path)
    opened = record.opened
    if (record.end == "closed" and not whole) or opened.procedure is None:
        found = "a closed session" if opened.procedure else "an imported table"
        raise RecordError(f"session {path}", found, "an interrupted session to continue")
    if instruments and [i.axes for i in instruments] != [i.axes for i in opened.instruments]:
        axes = " and ".join(f"@{i.axes}" for i in opened.instruments)
        raise UsageError("indicators of a continued session", "other axes", axes)
    known = instruments or _known_here(path, opened)
    plan = replace(_planned(path, opened, opened.procedure, known), continued=True)
    return aligning(plan, opened.aligned_to) if opened.aligned_to else plan


def plan_to_repeat(path: Path) -> Plan | None:
    """The plan of a finished session, as it can be measured once more.

    None for an imported table, and where its ports are those of another computer. Raises
    RecordError where the record is altered.
    """
    opened = read_record(path).opened
    if opened.procedure is None or not opened.instruments:
        return None
    try:
        known = _known_here(path, opened)
    except (PortsUnknown, UsageError, RecordError):
        return None
    return _planned(path, opened, opened.procedure, known)


def _planned(
    path: Path, opened: Opened, procedure: Procedure, instruments: tuple[Instrument, ...]
) -> Plan:
    verified = partner_of(path, opened.verifies)
    return Plan(
        path=path,
        machine=opened.machine,
        procedure=procedure,
        instruments=instruments,
        operator=opened.operator,
        temperature_c=opened.temperature_c,
        seed=opened.seed or 0,
        before=solve_for_controller(verified) if verified else None,
        verifies=opened.verifies,
    )


def _known_here(path: Path, opened: Opened) -> tuple[Instrument, ...]:
    """The indicators of a record, if its ports mean anything here."""
    instruments = from_file(opened.instruments, f"session {path}")
    simulated = all(instrument.port == SIMULATED for instrument in instruments)
    if not simulated and opened.computer != this_computer():
        anew = " ".join(f"--indicator PROFILE:PORT@{i.axes}" for i in instruments)
        raise PortsUnknown(
            f"session {path}",
            "ports that were not named on this computer",
            f"its indicators named anew: {anew}",
            "A machine file with [[indicator]] does it too: --machine FILE.",
        )
    return instruments


def session_name(folder: Path, word: str) -> Path:
    """A new file name with date and time."""
    plain = re.sub(r"[^\w-]+", "-", word)[:40]
    return unused_path(folder / f"{datetime.now():%Y-%m-%d_%H%M%S}_{plain}.jsonl")


def writable_folder(folder: Path) -> Path:
    """The folder, made where it is missing. Raises RecordError where that is impossible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise RecordError(
            f"folder {folder}",
            allowed="a folder with write permission",
            reason=reason_of(problem),
        ) from problem
    return folder


DEMO_MOTION_S = 0.6
COMPRESSED_STEP_S = 0.01
WATCHED_STEP_S = 3.0
"""About how long a step of the demonstration takes, unattended and on the screen."""

HURRIED_STEP_S, SELF_MOVING_STEP_S = 0.2, 4.0
"""The same on a machine that moves itself."""


def demo_plan(
    folder: Path,
    protocol: str | None,
    seed: int,
    bench: BenchSettings,
    profiles: Sequence[str] = (DEFAULT_PROFILE,),
    machine_name: str | None = None,
) -> Plan:
    """A session on a machine whose errors are hidden behind the seed.

    Without a protocol the machine's own. Raises UsageError and RecordError.
    """
    machine = load_machine(machine_name)
    procedure = load_procedure(protocol or machine.usual_procedure, machine.geometry())
    return Plan(
        path=session_name(folder, "demo"),
        machine=machine,
        procedure=procedure,
        instruments=simulated_indicators(profiles),
        operator="demo",
        seed=seed,
        bench=bench,
    )


HURRY, HURRIED_WINDOW_S = 30.0, 0.05
"""Of an unattended demonstration that moves itself: as much faster, and so short a rest."""


def moving_itself(plan: Plan, by: Literal["twin", "linuxcnc"], *, hurried: bool) -> Plan:
    """The plan on a machine behind a simulated controller or LinuxCNC; hurried where nobody looks.

    Raises UsageError where LinuxCNC cannot be started.
    """
    plan = replace(plan, by_itself=by)
    if by == "linuxcnc":
        check_linuxcnc()
        plan = replace(plan, machine=behind_linuxcnc(plan.machine, hurried=hurried))
    if not hurried:
        return plan
    bench = replace(plan.bench, hurry=HURRY)
    return replace(plan, bench=bench, window_s=HURRIED_WINDOW_S)


def rehearsal_plan(
    profile: str, protocol: str, machine: str | None, seed: int, resolution_mm: float
) -> Plan:
    """Indicators on a machine that goes where it is sent; no record. Raises as `demo_plan`."""
    known = load_machine(machine)
    procedure = load_procedure(protocol, known.geometry())
    bench = BenchSettings(resolution_mm, motion_s=DEMO_MOTION_S)
    instruments = simulated_indicators([profile])
    return Plan(Path("rehearsal"), known, procedure, instruments, seed=seed, bench=bench)


def with_hidden_effect(plan: Plan, effect: str) -> Plan:
    """The plan with an effect in its machine that the record does not tell.

    ``effect`` is an id, or id:where. Raises UsageError for one that is not known or that the
    procedure cannot see.
    """
    truth = hidden_machine(plan.machine.geometry(), plan.seed)
    step_s = WATCHED_STEP_S if plan.bench.motion_s else COMPRESSED_STEP_S
    if plan.by_itself:
        step_s = HURRIED_STEP_S if plan.bench.hurry > 1.0 else SELF_MOVING_STEP_S
    effects = hidden_effect(
        effect,
        truth,
        planned_readings(plan.procedure, plan.machine),
        effects=known_effects(),
        seed=plan.seed,
        noise_mm=math.hypot(plan.bench.scatter_mm, plan.bench.resolution_mm),
    )
    clock_rate = plan.procedure.seconds_per_step / step_s
    return replace(plan, bench=replace(plan.bench, effects=effects, clock_rate=clock_rate))


def aligning(plan: Plan, reference: Leg) -> Plan:
    """The plan with its rails aligned between rounds; a simulated machine's are off.

    What the record says was moved is moved. Raises RecordError.
    """
    if not plan.simulated:
        return replace(plan, reference=reference)
    geometry, moved = plan.machine.geometry(), []
    for change in fold(read_record(plan.path).events).changes if plan.continued else ():
        if change.support_mm is not None:  # else it was only begun
            moved.append(rail_moved(change, plan.machine.rails_rest_mm()))
    effects = (*misaligned(geometry, plan.seed), *moved)
    return replace(plan, reference=reference, bench=replace(plan.bench, effects=effects))


def verification_plan(plan: Plan, before: SessionSolution) -> Plan:
    """The same procedure after the offsets were entered in the controller."""
    found = before.joint_offsets_mm
    entered = [old + new for old, new in zip(plan.machine.entered_offsets_mm, found, strict=True)]
    held = plan.machine.home_at_mm()
    home = held and [old + new for old, new in zip(held, found, strict=True)]
    machine: Machine = plan.machine.model_copy(
        update={
            "adjusted": before.sessions[0].adjusted,
            "entered_offsets_mm": tuple(entered),
            "home_offset_mm": tuple(home) if home else None,
            "position_endstop_mm": None,
        }
    )
    path = unused_path(plan.path.with_name(plan.path.stem + "_verify.jsonl"))
    return replace(
        plan,
        path=path,
        machine=machine,
        before=before,
        verifies=plan.path.name,
        note="",
        continued=False,
    )


def measure_all(guided: GuidedSession) -> None:
    """Take every step of a simulated session unattended, keep all, and close the record.

    Raises IndicatorError where an indicator gives no value.
    """
    guided.go()
    while (taken := guided.take()) is not None:
        if taken.faults:
            raise IndicatorError("simulated indicator", taken.faults[0].words, "a reading")
        if taken.doubt:
            guided.keep(taken, "unattended: kept")
        guided.go()
    guided.finish()
