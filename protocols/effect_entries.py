"""Effects as they stand in a model file, and as the simulation takes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import AwareDatetime, Field

from calib.observations import TOOL, conditions
from calib.orthoglide.effects.catalogue import laws_of
from calib.orthoglide.effects.empirical import BASES, EMPIRICAL, empirical_law
from calib.orthoglide.effects.kinds import EffectParameter
from calib.orthoglide.effects.law import Law, Placed
from calib.orthoglide.geometry import Geometry
from protocols.documents import Document, Name
from protocols.errors import RecordError

Value = Annotated[float, Field(ge=-1e9, le=1e9)]


class ParameterEntry(Document):
    """One value, and the places that share it.

    ``of`` is the name of the parameter in the catalogue where the key is another; without
    ``places`` it acts where the effect does, with ``where = "all"`` at every place.
    """

    value: Value
    unit: Name
    standard_uncertainty: Annotated[Value, Field(ge=0.0)] | None = None
    of: Name | None = None
    places: tuple[Name, ...] = ()


class Provenance(Document):
    """Which sessions an effect was found in: names, digests, when, and the verdict."""

    sessions: tuple[Name, ...]
    digests: tuple[Name, ...] = ()
    found: AwareDatetime | None = None
    verdict: Name = ""


class EffectEntry(Document):
    """One adopted effect: its name in the catalogue, where it acts, its parameters."""

    id: Name
    where: Name
    title: Name = ""
    parameters: dict[Name, ParameterEntry]
    provenance: Provenance | None = None


def effect_entry(
    where: str,
    placed: Sequence[Placed],
    uncertainties: Mapping[str, tuple[float, float | None]] | None = None,
    provenance: Provenance | None = None,
) -> EffectEntry:
    """The entry of an effect that acts at several places, all of one law.

    ``uncertainties`` gives for each parameter its value and standard uncertainty, under names such
    as ``shift_xy`` that begin with the catalogue's. Places of equal value share one parameter.
    Raises RecordError for a complex value.
    """
    law = placed[0].law
    known = dict(uncertainties or {})
    found: dict[str, ParameterEntry] = {}
    for one in placed:
        for parameter, value in zip(law.parameters, one.values, strict=True):
            name = _name(parameter.name, _real(law, value), known, one.place, placed)
            places = (*found[name].places, one.place) if name in found else (one.place,)
            found[name] = ParameterEntry(
                value=_real(law, value),
                unit=parameter.unit,
                standard_uncertainty=known[name][1] if name in known else None,
                of=parameter.name,
                places=places,
            )
    return EffectEntry(
        id=law.id, where=where, title=law.title, parameters=found, provenance=provenance
    )


def _name(
    base: str,
    value: float,
    known: Mapping[str, tuple[float, float | None]],
    place: str,
    placed: Sequence[Placed],
) -> str:
    """The stated name of this value, else the catalogue's with the place where there are more."""
    stated = [
        name
        for name, (known_value, _) in known.items()
        if (name == base or name.startswith(base + "_")) and known_value == value
    ]
    own = f"{base}_{place}"
    if own in stated or not stated:
        return own if len(placed) > 1 else base
    return stated[0]


def _real(law: Law, value: float | complex) -> float:
    if isinstance(value, complex):
        raise RecordError(f"effect {law.id}", f"the value {value}", "real numbers in a model file")
    return float(value)


def placed_effects(
    entry: EffectEntry, laws: Sequence[Law], geometry: Geometry, thing: str
) -> tuple[Placed, ...]:
    """The entry for the simulation; ``thing`` begins the message of an error.

    Raises RecordError for an effect, parameter, unit or place that is not known.
    """
    law = _law_of(entry, laws, geometry, thing)
    values: dict[str, dict[str, float]] = {}
    for name, parameter in entry.parameters.items():
        base = parameter.of or name
        _check_unit(law, base, parameter, f"{thing}, {entry.id}, {name}")
        for place in _places(entry, parameter, law, geometry, thing):
            values.setdefault(place, {})[base] = parameter.value
    names = [parameter.name for parameter in law.parameters]
    for place, given in values.items():
        if set(given) != set(names):
            raise RecordError(
                f"{thing}, {entry.id} at {place}", ", ".join(given), " and ".join(names)
            )
    return tuple(
        Placed(law, place, tuple(given[name] for name in names)) for place, given in values.items()
    )


def _law_of(entry: EffectEntry, laws: Sequence[Law], geometry: Geometry, thing: str) -> Law:
    """The variant of the law that has these parameters."""
    if entry.id == EMPIRICAL:
        return _unnamed_law(entry, thing)
    variants = [law for law in (*laws_of(laws, geometry), *laws) if law.id == entry.id]
    if not variants:
        raise RecordError(
            f"{thing}, effect",
            repr(entry.id),
            ", ".join(dict.fromkeys(law.id for law in laws)),
            "An effect of your own must be in the folder of own effects, see docs/effects.md.",
        )
    named = {parameter.of or name for name, parameter in entry.parameters.items()}
    fitting = [law for law in variants if named == {p.name for p in law.parameters}]
    if not fitting:
        allowed = [" and ".join(p.name for p in law.parameters) for law in variants]
        raise RecordError(
            f"{thing}, parameters of {entry.id}",
            ", ".join(sorted(named)) or "none",
            ", or ".join(dict.fromkeys(allowed)),
        )
    return fitting[0]


def _unnamed_law(entry: EffectEntry, thing: str) -> Law:
    """The law of these bases; it is not in the catalogue, for it is the name of nothing."""
    named = [parameter.of or name for name, parameter in entry.parameters.items()]
    law = empirical_law(named)
    if law is None:
        raise RecordError(
            f"{thing}, parameters of {EMPIRICAL}",
            ", ".join(dict.fromkeys(named)) or "none",
            ", ".join(BASES),
        )
    return law


def _check_unit(law: Law, base: str, given: ParameterEntry, thing: str) -> None:
    known: dict[str, EffectParameter] = {p.name: p for p in law.parameters}
    if given.unit != known[base].unit:
        raise RecordError(f"{thing}, unit", repr(given.unit), known[base].unit)


def _places(
    entry: EffectEntry, parameter: ParameterEntry, law: Law, geometry: Geometry, thing: str
) -> tuple[str, ...]:
    legs = ([0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]) if geometry.orthogonal else ([], [])
    at = [*legs[0], TOOL, TOOL, TOOL], [*legs[1], 0, 1, 2]
    known = law.places(conditions(*at, np.zeros(len(at[0])).tolist()))
    every = known if entry.where == "all" else (entry.where,)
    wanted = parameter.places or every
    unknown = [place for place in wanted if place not in known]
    if unknown:
        raise RecordError(f"{thing}, place of {entry.id}", ", ".join(unknown), ", ".join(known))
    return wanted
