"""What the owner of a printer with three upright towers changes, and what that brings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from app.evaluating.correction import CLEARLY_BETTER
from calib.arrays import LEG_NAMES
from calib.errors import GlidecalError, UsageError
from calib.tripod.geometry import FURTHEST_DEG, USUAL_ANGLES_DEG

if TYPE_CHECKING:
    from app.evaluating.correction import ControllerCorrections, TowerCorrection
    from calib.posterior.correction import LeftOut, ToolOff
    from protocols.machine import Machine
    from protocols.session import Reading

FIRMWARE_TOWERS = "abc"


def drives_of_towers(
    machine: Machine,
    angles_deg: Sequence[float] = USUAL_ANGLES_DEG,
    furthest_deg: float | None = None,
) -> list[int]:
    """The drive of each tower of the firmware: as the machine file's ``joints`` say, or nearest.

    Firmware turns its towers: stated ones may stand anywhere, unless within ``furthest_deg``.
    Raises UsageError where one stands elsewhere or counts downwards, ImpossibleRequest for another
    kind of machine.
    """
    from calib.tripod.towers import Towers  # of printers only

    stand = Towers.of(machine.geometry())
    apart = stand.apart_deg(angles_deg)
    names = machine.joints or tuple(LEG_NAMES[row.index(min(row))] for row in apart)
    drives = [LEG_NAMES.index(name[-1]) for name in names]
    far = max(row[drive] for row, drive in zip(apart, drives, strict=True))
    if furthest_deg is None:
        furthest_deg = FURTHEST_DEG if machine.joints is None else 180.0
    if far > furthest_deg or len(set(drives)) < len(drives) or any("-" in name for name in names):
        places = ", ".join(f"{angle:.2f}" for angle in stand.angle_deg.tolist())
        raise UsageError(
            f"towers of machine '{machine.name}'",
            f"joints {', '.join(names)}, drives x, y, z at {places}°",
            f"joints that count upwards, at {', '.join(f'{at:g}' for at in angles_deg)}° in their "
            f"order within {furthest_deg:g}°",
            "State joints in the machine file, or use another format.",
        )
    return drives


def tower_names(machine: Machine) -> dict[str, str]:
    """Name of the firmware's tower by drive; empty where the machine is none of a printer."""
    if machine.position_endstop_mm is None:
        return {}
    try:
        drives = drives_of_towers(machine)
    except GlidecalError:
        return {}
    return {LEG_NAMES[drive]: name for drive, name in zip(drives, FIRMWARE_TOWERS, strict=True)}


@dataclass(frozen=True)
class ValueChange:
    """A value now, and with all that is entered."""

    now: float
    then: float

    @property
    def change(self) -> float:
        """What is added."""
        return self.then - self.now


@dataclass(frozen=True)
class TowerChange:
    """What changes of one tower of the firmware: mm, the angle in degrees.

    ``travel`` is what its steps are held by, rotation_distance or steps per mm; None: it stays.
    """

    tower: str
    endstop: ValueChange
    arm: ValueChange
    angle: ValueChange
    travel: ValueChange | None


