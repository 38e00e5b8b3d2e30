"""The alias map of a procedure."""

from __future__ import annotations

from collections.abc import Sequence

from app.measuring.simulated import simulated_session
from calib.diagnosis.hypotheses import alias_map as compare
from calib.diagnosis.results import AliasMap
from calib.tripod.effects.effect import Effect
from calib.tripod.pipeline import Model
from protocols.machine import load_machine
from protocols.observations import to_observations
from protocols.procedure import load_procedure
from protocols.session import fold

TYPICAL_MM = (1.0, -0.8, 0.6, 0.03, -0.02, 0.01)
"""Some machine that is not perfect: effects that scale readings need readings to scale."""


def alias_map(
    procedure: str | None, effects: Sequence[Effect], machine_name: str | None = None
) -> AliasMap:
    """What this procedure cannot tell apart on a machine; None: the usual ones.

    Raises UsageError, RecordError.
    """
    machine = load_machine(machine_name)
    model = Model(machine.geometry(), TYPICAL_MM)
    opened, readings = simulated_session(
        load_procedure(procedure or machine.usual_procedure, machine.geometry()),
        machine,
        model,
        seed=1,
        scatter_mm=0.0,
        resolution_mm=0.0,
    )
    return compare(model, to_observations([fold([opened, *readings])]), effects)
