"""Which postures show most: moved in their box, on the constraint link, or by the sliders between
the ends of their rails.

Bounds are kept exactly in the coordinates of the search. What else limits postures costs, more the
farther it is passed; what is left of that is taken back on the way to where the search began.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib import clusters
from calib.arrays import EXACT_BLIND, FloatArray, rank_of
from calib.design.criteria import Aim, Criterion, Observability, observability
from calib.design.refinement import Pull, RefinedPostures, count_on_bound, judged, refine
from calib.errors import CalibrationError, NotIdentifiable, UnreachablePosture
from calib.hexaslide.arms import transposed
from calib.hexaslide.derivatives import Bar, RowMaker
from calib.hexaslide.geometry import HexaSlide, forward_near, in_degrees, inverse, present
from calib.hexaslide.planning import (
    SCALED_WORDS,
    UNITS,
    at_enough,
    fewest_postures,
    rows_seen,
)
from calib.hexaslide.procedures import (
    WELL_HELD,
    Procedure,
    ProcedureKind,
    at_joints,
    looseness,
)
from calib.hexaslide.simulation import between, link_postures, on_link, random_on_link

SHARPNESS = (8.0, 32.0, 128.0, 512.0, 2048.0)
"""Criteria of single singular values are made smooth, less and less. On the bare condition number
of 9 postures of pose-inverse a search ends at 50 to 125, so at 43."""

STEEP = 1e4
"""What it costs, in logarithms of the criterion, to pass a limit by the whole travel: of 1 m some
hundredths of a millimetre are passed where the criterion would gain from it.
"""

HOLD = 3.0
"""The same of a condition number of the platform beyond `WELL_HELD`, e times too large: little,
for a steep wall would stop the search beside it.
"""

STAGES = (0.25, 0.5, 0.75, 1.0)
"""Of a way that is too long to be followed at once."""

REMEMBERED = 64
"""Postures of so many steps: a search that turns back goes on from the nearest."""

HALVINGS = 30


SearchSpace = Literal["box", "joints", "link"]


@dataclass(frozen=True, eq=False)
class Search:
    """How postures are looked for: by ``criterion`` from ``starts`` random sets of the seed, the
    first replaced by ``given`` ``(p, 6)``.

    ``space`` joints: the sliders are moved between the ends of their rails, the box is left out;
    link: in the box, but as high as the constraint link holds the platform. None: link where the
    procedure has a rigid one, without which no posture can be measured, otherwise box.
    ``scaled``: angles count at the joints of the platform, parameters by what they do at random
    postures. ``few``: so few postures are wanted that they cannot show all; what their rows show
    is judged. ``source`` tells where ``given`` came from.
    """

    criterion: Criterion = Criterion.CONDITION
    seed: int = 0
    starts: int = 8
    given: FloatArray | None = None
    space: SearchSpace | None = None
    scaled: bool = False
    few: bool = False
    source: str = "random"


def space_of(search: Search, procedure: Procedure) -> SearchSpace:
    """Where a search moves that may not say so."""
    return search.space or ("link" if procedure.has_rigid_link else "box")


@dataclass(frozen=True, eq=False)
class BestPostures:
    """The best of several searches; with ``values`` empty, postures that were only judged.

    ``values`` holds the criterion that each start so far came to, in their order; ``rank``
    combinations of the parameters are seen of ``reachable_rank`` that more postures show, all
    figures are of those. ``begin`` ``(p, 6)`` is where the best search began, ``coordinates``
    ``(p, 6)`` where it ended, ``start`` and ``criteria`` are the criteria of papers/001 before and
    after, ``seconds`` are those of all searches.
    """

    procedure: Procedure
    search: Search
    begin: FloatArray
    coordinates: FloatArray
    refined: RefinedPostures
    start: Observability
    criteria: Observability
    start_on_bound: int
    values: tuple[float, ...]
    rank: int
    reachable_rank: int
    seconds: float = 0.0

    @property
    def postures(self) -> tuple[dict[str, float], ...]:
        """The best ones by the names of the coordinates, in metres and degrees."""
        return in_degrees(self.coordinates)

    @property
    def units(self) -> str:
        """What the figures are in."""
        return SCALED_WORDS if self.search.scaled else UNITS

    @property
    def space(self) -> SearchSpace:
        """Where the search moved."""
        return space_of(self.search, self.procedure)

    @property
    def start_condition_number(self) -> float:
        """Condition number at the start that came to be the best."""
        return self.start.condition_number

    @property
    def condition_number(self) -> float:
        """Condition number of the best postures."""
        return self.criteria.condition_number


class Space:
    """Postures in the box, by their coordinates ``(p, 6)``, and the limits of the sliders."""

    def __init__(self, maker: RowMaker, machine: HexaSlide, *, few: bool) -> None:
        self._maker, self._few, self.procedure = maker, few, maker.procedure
        self.machine, self.width = machine, maker.width
        self.lower, self.upper = machine.box.lower, machine.box.upper
        self._limited = bool(np.isfinite(machine.travel_m).any())

    def random(self, count: int, generator: np.random.Generator) -> FloatArray:
        """Postures ``(count, 6)`` where a search may begin. Raises CalibrationError."""
        return self.machine.random(count, generator)

    def begin(self, postures: FloatArray) -> FloatArray:
        """Coordinates of postures where a search begins."""
        return postures

    def postures(self, coordinates: FloatArray) -> FloatArray:
        """Postures of coordinates not far from those before. Raises UnreachablePosture."""
        return coordinates

    def pulled(self, _postures: FloatArray, slopes: FloatArray) -> FloatArray:
        """Derivatives by the coordinates from those by the postures ``(p, 6)``."""
        return slopes

    def rows(self, coordinates: FloatArray) -> tuple[FloatArray, Pull]:
        """Rows and their pull, a `calib.design.refinement.RowsAndPull`. Raises
        UnreachablePosture.
        """
        postures = self.postures(coordinates)
        rows, pull = self.read(postures)
        return rows, lambda weights: self.pulled(postures, pull(weights))

    def read(self, postures: FloatArray) -> tuple[FloatArray, Pull]:
        """Rows of postures and their pull."""
        rows, pull = self._maker(postures)
        if not self._few:
            return rows, pull
        flat = rows.reshape(-1, rows.shape[-1])
        # the other way round: as many singular values as rows
        return flat.T[None], lambda weights: pull(weights[0].T.reshape(rows.shape))

    def beyond(self, coordinates: FloatArray) -> tuple[float, FloatArray]:
        """What passing limits costs, and its derivatives ``(p, 6)``."""
        if not self._limited:
            return 0.0, np.zeros_like(coordinates)
        chains = self._maker.chains(coordinates)
        least, greatest = self.machine.travel_m
        passed = chains.legs.sliders - np.clip(chains.legs.sliders, least, greatest)
        if not passed.any():
            return 0.0, np.zeros_like(coordinates)
        share = passed / (greatest - least)
        by_slider = 2.0 * STEEP * share / (greatest - least)
        slopes = np.einsum("pk,pkx->px", by_slider, chains.by_posture)
        return STEEP * float((share**2).sum()), slopes

    def allowed(self, coordinates: FloatArray) -> NDArray[np.bool_]:
        """Which of them ``(p,)`` may be."""
        sliders = np.asarray(inverse(self.machine.geometry, coordinates))
        return np.asarray(self.machine.within(sliders).all(axis=1))


class JointSpace(Space):
    """Sliders between the ends of their rails ``(p, 6)``, while they hold the platform well.

    Postures are followed from those before, so that they stay on the branch of the machine.
    """

    def __init__(self, maker: RowMaker, machine: HexaSlide, *, few: bool) -> None:
        super().__init__(maker, machine, few=few)
        self.lower, self.upper = machine.travel_m
        self._size = at_joints(machine.geometry)
        self._known: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=REMEMBERED)

    def begin(self, postures: FloatArray) -> FloatArray:
        """Where the search begins, and where solutions are followed from."""
        sliders = np.asarray(inverse(self.machine.geometry, postures))
        sliders = np.asarray(np.clip(sliders, self.lower, self.upper))  # rounding alone
        self._known.clear()
        self._known.append((sliders, postures))
        return sliders

    def postures(self, coordinates: FloatArray) -> FloatArray:
        """Postures of sliders. Raises UnreachablePosture."""
        sliders, near = min(
            self._known, key=lambda known_pair: float(np.abs(known_pair[0] - coordinates).max())
        )
        if np.array_equal(sliders, coordinates):
            return near
        geometry = self.machine.geometry
        try:
            near = np.asarray(forward_near(geometry, coordinates, near))
        except UnreachablePosture:
            for share in STAGES:
                on_way = sliders + share * (coordinates - sliders)
                near = np.asarray(forward_near(geometry, on_way, near))
        self._known.append((coordinates.copy(), near))
        return near

    def pulled(self, postures: FloatArray, slopes: FloatArray) -> FloatArray:
        """Derivatives by the sliders from those by the postures ``(p, 6)``."""
        by_posture = self._maker.chains(postures).by_posture
        return np.asarray(np.linalg.solve(transposed(by_posture), slopes[..., None])[..., 0])

    def beyond(self, coordinates: FloatArray) -> tuple[float, FloatArray]:
        """The condition number in Frobenius' norm is smooth and no less than the usual one."""
        postures = self.postures(coordinates)
        chains = self._maker.chains(postures)
        slopes = chains.by_posture / self._size
        inverses = np.linalg.inv(slopes)
        squares = [(matrices**2).sum(axis=(1, 2)) for matrices in (slopes, inverses)]
        over = np.maximum(0.5 * np.log(squares[0] * squares[1]) - np.log(WELL_HELD), 0.0)
        back = transposed(inverses)
        by_slopes = slopes / squares[0][:, None, None]
        by_slopes -= back @ inverses @ back / squares[1][:, None, None]
        by_slopes *= (2.0 * HOLD * over)[:, None, None] / self._size
        moved = chains.pull(np.zeros_like(chains.own), by_slopes)
        return HOLD * float((over**2).sum()), self.pulled(postures, moved)

    def allowed(self, coordinates: FloatArray) -> NDArray[np.bool_]:
        """Which hold the platform well ``(p,)``."""
        try:
            postures = self.postures(coordinates)
            return np.asarray(looseness(self.machine.geometry, postures) < WELL_HELD)
        except UnreachablePosture:
            return np.zeros(len(coordinates), dtype=np.bool_)


