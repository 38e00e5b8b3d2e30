"""Lines M665 and M666, which three firmwares read in three ways.

RepRapFirmware, Marlin and Smoothieware turn the towers that stand at 210, 330 and 90° anticlockwise
by degrees. A switch of RepRapFirmware trips at H + M666. In Marlin and Smoothieware the carriage is
taken to be at H (Z) once it stands M666 from its switch, which therefore trips at H - M666.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from app.evaluating.printer import drives_of_towers
from app.exports.towers import comments, endstops_now_mm, fitted
from app.report.offsets import Export, Offsets
from calib.arrays import LEG_NAMES
from calib.tripod.geometry import USUAL_ANGLES_DEG
from calib.tripod.towers import ALIKE_BARS, ON_ONE_CIRCLE, EnteredTowers, TowerEntries

TOWERS = "XYZ"

REPRAPFIRMWARE_PUT = (
    "put these lines into config.g in the place of M665 and M666 there, M665 with the B that it "
    "has (radius of the bed); take them out of config-override.g; then home. They end a tilt A B "
    "of M666, which import takes into account; other sessions are measured with A0 B0. Saved by "
    "M500 they lose digits after the third"
)
MARLIN_PUT = (
    "send these lines, then M500, then home. Marlin 2 that has M665 A B C (trims of the bars) is "
    "needed: M503 must show them after; older ones take B for another value. What M665 has "
    "beside these (S) stays. DELTA_RADIUS_TRIM_TOWER must be 0, 0, 0 in the configuration"
)
SMOOTHIEWARE_PUT = (
    "send these lines, then M500, then home. Older builds take F for H, the angle of the third "
    "tower. What M206 adds stays"
)


def config_g(offsets: Offsets) -> Export:
    """RepRapFirmware: lines for ``config.g``. Raises as `towers.printer_cfg`.

    H is the mean, so that the corrections of M666 add up to nothing, as automatic calibration
    leaves them.
    """

    def lines(values: EnteredTowers, drives: Sequence[int], stops: Sequence[float]) -> list[str]:
        height, towers = sum(stops) / len(stops), values.towers
        lengths = ":".join(f"{towers.length_mm[drive]:.6f}" for drive in drives)
        radius = float(towers.radius_mm[0])
        return [
            f"M665 L{lengths} R{radius:.6f} H{height:.6f} "
            f"{_words(TOWERS, turned_deg(values, drives))}",
            f"M666 {_words(TOWERS, [stop - height for stop in stops])} A0 B0",
        ]

    return _export(offsets, ON_ONE_CIRCLE, REPRAPFIRMWARE_PUT, "H + M666", lines)


def marlin(offsets: Offsets) -> Export:
    """Marlin: lines to send and to save. Raises as `config_g`.

    Trims of M666 must not be above 0: the carriage retraces from its switch by them. M665 takes two
    lines, because a line of it has 96 characters at most.
    """

    def lines(values: EnteredTowers, drives: Sequence[int], stops: Sequence[float]) -> list[str]:
        towers = values.towers
        # Marlin does not retrace by fewer than some steps: every trim is longer than these are
        height, length = min(stops) - 0.25, float(towers.length_mm.mean())
        trims = [float(towers.length_mm[drive]) - length for drive in drives]
        return [
            f"M665 L{length:.6f} R{float(towers.radius_mm[0]):.6f} H{height:.6f}",
            f"M665 {_words(TOWERS, turned_deg(values, drives))} {_words('ABC', trims)}",
            f"M666 {_words(TOWERS, [height - stop for stop in stops])}",
        ]

    return _export(offsets, ON_ONE_CIRCLE, MARLIN_PUT, "H - M666", lines)


def smoothieware(offsets: Offsets) -> Export:
    """Smoothieware: lines to send and to save.

    It has one length, and a radius for each tower. Raises as `config_g`, and UsageError where it
    holds unequal lengths now.
    """

    def lines(values: EnteredTowers, drives: Sequence[int], stops: Sequence[float]) -> list[str]:
        towers = values.towers
        height, radius = min(stops), float(towers.radius_mm.mean())
        further = [float(towers.radius_mm[drive]) - radius for drive in drives]
        return [
            f"M665 L{float(towers.length_mm[0]):.6f} R{radius:.6f} Z{height:.6f}",
            f"M665 {_words('ABC', further)} {_words('DEH', turned_deg(values, drives))}",
            f"M666 {_words(TOWERS, [height - stop for stop in stops])}",
        ]

    return _export(offsets, ALIKE_BARS, SMOOTHIEWARE_PUT, "Z - M666", lines)


def turned_deg(values: EnteredTowers, drives: Sequence[int]) -> list[float]:
    """How far each tower of the firmware is turned from its usual place, anticlockwise, degrees."""
    places = zip(drives, USUAL_ANGLES_DEG, strict=True)
    angles = values.towers.angle_deg
    return [(float(angles[drive]) - usual + 180.0) % 360.0 - 180.0 for drive, usual in places]


def _words(letters: str, values: Sequence[float]) -> str:
    return " ".join(f"{name}{value:z.6f}" for name, value in zip(letters, values, strict=True))


def _entries_now(entry: str, now: Sequence[float], drives: Sequence[int], unit: str = "mm") -> str:
    """The present entry of each tower, in the words of the firmware."""
    return "".join(
        f", {entry} of {name} (tower {LEG_NAMES[drive]}) {now[drive]:.6f} {unit}"
        for name, drive in zip(TOWERS, drives, strict=True)
    )


def _export(
    offsets: Offsets,
    entries: TowerEntries,
    instruction: str,
    entry: str,
    lines_of: Callable[[EnteredTowers, Sequence[int], Sequence[float]], list[str]],
) -> Export:
    """The lines for values, towers and heights of switches, below what is to be known of them.

    M92 is first: all lengths count from it.
    """
    drives, now = drives_of_towers(offsets.machine), endstops_now_mm(offsets)
    steps = offsets.machine.steps_per_mm
    offsets, values = fitted(offsets, entries, steps)
    controller_words = _entries_now(entry, now, drives)
    stops = values.endstops_mm(now)
    lines = lines_of(values, drives, [stops[drive] for drive in drives])
    if steps is not None and values.stretch.any():
        controller_words += _entries_now("M92", steps, drives, "steps per mm")
        a_step = values.turns_mm([1.0 / steps_of_tower for steps_of_tower in steps])
        lines = [f"M92 {_words(TOWERS, [1.0 / a_step[drive] for drive in drives])}", *lines]
    above = [f"; {line}" for line in comments(offsets, values, instruction, controller_words)]
    return Export({"": "\n".join([*above, *lines]) + "\n"}, offsets.cautions)
