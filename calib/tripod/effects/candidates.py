"""Every law at every place and in every arrangement, with the derivatives of the readings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, Conditions, FloatArray, IntArray, incidence, joined
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.drives import effects_of
from calib.tripod.effects.effect import AROUND, Effect, EffectInstance, EffectParameter, Kind
from calib.tripod.geometry import Geometry, inverse
from calib.tripod.pipeline import COMPLEX_STEP_MM, Flow, Model, Stage, posture, simulate
from calib.tripod.workspace import reached

VANISHES_MM = 1e-9
"""A column that changes readings by less, for an unremarkable size, is not there."""


@dataclass(frozen=True)
class Share:
    """A place of a candidate and which of its values act there."""

    effect: Effect
    place: str
    values: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A law in an arrangement, with ``r`` parameters.

    ``where`` is a place, ``"all"`` where values are shared, or the places (legs, where each has
    all its own) with commas between; ``arrangement`` is ``"one"`` place, the
    ``"same"`` values everywhere, two values ``"mirror"`` or ``"turning"``, or ``"each"`` place its
    own. ``columns`` ``(n_readings, r)`` are derivatives of the readings, mm per unit, at the model.
    """

    id: str
    title: str
    kind: Kind
    where: str
    arrangement: str
    parameters: tuple[EffectParameter, ...]
    columns: FloatArray
    shares: tuple[Share, ...] = ()

    def effects(self, values: FloatArray | Sequence[float]) -> tuple[EffectInstance, ...]:
        """The effects of these values ``(r,)``, for `Model.effects`."""
        return tuple(
            EffectInstance(share.effect, share.place, tuple(float(values[k]) for k in share.values))
            for share in self.shares
        )


def candidates(
    model: Model, observed: Conditions, effects: Sequence[Effect] = CATALOGUE
) -> tuple[Candidate, ...]:
    """What the readings could show of these laws; the rest is `invisible`."""
    return candidates_together([(model, observed)], effects)


def candidates_together(
    sessions: Sequence[tuple[Model, Conditions]], effects: Sequence[Effect] = CATALOGUE
) -> tuple[Candidate, ...]:
    """What several sessions could show together; ``columns`` are stacked over them.

    Places are those of all sessions: one that a session did not reach is zero there.
    """
    return tuple(c for c, seen in _all_candidates(sessions, effects) if seen)


def invisible(
    model: Model, observed: Conditions, effects: Sequence[Effect] = CATALOGUE
) -> tuple[tuple[str, str], ...]:
    """Id and place of what changes no reading of these, or only zeros of mountings."""
    found = list(_all_candidates([(model, observed)], effects))
    seen = {(c.id, c.where) for c, is_seen in found if is_seen}
    return tuple(dict.fromkeys((c.id, c.where) for c, _ in found if (c.id, c.where) not in seen))


@dataclass(frozen=True)
class _Together:
    """Effects of one stage side by side: each on its own machine, along a new leading axis."""

    effects: tuple[EffectInstance, ...]
    stage: Stage
    id: str = "together"

    def change(self, stage_input: NDArray[Any], flow: Flow) -> NDArray[Any]:
        return np.stack([effect.change(stage_input, flow) for effect in self.effects])


def _steps(effect: Effect, place: str) -> list[EffectInstance]:
    """The law with each of its values a complex step from nothing."""
    steps = 1j * COMPLEX_STEP_MM * np.eye(len(effect.parameters))
    return [EffectInstance(effect, place, tuple(step)) for step in steps.tolist()]


def place_columns(
    model: Model, observed: Conditions, effects: Sequence[Effect]
) -> list[dict[str, FloatArray]]:
    """For each law its places and the derivatives ``(n_readings, k)`` there, by the complex step.

    One simulation for each stage; what comes before the stage is computed once for all.
    """
    found: list[dict[str, list[FloatArray]]] = [{} for _ in effects]
    for stage in Stage:
        stepped = [
            (rows.setdefault(place, []), one)
            for effect, rows in zip(effects, found, strict=True)
            if effect.stage == stage
            for place in effect.places(observed)
            for one in _steps(effect, place)
        ]
        if stepped:
            together = _Together(tuple(placed for _, placed in stepped), stage)
            acting = (*model.effects, together)
            readings = simulate(model.geometry, model.parameters_mm, observed, acting)
            for (rows, _), row in zip(stepped, readings.imag / COMPLEX_STEP_MM, strict=True):
                rows.append(row)
    return [{place: np.stack(rows, axis=1) for place, rows in one.items()} for one in found]