class LinkSpace(Space):
    """Postures that the constraint link holds, by all of their coordinates but z.

    Along it the posture moves across the link's derivatives ``g``: dz = -(g · d(others)) / g_z.
    """

    def random(self, count: int, generator: np.random.Generator) -> FloatArray:
        """Held by the link. Raises CalibrationError."""
        return random_on_link(self.machine, count, generator)

    def begin(self, postures: FloatArray) -> FloatArray:
        """Raises CalibrationError for postures that the link cannot hold inside the box."""
        return on_link(self.machine, postures)

    def postures(self, coordinates: FloatArray) -> FloatArray:
        """Postures in the box or beyond its z, which is NaN where the link reaches nowhere."""
        return link_postures(self.machine, coordinates)

    def beyond(self, coordinates: FloatArray) -> tuple[float, FloatArray]:
        """A z beyond the box costs as a slider beyond its rail."""
        postures = self.postures(coordinates)
        cost, slopes = super().beyond(postures)
        least, greatest = self.lower[2], self.upper[2]
        share = (postures[:, 2] - np.clip(postures[:, 2], least, greatest)) / (greatest - least)
        slopes[:, 2] += 2.0 * STEEP * share / (greatest - least)
        return cost + STEEP * float((share**2).sum()), self.pulled(postures, slopes)

    def allowed(self, coordinates: FloatArray) -> NDArray[np.bool_]:
        """Which postures are in the box ``(p,)``."""
        postures = self.postures(coordinates)
        inside = between(self.machine.box, postures)
        inside[inside] = super().allowed(postures[inside])
        return inside

    def pulled(self, postures: FloatArray, slopes: FloatArray) -> FloatArray:
        """Derivatives by the coordinates, z following, from those by the postures ``(p, 6)``."""
        turn = self._maker.chains(postures).legs.arms.turn
        bar = Bar.at(present(self.machine.link), postures, turn).by_posture
        return np.asarray(slopes - slopes[:, 2:3] / bar[:, 2:3] * bar)


