"""The demonstration: calibrate a simulated machine, enter the offsets, measure again, compare."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from app.evaluating.own_effects import known_effects
from app.evaluating.solution import SessionSolution
from app.measuring.hidden_effect import hidden_effect
from app.measuring.indicators import DEFAULT_PROFILE, simulated_indicators
from app.measuring.opening import Plan, refuse_plate, session_name
from app.measuring.session import GuidedSession, TakenStep
from app.measuring.simulated import BenchSettings, planned_readings
from calib.errors import IndicatorError
from calib.tripod.simulation import hidden_machine
from protocols.files import unused_path
from protocols.machine import Machine, load_machine
from protocols.procedure import load_procedure

DEMO_MOTION_S = 0.6
COMPRESSED_STEP_S = 0.01
WATCHED_STEP_S = 3.0
"""About how long a step of the demonstration takes, unattended and on the screen."""


def demo_plan(
    folder: Path,
    protocol: str,
    seed: int,
    bench: BenchSettings,
    profiles: Sequence[str] = (DEFAULT_PROFILE,),
) -> Plan:
    """A session on a machine whose errors are hidden behind the seed."""
    machine = load_machine(None)
    return Plan(
        path=session_name(folder, "demo"),
        machine=machine,
        procedure=load_procedure(protocol, machine.geometry()),
        instruments=simulated_indicators(profiles),
        operator="demo",
        seed=seed,
        bench=bench,
    )


def rehearsal_plan(
    profile: str, protocol: str, machine: str | None, seed: int, resolution_mm: float
) -> Plan:
    """Two indicators on a machine that goes where it is sent; no record. Raises as `demo_plan`."""
    known = load_machine(machine)
    procedure = load_procedure(protocol, known.geometry())
    refuse_plate(procedure)
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


def verification_plan(plan: Plan, before: SessionSolution) -> Plan:
    """The same procedure after the offsets were entered in the controller."""
    found = before.joint_offsets_mm
    entered = [old + new for old, new in zip(plan.machine.entered_offsets_mm, found, strict=True)]
    held = plan.machine.home_offset_mm
    home = held and [old + new for old, new in zip(held, found, strict=True)]
    machine: Machine = plan.machine.model_copy(
        update={
            "entered_offsets_mm": tuple(entered),
            "home_offset_mm": tuple(home) if home else None,
        }
    )
    path = unused_path(plan.path.with_name(plan.path.stem + "_verify.jsonl"))
    return replace(
        plan, path=path, machine=machine, before=before, verifies=plan.path.name, continued=False
    )


def measure_all(
    guided: GuidedSession, progress: Callable[[TakenStep], None] = lambda _: None
) -> None:
    """Take every step of a simulated session unattended, keep all, and close the record.

    Raises IndicatorError where an indicator gives no value.
    """
    guided.go()
    while (taken := guided.take()) is not None:
        if taken.faults:
            raise IndicatorError("simulated indicator", taken.faults[0].words, "a reading")
        if taken.doubt:
            guided.keep(taken, "unattended: kept")
        progress(taken)
        guided.go()
    guided.finish()
