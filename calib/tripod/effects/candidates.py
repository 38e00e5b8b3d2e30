"""Every law at every place and in every arrangement, with the derivatives of the readings."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, Conditions, FloatArray, IntArray, incidence, joined
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.drives import effects_of
from calib.tripod.effects.effect import (
    AROUND,
    Effect,
    EffectInstance,
    EffectParameter,
    Kind,
    Placed,
)
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

    def effects(
        self, values: FloatArray | Sequence[float], deviations: FloatArray | None = None
    ) -> tuple[EffectInstance, ...]:
        """The effects of these values ``(r,)``, for `Model.effects`, with their ``deviations``."""
        columns = [values] if deviations is None else [values, deviations]
        return tuple(
            EffectInstance(
                share.effect,
                share.place,
                *(tuple(float(column[k]) for k in share.values) for column in columns),
            )
            for share in self.shares
        )


def candidates(
    model: Model, observations: Conditions, effects: Sequence[Effect] = CATALOGUE
) -> tuple[Candidate, ...]:
    """What the readings could show of these laws; the rest is `invisible`."""
    return candidates_together([(model, observations)], effects)


def candidates_together(
    sessions: Sequence[tuple[Model, Conditions]],
    effects: Sequence[Effect] = CATALOGUE,
    placed: Sequence[Mapping[Placed, FloatArray]] | None = None,
) -> tuple[Candidate, ...]:
    """What several sessions could show together; ``columns`` are stacked over them.

    Places are those of all sessions: one that a session did not reach is zero there. ``placed`` are
    `placed_columns` of each session where these are known.
    """
    return tuple(c for c, is_seen in _all_candidates(sessions, effects, placed) if is_seen)


def single_places(
    model: Model, observations: Conditions, effects: Sequence[Effect]
) -> tuple[Candidate, ...]:
    """These laws at one place each, as a model file names it, where the readings show them.

    `candidates` arranges several directions of a drive together; here each is alone.
    """
    placed_effects = effects_of(effects, model.geometry)
    placed = placed_columns(model, observations, placed_effects)
    alone = [_one(effect, {place: columns}, place) for (effect, place), columns in placed.items()]
    identifiable = _are_seen(observations.mount, alone)
    return tuple(
        candidate for candidate, is_seen in zip(alone, identifiable, strict=True) if is_seen
    )


def invisible(
    model: Model, observations: Conditions, effects: Sequence[Effect] = CATALOGUE
) -> tuple[tuple[str, str], ...]:
    """Id and place of what changes no reading of these, or only zeros of mountings."""
    every_candidate = list(_all_candidates([(model, observations)], effects))
    visible = {(c.id, c.where) for c, is_seen in every_candidate if is_seen}
    return tuple(
        dict.fromkeys((c.id, c.where) for c, _ in every_candidate if (c.id, c.where) not in visible)
    )


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


def placed_columns(
    model: Model,
    observations: Conditions,
    effects: Sequence[Effect],
    laws: Container[Placed] | None = None,
) -> dict[Placed, FloatArray]:
    """Derivatives ``(n_readings, k)`` by each law at each place, by the complex step.

    Of these ``laws``, None: of all. One simulation for each stage; what comes before the stage is
    computed once for all.
    """
    placed: dict[Placed, list[FloatArray]] = {
        (effect, place): []
        for effect in effects
        for place in effect.places(observations)
        if laws is None or (effect, place) in laws
    }
    for stage in Stage:
        stepped = [
            (rows, step)
            for (effect, place), rows in placed.items()
            if effect.stage == stage
            for step in _steps(effect, place)
        ]
        if stepped:
            together = _Together(tuple(step for _, step in stepped), stage)
            acting = (*model.effects, together)
            readings = simulate(model.geometry, model.parameters_mm, observations, acting)
            for (rows, _), row in zip(stepped, readings.imag / COMPLEX_STEP_MM, strict=True):
                rows.append(row)
    return {law: np.stack(rows, axis=1) for law, rows in placed.items()}


def tool_columns(
    geometry: Geometry,
    tool_mm: FloatArray,
    placed_laws: Sequence[Placed],
    way: float,
) -> FloatArray:
    """Derivatives ``(n, 3, k)`` of the tool at ``(n, 3)`` by the values of laws at places.

    Of the nominal machine; all carriages come one ``way``, 1 is upwards. Where the tool's place at
    Zero is set by hand, less what it does there. Raises UnreachablePosture.
    """
    points = np.vstack([tool_mm, np.zeros(3)])  # the last one tells what is done at Zero
    joint_mm, conditions = inverse(geometry, points), reached(len(points), way)
    stepped = [instance for effect, place in placed_laws for instance in _steps(effect, place)]
    moved = np.zeros((len(points), 3, len(stepped)))
    for stage in (Stage.ACTUATOR, Stage.FOOT, Stage.TOOL):
        index = [k for k, instance in enumerate(stepped) if instance.stage == stage]
        if index:
            together = _Together(tuple(stepped[k] for k in index), stage)
            flow = posture(geometry, (0.0,) * 6, conditions, joint_mm, (together,))
            moved[:, :, index] = np.moveaxis(flow.tool_mm.imag / COMPLEX_STEP_MM, 0, -1)
    return np.asarray(moved[:-1] - moved[-1] if geometry.set_at_zero else moved[:-1])


def _all_candidates(
    sessions: Sequence[tuple[Model, Conditions]],
    effects: Sequence[Effect],
    placed: Sequence[Mapping[Placed, FloatArray]] | None = None,
) -> Iterable[tuple[Candidate, bool]]:
    """Every candidate and whether it is seen."""
    geometry = sessions[0][0].geometry
    placed_effects = effects_of(effects, geometry)
    mount = joined([observations for _, observations in sessions]).mount
    placed = placed or [placed_columns(*session, placed_effects) for session in sessions]
    places = _stacked(placed, placed_effects, [len(conditions) for _, conditions in sessions])
    alone = [
        [_one(effect, by_place, place) for place in by_place] for effect, by_place in places.items()
    ]
    visibility = iter(
        _are_seen(mount, [candidate for alone_of_effect in alone for candidate in alone_of_effect])
    )
    candidates: list[Candidate] = []
    for effect, alone_of_effect in zip(places, alone, strict=True):
        pairs = [(candidate, next(visibility)) for candidate in alone_of_effect]
        candidates += [candidate for candidate, is_seen in pairs if not is_seen]
        by_place = {candidate.where: candidate.columns for candidate, is_seen in pairs if is_seen}
        candidates += _arrangements(effect, by_place, geometry, mount)
    return zip(candidates, _are_seen(mount, candidates), strict=True)


def _stacked(
    placed: Sequence[Mapping[Placed, FloatArray]],
    effects: Sequence[Effect],
    counts: Sequence[int],
) -> dict[Effect, dict[str, FloatArray]]:
    """For each law by its places the columns of sessions of so many readings below each other.

    Zero where one has no such place.
    """
    stacked: dict[Effect, dict[str, FloatArray]] = {effect: {} for effect in effects}
    for law in dict.fromkeys(law for of_session in placed for law in of_session):
        effect, place = law
        zeros = [np.zeros((count, len(effect.parameters))) for count in counts]
        stacked[effect][place] = np.vstack(
            [of_session.get(law, zero) for of_session, zero in zip(placed, zeros, strict=True)]
        )
    return stacked


def _are_seen(mount: IntArray, candidates: Sequence[Candidate]) -> list[bool]:
    """Whether an unremarkable size of each changes more than zeros of mountings."""
    if not candidates:
        return []
    columns = np.hstack([candidate.columns for candidate in candidates])
    sizes = np.array(
        [parameter.tolerance for candidate in candidates for parameter in candidate.parameters]
    )
    member = incidence(mount)
    mean = (member / member.sum(axis=0)).T @ columns  # a product: columns are many
    centred = np.abs(columns - mean[mount]).max(axis=0, initial=0.0)
    starts = np.cumsum([0, *(len(candidate.parameters) for candidate in candidates[:-1])])
    return list(np.maximum.reduceat(centred * sizes, starts) > VANISHES_MM)


def _arrangements(
    effect: Effect, by_place_seen: dict[str, FloatArray], geometry: Geometry, mount: IntArray
) -> Iterator[Candidate]:
    lateral = _is_lateral(by_place_seen, geometry)
    if not lateral or effect.stage in (Stage.TOUCH, Stage.READING):
        yield from (_one(effect, by_place_seen, place) for place in by_place_seen)
    if lateral or set(by_place_seen) == set(AROUND):
        yield from _by_leg(effect, by_place_seen)
    if len(by_place_seen) > 1:
        if geometry.common_zero or not lateral:
            yield _grouped(effect, by_place_seen, "same", {"": tuple(by_place_seen)})
        if set(by_place_seen) == set(geometry.across):
            yield from _symmetric(effect, by_place_seen, geometry, mount)
        legs = {place[0] for place in by_place_seen}
        if not lateral or len(legs) > 1:
            yield _each(
                effect,
                by_place_seen,
                by_place_seen,
                ",".join(_listed(by_place_seen, lateral=lateral)),
            )


def _is_lateral(places_seen: Iterable[str], geometry: Geometry) -> bool:
    """Whether these places are directions across drives, not pairs of drives of like names."""
    if not set(places_seen) <= set(geometry.across):
        return False
    return any(place[::-1] in places_seen or place[1] not in LEG_NAMES for place in places_seen)


def _symmetric(
    effect: Effect, columns_by_place: dict[str, FloatArray], geometry: Geometry, mount: IntArray
) -> Iterator[Candidate]:
    """Two values that all drives share, as the machine is symmetric.

    Drives whose legs are read: each the mirror image of itself when two axes are exchanged; going
    round with the axes, towards the next one and the one before. Else radial and tangential, where
    it is seen: contacts with a plate do not show that all towers are turned alike.
    """
    first, second = list(columns_by_place)[0::2], list(columns_by_place)[1::2]
    if not geometry.common_zero:
        groups = {"_r": tuple(first), "_t": tuple(second)}
        alone = [
            _grouped(effect, columns_by_place, "turning", {ending: group})
            for ending, group in groups.items()
        ]
        identifiable = zip(groups.items(), _are_seen(mount, alone), strict=True)
        groups_seen = {ending: group for (ending, group), is_seen in identifiable if is_seen}
        if groups_seen:
            yield _grouped(effect, columns_by_place, "turning", groups_seen)
        return
    yield _grouped(
        effect, columns_by_place, "mirror", {"_first": tuple(first), "_second": tuple(second)}
    )
    following = (first[0], second[1], first[2])
    exchanged = (second[0], first[1], second[2])
    yield _grouped(effect, columns_by_place, "turning", {"_next": following, "_before": exchanged})


def _listed(places_seen: Iterable[str], *, lateral: bool) -> list[str]:
    """Places for a reader: legs where both directions across every one of them are there."""
    by_leg = {leg: [place for place in places_seen if place[0] == leg] for leg in LEG_NAMES}
    legs = [leg for leg, places in by_leg.items() if places]
    complete = lateral and all(len(by_leg[leg]) == 2 for leg in legs)
    return legs if complete else list(places_seen)


def _by_leg(effect: Effect, columns_by_place: dict[str, FloatArray]) -> Iterator[Candidate]:
    """Both directions across one leg, or both pairs of an axis, each with its own value."""
    for leg in LEG_NAMES:
        places_of_leg = [
            place
            for place in columns_by_place
            if leg in (place if set(columns_by_place) == set(AROUND) else place[0])
        ]
        if len(places_of_leg) == 2:
            yield _each(effect, columns_by_place, places_of_leg, leg)


def _one(effect: Effect, columns_by_place: dict[str, FloatArray], place: str) -> Candidate:
    return _grouped(effect, columns_by_place, "one", {"": (place,)}, place)


def _each(
    effect: Effect, columns_by_place: dict[str, FloatArray], places: Iterable[str], where: str
) -> Candidate:
    return _grouped(
        effect, columns_by_place, "each", {f"_{place}": (place,) for place in places}, where
    )


def _grouped(
    effect: Effect,
    columns_by_place: dict[str, FloatArray],
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
            [
                np.sum([columns_by_place[member] for member in places], axis=0)
                for places in groups.values()
            ]
        ),
        shares=tuple(
            Share(effect, place, tuple(range(number * count, (number + 1) * count)))
            for number, places in enumerate(groups.values())
            for place in places
        ),
    )
