"""Sessions that a simulation measured at once, without ports; what a simulated machine hides."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from app.evaluating.own_effects import known_effects
from app.measuring.indicators import SIMULATED
from app.version import program
from calib.arrays import Conditions, Observations, descending
from calib.errors import RecordError, UsageError, check_number
from calib.tripod.effects import BESIDE_CATALOGUE
from calib.tripod.effects.candidates import candidates, single_places
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.hidden import hidden_among
from calib.tripod.pipeline import Model, StageEffect, measure
from calib.tripod.planning import excursion_mm
from drivers.profile import LARGEST_MM
from protocols.documents import LEAST_FIGURE_MM
from protocols.effect_entries import LARGEST_SIZE
from protocols.machine import Instrument, Machine, load_machine
from protocols.model_file import OF_MODELS, read_model
from protocols.observations import to_observations
from protocols.procedure import (
    Leg,
    Procedure,
    Step,
    Touched,
    default_mount,
    leg_number,
    procedure_on,
)
from protocols.session import Opened, Reading, Session, fold


def hidden_effect(
    name: str,
    truth: Model,
    conditions: Conditions,
    *,
    seed: int,
    noise_mm: float,
    size: float | None = None,
) -> tuple[EffectInstance, ...]:
    """The effect of this ``name`` (id, or id:where) for the machine ``truth``; see `hidden_among`.

    Raises UsageError where it is not known, or these readings cannot show it.
    """
    effect_id, _, where = f"{name}".partition(":")
    effects = (*known_effects(), *BESIDE_CATALOGUE, *OF_MODELS)
    if effect_id not in {effect.id for effect in effects}:
        raise UsageError("effect", repr(effect_id), ", ".join(dict.fromkeys(x.id for x in effects)))
    laws = [effect for effect in effects if effect.id == effect_id]
    of_it = [c for c in candidates(truth, conditions, laws) if "," not in c.where]
    if not of_it:
        raise _not_seen(effect_id)
    here = [c for c in of_it if where in ("", c.where)]
    if not here:  # one direction across a drive, which has a place in a model file, too
        alone = single_places(truth, conditions, laws)
        here = [c for c in alone if c.where == where]
    if not here:
        places = ", ".join(dict.fromkeys(c.where for c in (*of_it, *alone)))
        raise UsageError(f"place of effect {effect_id}", repr(where), places)
    effect_hidden = hidden_among(here, truth, conditions, seed=seed, noise_mm=noise_mm, size=size)
    if not effect_hidden:
        raise _not_seen(name, " Or state its size with --size.")
    return effect_hidden


def _not_seen(effect: str, or_size: str = "") -> UsageError:
    return UsageError(
        f"effect {effect}",
        "nothing to see of it beside offsets and lengths with this procedure",
        "a procedure and a machine that show it",
        f"Try another procedure (--protocol), or a machine that is off (--model).{or_size}",
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


EXACT_DECIMALS = 15
LARGEST_FIGURE_MM = 10.0
"""Of scatter and resolution of what is simulated."""


def simulated_session(
    procedure: Procedure,
    machine: Machine,
    truth: Model,
    *,
    seed: int,
    scatter_mm: float,
    resolution_mm: float,
) -> Session:
    """A session that the simulation measured.

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
            f"up to {LARGEST_MM:g} mm, the limit of a record",
            "The model has an effect of impossible size.",
        )
    decimals = max(0, -math.floor(math.log10(resolution_mm))) if resolution_mm else EXACT_DECIMALS
    texts = [f"{value:.{decimals}f}" for value in values]
    readings = [
        reading.model_copy(update={"value_mm": float(text), "text": text})
        for reading, text in zip(blank, texts, strict=True)
    ]
    return fold([opened, *readings])


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
) -> Session:
    """A simulated session as of `simulated_session`, from names and files; None: the usual ones.

    An ``effect`` (id, or id:where) of this ``size`` is hidden in the machine. Raises UsageError and
    RecordError.
    """
    for option, value in (("--scatter", scatter_mm), ("--resolution", resolution_mm)):
        check_number(option, value, 0.0, LARGEST_FIGURE_MM, "mm")
    if 0.0 < resolution_mm < LEAST_FIGURE_MM:
        raise UsageError("--resolution", f"{resolution_mm:g} mm", f"0, or {LEAST_FIGURE_MM:g} mm")
    check_number("--seed", seed, 0, sys.maxsize)
    if size is not None:
        check_number("--size", size, -LARGEST_SIZE, LARGEST_SIZE)
    if size is not None and effect is None:
        raise UsageError("--size", "no --effect", "the size of an effect: both options, or none")
    # numbers of numpy are none of a record
    seed, scatter_mm, resolution_mm = int(seed), float(scatter_mm), float(resolution_mm)
    if model and machine:
        raise UsageError("--model and --machine", "both", "one: a model brings its own machine")
    if model:
        real, machine_known = read_model(model, known_effects())
    else:
        machine_known = load_machine(machine)
        real = Model(machine_known.geometry())
    planned = procedure_on(machine_known, procedure)
    if effect is not None:
        hidden = hidden_effect(
            effect,
            real,
            planned_readings(planned, machine_known),
            seed=seed,
            noise_mm=max(scatter_mm, resolution_mm),
            size=size,
        )
        real = real.with_effects((*real.effects, *hidden))
    return simulated_session(
        planned, machine_known, real, seed=seed, scatter_mm=scatter_mm, resolution_mm=resolution_mm
    )


