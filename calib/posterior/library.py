"""What may be true of a machine: every effect at its places, laws without a name, something else.

A component has a normal prior for each of its sizes, of which one unit is a size that nobody would
remark on, times one of a few scales (`SCALES`). Its log prior says how likely it is among others:
first kinds, then effects, then places and arrangements.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Conditions, FloatArray, IntArray, numbered, rows_of
from calib.tripod.effects import BESIDE_CATALOGUE, CATALOGUE
from calib.tripod.effects.candidates import (
    AXES,
    Candidate,
    Share,
    axes_together,
    candidates_together,
)
from calib.tripod.effects.drives import (
    ISO_LEADS_MM,
    ActuatorCyclic,
    StraightnessOfFourthOrder,
    effects_of,
)
from calib.tripod.effects.effect import Effect, EffectInstance, Kind, Placed
from calib.tripod.effects.empirical import BASES, Coupling, Empirical, Repeating
from calib.tripod.effects.gauges import BowOfTouchedPlate, PlatformTilt
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model, Stage

ELSE = "something_else"
"""The name of an error of each posture's own, smooth along the travel."""

OTHER_BARS = "other_bars"
"""The name of bars of other lengths in a session than in the first."""

SMOOTH_MM = 40.0
"""How far along the travel an error of each posture's own is alike."""

ELSE_UNIT_MM = 0.003
"""R.m.s. of something else that nobody would remark on, in the readings."""

SIDED = 0.3
"""Share of the square of that error which depends on the side of approach."""

LEAST_SQUARE = 1e-2
"""Directions of that error of less than a tenth of its size show nothing."""

ALL = "all"

PRIOR_OF_OTHER_BARS = 0.003
"""Of a session, as of any mistake of its labels."""

SHARES = {"named": 0.67, "beside": 0.06, "nameless": 0.15, ELSE: 0.12}
"""Of the prior of a single component. Something else stands against names that are put together,
three of which fit nearly any shape."""


@dataclass(frozen=True, eq=False)
class Component:
    """One thing that may be true.

    ``unit`` ``(r,)`` are unremarkable sizes of its values. ``candidate`` knows its places; None for
    something else and for other bars. ``squares`` ``(r,)`` are mean squares over the readings of
    one mm of each value, where there are no laws that act at the tool.
    """

    id: str
    where: str
    kind: str
    unit: FloatArray
    candidate: Candidate | None
    log_prior: float = 0.0
    squares: FloatArray | None = None

    @property
    def shares(self) -> tuple[Share, ...]:
        """Laws at places, and which of the values act there."""
        return self.candidate.shares if self.candidate else ()

    @property
    def at_one_place(self) -> Placed | None:
        """The law of a component that acts at a single place, and where; None of others."""
        if self.candidate is None or self.candidate.arrangement != "one":
            return None
        (share,) = self.shares
        return share.effect, share.place

    def effects(self, values: FloatArray) -> tuple[EffectInstance, ...]:
        """The effects of these values ``(r,)``; none of a component without laws."""
        return self.candidate.effects(values) if self.candidate else ()


def other_bars(number: int, tolerance_mm: FloatArray) -> Component:
    """Bars of other lengths in the session of this number, mm; ``tolerance_mm`` ``(3,)``."""
    log_prior = math.log(PRIOR_OF_OTHER_BARS)
    return Component(OTHER_BARS, f"session {number + 1}", "mistake", tolerance_mm, None, log_prior)


STATED_ONLY = frozenset({BowOfTouchedPlate.id, PlatformTilt.id})
"""What is looked for where the machine file has its tolerance: a bowed plate and a wrong radius
together explain a wrong distance between marks."""

POWERS = tuple(name for name, basis in BASES.items() if basis.stage == Stage.ACTUATOR)
OF_READING = tuple(name for name, basis in BASES.items() if basis.stage == Stage.READING)[:4]


def laws(geometry: Geometry, effects: Sequence[Effect] = CATALOGUE) -> tuple[Effect, ...]:
    """The effects to name, those beside them, laws without a name; as they are on this machine."""
    nameless: tuple[Effect, ...] = (
        *(Empirical((name,)) for name in POWERS),
        Empirical(POWERS),
        Empirical(OF_READING),
        StraightnessOfFourthOrder(),
        Coupling(),
    )
    further = (effect for effect in BESIDE_CATALOGUE if effect.id not in STATED_ONLY)
    return effects_of(dict.fromkeys((*effects, *further, *nameless)), geometry)


def library(
    sessions: Sequence[tuple[Model, Conditions]],
    effects: Sequence[Effect] | None = None,
    beyond: Mapping[Effect, float] | None = None,
    placed: Sequence[Mapping[Placed, FloatArray]] | None = None,
) -> list[Component]:
    """Components that these sessions can show; ``effects`` in place of the catalogue.

    ``beyond`` are tolerances of parameters beyond which they have a name: they are its unit.
    ``placed`` are `placed_columns` of each session by all `laws` where they are known.
    """
    tolerances = beyond or {}
    effects = CATALOGUE if effects is None else effects
    ids = {effect.id for effect in effects} - STATED_ONLY
    components = []
    geometry = sessions[0][0].geometry
    travel_mm = max(geometry.travel_max_mm, -geometry.travel_min_mm)
    candidates = candidates_together(sessions, laws(geometry, effects), placed)
    for candidate in (*candidates, *_one_way(candidates)):
        nameless = candidate.kind == Kind.EMPIRICAL or candidate.id == "straightness_fourth"
        if nameless and candidate.arrangement != "one":
            continue
        kind = "nameless" if nameless else "named" if candidate.id in ids else "beside"
        unit = np.array([parameter.unit_over(travel_mm) for parameter in candidate.parameters])
        tolerances_of_shares = [
            tolerances[s.effect] for s in candidate.shares if s.effect in tolerances
        ]
        if math.inf in tolerances_of_shares:
            continue
        unit = np.maximum(unit, max(tolerances_of_shares, default=0.0))
        components.append(Component(candidate.id, candidate.where, kind, unit, candidate))
    components += _axes_together(components)
    components.append(Component(ELSE, "all", ELSE, np.full(1, ELSE_UNIT_MM), None))
    return _with_priors(components)


