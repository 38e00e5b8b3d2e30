"""Every law at every place and in every arrangement, with the derivatives of the readings."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress, islice
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
from calib.tripod.pipeline import COMPLEX_STEP_MM, Flow, Model, Stage, simulate
from calib.tripod.workspace import reached

AXES = "axes"
"""Where all axes are out of square and shifted, each as it likes."""

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
    return tuple(compress(alone, _are_seen(observations.mount, alone)))


def axes_together(
    candidates: Sequence[Candidate],
) -> tuple[Candidate, tuple[Candidate, Candidate]] | None:
    """All axes out of square and shifted at once, each as it likes, with the two that it is of.

    None where these candidates do not have both.
    """
    parts = [
        candidate
        for candidate in candidates
        if candidate.id in ("axis_squareness", "axis_offset")
        and candidate.arrangement == "each"
        and len(candidate.parameters) == 3
    ]
    if len(parts) != 2:
        return None
    first, second = parts
    width = len(first.parameters)
    union = replace(
        first,
        title="the axes are not square and miss each other",
        where=AXES,
        parameters=(*first.parameters, *second.parameters),
        columns=np.hstack([first.columns, second.columns]),
        shares=(
            *first.shares,
            *(replace(s, values=tuple(width + k for k in s.values)) for s in second.shares),
        ),
    )
    return union, (first, second)


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
            flow = Flow(geometry, (0.0,) * 6, conditions, joint_mm, (together,))
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
    # columns of all sessions below each other, zero where one has no such place
    places: dict[Effect, dict[str, FloatArray]] = {effect: {} for effect in placed_effects}
    for law in dict.fromkeys(law for of_session in placed for law in of_session):
        effect, place = law
        width = len(effect.parameters)
        places[effect][place] = np.vstack(
            [
                of_session.get(law, np.zeros((len(observations), width)))
                for of_session, (_, observations) in zip(placed, sessions, strict=True)
            ]
        )
    alone = [
        _one(effect, columns, place) for effect, columns in places.items() for place in columns
    ]
    visibility = iter(zip(alone, _are_seen(mount, alone), strict=True))
    candidates: list[Candidate] = []
    for effect, columns in places.items():
        pairs = list(islice(visibility, len(columns)))
        candidates += [candidate for candidate, is_seen in pairs if not is_seen]
        seen_columns = {c.where: c.columns for c, is_seen in pairs if is_seen}
        candidates += _arrangements(effect, seen_columns, geometry, mount)
    return zip(candidates, _are_seen(mount, candidates), strict=True)


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
    effect: Effect, columns: dict[str, FloatArray], geometry: Geometry, mount: IntArray
) -> Iterator[Candidate]:
    """The law in every arrangement of the places that are seen, by their ``columns``."""

    def each(places: Sequence[str], where: str) -> Candidate:
        return _grouped(effect, columns, "each", {f"_{place}": (place,) for place in places}, where)

    # directions across drives, not pairs of drives of like names
    lateral = columns.keys() <= geometry.across.keys() and any(
        place[::-1] in columns or place[1] not in LEG_NAMES for place in columns
    )
    around = set(columns) == set(AROUND)
    of_leg = {
        leg: [place for place in columns if leg in (place if around else place[0])]
        for leg in LEG_NAMES
    }
    if not lateral or effect.stage in (Stage.TOUCH, Stage.READING):
        yield from (_one(effect, columns, place) for place in columns)
    if lateral or around:
        yield from (each(places, leg) for leg, places in of_leg.items() if len(places) == 2)
    if len(columns) > 1:
        if geometry.common_zero or not lateral:
            yield _grouped(effect, columns, "same", {"": tuple(columns)})
        if columns.keys() == geometry.across.keys():
            yield from _symmetric(effect, columns, geometry, mount)
        legs = [leg for leg, places in of_leg.items() if places]
        if not lateral or len(legs) > 1:
            complete = lateral and all(len(of_leg[leg]) == 2 for leg in legs)
            yield each(list(columns), ",".join(legs if complete else columns))


def _symmetric(
    effect: Effect, columns: dict[str, FloatArray], geometry: Geometry, mount: IntArray
) -> Iterator[Candidate]:
    """Two values that all drives share, as the machine is symmetric.

    Drives whose legs are read: each the mirror image of itself when two axes are exchanged; going
    round with the axes, towards the next one and the one before. Else radial and tangential, where
    it is seen: contacts with a plate do not show that all towers are turned alike.
    """
    first, second = tuple(columns)[0::2], tuple(columns)[1::2]
    if geometry.common_zero:
        yield _grouped(effect, columns, "mirror", {"_first": first, "_second": second})
        following = (first[0], second[1], first[2])
        exchanged = (second[0], first[1], second[2])
        yield _grouped(effect, columns, "turning", {"_next": following, "_before": exchanged})
        return
    groups = {"_r": first, "_t": second}
    alone = [_grouped(effect, columns, "turning", {end: group}) for end, group in groups.items()]
    visible = zip(groups.items(), _are_seen(mount, alone), strict=True)
    if groups_seen := {end: group for (end, group), is_seen in visible if is_seen}:
        yield _grouped(effect, columns, "turning", groups_seen)


def _one(effect: Effect, columns: dict[str, FloatArray], place: str) -> Candidate:
    return _grouped(effect, columns, "one", {"": (place,)}, place)


def _grouped(
    effect: Effect,
    columns: dict[str, FloatArray],
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
            [np.sum([columns[member] for member in places], axis=0) for places in groups.values()]
        ),
        shares=tuple(
            Share(effect, place, tuple(range(number * count, (number + 1) * count)))
            for number, places in enumerate(groups.values())
            for place in places
        ),
    )
