"""Machines with three drives: what a procedure sees, which postures, the next measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import Annotated

from app.evaluating.correction import case_of, case_of_machine
from app.evaluating.own_effects import known_effects
from app.measuring.simulated import planned_readings
from calib.arrays import LEG_NAMES
from calib.diagnosis.aliases import alias_map as compare
from calib.diagnosis.results import AliasMap
from calib.errors import ImpossibleRequest, UsageError, check_choice, check_number
from calib.noise.reading import IndicatorFigures, Noise
from calib.posterior.correction import Holds, correction
from calib.posterior.expected import ExpectedResult, expected_of
from calib.posterior.measurements import USUAL_PACE, Pace, candidates, nothing_measured
from calib.posterior.planning import FurtherSetUp, Planner, Proposal
from calib.posterior.posterior import posterior
from calib.quantity import Quantity
from calib.tripod.effects.effect import AdoptedLaws, Effect
from calib.tripod.optimum import Orders
from calib.tripod.pipeline import Model
from calib.tripod.planning import TripodPlanning
from protocols.data_table import DataTable, Tabled
from protocols.documents import LEAST_FIGURE_MM
from protocols.files import Contents, unused_path
from protocols.machine import Frame, Instrument, Machine, load_machine
from protocols.model_file import free_effects, read_model, read_model_file
from protocols.motion import seconds_per_step
from protocols.observations import worst_stated
from protocols.procedure import Procedure, procedure_on
from protocols.session import Session

LARGEST_NOISE_MM = 10.0


def stated_noise(machine: Machine, noise_mm: float | None) -> tuple[Noise, str]:
    """Noise of single readings and where it is from. Raises UsageError where it is no length."""
    if noise_mm is not None:
        allowed = f"a positive length in mm, up to {LARGEST_NOISE_MM:g}"
        check_number("--noise", noise_mm, LEAST_FIGURE_MM, LARGEST_NOISE_MM, "mm", allowed)
    figures, noise_source = IndicatorFigures(repeatability_mm=noise_mm), "as asked for"
    if noise_mm is None:
        figures, noise_source = worst_stated(machine.indicator), "of the machine file's indicators"
        if figures.noise() is None:
            # repeatability of the papers' indicators; serves where nothing is stated
            figures = IndicatorFigures(repeatability_mm=0.02)
            noise_source = "that of the papers' indicators"
    noise = figures.noise(2)
    if noise is None:  # so little that it is arithmetic
        raise UsageError("--noise", f"{noise_mm:g} mm", "a positive length in mm")
    return noise, f"{noise.standard_deviation_mm:.4g} mm, {noise_source}"


def tripod_planning(
    machine: Machine,
    procedure: Procedure,
    noise_mm: float | None = None,
    minutes_per_mounting: float = USUAL_PACE.minutes_per_mounting,
) -> TripodPlanning:
    """What a procedure reads; without noise that of the machine file. Raises UsageError."""
    geometry = machine.geometry()
    noise, noise_source = stated_noise(machine, noise_mm)
    steps = procedure.steps(geometry)
    return TripodPlanning(
        name=machine.name,
        geometry=geometry,
        procedure=procedure.name,
        planned=planned_readings(procedure, machine),
        of_tool=not procedure.levels,
        stations=procedure.stations,
        step_count=len(steps),
        mounting_count=len({step.place for step in steps}),
        seconds_per_step=seconds_per_step(machine, procedure),
        minutes_per_mounting=minutes_per_mounting,
        noise=noise,
        noise_words=noise_source,
    )


def before_measuring(
    procedure: Procedure, machine: Machine, instruments: Sequence[Instrument]
) -> tuple[ExpectedResult, str]:
    """What a procedure will tell with these indicators, and what their noise is."""
    at_hand = machine.model_copy(update={"indicator": tuple(instruments)})
    planned = tripod_planning(at_hand, procedure)
    return expected_of(planned, machine.tolerances_mm()), planned.noise_words


def procedure_files(orders: Orders, like: Procedure, path: Path) -> tuple[Path, Contents]:
    """What to write where: one procedure where all mountings visit the same displacements, else one
    for each, with its name before the suffix.

    Timing and limits are those of the procedure ``like`` them.
    """
    legs = sorted({leg for leg, _ in orders})
    stations = sorted({station for _, station in orders})
    first = next(iter(orders.values()))
    all_alike = all(order == first for order in orders.values())
    if all_alike and len(orders) == len(legs) * len(stations):
        return path, {"": _toml(like, "optimum", legs, stations, first)}
    return path.parent, {
        f"{path.stem}-{LEG_NAMES[leg]}-{station:g}.toml": _toml(
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


RUNNERS_UP = 5


@dataclass(frozen=True)
class JudgedMeasurement:
    """A measurement that may be made next, and the bound at the tool after it."""

    legs: Annotated[tuple[str, ...], Quantity("legs", words="the legs that are read")]
    station: Annotated[
        float, Quantity("station", words="place on the bar, a fraction from the tool end")
    ]
    displacements_mm: Annotated[
        tuple[float, ...],
        Quantity("at", "mm", words="displacements in the order in which they are read"),
    ]
    cycles: Annotated[int, Quantity("cycles", words="how often they are read")]
    before: Annotated[
        str, Quantity("before", words="what is changed before it, in controller or load")
    ]
    minutes: Annotated[float, Quantity("minutes", decimals=1, words="time for set-up and readings")]
    bound_mm: Annotated[
        float,
        Quantity(
            "tool at most",
            "mm",
            "uncertainty",
            3,
            "bound of the tool error that is expected after it",
        ),
    ]


@dataclass(frozen=True, eq=False)
class MeasurementPlan(Tabled):
    """What is worth measuring after these sessions.

    ``noise_words`` say where the noise of a reading is from.
    """

    sessions: tuple[str, ...]
    machine: str
    noise_words: str
    planner: Planner

    @property
    def best(self) -> Proposal:
        """The measurement that is proposed."""
        return self.planner.proposals[0]

    @property
    def runners_up(self) -> tuple[Proposal, ...]:
        """The next best."""
        return tuple(self.planner.proposals[1 : RUNNERS_UP + 1])

    def table(self) -> DataTable:
        """Every measurement that was judged, the best first."""
        return DataTable.of(
            JudgedMeasurement,
            (
                JudgedMeasurement(
                    proposal.candidate.legs,
                    proposal.candidate.station,
                    proposal.candidate.levels_mm,
                    proposal.candidate.cycles,
                    proposal.candidate.preparation.words,
                    proposal.candidate.minutes,
                    proposal.bound_mm,
                )
                for proposal in self.planner.proposals
            ),
        )


FURTHER = "_further"


def all_sessions(first: Path) -> list[Path]:
    """A session, and those of further set-ups that were measured after it."""
    return [first, *sorted(first.parent.glob(f"{escape(first.stem)}{FURTHER}*.jsonl"))]


def further_session(first: Path) -> Path:
    """The file of one more set-up after a session."""
    return unused_path(first.with_name(f"{first.stem}{FURTHER}.jsonl"))


def further_procedure(like: Procedure, set_up: FurtherSetUp) -> Procedure:
    """A proposed set-up as a procedure; timing and limits are those of the one ``like`` it."""
    changes = {
        "legs": set_up.legs,
        "stations": (set_up.station,),
        "levels": set_up.displacements_mm,
    }
    once = {"cycles": 1, "return_to_zero": False, "order": "fixed", "random_seed": None}
    texts = {"name": "further", "title": "A further set-up, there and back", "description": ""}
    planned: Procedure = like.model_copy(update={**changes, **once, **texts, "plane": None})
    return planned


def next_measurement(
    sessions: Sequence[Session],
    *,
    machine_file: Path | str | None = None,
    model_file: Path | None = None,
    noise_mm: float | None = None,
    minutes_per_mounting: float = USUAL_PACE.minutes_per_mounting,
    frame: Frame | None = None,
    holds: Holds = "offsets",
) -> MeasurementPlan:
    """Judge measurements on top of the sessions by the bound that they leave at the tool.

    The bound is that of a correction in a ``frame``, else that of the machine file, for what a
    controller ``holds``. Before any reading the parameters are known to the tolerances of the
    machine file. Raises UsageError for files that do not fit each other, and for a word that is no
    frame and none of `Holds`.
    """
    check_choice("frame", frame, Frame)
    check_choice("holds", holds, Holds)
    machine, model = _machine_and_model(sessions, machine_file, model_file)
    noise, noise_source = stated_noise(machine, noise_mm)
    nominal = Model(model.geometry).with_effects(model.effects)
    free: AdoptedLaws = {}
    if model_file:
        free = free_effects(read_model_file(model_file), known_effects())
    cases = [case_of(session, nominal, free) for session in sessions]
    if not sessions:
        cases = [case_of_machine(machine, nominal, free, *nothing_measured(nominal))]
    weighted = posterior(cases)
    measurements = candidates(weighted, Pace(minutes_per_mounting, _pace_s(machine, sessions)))
    if not measurements:
        raise ImpossibleRequest(
            "touched points of the bars",
            "no displacement to both sides of Zero at any station",
            "a usable part of the bars that an indicator stays on",
            "Widen usable_bar in the machine file.",
        )
    asked_mm = None if sessions and noise_mm is None else noise.standard_deviation_mm
    entered = correction(weighted, holds, frame or machine.frame)
    planner = Planner(weighted, entered, tuple(measurements), asked_mm)
    noise_source = (
        noise_source if asked_mm else f"{planner.forecast.noise_mm:.2g} mm, from the sessions"
    )
    names = tuple(session.name for session in sessions)
    return MeasurementPlan(names, machine.name, noise_source, planner)


def _pace_s(machine: Machine, sessions: Sequence[Session]) -> float:
    """Seconds of one more step: by hand, or as in the last session of a moving machine."""
    if machine.motion is None:
        return USUAL_PACE.seconds_per_step
    last = sessions[-1].opened.procedure if sessions else None
    like = last or procedure_on(machine)
    return seconds_per_step(machine, like)


def _machine_and_model(
    sessions: Sequence[Session], machine_file: Path | str | None, model_file: Path | None
) -> tuple[Machine, Model]:
    if model_file and machine_file:
        raise UsageError("--model and --machine", "both", "one: a model brings its own machine")
    model, machine = (
        read_model(model_file, known_effects())
        if model_file
        else (None, load_machine(machine_file))
    )
    if sessions:
        recorded = sessions[0].opened.machine
        if (model_file or machine_file) and recorded.geometry() != machine.geometry():
            raise UsageError(
                "machine of the sessions",
                f"'{recorded.name}', other dimensions than '{machine.name}'",
                "a machine or model file of the same machine, or none",
            )
        machine = recorded
    of_tool = any(r.position_mm is not None for session in sessions for r in session.readings)
    next_step = "glidecal identifiability shows what a procedure of your own determines."
    if machine.position_endstop_mm is not None:
        next_step = (
            "--macro writes places to probe, for the firmware of a printer. Distances on a "
            "printed object show what a plate does not: glidecal import --distances."
        )
    if of_tool or not machine.geometry().reads_legs:
        raise UsageError(
            "glidecal plan",
            f"readings of the tool, or the machine '{machine.name}'",
            "readings of legs, on bars that lie along their drives at Zero",
            next_step,
        )
    return machine, model or Model(machine.geometry())


def alias_map(
    procedure: str | None, effects: Sequence[Effect], machine_name: str | None = None
) -> AliasMap:
    """What this procedure cannot tell apart on a machine; None: the usual ones.

    Raises UsageError, RecordError.
    """
    machine = load_machine(machine_name)
    # some machine that is not perfect: effects that scale readings need readings to scale
    model = Model(machine.geometry(), (1.0, -0.8, 0.6, 0.03, -0.02, 0.01))
    planned = planned_readings(procedure_on(machine, procedure), machine, model)
    return compare(model, planned, effects)
