"""The next measurement worth making: what lowers the expected tool error most per minute."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from app.evaluating.own_effects import known_laws
from app.evaluating.solution import indicator_figures, load_sessions
from app.planning.tripod import FREE, stated_noise, tool_metric
from calib.design.criteria import covariances_after, inverse
from calib.errors import NotIdentifiable
from calib.identify.identify import identify, sensitivity_of_readings
from calib.identify.solution import LACK_OF_FIT_LEVEL
from calib.noise.reading import Noise, reading_noise, reading_weights, visits
from calib.observations import LEG_NAMES, FloatArray, Observations
from calib.ties import descending, largest
from calib.tripod.pipeline import Model, derivatives
from calib.tripod.pool import PARAMETERS, LegPool, leg_pool, levels_mm
from protocols.errors import UsageError
from protocols.machine import Machine, load_machine
from protocols.model_file import read_model
from protocols.observations import to_observations
from protocols.session import Session

SECONDS_PER_STEP = 20.0
RUNNERS_UP = 5


@dataclass(frozen=True)
class Proposal:
    """One more mounting and the displacements to read there along both axes.

    ``tool_mm`` is the expected r.m.s. error of the tool over the workspace afterwards.
    """

    leg: str
    station: float
    displacements_mm: tuple[float, ...]
    minutes: float
    tool_mm: float
    variance_per_minute_mm2: float


@dataclass(frozen=True)
class NextMeasurement:
    """The best proposal first; ``tool_before_mm`` without any of them."""

    sessions: tuple[str, ...]
    machine: str
    tool_before_mm: float
    noise_words: str
    proposals: tuple[Proposal, ...]
    warnings: tuple[str, ...]

    @property
    def best(self) -> Proposal:
        """The measurement that is proposed."""
        return self.proposals[0]


def next_measurement(
    sessions: Sequence[Path] = (),
    *,
    machine_file: Path | str | None = None,
    model_file: Path | None = None,
    noise_mm: float | None = None,
    minutes_per_mounting: float = 2.0,
) -> NextMeasurement:
    """Judge every mounting with two or three displacements on top of the sessions.

    Before any reading the parameters are known to the tolerances of the machine file. Raises
    UsageError for files that do not fit each other, RecordError for files that cannot be used.
    """
    folded, warnings = load_sessions(sessions)
    machine, model = _machine_and_model(folded, machine_file, model_file)
    information = np.diag(np.array(machine.tolerances_mm()) ** -2.0)
    noise, words = stated_noise(machine, noise_mm)
    if folded:
        measured, noise, seen = _measured(folded, model, noise, noise_mm)
        information, words = information + measured, seen or words
    covariance, metric = inverse(information), tool_metric(model.geometry)
    before = float(np.trace(metric @ covariance))
    found = _judged(model, covariance, metric, noise.standard_deviation_mm, minutes_per_mounting)
    return NextMeasurement(
        sessions=tuple(path.name for path in sessions),
        machine=machine.name,
        tool_before_mm=before**0.5,
        noise_words=words,
        proposals=tuple(found),
        warnings=tuple(warnings),
    )


def _machine_and_model(
    sessions: Sequence[Session], machine_file: Path | str | None, model_file: Path | None
) -> tuple[Machine, Model]:
    if model_file and machine_file:
        raise UsageError("--model and --machine", "both", "one: a model brings its own machine")
    model, machine = (
        read_model(model_file, known_laws()) if model_file else (None, load_machine(machine_file))
    )
    if sessions:
        own = sessions[0].opened.machine
        if (model_file or machine_file) and own.geometry() != machine.geometry():
            raise UsageError(
                "machine of the sessions",
                f"'{own.name}', other dimensions than '{machine.name}'",
                "a machine or model file of the same machine, or none",
            )
        machine = own
    of_tool = any(r.position_mm is not None for one in sessions for r in one.readings)
    if of_tool or not machine.geometry().orthogonal:
        raise UsageError(
            "glidecal plan",
            f"readings of the tool, or the machine '{machine.name}'",
            "readings of legs, on drives that are square to each other",
            "glidecal identifiability tells what a procedure of your own would see.",
        )
    return machine, model or Model(machine.geometry())


def _measured(
    sessions: Sequence[Session], model: Model, stated: Noise, noise_mm: float | None
) -> tuple[FloatArray, Noise, str]:
    """Information ``(6, 6)`` of the sessions, and the noise that they show themselves.

    What the model leaves of them beyond chance counts as noise, as ``solve`` tells it.
    """
    visited = visits(to_observations(sessions))
    shown, words = None, ""
    if noise_mm is None:
        shown, words = _noise_of(sessions, visited, model)
    noise = shown or Noise(stated.indicators[:1] * visited.indicator_count, "instrument")
    design = derivatives(model.geometry, model.parameters_mm, visited)
    weight = reading_weights(visited, noise)
    whitened = sensitivity_of_readings(
        model.geometry, visited, weight, design, FREE, noise_known=True
    ).jacobian
    return np.asarray(whitened.T @ whitened), noise, words


def _noise_of(
    sessions: Sequence[Session], visited: Observations, model: Model
) -> tuple[Noise | None, str]:
    figures = indicator_figures(sessions)
    noise = reading_noise(visited, figures)
    if noise is None:
        return None, ""
    words = f"{noise.standard_deviation_mm:.4g} mm, from the sessions"
    tolerance = np.array(sessions[0].opened.machine.tolerances_mm())
    try:
        fitted = identify(
            model, visited, "with-tolerances", indicator=figures, tolerance_mm=tolerance
        )
    except NotIdentifiable:  # nothing to compare with the noise
        return noise, words
    fit = fitted.lack_of_fit
    if fit is None or fit.p_value >= LACK_OF_FIT_LEVEL:
        return noise, words
    words += f", times {fitted.spread**0.5:.3g} because the model leaves so much: "
    words += "run glidecal diagnose first"
    return noise.scaled(fitted.spread), words


def _judged(
    model: Model,
    covariance: FloatArray,
    metric: FloatArray,
    noise_mm: float,
    minutes_per_mounting: float,
) -> list[Proposal]:
    """The best proposal of each leg and station, the best of all first."""
    pool = leg_pool(model.geometry, parameters_mm=model.parameters_mm, both_ways=False)
    before = float(np.trace(metric @ covariance))
    best: dict[tuple[int, float], Proposal] = {}
    for size in (2, 3):
        minutes = minutes_per_mounting + size * SECONDS_PER_STEP / 60.0
        for leg, station, some, rows in _mountings(model, pool, size):
            after = covariances_after(
                covariance, rows / noise_mm, np.ones(rows.shape[1]), list(FREE)
            )
            variance = np.einsum("ij,bji->b", metric, after)
            k = largest(-variance)
            proposal = Proposal(
                leg=LEG_NAMES[leg],
                station=station,
                displacements_mm=some[k],
                minutes=minutes,
                tool_mm=float(variance[k]) ** 0.5,
                variance_per_minute_mm2=(before - float(variance[k])) / minutes,
            )
            held = best.get((leg, station))
            if held is None or _gain(proposal) > _gain(held):
                best[leg, station] = proposal
    return descending(best.values(), _gain)[: RUNNERS_UP + 1]


def _gain(proposal: Proposal) -> float:
    return proposal.variance_per_minute_mm2


def _mountings(
    model: Model, pool: LegPool, size: int
) -> list[tuple[int, float, list[tuple[float, ...]], FloatArray]]:
    """Sets of displacements at each place with rows ``(b, 2 size, 6)``, own zeros fitted."""
    geometry = model.geometry
    sets = list(combinations(levels_mm(geometry), size))
    if size == 3:  # a third one between the joint limits
        ends = (geometry.travel_min_mm, geometry.travel_max_mm)
        sets = [one for one in sets if (one[0], one[-1]) == ends]
    found = []
    for number, (leg, station) in enumerate(pool.places):
        members = np.flatnonzero(pool.place == number)
        row = {float(pool.displacement_mm[k]): int(k) for k in members}
        index = np.array([[row[level] for level in one] for one in sets])
        rows = pool.rows[index][:, :, :, :PARAMETERS]
        centred = rows - rows.mean(axis=1, keepdims=True)
        found.append((leg, station, sets, centred.reshape(len(sets), -1, PARAMETERS)))
    return found