def tool_columns(
    geometry: Geometry,
    tool_mm: FloatArray,
    placed: Sequence[tuple[Effect, str]],
    way: float,
) -> FloatArray:
    """Derivatives ``(n, 3, k)`` of the tool at ``(n, 3)`` by the values of laws at places.

    Of the nominal machine; all carriages come one ``way``, 1 is upwards. Where the tool's place at
    Zero is set by hand, less what it does there. Raises UnreachablePosture.
    """
    points = np.vstack([tool_mm, np.zeros(3)])  # the last one tells what is done at Zero
    joint_mm, taken = inverse(geometry, points), reached(len(points), way)
    stepped = [one for effect, place in placed for one in _steps(effect, place)]
    moved = np.zeros((len(points), 3, len(stepped)))
    for stage in (Stage.ACTUATOR, Stage.FOOT, Stage.TOOL):
        index = [k for k, one in enumerate(stepped) if one.stage == stage]
        if index:
            together = _Together(tuple(stepped[k] for k in index), stage)
            flow = posture(geometry, (0.0,) * 6, taken, joint_mm, (together,))
            moved[:, :, index] = np.moveaxis(flow.tool_mm.imag / COMPLEX_STEP_MM, 0, -1)
    return np.asarray(moved[:-1] - moved[-1] if geometry.set_at_zero else moved[:-1])


def _all_candidates(
    sessions: Sequence[tuple[Model, Conditions]], effects: Sequence[Effect]
) -> Iterable[tuple[Candidate, bool]]:
    """Every candidate and whether it is seen."""
    geometry = sessions[0][0].geometry
    known = effects_of(effects, geometry)
    mount = joined([observed for _, observed in sessions]).mount
    places = stacked_columns(sessions, known)
    alone = [
        [_one(effect, columns, place) for place in columns]
        for effect, columns in zip(known, places, strict=True)
    ]
    shown = iter(_are_seen(mount, [one for some in alone for one in some]))
    every: list[Candidate] = []
    for effect, some in zip(known, alone, strict=True):
        each = [(one, next(shown)) for one in some]
        every += [one for one, seen in each if not seen]
        by_place = {one.where: one.columns for one, seen in each if seen}
        every += _arrangements(effect, by_place, geometry)
    return zip(every, _are_seen(mount, every), strict=True)


def stacked_columns(
    sessions: Sequence[tuple[Model, Conditions]], effects: Sequence[Effect]
) -> list[dict[str, FloatArray]]:
    """`place_columns` of several sessions below each other, zero where one has no such place."""
    parts = [place_columns(model, observed, effects) for model, observed in sessions]
    found = []
    for effect, *each in zip(effects, *parts, strict=True):
        nothing = [np.zeros((len(o), len(effect.parameters))) for _, o in sessions]
        places = dict.fromkeys(place for one in each for place in one)
        found.append(
            {
                place: np.vstack([o.get(place, z) for o, z in zip(each, nothing, strict=True)])
                for place in places
            }
        )
    return found


def _are_seen(mount: IntArray, some: Sequence[Candidate]) -> list[bool]:
    """Whether an unremarkable size of each changes more than zeros of mountings."""
    if not some:
        return []
    columns = np.hstack([one.columns for one in some])
    sizes = np.array([parameter.tolerance for one in some for parameter in one.parameters])
    member = incidence(mount)
    mean = (member / member.sum(axis=0)).T @ columns  # a product: columns are many
    left = np.abs(columns - mean[mount]).max(axis=0, initial=0.0)
    starts = np.cumsum([0, *(len(one.parameters) for one in some[:-1])])
    return list(np.maximum.reduceat(left * sizes, starts) > VANISHES_MM)


