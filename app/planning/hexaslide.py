"""The Hexa Slide's side of `app.planning`: what its procedures see in a box of postures."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.planning.machines import Cure, Examined, Pool, Request
from calib.design.criteria import Criterion
from calib.errors import CalibrationError
from calib.hexaslide.geometry import Box
from calib.hexaslide.planning import (
    BestPostures,
    HexaSlide,
    best_postures,
    enough_postures,
    fewest_postures,
    judged_postures,
    reachable,
    sensitivity,
)
from calib.hexaslide.procedures import COMPONENTS, Kind, Procedure, held_postures
from calib.observations import FloatArray
from protocols.errors import RecordError, UsageError
from protocols.files import write_files
from protocols.hexaslide_machine import load_hexaslide
from protocols.hexaslide_postures import COLUMNS, load_postures
from protocols.table import csv_text

UNITS = "metres and radians, columns not scaled"
COORDINATES = COLUMNS

MOST_MOVED = 1000
"""More postures would take hours."""

AS_IS = "With --as-is postures are judged wherever they are."
ROUNDING = 1e-9
"""How far a bound may be passed by writing it down, metres or radians."""

PUBLISHED = {
    Kind.POSE_INVERSE: 49,
    Kind.POSE_FORWARD: 49,
    Kind.POSITION: 48,
    Kind.CONSTRAINT_LINK: 46,
}
"""Ranks that papers/001, table 1, states."""

WRONG = {
    Kind.POSITION: "papers/001 counts 48; with exact derivatives it is 46: turning the frame of "
    "the platform about its origin changes no position. 48 is also its number of rows, 16 × 3.",
    Kind.CONSTRAINT_LINK: "papers/001 counts 46; with exact derivatives it is 48: only motions "
    "of whole frames are lost, six of the platform, one of the base. 46 is also its row count.",
}


@dataclass(frozen=True, eq=False)
class HexaSlidePlanning:
    """One machine with one procedure."""

    request: Request
    procedure: Procedure
    machine: HexaSlide

    @staticmethod
    def of(request: Request) -> HexaSlidePlanning:
        """Raises UsageError for a procedure or component, RecordError for a machine file."""
        try:
            procedure = Procedure.of(request.procedure, request.measured, request.known)
        except CalibrationError as problem:
            raise UsageError(
                problem.thing, problem.found, problem.allowed, problem.next_step
            ) from problem
        if request.posture_file is not None and request.postures is not None:
            raise UsageError("--posture-file and --postures", "both", "one of them")
        if request.noise_mm is not None:
            raise UsageError("--noise", "the machine hexaslide", "the machine orthoglide")
        own = load_hexaslide(request.machine_file)
        if procedure.kind is Kind.CONSTRAINT_LINK and own.constraint_link is None:
            raise UsageError("machine file", "no [constraint_link]", "one for constraint-link")
        machine = HexaSlide(own.geometry(), own.posture_box(), own.link())
        return HexaSlidePlanning(request, procedure, machine)

    @property
    def name(self) -> str:
        """The name on the command line."""
        return "hexaslide"

    def examine(self) -> Examined:
        """What the procedure sees from random postures in the box."""
        postures = self.postures()
        # nothing is left out of what is told to be lost
        seen = replace(sensitivity(self.procedure, self.machine, postures), whole_shares=True)
        kind = self.procedure.kind
        usual = self.procedure == Procedure.of(kind.value)
        return Examined(
            procedure=kind.value,
            sensitivity=seen,
            bare=seen.jacobian,
            measured=self.procedure.read,
            posture_count=len(postures),
            independent_count=len(seen.jacobian),
            minutes=0.0,
            units=UNITS,
            noise_words="not known, it decides nothing here",
            source=self._source(),
            fewest_postures=fewest_postures(self.procedure, self.machine),
            reachable_rank=reachable(self.procedure, self.machine).rank,
            published_rank=PUBLISHED[kind] if usual else None,
            remark=WRONG.get(kind, "") if usual else "",
        )

    def _source(self) -> str:
        file = self.request.posture_file
        return f"random in the box, seed {self.request.seed}" if file is None else f"{file}"

    def postures(self) -> FloatArray:
        """Those of the file, else random ones in the box ``(p, 6)``. Raises RecordError."""
        if self.request.posture_file is not None:
            return load_postures(self.request.posture_file)
        if self.request.postures is None:
            return enough_postures(self.procedure, self.machine, self.request.seed)
        geometry, box = self.machine.geometry, self.machine.box
        return held_postures(geometry, box, self.request.postures, self.request.seed)

    def pool(self) -> Pool:
        """Raises UsageError: its postures are no list to choose from."""
        raise _not_yet()

    def metric(self) -> FloatArray:
        """Raises UsageError: its postures are no list to choose from."""
        raise _not_yet()

    def cures(self, vectors: Sequence[FloatArray]) -> tuple[Cure | None, ...]:
        """None: what is lost is lost at every posture."""
        return (None,) * len(vectors)


@dataclass(frozen=True, eq=False)
class BoxedPostures:
    """The best postures found in the box, and how long all searches took; ``source`` tells where
    the first start came from.
    """

    procedure: Procedure
    best: BestPostures
    seed: int
    seconds: float
    source: str = "random"

    @property
    def postures(self) -> tuple[dict[str, float], ...]:
        """The postures found: coordinates by name, in metres and degrees."""
        return tuple(_coordinates(posture) for posture in self.best.refined.coordinates)


def asked_postures(
    request: Request,
    count: int | None,
    criterion: Criterion | None = None,
    *,
    starts: int,
    as_is: bool = False,
    output: Path | None = None,
) -> BoxedPostures:
    """The best postures, from those of the file if there is one, or those ``as_is``.

    ``criterion`` None is the condition number, as in papers/001. Raises UsageError, RecordError,
    CalibrationError for postures that do not determine enough.
    """
    file, criterion = request.posture_file, criterion or Criterion.CONDITION
    _check_output(output)
    if file is None:
        if as_is:
            raise UsageError("--as-is", "no --posture-file", "one to judge")
        if count is None:
            raise UsageError("--count", "none", "how many postures to find, or a --posture-file")
        return boxed_postures(request, count, criterion, seed=request.seed, starts=starts)
    given = load_postures(file)
    if count not in (None, len(given)):
        raise UsageError("--count", f"{count}", f"{len(given)} as in the posture file, or none")
    if as_is:
        return _as_they_are(request, given, criterion)
    found = boxed_postures(
        request, len(given), criterion, seed=request.seed, starts=starts, given=given
    )
    return replace(found, source=f"{file}")


def boxed_postures(
    request: Request,
    count: int,
    criterion: Criterion,
    *,
    seed: int,
    starts: int,
    given: FloatArray | None = None,
    watch: Callable[[], object] = lambda: None,
) -> BoxedPostures:
    """The best ``count`` postures; ``given`` ``(count, 6)`` is the first start.

    Raises UsageError, RecordError, NotIdentifiable for too few.
    """
    planned = _searchable(request, criterion)
    if count > MOST_MOVED:
        raise UsageError("--count", f"{count}", f"{MOST_MOVED} postures at most")
    if given is not None:
        given = inside_box(given, planned.machine.box, AS_IS)
    begin = time.perf_counter()
    best = best_postures(
        planned.procedure,
        planned.machine,
        count,
        criterion,
        seed=seed,
        starts=starts,
        given=given,
        watch=watch,
    )
    return BoxedPostures(planned.procedure, best, seed, time.perf_counter() - begin)


def _as_they_are(request: Request, given: FloatArray, criterion: Criterion) -> BoxedPostures:
    planned = _searchable(request, criterion)
    best = judged_postures(planned.procedure, planned.machine, given, criterion)
    return BoxedPostures(planned.procedure, best, request.seed, 0.0, f"{request.posture_file}")


def _searchable(request: Request, criterion: Criterion) -> HexaSlidePlanning:
    if criterion is Criterion.TOOL_VARIANCE:
        raise UsageError("--criterion", criterion.value, "the other five for the hexaslide")
    return HexaSlidePlanning.of(request)


def inside_box(given: FloatArray, box: Box, advice: str = "") -> FloatArray:
    """The postures, on the bounds where only rounding is outside. Raises RecordError."""
    outside = (given < box.lower - ROUNDING) | (given > box.upper + ROUNDING)
    if outside.any():
        row, column = (int(part[0]) for part in np.nonzero(outside))
        name, unit = COORDINATES[column], 1.0 if column < 3 else np.degrees(1.0)
        raise RecordError(
            f"posture file, posture {row + 1}, {name}",
            f"{unit * given[row, column]:g}",
            f"{unit * box.lower[column]:g} to {unit * box.upper[column]:g}, the machine's box",
            advice,
        )
    return np.asarray(np.clip(given, box.lower, box.upper))


def _check_output(output: Path | None) -> None:
    if output is not None and output.suffix != ".csv":
        raise UsageError("--output", f"{output}", "a path that ends with .csv for the hexaslide")


def write_postures(found: BoxedPostures, path: Path) -> Path:
    """A table that ``--posture-file`` reads, units in its header line. Raises RecordError."""
    _check_output(path)
    rows = [[f"{value:.12g}" for value in row.values()] for row in found.postures]
    write_files(path, {"": csv_text([COORDINATES, *rows])})
    return path


def _coordinates(posture: FloatArray) -> dict[str, float]:
    places = [*posture[:3], *np.degrees(posture[3:])]
    return {name: float(value) for name, value in zip(COORDINATES, places, strict=True)}


def _not_yet() -> UsageError:
    return UsageError(
        "machine",
        "hexaslide",
        "orthoglide for choosing among postures",
        f"What a Hexa Slide reads: {', '.join(COMPONENTS)}; see glidecal identifiability.",
    )
