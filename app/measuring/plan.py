"""What is to be measured: anew, going on, once more, after an export, or with rails aligned."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Literal

from app.evaluating.comparison import partner_of
from app.evaluating.solution import SessionSolution, solve_files
from app.measuring.indicators import SIMULATED, from_file, this_computer
from app.measuring.simulated import BenchSettings
from calib.errors import RecordError, UsageError
from calib.tripod.alignment import RailMoved, Shim, misaligned
from protocols.files import reason_of, unused_path
from protocols.machine import Instrument, Machine
from protocols.motion import timed
from protocols.procedure import ALL_AXES, Leg, Procedure
from protocols.record import read_record
from protocols.session import Changed, Opened

SIMULATED_INTERVAL_S, QUICK_INTERVAL_S = 0.05, 0.01
"""Simulated indicators may be asked faster than real ones, and faster still where nobody looks;
without any pause they take the processor from all the rest."""


@dataclass(frozen=True)
class Plan:
    """Everything known before the first reading.

    ``before`` is the solution whose offsets this session verifies, ``verifies`` its file name.
    ``continued``: the record is there and goes on. With ``reference`` the rails are aligned to that
    one between rounds of measuring. ``motion`` names the controller that moves the machine;
    with ``by_itself`` a simulated machine is moved, by a simulated controller or a real LinuxCNC.
    ``prove``: it proves itself again, though it did once.
    """

    path: Path
    machine: Machine
    procedure: Procedure
    instruments: tuple[Instrument, ...]
    operator: str = ""
    temperature_c: float | None = None
    note: str = ""
    seed: int = 1
    before: SessionSolution | None = None
    verifies: str | None = None
    continued: bool = False
    bench: BenchSettings = BenchSettings()
    interval_s: float = SIMULATED_INTERVAL_S
    window_s: float | None = None
    reference: Leg | None = None
    motion: str | None = None
    by_itself: Literal["twin", "linuxcnc"] | None = None
    prove: bool = False

    def __post_init__(self) -> None:
        """Against a plate, or over planes alone, the first indicator reads that may along it.

        Steps take as long as the machine needs where it moves itself.
        """
        if not self.procedure.levels:
            instruments = self.procedure.indicators_used(self.instruments)
            object.__setattr__(self, "instruments", instruments)
        if self.motion and not self.continued:
            machine_time = timed(self.procedure, self.machine, self.axes)
            object.__setattr__(self, "procedure", machine_time)

    @property
    def simulated(self) -> bool:
        """The machine and its indicators are simulated."""
        return all(instrument.port == SIMULATED for instrument in self.instruments)

    @property
    def axes(self) -> tuple[str, ...]:
        """For each indicator the directions it may measure along."""
        return tuple(instrument.axes for instrument in self.instruments)


class PortsUnknown(UsageError):
    """The ports of a record are those of another computer."""


def plan_to_continue(
    path: Path, instruments: tuple[Instrument, ...] = (), *, whole: bool = False
) -> Plan:
    """The plan of an interrupted session, on the same indicators unless others are named.

    Of a ``whole`` one that more set-ups follow. Raises RecordError where the record is altered,
    closed or imported, PortsUnknown where it is of another computer and no indicators are named.
    """
    record = read_record(path)
    opened = record.opened
    if (record.end == "closed" and not whole) or opened.procedure is None:
        kind = "a closed session" if opened.procedure else "an imported table"
        raise RecordError(f"session {path}", kind, "an interrupted session to continue")
    if instruments and [i.axes for i in instruments] != [i.axes for i in opened.instruments]:
        axes = " and ".join(f"@{i.axes}" for i in opened.instruments)
        raise UsageError("indicators of a continued session", "other axes", axes)
    instruments_known = instruments or _known_here(path, opened)
    plan = replace(_planned(path, opened, opened.procedure, instruments_known), continued=True)
    return aligning(plan, opened.aligned_to) if opened.aligned_to else plan


def plan_to_repeat(path: Path) -> Plan | None:
    """The plan of a finished session, as it can be measured once more.

    None for an imported table, and where its ports are those of another computer. Raises
    RecordError where the record is altered.
    """
    opened = read_record(path).opened
    if opened.procedure is None or not opened.instruments:
        return None
    try:
        instruments = _known_here(path, opened)
    except (UsageError, RecordError):
        return None
    return _planned(path, opened, opened.procedure, instruments)


def _planned(
    path: Path, opened: Opened, procedure: Procedure, instruments: tuple[Instrument, ...]
) -> Plan:
    verified = partner_of(path, opened.verifies)
    return Plan(
        path=path,
        machine=opened.machine,
        procedure=procedure,
        instruments=instruments,
        operator=opened.operator,
        temperature_c=opened.temperature_c,
        seed=opened.seed or 0,
        before=solve_files([verified]) if verified else None,
        verifies=opened.verifies,
    )


def _known_here(path: Path, opened: Opened) -> tuple[Instrument, ...]:
    """The indicators of a record, if its ports mean anything here."""
    instruments = from_file(opened.instruments, f"session {path}")
    simulated = all(instrument.port == SIMULATED for instrument in instruments)
    if not simulated and opened.computer != this_computer():
        anew = " ".join(f"--indicator PROFILE:PORT@{i.axes}" for i in instruments)
        raise PortsUnknown(
            f"session {path}",
            "ports that were not named on this computer",
            f"its indicators named again: {anew}",
            "A machine file with [[indicator]] does it too: --machine FILE.",
        )
    return instruments


def aligning(plan: Plan, reference: Leg) -> Plan:
    """The plan with its rails aligned between rounds; a simulated machine's are off.

    What the record says was moved is moved. Raises RecordError.
    """
    if not plan.simulated:
        return replace(plan, reference=reference)
    changes = read_record(plan.path).session.changes if plan.continued else ()
    moved = [
        _rail_moved(change, plan.machine.rails_rest_mm())
        for change in changes
        if change.support_mm is not None  # else it was only begun
    ]
    effects = (*misaligned(plan.machine.geometry(), plan.seed), *moved)
    return replace(plan, reference=reference, bench=replace(plan.bench, effects=effects))


def _rail_moved(change: Changed, supports_mm: tuple[float, float]) -> RailMoved:
    """A recorded move of one end, as a simulated machine makes it."""
    low, high = supports_mm
    at_mm = change.support_mm or low
    moved_mm = change.asked_mm if change.moved_mm is None else change.moved_mm
    rail, towards = (
        ALL_AXES.index(letter) for letter in (change.rail or "x", change.towards or "y")
    )
    shim = Shim(rail, towards, at_mm, high if at_mm == low else low, 0.0, 0.0)
    return RailMoved.by_shim(shim, moved_mm or 0.0)


def verification_plan(plan: Plan, result: SessionSolution) -> Plan:
    """The plan of the same procedure after the offsets were entered in the controller."""
    offsets_mm = result.joint_offsets_mm
    entered = [
        old + new for old, new in zip(plan.machine.entered_offsets_mm, offsets_mm, strict=True)
    ]
    home_mm = plan.machine.home_at_mm()
    home = home_mm and [old + new for old, new in zip(home_mm, offsets_mm, strict=True)]
    machine: Machine = plan.machine.model_copy(
        update={
            "adjusted": result.sessions[0].adjusted,
            "entered_offsets_mm": tuple(entered),
            "home_offset_mm": tuple(home) if home else None,
            "position_endstop_mm": None,
        }
    )
    path = unused_path(plan.path.with_name(plan.path.stem + "_verify.jsonl"))
    if "joint-offsets" not in result.choice.refused:  # what was entered, whatever was looked at
        result = result.with_subset("joint-offsets")
    return replace(
        plan,
        path=path,
        machine=machine,
        before=result,
        verifies=plan.path.name,
        note="",
        continued=False,
    )


def session_name(folder: Path, word: str) -> Path:
    """A new file name with date and time."""
    plain = re.sub(r"[^\w-]+", "-", word)[:40]
    return unused_path(folder / f"{datetime.now():%Y-%m-%d_%H%M%S}_{plain}.jsonl")


def writable_folder(folder: Path) -> Path:
    """The folder, made where it is missing. Raises RecordError where that is impossible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise RecordError(
            f"folder {folder}", allowed="a folder with write permission", reason=reason_of(problem)
        ) from problem
    return folder