def _blank_readings(
    procedure: Procedure, machine: Machine, resolution_mm: float
) -> tuple[Reading, ...]:
    """Every reading of the procedure, its value still zero."""
    visits = [(step, axis) for step in procedure.steps(machine.geometry()) for axis in step.axes]
    return tuple(
        Reading.of_step(
            step,
            axis,
            procedure,
            reading=number,
            value_mm=0.0,
            text="0",
            mount=default_mount(step.leg, axis, step.place[1]),
            time_s=step.number * procedure.seconds_per_step,
            resolution_mm=resolution_mm or None,
        )
        for number, (step, axis) in enumerate(visits, start=1)
    )


def short_travels(
    procedure: Procedure, machine: Machine, instruments: Sequence[Instrument]
) -> list[tuple[Instrument, float, str]]:
    """Indicators whose travel may not do, with the most that is needed in mm, and where."""
    if procedure.plate is not None or all(entry.travel_mm is None for entry in instruments):
        return []
    geometry = machine.geometry()
    places: dict[tuple[Touched, float, tuple[Leg, ...]], list[Step]] = {}
    for step in procedure.steps(geometry, [entry.axes for entry in instruments]):
        places.setdefault(step.place, []).append(step)
    tolerance_mm, short = machine.tolerances_mm(), []
    for k, instrument in enumerate(instruments):
        travels = []
        for steps in places.values():
            first = steps[0]
            if k not in first.indicators:
                continue
            axis = first.axes[first.indicators.index(k)]
            mounting = leg_number(first.leg), leg_number(axis)
            where = f"along {axis.upper()} of leg {first.leg.upper()}, "
            at = [(step.displacement_mm, step.station) for step in steps]
            tilt = machine.plane_tilt_mrad if first.over_plane else None
            moved_mm = excursion_mm(geometry, tolerance_mm, mounting, at, tilt)
            where += "over the plane" if first.over_plane else f"station {first.station:g}"
            travels.append((instrument, moved_mm, where))
        worst = descending(travels, lambda travel: travel[1])[0]
        if instrument.travel_mm is not None and worst[1] > instrument.travel_mm:
            short.append(worst)
    return short


def planned_readings(
    procedure: Procedure, machine: Machine, truth: Model | None = None
) -> Observations:
    """Every reading of the procedure in order, as the ``truth`` gives it, None: the nominal one."""
    model = truth or Model(machine.geometry())
    planned = simulated_session(
        procedure, machine, model, seed=0, scatter_mm=0.0, resolution_mm=0.0
    )
    return to_observations([planned])
