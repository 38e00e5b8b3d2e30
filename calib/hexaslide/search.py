"""The best postures of a Hexa Slide: how long it took, and how far a search has come."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.design.criteria import Criterion
from calib.hexaslide.geometry import COORDINATES, Box
from calib.hexaslide.planning import BestPostures, best_postures, judged_postures
from calib.hexaslide.procedures import Procedure
from calib.hexaslide.seen import HexaSlidePlanning
from calib.observations import FloatArray


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


def _coordinates(posture: FloatArray) -> dict[str, float]:
    places = [*posture[:3], *np.degrees(posture[3:])]
    return {name: float(value) for name, value in zip(COORDINATES, places, strict=True)}


def boxed_postures(
    planned: HexaSlidePlanning,
    count: int,
    criterion: Criterion,
    *,
    seed: int,
    starts: int,
    given: FloatArray | None = None,
    watch: Callable[[], object] = lambda: None,
) -> BoxedPostures:
    """The best ``count`` postures; ``given`` ``(count, 6)``, those of the planning, are the first
    start. Raises NotIdentifiable for too few.
    """
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
    seconds = time.perf_counter() - begin
    source = "random" if given is None else planned.source
    return BoxedPostures(planned.procedure, best, seed, seconds, source)


def postures_as_given(planned: HexaSlidePlanning, criterion: Criterion) -> BoxedPostures:
    """The postures of the planning, judged wherever they are. Raises as `judged_postures`."""
    best = judged_postures(planned.procedure, planned.machine, planned.postures(), criterion)
    return BoxedPostures(planned.procedure, best, planned.seed, 0.0, planned.source)


@dataclass(frozen=True, eq=False)
class Found:
    """Searches so far: how many are done, and the best of them with where it began ``(p, 6)``."""

    done: int
    starts: int
    begin: FloatArray
    best: BoxedPostures

    @property
    def postures(self) -> FloatArray:
        """The best postures ``(p, 6)``."""
        return self.best.best.refined.coordinates


def find_postures(
    planned: HexaSlidePlanning,
    count: int,
    *,
    starts: int,
    heard: Callable[[Found], None],
    going_on: Callable[[], bool],
) -> None:
    """Search from one start after the other, tell after each; end soon when not ``going_on``.

    Raises CalibrationError as `boxed_postures`.
    """

    def watch() -> None:
        if not going_on():
            raise _NotWanted

    found: Found | None = None
    for k in range(starts):
        seed = planned.seed + k
        try:
            watch()
            best = boxed_postures(
                planned, count, Criterion.CONDITION, seed=seed, starts=1, watch=watch
            )
        except _NotWanted:
            return
        if found is None or best.best.condition_number < found.best.best.condition_number:
            found = Found(k + 1, starts, begin_of(planned.machine.box, count, seed), best)
        found = replace(found, done=k + 1)
        heard(found)


class _NotWanted(Exception):
    """The search was left."""


def begin_of(box: Box, count: int, seed: int) -> FloatArray:
    """The postures ``(count, 6)`` at which the search of one start with this seed begins."""
    return box.random(count, np.random.default_rng(seed))
