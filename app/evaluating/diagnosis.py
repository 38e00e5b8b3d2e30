"""From session files to a diagnosis: what the command, the screen and other programs share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from app.evaluating.own_effects import known_effects
from app.evaluating.solution import indicator_figures, load_sessions
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.problem import Case
from calib.diagnosis.results import Diagnosis
from calib.errors import NotIdentifiable, UsageError
from calib.tripod.effects.effect import Effect
from calib.tripod.pipeline import Model
from protocols.model_file import ambiguity, ambiguous_effects, read_model_file, to_model
from protocols.observations import to_observations
from protocols.session import Session


@dataclass(frozen=True, eq=False)
class SessionDiagnosis:
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
    effects: Sequence[Effect] | None = None,
) -> SessionDiagnosis:
    """Diagnose sessions against their nominal machine, or against a model with effects.

    ``effects`` are looked for in place of all that are known. Sessions may have different joint
    offsets entered; their geometry must be one. Raises RecordError, UsageError and NotIdentifiable.
    """
    sessions, warnings = load_sessions(paths)
    if not sessions:
        raise NotIdentifiable("sessions", "none", "at least one session")
    others, more = load_sessions(held_out)
    _check(paths, held_out, sessions, others)
    effects = known_effects() if effects is None else effects
    nominal = Model(sessions[0].opened.machine.geometry())
    known = nominal
    if model:
        found = read_model_file(model)
        known = to_model(found, f"model {model}", effects)
        more += [said] if (said := ambiguity(ambiguous_effects(found))) else []
    return SessionDiagnosis(
        names=tuple(path.name for path in paths),
        held_out=tuple(path.name for path in held_out),
        sessions=tuple(sessions),
        model=known,
        diagnosis=diagnose(cases(sessions, known), effects, cases(others, known)),
        warnings=(*warnings, *more),
    )


def cases(sessions: Sequence[Session], model: Model) -> list[Case]:
    """What is to be diagnosed of these sessions, each with the load that its tool carried."""
    return [
        Case(
            replace(model, geometry=replace(model.geometry, load=session.opened.machine.load)),
            to_observations([session]),
            indicator_figures([session]),
            session.opened.machine.tolerances_mm(),
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
    same_file = {path.resolve() for path in paths} & {path.resolve() for path in held_out}
    # a copy has another path, but it began at the same moment
    if same_file or {one.opened.at for one in sessions} & {one.opened.at for one in others}:
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