def _axes_together(components: Sequence[Component]) -> list[Component]:
    """All axes out of square and shifted at once, each as it likes: as a frame is assembled."""
    together = axes_together([c.candidate for c in components if c.candidate])
    if together is None:
        return []
    union, pair = together
    unit = np.concatenate([c.unit for c in components if c.candidate in pair])
    return [Component(union.id, union.where, "named", unit, union)]


def _one_way(candidates: Sequence[Candidate]) -> Iterator[Candidate]:
    """Candidates across one direction of a drive where they have a value in each of both.

    A guide that is bent one way only would pay for the size of the other.
    """
    free_laws = {
        (s.effect, s.place)
        for candidate in candidates
        if candidate.arrangement == "one"
        for s in candidate.shares
    }
    for candidate in candidates:
        if candidate.arrangement != "each" or "," in candidate.where:
            continue
        for share in candidate.shares:
            if (share.effect, share.place) not in free_laws:
                values = list(share.values)
                yield replace(
                    candidate,
                    where=share.place,
                    arrangement="one",
                    parameters=share.effect.parameters,
                    columns=candidate.columns[:, values],
                    shares=(replace(share, values=tuple(range(len(values)))),),
                )


SORTS = {"one": 0.60, "same": 0.32, "each": 0.08}
"""Of the prior of an effect: at one place, alike everywhere, at several places with their own."""


LEADS_APART = 36
"""Leads, and other periods, that readings over a travel of 160 mm tell apart."""

OTHER_LEAD = 0.08
"""How likely a lead that was searched is beside one of ISO 3408-2. A fifth of drives may have such
a lead, the best of `LEADS_APART`; eleven leads of the standard share the rest."""


def _share_of_search(component: Component) -> float:
    """Share of a component among those of its effect: 1 but where a lead or period was searched."""
    laws = {s.effect for s in component.shares}
    if any(isinstance(law, Repeating) for law in laws):
        return 1.0 / LEADS_APART
    leads = {law.lead_mm for law in laws if isinstance(law, ActuatorCyclic)}
    return OTHER_LEAD if leads.difference(ISO_LEADS_MM) else 1.0


def _sort(component: Component) -> str:
    if "," in component.where or component.where == AXES:
        return "each"
    return "same" if component.where == ALL else "one"


def _with_priors(components: Sequence[Component]) -> list[Component]:
    """Each kind has its share, spread over ids, then over sorts of places, then over these.

    Laws without a name are terms of one series and count as one id.
    """
    keys = [
        (component.kind, "" if component.kind == "nameless" else component.id)
        for component in components
    ]
    ids = Counter(kind for kind, _ in set(keys))
    places: dict[tuple[str, str, str], float] = defaultdict(float)
    for key, component in zip(keys, components, strict=True):
        places[*key, _sort(component)] += _share_of_search(component)
    weighted = []
    for key, component in zip(keys, components, strict=True):
        sort, sorts = _sort(component), math.fsum(p for s, p in SORTS.items() if places[*key, s])
        prior = SHARES[component.kind] / ids[component.kind] * SORTS[sort] / sorts
        prior *= _share_of_search(component) / places[*key, sort]
        weighted.append(replace(component, log_prior=math.log(prior)))
    return weighted


def something_else(conditions: Conditions) -> FloatArray:
    """Columns ``(n, r)`` of an error of each posture's own, 1 mm r.m.s.; smooth along the travel.

    A share of its square, `SIDED`, is another from each side of approach; what a first take has of
    its own is a mistake.
    """
    side = numbered(conditions.approach, *conditions.movement.T)
    cell = numbered(
        conditions.leg, conditions.axis, conditions.level, *conditions.position_mm.T, side
    )
    first = np.unique(cell, return_index=True)[1]
    blocks = []
    for rows in rows_of(numbered(conditions.leg[first], conditions.axis[first])):
        square, axes = np.linalg.eigh(_alike(conditions.take(first[rows]), side[first[rows]]))
        visible = square > LEAST_SQUARE
        blocks.append(np.zeros((len(first), int(visible.sum()))))
        blocks[-1][rows] = axes[:, visible] * np.sqrt(square[visible])
    columns = np.hstack(blocks)
    # one that nobody saw reached lies between its sides: else every first take would be explained
    place = numbered(conditions.leg, conditions.axis, conditions.level, *conditions.position_mm.T)[
        first
    ]
    with_approach = conditions.approach_known[first]
    for row in np.flatnonzero(~with_approach):
        sides = with_approach & (place == place[row])
        if sides.any():
            columns[row] = columns[sides].mean(axis=0)
    return np.asarray(columns[cell])


def _alike(conditions: Conditions, side: IntArray) -> FloatArray:
    """How alike errors of postures of one mounting are ``(n, n)``."""
    apart = conditions.displacement_mm[:, None] - conditions.displacement_mm
    far = ((conditions.position_mm[:, None] - conditions.position_mm) ** 2).sum(axis=-1)
    alike = np.exp(-(apart**2 + far) / (2.0 * SMOOTH_MM**2))
    return np.asarray(alike * np.where(side[:, None] == side, 1.0, 1.0 - SIDED))
