"""The demonstration: calibrate a simulated machine, enter the offsets, measure again, compare."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from app.bench import BenchSettings, hidden_machine
from app.exports import FORMATS
from app.exports.offsets import offsets_from_solved
from app.exports.writing import write_files
from app.guided import GuidedSession, Taken
from app.hidden_effect import hidden_effect
from app.indicators import DEFAULT_PROFILE, simulated_indicators
from app.opening import Plan, session_name, start_session
from app.own_effects import known_laws
from app.planning_orthoglide import planned_readings
from app.solving import Solved, solve_for_controller
from calib.errors import CalibrationError
from drivers.errors import IndicatorError
from protocols.machine import Machine, load_machine
from protocols.own_files import unused_path
from protocols.procedure import load_procedure

DEMO_MOTION_S = 0.6
COMPRESSED_STEP_S = 0.01
WATCHED_STEP_S = 3.0
"""About how long a step of the demonstration takes, unattended and on the screen."""

FILE_NAMES = {"json": "offsets.json", "csv": "offsets.csv", "model": "model.json"}


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
        laws=known_laws(),
        seed=plan.seed,
        noise_mm=math.hypot(plan.bench.scatter_mm, plan.bench.resolution_mm),
    )
    clock_rate = plan.procedure.seconds_per_step / step_s
    return replace(plan, bench=replace(plan.bench, effects=effects, clock_rate=clock_rate))


def verification_plan(plan: Plan, before: Solved) -> Plan:
    """The same procedure after the offsets were entered in the controller."""
    offsets = offsets_from_solved(before)
    entered = [
        old + new
        for old, new in zip(plan.machine.entered_offsets_mm, offsets.joint_offsets_mm, strict=True)
    ]
    held = plan.machine.home_offset_mm
    home = held and [old + new for old, new in zip(held, offsets.joint_offsets_mm, strict=True)]
    machine: Machine = plan.machine.model_copy(
        update={
            "entered_offsets_mm": tuple(entered),
            "home_offset_mm": tuple(home) if home else None,
        }
    )
    path = unused_path(plan.path.with_name(plan.path.stem + "_verify.jsonl"))
    return replace(plan, path=path, machine=machine, before=before, verifies=plan.path.name)


def measure_all(guided: GuidedSession, progress: Callable[[Taken], None] = lambda _: None) -> None:
    """Take every step of a simulated session unattended and close the record.

    Raises IndicatorError where an indicator gives no value.
    """
    guided.go()
    while (taken := guided.take()) is not None:
        if taken.faults:
            raise IndicatorError("simulated indicator", taken.faults[0].words, "a reading")
        progress(taken)
        guided.go()
    guided.finish()


def export_offsets(solved: Solved, folder: Path) -> list[Path]:
    """Offsets of a solution in every format, into a folder. Raises RecordError."""
    offsets = offsets_from_solved(solved)
    paths: list[Path] = []
    for name, written in FORMATS.items():
        target = folder if name == "linuxcnc" else folder / FILE_NAMES[name]
        paths += write_files(target, written(offsets))
    return paths


def run_headless(plan: Plan, say: Callable[[str], None]) -> tuple[Solved, Solved]:
    """Measure, identify, export, measure again; the two solutions to compare."""
    before = _measured(plan, say)
    folder = plan.path.with_suffix("")
    for path in export_offsets(before, folder):
        say(f"exported: {path}")
    after = _measured(verification_plan(plan, before), say)
    if not after.solution.rms_before_mm < before.solution.rms_before_mm:
        raise CalibrationError(
            "verification",
            f"{after.solution.rms_before_mm:.3f} mm r.m.s. after calibration",
            f"less than the {before.solution.rms_before_mm:.3f} mm before it",
            "Look at both sessions with glidecal solve.",
        )
    return before, after


def _measured(plan: Plan, say: Callable[[str], None]) -> Solved:
    with start_session(plan) as guided:
        total = len(guided.steps)
        say(f"measuring {total} steps into {plan.path}")
        measure_all(guided)
    return solve_for_controller(plan.path)
