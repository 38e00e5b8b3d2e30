"""Values for Klipper: a file to include at the end of ``printer.cfg``.

``position_endstop`` is the tool's height over the middle where a switch trips; the carriage is
then higher by sqrt(arm_length^2 - delta_radius^2). Of a key that is there twice the last counts
(klippy/kinematics).
"""

from __future__ import annotations

from app.exports.towers import comments, drives_of_towers, endstops_now_mm, fitted
from app.report.offsets import Offsets
from calib.arrays import LEG_NAMES
from protocols.files import Written

STEPPERS = "abc"


def printer_cfg(offsets: Offsets) -> Written:
    """One file. Raises as `drives_of_towers`, `endstops_now_mm` and `fitted`."""
    drives, now = drives_of_towers(offsets), endstops_now_mm(offsets)
    found = fitted(offsets)
    stops = found.endstops_mm(now)
    steppers = [
        f"stepper_{name} (tower {LEG_NAMES[drive]}) position_endstop {now[drive]:.6f} mm"
        for name, drive in zip(STEPPERS, drives, strict=True)
    ]
    put = (
        "put '[include FILE]' with the name of this file at the end of printer.cfg, where it wins "
        "over what stands above and over saved values; then home. Later saved calibrations are "
        "refused while it is included"
    )
    lines = [f"# {line}" for line in comments(offsets, found, put, ", ".join(steppers))]
    lines += ["[printer]", f"delta_radius: {found.towers.radius_mm:.6f}"]
    for name, drive in zip(STEPPERS, drives, strict=True):
        lines += [
            f"[stepper_{name}]",
            f"position_endstop: {stops[drive]:.6f}",
            f"arm_length: {found.towers.length_mm[drive]:.6f}",
            f"angle: {found.towers.angle_deg[drive]:.6f}",
        ]
    return {"": "\n".join(lines) + "\n"}
