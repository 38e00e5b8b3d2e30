"""Machines with three drives: from files and options to planning, from postures to files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from app.measuring.simulated import planned_readings
from calib.arrays import LEG_NAMES
from calib.errors import UsageError
from calib.noise.reading import IndicatorFigures, Noise
from calib.tripod.planning import Orders, TripodPlanning
from protocols.files import Written
from protocols.machine import Machine, load_machine
from protocols.procedure import Procedure, load_procedure

PROTOTYPE_NOISE_MM = 0.02
"""Repeatability of the papers' indicators; serves where nothing is stated."""


def stated_noise(machine: Machine, noise_mm: float | None) -> tuple[Noise, str]:
    """Noise of single readings and where it is from. Raises UsageError where it is not positive."""
    figures = IndicatorFigures(repeatability_mm=noise_mm)
    words = "as asked for"
    if noise_mm is None:
        worst = [
            max((float(v) for v in values if v is not None), default=None)
            for values in zip(
                *((i.resolution_mm, i.repeatability_mm) for i in machine.indicator), strict=True
            )
        ] or [None, None]
        figures, words = IndicatorFigures(worst[0], worst[1]), "of the machine file's indicators"
        if figures.noise() is None:
            figures = IndicatorFigures(repeatability_mm=PROTOTYPE_NOISE_MM)
            words = "that of the papers' indicators"
    noise = figures.noise(2)
    if noise is None:
        raise UsageError("--noise", f"{noise_mm:g} mm", "a positive length in mm")
    return noise, f"{noise.standard_deviation_mm:.4g} mm, {words}"


def tripod_planning(
    name: str,
    procedure_name: str = "",
    machine_file: Path | None = None,
    noise_mm: float | None = None,
    minutes_per_mounting: float = 2.0,
) -> tuple[TripodPlanning, Procedure]:
    """From names and paths, with the procedure; without a name or noise, those of the machine.

    Raises UsageError and RecordError.
    """
    machine = load_machine(machine_file or name)
    geometry = machine.geometry()
    procedure = load_procedure(procedure_name or machine.usual_procedure, geometry)
    noise, words = stated_noise(machine, noise_mm)
    steps = procedure.steps(geometry)
    planning = TripodPlanning(
        name=name,
        geometry=geometry,
        procedure=procedure.name,
        planned=planned_readings(procedure, machine),
        of_tool=not procedure.levels,
        stations=procedure.stations,
        step_count=len(steps),
        mounting_count=len({step.place for step in steps}),
        seconds_per_step=procedure.seconds_per_step,
        minutes_per_mounting=minutes_per_mounting,
        noise=noise,
        noise_words=words,
    )
    return planning, procedure


def procedure_files(orders: Orders, like: Procedure, path: Path) -> tuple[Path, Written]:
    """What to write where: the procedure, or one for each mounting with its name before the suffix.

    Timing and limits are those of the procedure ``like`` them.
    """
    texts = _texts(orders, like)
    if list(texts) == [""]:
        return path, texts
    return path.parent, {f"{path.stem}{part}.toml": text for part, text in texts.items()}


def _texts(orders: Orders, like: Procedure) -> dict[str, str]:
    """One procedure where all mountings visit the same displacements, else one for each."""
    legs = sorted({leg for leg, _ in orders})
    stations = sorted({station for _, station in orders})
    first = next(iter(orders.values()))
    if len(orders) == len(legs) * len(stations) and all(
        order == first for order in orders.values()
    ):
        return {"": _toml(like, "optimum", legs, stations, first)}
    return {
        f"-{LEG_NAMES[leg]}-{station:g}": _toml(
            like, f"optimum-{LEG_NAMES[leg]}", [leg], [station], order
        )
        for (leg, station), order in orders.items()
    }


def _toml(
    like: Procedure,
    name: str,
    legs: Sequence[int],
    stations: Sequence[float],
    levels: Sequence[float],
) -> str:
    listed = ", ".join(f'"{LEG_NAMES[leg]}"' for leg in legs)
    return "\n".join(
        [
            'schema = "glidecal.procedure/1"',
            f'name = "{name}"',
            'title = "Optimum postures, made by glidecal postures"',
            f"legs = [{listed}]",
            f"stations = [{', '.join(map(repr, stations))}]",
            "cycles = 1",
            f"levels = [{', '.join(map(repr, levels))}]",
            "return_to_zero = false  # the postures were chosen without it",
            f"seconds_per_step = {like.seconds_per_step!r}",
            'order = "fixed"  # each level is reached from the side that was chosen',
            f"window_s = {like.window_s!r}",
            f"tolerance_mm = {like.tolerance_mm!r}",
            f"repeat_limit_mm = {like.repeat_limit_mm!r}",
            "",
        ]
    )
