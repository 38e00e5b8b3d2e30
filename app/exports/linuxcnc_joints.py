"""What [JOINT_n] sections of LinuxCNC are told of a model: HOME_OFFSET, BACKLASH or COMP_FILE.

``HOME_OFFSET`` is the joint coordinate of the home switch, so new = old + e(switch, direction of
latching), e being true - believed place of the carriage. A table is read in coordinates that are
believed once that is entered, and BACKLASH is not looked at beside one: play goes into it.
"""

from __future__ import annotations

from dataclasses import dataclass

from app.exports.linuxcnc_ini import ControllerJoint
from calib.errors import ImpossibleRequest
from calib.tripod.controller import NOTHING_MM, Table, carriage_errors_mm, table_of
from calib.tripod.pipeline import Model

PLAY_ALONE_MM = 2e-4
"""A table whose columns differ by play alone, within this, is BACKLASH."""


@dataclass(frozen=True)
class JointEntries:
    """Entries of one joint, mm; ``home_change_mm`` is what HOME_OFFSET grows by."""

    joint: int
    home_change_mm: float
    backlash_mm: float = 0.0
    table: Table | None = None


def joint_entries(model: Model, joint: int, held: ControllerJoint) -> JointEntries:
    """Entries of a joint that now holds this. Raises ImpossibleRequest for what it cannot take."""
    table = table_of(model, joint)
    if table is None:
        return JointEntries(joint, model.parameters_mm[joint])
    if (table.error_down_mm - table.error_up_mm).min() < -NOTHING_MM:
        raise ImpossibleRequest(
            f"play of joint {joint}",
            f"{(table.error_down_mm - table.error_up_mm).min():+.4f} mm",
            "play that is not negative",
            "Take the effect out of the model: glidecal model --remove.",
        )
    if held.absolute_encoder:
        change = model.parameters_mm[joint]  # nothing is absorbed by homing
    else:
        change = carriage_errors_mm(model, held.home_offset_mm, held.latch_sign or 1)[joint]
    play = float(table.error_down_mm.mean())
    if max(abs(table.error_up_mm).max(), abs(table.error_down_mm - play).max()) < PLAY_ALONE_MM:
        return JointEntries(joint, change, backlash_mm=play)
    return JointEntries(joint, change, table=table)


def table_text(table: Table, mm_per_unit: float = 1.0) -> str:
    """A COMP_FILE of type 1: believed coordinate, what is added to the motor up and down.

    Numbers alone: LinuxCNC takes no heading, and stops at the first line that it cannot read.
    """
    rows = zip(table.joint_mm, table.error_up_mm, table.error_down_mm, strict=True)
    return "".join(
        f"{q / mm_per_unit:.6f} {-up / mm_per_unit:.6f} {-down / mm_per_unit:.6f}\n"
        for q, up, down in rows
    )
