"""From session files to a diagnosis: what the command, the screen and other programs share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.evaluating.own_effects import known_laws
from app.evaluating.solution import indicator_figures, load_sessions
from calib.diagnosis.cleaning import Case, cleaned
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.problem import Problem, Sitting
from calib.diagnosis.results import Diagnosis
from calib.errors import NotIdentifiable
from calib.observations import LEG_NAMES, TOOL, TOUCHED_NAMES, FloatArray, numbered, rows_of
from calib.tripod.effects.effect import Law, Placed
from calib.tripod.pipeline import Model
from protocols.errors import UsageError
from protocols.model_file import read_model
from protocols.observations import to_observations
from protocols.session import Session


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """A diagnosis with the sessions it was made from."""

    names: tuple[str, ...]
    held_out: tuple[str, ...]
    sessions: tuple[Session, ...]
    model: Model
    diagnosis: Diagnosis
    warnings: tuple[str, ...]


def diagnose_files(
    paths: Sequence[Path],
    *,
    model: Path | None = None,
    held_out: Sequence[Path] = (),
    laws: Sequence[Law] | None = None,
) -> Diagnosed:
    """Diagnose sessions against their nominal machine, or against a model with effects.

    Sessions may have different joint offsets entered; their geometry must be one. Raises
    RecordError, UsageError and NotIdentifiable.
    """
    sessions, warnings = load_sessions(paths)
    if not sessions:
        raise NotIdentifiable("sessions", "none", "at least one session")
    others, more = load_sessions(held_out)
    _check(paths, held_out, sessions, others)
    used = known_laws() if laws is None else tuple(laws)
    nominal = Model(sessions[0].opened.machine.geometry())
    known = read_model(model, used)[0] if model else nominal
    return Diagnosed(
        names=tuple(path.name for path in paths),
        held_out=tuple(path.name for path in held_out),
        sessions=tuple(sessions),
        model=known,
        diagnosis=diagnose(cases(sessions, known), used, cases(others, known)),
        warnings=(*warnings, *more),
    )


def cases(sessions: Sequence[Session], model: Model) -> list[Case]:
    """What is to be diagnosed of these sessions, each with the load that its tool carried."""
    return [
        Case(
            replace(model, geometry=replace(model.geometry, load=session.opened.machine.load)),
            to_observations([session]),
            indicator_figures([session]),
            np.array(session.opened.machine.tolerances_mm()),
        )
        for session in sessions
    ]


def _check(
    paths: Sequence[Path],
    held_out: Sequence[Path],
    sessions: Sequence[Session],
    others: Sequence[Session],
) -> None:
    """One geometry for all, and no session on both sides."""
    both = {path.resolve() for path in paths} & {path.resolve() for path in held_out}
    same = both or {s.opened.previous + str(s.opened.at) for s in sessions} & {
        s.opened.previous + str(s.opened.at) for s in others
    }
    if same:
        raise UsageError(
            "--held-out",
            "a session that is also diagnosed",
            "sessions that the choice does not see",
            "Leave it out on one side.",
        )
    geometries = {
        replace(session.opened.machine.geometry(), load=1.0) for session in (*sessions, *others)
    }
    if len(geometries) > 1:
        raise UsageError(
            "sessions of different machines",
            f"{len(geometries)} geometries",
            "sessions of one machine; entered offsets and load may differ",
            "Diagnose them one at a time.",
        )


SEEN = 2.0
"""Standard deviations of a mean beyond which it is more than noise."""


@dataclass(frozen=True)
class Cell:
    """The mean residual of one leg, axis, station, displacement and side of approach, in mm.

    One of the tool has a ``position_mm`` and no displacement or side.
    ``after_mm`` is None where nothing was named that could be adopted. ``noise_mm`` is the
    standard deviation of the mean.
    """

    leg: str
    axis: str
    station: float
    displacement_mm: float
    approach: int
    before_mm: float
    after_mm: float | None
    noise_mm: float
    position_mm: tuple[float, ...] | None = None

    @property
    def strength(self) -> float:
        """The residual before, in standard deviations of its mean."""
        return self.before_mm / self.noise_mm


def residual_cells(diagnosed: Diagnosed) -> tuple[Cell, ...]:
    """Mean residuals of the readings as they were diagnosed, offsets, lengths and zeros fitted.

    Mistakes that the diagnosis found are corrected or left out, as it did. Raises NotIdentifiable.
    """
    effects = tuple(effect for one in diagnosed.diagnosis.effects for effect in one.effects)
    some = cleaned(cases(diagnosed.sessions, diagnosed.model))
    sittings = [Sitting.of(c.model, c.observed, c.indicator, c.tolerance_mm) for c in some]
    before = Problem.of(sittings)
    after = None
    if effects:
        after = _left_with(some, effects, sittings)
    return _cells(before, after)


def _left_with(
    cases: Sequence[Case], effects: tuple[Placed, ...], sittings: Sequence[Sitting]
) -> FloatArray | None:
    """Residuals ``(n,)`` in mm with more effects; None where the legs cannot meet."""
    models = [case.model.with_effects((*case.model.effects, *effects)) for case in cases]
    try:
        fitted = [
            one.again(model, case.tolerance_mm)
            for case, model, one in zip(cases, models, sittings, strict=True)
        ]
    except NotIdentifiable:
        return None
    problem = Problem.of(fitted)
    return np.asarray(problem.y / problem.root_weight)


def _cells(problem: Problem, after_mm: FloatArray | None) -> tuple[Cell, ...]:
    before_mm = problem.y / problem.root_weight
    names = ("leg", "axis", "station", "displacement_mm", "approach")
    positions = problem.conditions("position_mm")
    columns = [*(problem.conditions(name) for name in names), *positions.T]
    keys = [column.astype(np.float64).round(4) for column in columns]
    found = []
    for rows in rows_of(numbered(*keys)):
        leg, axis, station, displacement, approach, *position = (float(k[rows[0]]) for k in keys)
        found.append(
            Cell(
                leg=TOUCHED_NAMES[int(leg)],
                axis=LEG_NAMES[int(axis)],
                station=station,
                displacement_mm=displacement,
                approach=int(approach),
                before_mm=float(before_mm[rows].mean()),
                after_mm=None if after_mm is None else float(after_mm[rows].mean()),
                noise_mm=float(np.sqrt((problem.root_weight[rows] ** -2.0).sum()) / len(rows)),
                position_mm=tuple(position) if leg == TOOL else None,
            )
        )
    return tuple(found)


def explained_share(before_rms_mm: float, after_rms_mm: float) -> float:
    """The part of the gap's square that is gone, between 0 and 1."""
    if before_rms_mm <= 0.0:
        return 0.0
    return min(max(1.0 - (after_rms_mm / before_rms_mm) ** 2, 0.0), 1.0)


def rms_um(cells: tuple[Cell, ...]) -> tuple[float, float | None, float]:
    """R.m.s. over the cells, in µm: before, after (None without it), and the noise of a mean."""
    before = np.array([cell.before_mm for cell in cells])
    after = [cell.after_mm for cell in cells if cell.after_mm is not None]
    noise = np.array([cell.noise_mm for cell in cells])
    later = _rms_um(np.array(after)) if after else None
    return _rms_um(before), later, _rms_um(noise)


def _rms_um(values_mm: FloatArray) -> float:
    return float(1000.0 * np.sqrt((values_mm**2).mean())) if len(values_mm) else 0.0
