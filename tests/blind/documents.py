"""What the bench reads of a diagnosis: its public document (contract §4), nothing else."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Protocol

Json = dict[str, Any]


class Diagnose(Protocol):
    """From a session file, ids left out of the catalogue and added to it, to the document."""

    def __call__(
        self, session: Path, without: tuple[str, ...], also: tuple[str, ...] = ()
    ) -> Json: ...


class CannotLeaveOut(Exception):
    """The diagnosis has no door to leave an effect out of its catalogue."""


def of_the_program(session: Path, without: tuple[str, ...], also: tuple[str, ...] = ()) -> Json:
    """The document of the program's own diagnosis. Raises CannotLeaveOut."""
    from app.evaluating.diagnosis import diagnose_files
    from app.report.schema.diagnosis import DiagnosisReport

    options: Json = {}
    if without or also:
        options["effects"] = tuple(
            effect for effect in _catalogue(also) if effect.id not in without
        )
    diagnosis = diagnose_files([session], **options)
    return DiagnosisReport.of(diagnosis, None, None).model_dump(mode="json")


def _catalogue(also: tuple[str, ...]) -> tuple[Any, ...]:
    """Every effect that the program looks for, and others that it knows.

    The bench reads nothing of them but their ids.
    """
    try:
        from app.evaluating.own_effects import known_effects
    except ImportError as problem:
        raise CannotLeaveOut from problem
    from calib.tripod.effects import BESIDE_CATALOGUE

    return (*known_effects(), *(effect for effect in BESIDE_CATALOGUE if effect.id in also))


def row_of(
    diagnose: Diagnose,
    session: Path,
    without: tuple[str, ...],
    also: tuple[str, ...] = (),
) -> Json:
    """One line of results: what was said and how long it took.

    A diagnosis that fails, even by a defect, is a row of its own and does not end the run.
    """
    start, cpu_s = time.perf_counter(), time.process_time()
    try:
        summary = extract(diagnose(session, without, also) if also else diagnose(session, without))
    except CannotLeaveOut:
        summary = {"verdict": "not run", "effects": []}
    except Exception as problem:
        text = f"{type(problem).__name__}: {problem}"[:300]
        summary = {"verdict": "error", "effects": [], "error": text}
    seconds = {"seconds": time.perf_counter() - start, "cpu_s": time.process_time() - cpu_s}
    return {**summary, **{name: round(value, 4) for name, value in seconds.items()}}


def extract(document: Json) -> Json:
    """The parts of a document that scoring needs."""
    return {
        "verdict": document["verdict"],
        "effects": [_effect(effect) for effect in document["effects"]],
        "candidates": [
            {"id": candidate["id"], "where": candidate["where"]}
            for candidate in document["candidates"][:5]
        ],
        "probabilities": [[name["id"], name["probability"]] for name in document["names"]],
        "held_out": document.get("held_out_gap"),
        "noise_dof": (document.get("noise") or {}).get("degrees_of_freedom"),
        "next": (document.get("next_measurement") or {}).get("protocol"),
    }


def _effect(effect: Json) -> Json:
    return {
        "id": effect["id"],
        "kind": effect["kind"],
        "where": effect["where"],
        "parameters": effect["parameters"],
        "also": [rival["id"] for rival in effect["indistinguishable_from"]],
        "also_at": [[rival["id"], rival["where"]] for rival in effect["indistinguishable_from"]],
    }