@dataclass(frozen=True, eq=False)
class PrinterChange:
    """All that changes, with the bound of the tool, and how even the plate is in the contacts.

    ``uneven_mm`` is the r.m.s. of heights about their mean, as they were probed and as the same
    probing would show them; None for a session that is not of contacts. ``scatter_mm`` is that of
    repeats, None without. ``left_out`` are parts that no entry takes. With ``turns`` travels are mm
    for a turn, else steps per mm.
    """

    towers: tuple[TowerChange, ...]
    radius: ValueChange
    off: ToolOff
    now_mm: float
    bound_mm: float
    uneven_mm: ValueChange | None
    scatter_mm: float | None
    left_out: tuple[LeftOut, ...]
    turns: bool = True

    @property
    def helps(self) -> bool:
        """Whether the values are worth entering.

        The tool is bounded clearly more closely and the plate no less even; or the plate, uneven
        beyond what the probe scatters, is clearly more even and the bound no larger, as what a
        plate does not show can keep it where it is.
        """
        share = self.bound_mm / self.now_mm
        if self.uneven_mm is None:
            return share < CLEARLY_BETTER
        even = self.uneven_mm.then / max(self.uneven_mm.now, LEAST)
        better = share if self.probe_limits else min(share, even)
        return max(share, even) < 1.0 and better < CLEARLY_BETTER

    @property
    def probe_limits(self) -> bool:
        """Whether heights of the plate differ hardly more than contacts at one place do."""
        if self.uneven_mm is None or not self.scatter_mm:
            return False
        return self.uneven_mm.now < BEYOND_NOISE * self.scatter_mm

    @property
    def endstops_alone(self) -> bool:
        """Whether lengths, radius and angles stay as they are."""
        changes = (
            self.radius,
            *(change for tower in self.towers for change in (tower.arm, tower.angle)),
        )
        return not self.travels and all(abs(change.change) < LEAST for change in changes)

    @property
    def travels(self) -> bool:
        """Whether what is held for the travel of towers changes."""
        return any(tower.travel for tower in self.towers)


BEYOND_NOISE = 2.0
"""Times the scatter of a contact: heights that differ by more are not of the probe alone."""

LEAST = 5e-4
"""A change of less is not shown, in mm and degrees."""


def printer_change(
    machine: Machine,
    corrections: ControllerCorrections,
    contacts: Sequence[Reading] = (),
    scatter_mm: float | None = None,
) -> PrinterChange | None:
    """What a printer's owner changes; None where the machine is none whose switches are stated.

    ``contacts`` are those that were taken; none of a session of readings. ``scatter_mm`` is that of
    their repeats, None without any.
    """
    if machine.position_endstop_mm is None:
        return None
    from calib.tripod.towers import ON_ONE_CIRCLE  # of printers only

    try:
        drives = drives_of_towers(machine)
        turns, steps = machine.rotation_distance_mm, machine.steps_per_mm
        best = corrections.of_towers(replace(ON_ONE_CIRCLE, travels=bool(turns or steps)))
    except GlidecalError:
        return None
    values, held_mm = best.values, machine.position_endstop_mm
    stops_mm = values.endstops_mm(held_mm)
    now, then = values.now, values.towers
    travels: list[ValueChange | None] = [None] * 3
    if values.stretch.any() and (travels_now := turns or steps):
        changed = values.stretch if turns else 1.0 / (1.0 + values.stretch) - 1.0
        parts = zip(travels_now, changed.tolist(), strict=True)
        travels = [
            ValueChange(value_now, value_now + value_now * part) for value_now, part in parts
        ]
    return PrinterChange(
        tuple(
            TowerChange(
                name,
                ValueChange(held_mm[drive], stops_mm[drive]),
                ValueChange(float(now.length_mm[drive]), float(then.length_mm[drive])),
                ValueChange(float(now.angle_deg[drive]), float(then.angle_deg[drive])),
                travels[drive],
            )
            for name, drive in zip(FIRMWARE_TOWERS, drives, strict=True)
        ),
        ValueChange(float(now.radius_mm[0]), float(then.radius_mm[0])),
        best.off,
        corrections.off_now.bound_in(corrections.frame),
        best.off.bound_in(corrections.frame),
        _uneven_mm(contacts, best),
        scatter_mm,
        best.left_out,
        turns is not None,
    )


def _uneven_mm(contacts: Sequence[Reading], best: TowerCorrection) -> ValueChange | None:
    """Unevenness of the most contacts of one way of measuring: others have their own zeros."""
    if not contacts:
        return None
    ((commonest, _),) = Counter(contact.mount for contact in contacts).most_common(1)
    alike = [
        (contact.position_mm, contact.value_mm)
        for contact in contacts
        if contact.mount == commonest and contact.position_mm is not None
    ]
    return ValueChange(*best.values.uneven_mm(*zip(*alike, strict=True)))
