"""Values for RepRapFirmware: lines M665 and M666 for ``config.g``.

A switch trips with the carriage at H + sqrt(L^2 - R^2) + M666. X, Y, Z of M665 turn the towers at
210, 330 and 90° anticlockwise, in degrees (LinearDeltaKinematics.cpp). H is the mean, so that the
corrections of M666 add up to nothing, as automatic calibration leaves them.
"""

from __future__ import annotations

from app.exports.towers import (
    USUAL_ANGLES_DEG,
    comments,
    drives_of_towers,
    endstops_now_mm,
    fitted,
)
from app.report.offsets import Offsets
from calib.arrays import LEG_NAMES
from protocols.files import Written

TOWERS = "XYZ"


def config_g(offsets: Offsets) -> Written:
    """One file. Raises as `drives_of_towers`, `endstops_now_mm` and `fitted`."""
    drives, now = drives_of_towers(offsets), endstops_now_mm(offsets)
    found = fitted(offsets)
    stops, towers = [found.endstops_mm(now)[drive] for drive in drives], found.towers
    height = sum(stops) / len(stops)
    held = [
        f"H + M666 of {name} (tower {LEG_NAMES[drive]}) {now[drive]:.6f} mm"
        for name, drive in zip(TOWERS, drives, strict=True)
    ]
    put = (
        "put these lines into config.g in the place of M665 and M666 there, each with the B that "
        "it has (radius of the bed; tilt, which must be A0 B0 now); take them out of "
        "config-override.g; then home. Saved by M500 they lose digits after the third"
    )
    turned = [
        f"{name}{(towers.angle_deg[drive] - usual + 180.0) % 360.0 - 180.0:z.6f}"
        for name, drive, usual in zip(TOWERS, drives, USUAL_ANGLES_DEG, strict=True)
    ]
    lengths = ":".join(f"{towers.length_mm[drive]:.6f}" for drive in drives)
    raised = [f"{name}{stop - height:z.6f}" for name, stop in zip(TOWERS, stops, strict=True)]
    lines = [f"; {line}" for line in comments(offsets, found, put, ", ".join(held))]
    lines.append(f"M665 L{lengths} R{towers.radius_mm:.6f} H{height:.6f} {' '.join(turned)}")
    lines.append(f"M666 {' '.join(raised)}")
    return {"": "\n".join(lines) + "\n"}