def _arrangements(
    effect: Effect, seen: dict[str, FloatArray], geometry: Geometry
) -> Iterator[Candidate]:
    lateral = _is_lateral(seen, geometry)
    if not lateral or effect.stage in (Stage.TOUCH, Stage.READING):
        yield from (_one(effect, seen, place) for place in seen)
    if lateral or set(seen) == set(AROUND):
        yield from _by_leg(effect, seen)
    if len(seen) > 1:
        if geometry.common_zero or not lateral:
            yield _grouped(effect, seen, "same", {"": tuple(seen)})
        if set(seen) == set(geometry.across):
            yield from _symmetric(effect, seen, geometry)
        legs = {place[0] for place in seen}
        if not lateral or len(legs) > 1:
            yield _each(effect, seen, seen, ",".join(_listed(seen, lateral=lateral)))


def _is_lateral(seen: Iterable[str], geometry: Geometry) -> bool:
    """Whether these places are directions across drives, not pairs of drives of like names."""
    if not set(seen) <= set(geometry.across):
        return False
    return any(place[::-1] in seen or place[1] not in LEG_NAMES for place in seen)


def _symmetric(
    effect: Effect, seen: dict[str, FloatArray], geometry: Geometry
) -> Iterator[Candidate]:
    """Two values that all drives share, as the machine is symmetric.

    Drives whose legs are read: each the mirror image of itself when two axes are exchanged; going
    round with the axes, towards the next one and the one before. Else radial and tangential.
    """
    first, second = list(seen)[0::2], list(seen)[1::2]
    if not geometry.common_zero:
        yield _grouped(effect, seen, "turning", {"_r": tuple(first), "_t": tuple(second)})
        return
    yield _grouped(effect, seen, "mirror", {"_first": tuple(first), "_second": tuple(second)})
    following = (first[0], second[1], first[2])
    before = (second[0], first[1], second[2])
    yield _grouped(effect, seen, "turning", {"_next": following, "_before": before})


def _listed(seen: Iterable[str], *, lateral: bool) -> list[str]:
    """Places for a reader: legs where both directions across every one of them are there."""
    by_leg = {leg: [place for place in seen if place[0] == leg] for leg in LEG_NAMES}
    legs = [leg for leg, places in by_leg.items() if places]
    whole = lateral and all(len(by_leg[leg]) == 2 for leg in legs)
    return legs if whole else list(seen)


def _by_leg(effect: Effect, seen: dict[str, FloatArray]) -> Iterator[Candidate]:
    """Both directions across one leg, or both pairs of an axis, each with its own value."""
    for leg in LEG_NAMES:
        both = [place for place in seen if leg in (place if set(seen) == set(AROUND) else place[0])]
        if len(both) == 2:
            yield _each(effect, seen, both, leg)


def _one(effect: Effect, seen: dict[str, FloatArray], place: str) -> Candidate:
    return _grouped(effect, seen, "one", {"": (place,)}, place)


def _each(
    effect: Effect, seen: dict[str, FloatArray], places: Iterable[str], where: str
) -> Candidate:
    return _grouped(effect, seen, "each", {f"_{place}": (place,) for place in places}, where)


def _grouped(
    effect: Effect,
    seen: dict[str, FloatArray],
    arrangement: str,
    groups: dict[str, tuple[str, ...]],
    where: str = "all",
) -> Candidate:
    """Groups of places that share their values, by the ending of their parameters' names."""
    count = len(effect.parameters)
    return Candidate(
        id=effect.id,
        title=effect.title,
        kind=effect.kind,
        where=where,
        arrangement=arrangement,
        parameters=tuple(
            replace(parameter, name=parameter.name + ending) if ending else parameter
            for ending in groups
            for parameter in effect.parameters
        ),
        columns=np.hstack(
            [np.sum([seen[one] for one in places], axis=0) for places in groups.values()]
        ),
        shares=tuple(
            Share(effect, place, tuple(range(number * count, (number + 1) * count)))
            for number, places in enumerate(groups.values())
            for place in places
        ),
    )
