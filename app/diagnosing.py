"""From session files to a diagnosis: what the command, the screen and other programs share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from app.own_effects import known_laws
from app.solving import indicator_figures, load_sessions
from calib.diagnosis.cleaning import Case
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.results import Diagnosis, Finding, Gap, HeldOutGap, Value
from calib.errors import NotIdentifiable
from calib.orthoglide.effects.law import Law
from calib.orthoglide.model import Model
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


def diagnosis_document(diagnosed: Diagnosed) -> dict[str, Any]:
    """Schema ``glidecal.diagnosis/1``."""
    found = diagnosed.diagnosis
    return {
        "schema": "glidecal.diagnosis/1",
        "sessions": list(diagnosed.names),
        "held_out": list(diagnosed.held_out),
        "noise": {
            "standard_deviation_mm": found.noise_mm,
            "degrees_of_freedom": found.noise_df if math.isfinite(found.noise_df) else None,
            "source": found.noise_source,
        },
        "verdict": found.verdict,
        "sentence": found.sentence,
        "gap_before": _gap(found.gap_before),
        "gap_after": _gap(found.gap_after),
        "held_out_gap": _held_out(found.held_out),
        "where": [
            {
                "leg": share.leg or None,
                "axis": share.axis or None,
                "posture_or_pattern": share.pattern,
                "share": share.share,
                "p_value": share.p_value,
            }
            for share in found.where
        ],
        "effects": [_finding(one) for one in found.effects],
        "candidates": [
            {
                "id": one.id,
                "where": one.where,
                "parameters": _values(one.parameters),
                "p_value": one.p_value,
                "gap_rms_after_mm": one.gap_rms_after_mm,
                "held_out_gap_rms_mm": one.held_out_gap_rms_mm,
                "reason_rejected": one.reason_rejected,
            }
            for one in found.candidates
        ],
        "next_measurement": None
        if found.next_measurement is None
        else {
            "reason": found.next_measurement.reason,
            "protocol": found.next_measurement.protocol,
            "expected_separation": found.next_measurement.expected_separation,
            "between": [
                {"id": name.id, "where": name.where} for name in found.next_measurement.between
            ],
            "before": {
                "add_to_entered_offsets_mm": list(found.next_measurement.entered_mm),
                "load": found.next_measurement.load,
            },
        },
        "smallest_detectable": [
            {"id": one.id, "size": one.size, "unit": one.unit} for one in found.smallest_detectable
        ],
        "left_over": None
        if found.left_over is None
        else _finding(found.left_over.law)
        | {
            "instead_of_what_was_named": found.left_over.whole,
            "held_out_gap": _held_out(found.left_over.held_out),
        },
        "remarks": list(found.remarks),
    }


def _gap(gap: Gap) -> dict[str, float | int]:
    return {
        "rms_mm": gap.rms_mm,
        "chi_square": gap.chi_square,
        "degrees_of_freedom": gap.degrees_of_freedom,
        "p_value": gap.p_value,
    }


def _held_out(gap: HeldOutGap | None) -> dict[str, float | str] | None:
    if gap is None:
        return None
    return {
        "how": gap.how,
        "before_rms_mm": gap.before_rms_mm,
        "after_rms_mm": gap.after_rms_mm,
        "noise_rms_mm": gap.noise_rms_mm,
    }


def _finding(one: Finding) -> dict[str, Any]:
    return {
        "id": one.id,
        "kind": one.kind,
        "title": one.title,
        "where": one.where,
        "parameters": _values(one.parameters),
        "p_value": one.p_value,
        "gap_rms_before_mm": one.gap_rms_before_mm,
        "gap_rms_after_mm": one.gap_rms_after_mm,
        "indistinguishable_from": [
            {"id": name.id, "where": name.where} for name in one.indistinguishable_from
        ],
    }


def _values(values: Sequence[Value]) -> list[dict[str, float | str]]:
    return [
        {
            "name": value.name,
            "value": value.value,
            "standard_uncertainty": value.standard_uncertainty,
            "unit": value.unit,
        }
        for value in values
    ]
