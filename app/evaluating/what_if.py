"""What an effect of a stated size would explain; nothing is looked for, its size is not fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.evaluating.own_effects import known_effects
from app.evaluating.solution import SessionSolution, solve_sessions
from calib.errors import UsageError
from calib.identify.identify import Subset
from calib.tripod.controller import tool_error_mm
from calib.tripod.effects.candidates import candidates
from calib.tripod.pipeline import Model
from protocols.observations import to_observations
from protocols.session import Session


@dataclass(frozen=True, eq=False)
class WhatIf:
    """``solved`` has the parameters fitted beside the effect ``id:where`` of these ``values``.

    ``tool_mm`` is what the effect by itself does at the tool if nobody compensates it, r.m.s. over
    the workspace.
    """

    effect: str
    values: tuple[float, ...]
    units: tuple[str, ...]
    solved: SessionSolution
    tool_mm: float


def what_if(
    names: Sequence[str],
    sessions: Sequence[Session],
    effect: str,
    values: Sequence[float],
    subset: Subset | None = None,
) -> WhatIf:
    """Solve with an effect (``id:where``) of these values, each in its own unit, held.

    Raises UsageError for an effect or place that these readings cannot show, and for another number
    of values than it has; NotIdentifiable as `solve_sessions`.
    """
    nominal = Model(sessions[0].opened.machine.geometry())
    known = candidates(nominal, to_observations(sessions), known_effects())
    wanted, _, where = effect.partition(":")
    of_it = [one for one in known if one.id == wanted]
    fitting = [one for one in of_it if one.where == where]
    if not fitting:
        places = [f"{one.id}:{one.where}" for one in of_it or known]
        raise UsageError("effect", repr(effect), ", ".join(places))
    chosen = next((one for one in fitting if len(one.parameters) == len(values)), None)
    if chosen is None:
        numbers = " or ".join(sorted({str(len(one.parameters)) for one in fitting}))
        raise UsageError(f"values of {effect}", f"{len(values)}", numbers)
    units = tuple(parameter.unit for parameter in chosen.parameters)
    held = chosen.effects(values)
    solved = solve_sessions(names, sessions, subset=subset, held=held)
    alone = tool_error_mm(nominal.with_effects(held))
    return WhatIf(effect, tuple(map(float, values)), units, solved, alone)