SPACES: dict[SearchSpace, type[Space]] = {"box": Space, "joints": JointSpace, "link": LinkSpace}


def searches(
    procedure: Procedure,
    machine: HexaSlide,
    count: int,
    search: Search,
    watch: Callable[[], object] = lambda: None,
) -> Iterator[BestPostures]:
    """The best so far, after each start; what the procedure never sees is left out.

    ``watch`` is called before every step and ends the search by what it raises. Raises
    NotIdentifiable for fewer postures than the procedure needs, or a start that does not show
    enough; CalibrationError where limits leave no postures.
    """
    began = time.perf_counter()
    space = _space(procedure, machine, count, search)
    generator, aim = np.random.default_rng(search.seed), Aim(search.criterion)
    begins = [space.random(count, generator) for _ in range(search.starts)]
    if search.given is not None:  # drawn all the same: the other starts are those of the seed
        begins[0] = search.given

    def refined(part: tuple[int, FloatArray]) -> tuple[FloatArray, RefinedPostures]:
        number, begin = part[0], space.begin(part[1])
        progress = clusters.on_part.get()

        def watched(coordinates: FloatArray) -> tuple[FloatArray, Pull]:
            watch()
            return space.rows(coordinates)

        refined_postures = refine(
            watched,
            begin,
            space.lower,
            space.upper,
            aim,
            sharpness=SHARPNESS,
            penalty=space.beyond,
            progress=lambda count, parts: progress(number + count / parts, search.starts),
        )
        refined_postures = _taken_back(space, begin, refined_postures, aim)
        return space.postures(refined_postures.coordinates), refined_postures

    best: BestPostures | None = None
    values: tuple[float, ...] = ()
    for begin, (end, optimum) in zip(
        begins, clusters.in_parallel(refined, list(enumerate(begins))), strict=True
    ):
        values += (optimum.value,)
        if best is None or search.criterion.better(optimum.value, best.refined.value):
            best = _described(space, search, begin, end, optimum)
        best = replace(best, values=values, seconds=time.perf_counter() - began)
        yield best


