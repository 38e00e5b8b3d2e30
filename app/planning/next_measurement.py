"""The next measurement worth making, from sessions and files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from app.evaluating.own_effects import known_effects
from app.evaluating.solution import indicator_figures, load_sessions
from app.measuring.simulated import simulated_session
from app.planning.tripod import stated_noise
from calib.diagnosis.hypotheses import alias_map as compare
from calib.diagnosis.results import AliasMap
from calib.errors import UsageError
from calib.identify.next_mounting import (
    MINUTES_PER_MOUNTING,
    NextMountings,
    Proposal,
    next_mountings,
)
from calib.tripod.effects.effect import Effect
from calib.tripod.pipeline import Model
from protocols.data_table import DataTable
from protocols.machine import Machine, load_machine
from protocols.model_file import read_model
from protocols.observations import to_observations
from protocols.procedure import load_procedure
from protocols.session import Session, fold

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True)
class NextMeasurement:
    """What is worth measuring after these sessions."""

    sessions: tuple[str, ...]
    machine: str
    found: NextMountings
    warnings: tuple[str, ...]

    @property
    def best(self) -> Proposal:
        """The measurement that is proposed."""
        return self.found.proposals[0]

    def table(self) -> DataTable:
        """Every set-up that was judged, the best first."""
        names = ("leg", "station", "displacements_mm", "minutes", "tool_mm")
        rows = [
            (
                one.leg,
                one.station,
                ", ".join(f"{mm:g}" for mm in one.displacements_mm),
                one.minutes,
                one.tool_mm,
            )
            for one in self.found.proposals
        ]
        return DataTable(names, tuple(rows))

    def to_frame(self) -> DataFrame:
        """`table` for pandas. Raises UsageError where that is not installed."""
        return self.table().to_frame()


def next_measurement(
    sessions: Sequence[Path] = (),
    *,
    machine_file: Path | str | None = None,
    model_file: Path | None = None,
    noise_mm: float | None = None,
    minutes_per_mounting: float = MINUTES_PER_MOUNTING,
) -> NextMeasurement:
    """As `next_after`, of files, with their warnings. Raises RecordError for those, too."""
    folded, warnings = load_sessions(sessions)
    found = next_after(
        [path.name for path in sessions],
        folded,
        machine_file=machine_file,
        model_file=model_file,
        noise_mm=noise_mm,
        minutes_per_mounting=minutes_per_mounting,
    )
    return replace(found, warnings=tuple(warnings))


def next_after(
    names: Sequence[str],
    folded: Sequence[Session],
    *,
    machine_file: Path | str | None = None,
    model_file: Path | None = None,
    noise_mm: float | None = None,
    minutes_per_mounting: float = 2.0,
) -> NextMeasurement:
    """Judge every mounting with two or three displacements on top of the sessions.

    Before any reading the parameters are known to the tolerances of the machine file. Raises
    UsageError for files that do not fit each other.
    """
    machine, model = _machine_and_model(folded, machine_file, model_file)
    found = next_mountings(
        model,
        machine.tolerances_mm(),
        stated_noise(machine, noise_mm),
        minutes_per_mounting,
        to_observations(folded) if folded else None,
        indicator_figures(folded) if folded and noise_mm is None else None,
    )
    return NextMeasurement(
        sessions=tuple(names),
        machine=machine.name,
        found=found,
        warnings=(),
    )


def _machine_and_model(
    sessions: Sequence[Session], machine_file: Path | str | None, model_file: Path | None
) -> tuple[Machine, Model]:
    if model_file and machine_file:
        raise UsageError("--model and --machine", "both", "one: a model brings its own machine")
    model, machine = (
        read_model(model_file, known_effects())
        if model_file
        else (None, load_machine(machine_file))
    )
    if sessions:
        own = sessions[0].opened.machine
        if (model_file or machine_file) and own.geometry() != machine.geometry():
            raise UsageError(
                "machine of the sessions",
                f"'{own.name}', other dimensions than '{machine.name}'",
                "a machine or model file of the same machine, or none",
            )
        machine = own
    of_tool = any(r.position_mm is not None for one in sessions for r in one.readings)
    if of_tool or not machine.geometry().orthogonal:
        raise UsageError(
            "glidecal plan",
            f"readings of the tool, or the machine '{machine.name}'",
            "readings of legs, on drives that are square to each other",
            "glidecal identifiability tells what a procedure of your own would see.",
        )
    return machine, model or Model(machine.geometry())


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
