"""The effect that a person wants hidden in a simulated machine, by its name and place."""

from __future__ import annotations

from collections.abc import Sequence

from calib.errors import UsageError
from calib.observations import TOOL, Conditions
from calib.tripod.effects.candidates import candidates
from calib.tripod.effects.effect import Effect, EffectInstance
from calib.tripod.effects.hidden import hidden_among
from calib.tripod.pipeline import Model


def hidden_effect(
    wanted: str,
    truth: Model,
    taken: Conditions,
    *,
    effects: Sequence[Effect],
    seed: int,
    noise_mm: float,
    size: float | None = None,
) -> tuple[EffectInstance, ...]:
    """The effect ``wanted`` (id, or id:where) for the machine ``truth``; see `hidden_among`.

    Raises UsageError where it is not known, or these readings cannot show it.
    """
    effect_id, _, where = wanted.partition(":")
    if effect_id not in {effect.id for effect in effects}:
        raise UsageError("effect", repr(effect_id), ", ".join(dict.fromkeys(x.id for x in effects)))
    of_it = [
        c for c in candidates(truth, taken, effects) if c.id == effect_id and "," not in c.where
    ]
    if not of_it:
        raise _not_seen(effect_id, taken)
    here = [c for c in of_it if where in ("", c.where)]
    if not here:
        places = ", ".join(dict.fromkeys(c.where for c in of_it))
        raise UsageError(f"place of effect {effect_id}", repr(where), places)
    found = hidden_among(here, truth, taken, seed=seed, noise_mm=noise_mm, size=size)
    if not found:
        raise _not_seen(wanted, taken)
    return found


def _not_seen(effect: str, taken: Conditions) -> UsageError:
    return UsageError(
        f"effect {effect}",
        "nothing to see of it beside offsets and lengths with this procedure",
        "a procedure that shows it",
        "Give --size." if TOOL in taken.leg else "Try --protocol two-station, or give --size.",
    )
