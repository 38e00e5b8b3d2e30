"""What may be true of a machine: every effect at its places, laws without a name, something else.

A component has a normal prior for each of its sizes, of which one unit is a size that nobody would
remark on, times one of a few scales (`SCALES`). Its log prior says how likely it is among others:
first kinds, then effects, then places and arrangements.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import LEG_NAMES, Conditions, FloatArray, numbered
from calib.tripod.effects import BESIDE_CATALOGUE, CATALOGUE
from calib.tripod.effects.candidates import Candidate, Share, candidates_together
from calib.tripod.effects.drives import StraightnessOfFourthOrder, effects_of
from calib.tripod.effects.effect import Effect, EffectInstance, Kind
from calib.tripod.effects.empirical import BASES, Coupling, Empirical
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model, Stage

ELSE = "something_else"
"""The name of an error of each posture's own, smooth along the travel."""

SMOOTH_MM = 40.0
"""How far along the travel an error of each posture's own is alike."""

ELSE_UNIT_MM = 0.003
"""R.m.s. of something else that nobody would remark on, in the readings."""

SHARES = {"named": 0.70, "beside": 0.08, "nameless": 0.17, ELSE: 0.05}
"""Of the prior of a single component; docs/decisions/0016."""


@dataclass(frozen=True, eq=False)
class Component:
    """One thing that may be true.

    ``unit`` ``(r,)`` are unremarkable sizes of its values. ``candidate`` knows its places; None for
    something else.
    """

    id: str
    where: str
    kind: str
    unit: FloatArray
    candidate: Candidate | None
    log_prior: float = 0.0

    @property
    def shares(self) -> tuple[Share, ...]:
        """Laws at places, and which of the values act there."""
        return self.candidate.shares if self.candidate else ()

    @property
    def law(self) -> str:
        """What shares a prior: the id, of what has no name what it does."""
        if self.kind != "nameless":
            return self.id
        effect = self.shares[0].effect
        return f"{type(effect).__name__} at {effect.stage}"

    def with_width(self, count: int) -> Component:
        """The same with so many values of one size."""
        return replace(self, unit=np.full(count, self.unit[0]))

    @property
    def named(self) -> bool:
        """Whether it has a name that a mechanic can act on."""
        return self.kind in ("named", "beside")


POWERS = tuple(
    name for name, basis in BASES.items() if basis.stage == Stage.ACTUATOR and basis.power
)
OF_READING = tuple(name for name, basis in BASES.items() if basis.stage == Stage.READING)[:4]


def laws(geometry: Geometry) -> tuple[Effect, ...]:
    """Every law that the library knows, as it is on this machine."""
    nameless: tuple[Effect, ...] = (
        *(Empirical((name,)) for name in POWERS),
        Empirical(POWERS),
        Empirical(OF_READING),
        StraightnessOfFourthOrder(),
        Coupling(),
    )
    return effects_of((*CATALOGUE, *BESIDE_CATALOGUE, *nameless), geometry)


def library(
    sessions: Sequence[tuple[Model, Conditions]], effects: Sequence[Effect] | None = None
) -> list[Component]:
    """Components that these sessions can show; ``effects`` in place of the catalogue to name."""
    geometry = sessions[0][0].geometry
    known = {effect.id for effect in (CATALOGUE if effects is None else effects)}
    every = (*laws(geometry), *effects_of(effects, geometry)) if effects else laws(geometry)
    found = []
    for candidate in candidates_together(sessions, tuple(dict.fromkeys(every))):
        nameless = candidate.kind == Kind.EMPIRICAL or candidate.id == "straightness_fourth"
        if nameless and not at_one_place(candidate):
            continue
        kind = "nameless" if nameless else "named" if candidate.id in known else "beside"
        unit = np.array([parameter.tolerance for parameter in candidate.parameters])
        found.append(Component(candidate.id, candidate.where, kind, unit, candidate))
    found += _axes_together(found)
    found.append(Component(ELSE, "all", ELSE, np.full(1, ELSE_UNIT_MM), None))
    return _with_priors(found)


def at_one_place(candidate: Candidate) -> bool:
    """Whether a law acts at one place; both directions across a drive are one."""
    return candidate.arrangement == "one" or candidate.where in LEG_NAMES


def _axes_together(every: Sequence[Component]) -> list[Component]:
    """All axes out of square and shifted at once, each as it likes: as a frame is assembled."""
    each = [
        candidate
        for one in every
        if (candidate := one.candidate)
        and one.id in ("axis_squareness", "axis_offset")
        and candidate.arrangement == "each"
        and len(candidate.parameters) == 3
    ]
    if len(each) != 2:
        return []
    first, second = each
    width = len(first.parameters)
    moved = (replace(s, values=tuple(width + k for k in s.values)) for s in second.shares)
    parameters = (*first.parameters, *second.parameters)
    both = Candidate(
        "axis_squareness",
        "the axes are not square and miss each other",
        first.kind,
        "axes",
        "each",
        parameters,
        np.hstack([first.columns, second.columns]),
        (*first.shares, *moved),
    )
    unit = np.array([parameter.tolerance for parameter in parameters])
    return [Component(both.id, both.where, "named", unit, both)]


def _with_priors(every: Sequence[Component]) -> list[Component]:
    """Each kind has its share, spread over laws, then over places together or apart, then places.

    Laws without a name are sorted by what they move and how, since they share one id.
    """
    keys = [(one.kind, one.law, one.where == "all") for one in every]
    laws = Counter(kind for kind, _ in {key[:2] for key in keys})
    sorts = Counter(key[:2] for key in set(keys))
    places = Counter(keys)
    return [
        replace(
            one,
            log_prior=float(np.log(SHARES[key[0]] / laws[key[0]] / sorts[key[:2]] / places[key])),
        )
        for one, key in zip(every, keys, strict=True)
    ]


def something_else(taken: Conditions) -> FloatArray:
    """Columns ``(n, r)`` of an error of each posture's own, 1 mm r.m.s., smooth along travel."""
    place = numbered(taken.leg, taken.axis, taken.level, *taken.position_mm.T)
    first = np.unique(place, return_index=True)[1]
    same = (taken.leg[first][:, None] == taken.leg[first]) & (
        taken.axis[first][:, None] == taken.axis[first]
    )
    apart = taken.displacement_mm[first][:, None] - taken.displacement_mm[first]
    far = ((taken.position_mm[first][:, None] - taken.position_mm[first]) ** 2).sum(axis=-1)
    alike = same * np.exp(-(apart**2 + far) / (2.0 * SMOOTH_MM**2))
    square, axes = np.linalg.eigh(alike)
    kept = square > 1e-9
    return np.asarray((axes[:, kept] * np.sqrt(square[kept]))[place])


def instances(component: Component, values: FloatArray) -> tuple[EffectInstance, ...]:
    """The effects of these values ``(r,)``."""
    return component.candidate.effects(values) if component.candidate else ()