def best_postures(
    procedure: Procedure, machine: HexaSlide, count: int, search: Search | None = None
) -> BestPostures:
    """The last of `searches`."""
    return deque(searches(procedure, machine, count, search or Search()), maxlen=1).pop()


def judged_postures(
    procedure: Procedure, machine: HexaSlide, postures: FloatArray, search: Search | None = None
) -> BestPostures:
    """Postures ``(p, 6)`` as they are, in the box or not.

    Raises NotIdentifiable where they do not show all that the procedure can show, and
    UnreachablePosture.
    """
    search = replace(search or Search(), space="box")
    space = _space(procedure, machine, len(postures), search)
    value = judged(space.rows(postures)[0], Aim(search.criterion))
    as_is = RefinedPostures(
        postures, value, value, count_on_bound(postures, space.lower, space.upper)
    )
    return _described(space, search, postures, postures, as_is)


def _space(procedure: Procedure, machine: HexaSlide, count: int, search: Search) -> Space:
    """Raises NotIdentifiable for too few postures, CalibrationError for rails without ends."""
    fewest = fewest_postures(procedure, machine)
    few = search.few and count < fewest
    if few:
        rows = at_enough(procedure, machine).jacobian
        rows = rows[: count * len(procedure.read)]
        rank = rank_of(rows, EXACT_BLIND)
        if rank < len(rows):
            raise NotIdentifiable(
                f"{count} postures of {procedure.kind.value}",
                f"{len(rows)} values that show {rank} combinations, so that some add nothing",
                f"{fewest} or more postures",
            )
    elif count < fewest:
        raise NotIdentifiable(
            "number of postures",
            f"{count}",
            f"{fewest} or more for {procedure.kind.value}",
            "With --few the combinations that so few postures show are judged.",
        )
    if search.space == "joints" and not np.isfinite(machine.travel_m).all():
        raise CalibrationError(
            f"search between the ends of the {machine.geometry.part}s",
            "no travel_mm in the machine file",
            "travel_mm in every [[chain]]",
        )
    if search.space == "link" and procedure.kind is not ProcedureKind.CONSTRAINT_LINK:
        raise CalibrationError(
            "search on the constraint link", procedure.kind.value, "constraint-link"
        )
    maker = rows_seen(procedure, machine, scaled=search.scaled)
    return SPACES[space_of(search, procedure)](maker, machine, few=few)


def _taken_back(
    space: Space, begin: FloatArray, refined: RefinedPostures, aim: Aim
) -> RefinedPostures:
    """Coordinates that pass a limit moved back towards where they began until they do not."""
    way = refined.coordinates - begin
    fits_there = space.allowed(refined.coordinates)
    if fits_there.all():
        return refined
    within, beyond = np.zeros((len(begin), 1)), np.ones((len(begin), 1))
    for _ in range(HALVINGS):
        middle = (within + beyond) / 2.0
        fits = space.allowed(begin + middle * way)[:, None]
        within, beyond = np.where(fits, middle, within), np.where(fits, beyond, middle)
    moved = np.where(fits_there[:, None], refined.coordinates, begin + within * way)
    value = judged(space.rows(moved)[0], aim)
    if not aim.criterion.better(value, refined.start_value):
        moved, value = begin, refined.start_value
    on_bound = count_on_bound(moved, space.lower, space.upper)
    return RefinedPostures(moved, value, refined.start_value, on_bound)


def _described(
    space: Space, search: Search, begin: FloatArray, end: FloatArray, refined: RefinedPostures
) -> BestPostures:
    """The result of a search from postures ``begin`` to ``end`` ``(p, 6)``."""
    figures, rank = [], 0
    for postures in (begin, end):
        rows = space.read(postures)[0]
        singular = np.linalg.svd(rows.reshape(-1, rows.shape[-1]), compute_uv=False)
        figures.append(observability(np.asarray(singular, dtype=np.float64), len(postures)))
        rank = len(singular)
    return BestPostures(
        procedure=space.procedure,
        search=search,
        begin=begin,
        coordinates=end,
        refined=refined,
        start=figures[0],
        criteria=figures[1],
        start_on_bound=count_on_bound(space.begin(begin), space.lower, space.upper),
        values=(),
        rank=rank,
        reachable_rank=space.width,
    )
