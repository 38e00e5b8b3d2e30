"""What ``import glidecal`` offers: the verbs of the command line on paths and sessions.

What is worth knowing beside a result is given as a Python warning. Every function raises
`GlidecalError` with one paragraph for a person.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.errors import GlidecalError, UsageError
from protocols.machine import Machine
from protocols.session import Session

if TYPE_CHECKING:  # heavy: imported where used
    from app.evaluating.diagnosis import SessionDiagnosis
    from app.evaluating.solution import SessionSolution
    from app.evaluating.what_if import WhatIf
    from app.planning.tripod import MeasurementPlan
    from app.report.pages.notebook import SessionFigures
    from calib.identify.solution import Method, Subset
    from calib.posterior.correction import Holds
    from protocols.machine import Frame

__all__ = [
    "GlidecalError",
    "Machine",
    "Session",
    "diagnose",
    "figures",
    "load",
    "plan",
    "report",
    "simulate",
    "solve",
    "what_if",
]

File = str | Path


def load(path: File, machine: File | None = None) -> Session:
    """A session from its record, or from a table of readings (.csv, .xlsx, .parquet).

    ``machine`` is that of a table, by its name or as a machine file; None: orthoglide.
    """
    from app.evaluating.loading import load_sessions
    from app.version import program
    from protocols.machine import load_machine
    from protocols.session import fold
    from protocols.table import is_table, opened_table

    file = _path("session", path)
    if is_table(file):
        opened, events, unknown = opened_table(file, load_machine(machine), program())
        _warn([f"columns kept but not used: {', '.join(unknown)}"] if unknown else [])
        return fold([opened, *events])
    if machine is not None:
        raise UsageError("machine", f"{machine}, beside a record", "None: a record has its machine")
    (session,), remarks = load_sessions([file])
    _warn(remarks)
    return session


def solve(
    *sessions: File | Session,
    subset: Subset | None = None,
    method: Method = "exact",
    model: File | None = None,
    frame: Frame | None = None,
) -> SessionSolution:
    """What to enter in the controller, and parameters with uncertainties as a view beside it.

    `SessionSolution.correction` is for a ``frame``, that of the machine file where none is named;
    ``subset`` and ``method`` choose the view. With a ``model`` the sizes of its effects are fitted,
    too. `SessionSolution.solution` has ``values_mm`` ``(k,)`` and ``covariance_mm2`` ``(k, k)``
    by ``names``; it raises NotIdentifiable where the readings determine no set.
    """
    from app.evaluating.solution import solve_sessions
    from protocols.model_file import read_model_file

    loaded = _given(sessions)
    model_file = read_model_file(_path("model", model)) if model else None
    return solve_sessions(loaded, subset=subset, method=method, model=model_file, frame=frame)


def diagnose(
    *sessions: File | Session,
    model: File | None = None,
    held_out: Sequence[File | Session] = (),
) -> SessionDiagnosis:
    """What is missing in the model, and where it shows.

    ``held_out`` sessions only give the gap that the named effects leave there.
    """
    from app.evaluating.diagnosis import diagnose_sessions

    loaded = _given(sessions)
    model_path = _path("model", model) if model else None
    diagnosed = diagnose_sessions(loaded, model=model_path, held_out=_given(_listed(held_out)))
    _warn(diagnosed.warnings)
    return diagnosed


def what_if(
    *sessions: File | Session,
    effect: str,
    size: float | Sequence[float],
    subset: Subset | None = None,
    model: File | None = None,
) -> WhatIf:
    """Solve with an effect (``id:where``, as `diagnose` names them) of this size held.

    Predicted differences, residuals and the error at the tool follow from it; a size for each of
    its parameters, in their units. Other effects of a ``model`` are fitted. Nothing is adopted.
    """
    from app.evaluating.what_if import what_if as evaluated
    from protocols.model_file import read_model_file

    loaded = _given(sessions)
    sizes: Any = size.tolist() if hasattr(size, "tolist") else size  # numpy's, as plain numbers
    values = list(sizes) if isinstance(sizes, Iterable) and not isinstance(sizes, str) else [sizes]
    model_file = read_model_file(_path("model", model)) if model else None
    return evaluated(loaded, effect, values, subset, model_file)


def simulate(
    procedure: File | None = None,
    *,
    machine: File | None = None,
    model: File | None = None,
    effect: str | None = None,
    size: float | None = None,
    seed: int = 1,
    scatter_mm: float = 0.002,
    resolution_mm: float = 0.001,
) -> Session:
    """A session of a simulated machine, of that of a ``model`` or with an ``effect`` hidden in it.

    ``scatter_mm`` is the standard deviation of a re-approach, ``resolution_mm`` the step of the
    display, 0 none.
    """
    from app.measuring.simulated import simulated_of_files

    return simulated_of_files(
        None if procedure is None else str(procedure),
        machine,
        _path("model", model) if model else None,
        effect=effect,
        size=size,
        seed=seed,
        scatter_mm=scatter_mm,
        resolution_mm=resolution_mm,
    )


def plan(
    *sessions: File | Session,
    machine: File | None = None,
    model: File | None = None,
    noise_mm: float | None = None,
    frame: Frame | None = None,
    holds: Holds = "offsets",
) -> MeasurementPlan:
    """The measurement that lowers the bound of the tool most per minute, after these sessions.

    ``frame``: that of the machine file unless given; ``holds`` is what the controller can hold.
    """
    from app.planning.tripod import next_measurement

    loaded = _given(sessions)
    model_path = _path("model", model) if model else None
    return next_measurement(
        loaded,
        machine_file=machine,
        model_file=model_path,
        noise_mm=noise_mm,
        frame=frame,
        holds=holds,
    )


def figures(*sessions: File | Session, model: File | None = None) -> SessionFigures:
    """A picture for each leg and axis: readings, the fit, and the residuals, enlarged.

    A notebook shows it (with matplotlib), ``print`` gives characters, and `SessionFigures.draw`
    draws one on axes.
    """
    from app.report.pages.notebook import SessionFigures

    return SessionFigures.of(solve(*sessions, model=model))


def report(
    *sessions: File,
    output: File,
    model: File | None = None,
    after: File | None = None,
    tolerance_mm: float | None = None,
    certificate: File | None = None,
    replace: bool = False,
) -> Path:
    """Write the calibration report of session files, .html or .pdf; it names their digests.

    With the file of a ``certificate`` it is a certificate; .xml is a digital one.
    """
    from app.evaluating.tolerance import check_tolerance
    from app.report.certificate import read_head
    from app.report.pages.report import source_of_legs, write_report

    check_tolerance(tolerance_mm)
    head = read_head(_path("certificate", certificate)) if certificate else None
    source = partial(
        source_of_legs,
        [_path("session", path) for path in sessions],
        model=_path("model", model) if model else None,
        later_path=_path("session after", after) if after else None,
        tolerance_mm=tolerance_mm,
        head=head,
    )
    return write_report(source, _path("output", output), head, replace=replace)


def _given(sessions: Iterable[File | Session]) -> list[Session]:
    """Sessions by their files' names, or numbered, in the order in which they were measured.

    Raises RecordError for one session twice.
    """
    from app.evaluating.loading import load_sessions, measured_first, refuse_twice

    given, loaded = list(sessions), []
    for number, file in enumerate(given, start=1):
        if isinstance(file, Session):
            loaded.append((f"session {number}", file))
            continue
        path = _path(f"session {number}", file, "the path of a file, or a Session")
        (session,), remarks = load_sessions([path])
        _warn(remarks)
        loaded.append((session.name, session))
    refuse_twice(loaded)
    return sorted((replace(session, name=name) for name, session in loaded), key=measured_first)


def _path(thing: str, file: object, allowed: str = "the path of a file") -> Path:
    """Raises UsageError for what is no path."""
    if isinstance(file, str | os.PathLike) and not isinstance(path := os.fspath(file), bytes):
        return Path(path)
    raise UsageError(thing, f"a value of type {type(file).__name__}", allowed)


def _listed(files: object) -> Iterable[Any]:
    """Several files or sessions, or a single one."""
    several = isinstance(files, Iterable) and not isinstance(files, str)
    return files if several else [files]  # type: ignore[return-value]


def _warn(remarks: Iterable[str]) -> None:
    for text in remarks:
        warnings.warn(text, stacklevel=3)
