"""What exports for upright towers share: which drive, what is held now, what is said."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from app.exports.linuxcnc import known_lines, origin, refuse_what_is_ambiguous, short_lines
from app.report.offsets import Offsets
from calib.arrays import LEG_NAMES, FloatArray
from calib.errors import UsageError
from calib.tripod.pipeline import Model
from calib.tripod.towers import LEAST_MM, Entered, Towers, each_alone, entered

USUAL_ANGLES_DEG = (210.0, 330.0, 90.0)
"""Of the first, second and third tower of printers, from x, anticlockwise."""

FURTHEST_DEG = 30.0
"""A tower that stands further from the firmware's place for it is another one."""


def drives_of_towers(
    offsets: Offsets,
    angles_deg: Sequence[float] = USUAL_ANGLES_DEG,
    furthest_deg: float = FURTHEST_DEG,
) -> list[int]:
    """The drive of each tower of the firmware: as the machine file's ``joints`` say, or nearest.

    Raises UsageError where one stands elsewhere or counts downwards, ImpossibleRequest for another
    kind of machine.
    """
    stand = Towers.of(offsets.machine.geometry())
    apart = stand.apart_deg(angles_deg)
    named = offsets.machine.joints or tuple(LEG_NAMES[row.index(min(row))] for row in apart)
    drives = [LEG_NAMES.index(name[-1]) for name in named]
    far = max(row[drive] for row, drive in zip(apart, drives, strict=True))
    if far > furthest_deg or len(set(drives)) < len(drives) or any("-" in name for name in named):
        raise UsageError(
            f"towers of machine '{offsets.machine.name}'",
            f"joints {', '.join(named)}, drives x, y, z at {_three(stand.angle_deg, 2)}°",
            f"joints that count upwards, at {', '.join(f'{at:g}' for at in angles_deg)}° in their "
            f"order within {furthest_deg:g}°",
            "State joints in the machine file, or use another format.",
        )
    return drives


def endstops_now_mm(offsets: Offsets) -> list[float]:
    """Heights of the tool at which the switches of drives x, y, z trip now, mm.

    Raises UsageError where nobody stated them.
    """
    held = offsets.controller
    if held is None:
        raise UsageError(
            "present heights of the switches",
            "none stated",
            "position_endstop_mm in the machine file, or --endstops X,Y,Z: Klipper's "
            "position_endstop; of RepRapFirmware H plus M666",
        )
    joints = [name.lower() for name in held.axes or "XYZ"]
    home = [held.joints[joints.index(name)].home_offset_mm for name in LEG_NAMES]
    zero = offsets.machine.geometry().zero_mm.tolist()
    return [at - below for at, below in zip(home, zero, strict=True)]


def fitted(offsets: Offsets) -> Entered:
    """Values of firmware that holds each bar and tower. Raises UsageError for what is not sure."""
    refuse_what_is_ambiguous(offsets)
    return entered(offsets.model, each_tower=True)


def comments(
    offsets: Offsets, found: Entered, put: str, holds: str, *, each_tower: bool = True
) -> list[str]:
    """What stands above the values: where they go, what they are for, what they leave, cautions."""
    said = [*origin(offsets), put, *_for(found, holds)]
    said += _left(offsets.model, found, each_tower=each_tower)
    for name, one in offsets.parameters.items():
        said += known_lines(name, one, lacks_fit=offsets.lacks_fit)
    return [line for text in (*said, *offsets.cautions) for line in short_lines(text)]


def _for(found: Entered, holds: str) -> Iterator[str]:
    now = found.now
    yield (
        f"made for a controller that now holds radius {now.radius_mm:.3f} mm, lengths of the bars "
        f"{_three(now.length_mm)} mm, towers at {_three(now.angle_deg)}°, {holds}; if it "
        "holds others, these values are wrong"
    )
    yield (
        f"tool error over the workspace, if the model is right: {found.before_mm:.4f} mm r.m.s. "
        f"now, {found.after_mm:.4f} mm with these values"
    )
    x, y, z = found.at_zero_mm.tolist()
    if max(abs(x), abs(y), abs(z)) >= LEAST_MM:
        yield (
            f"the tool sent to Zero then stands at ({x:+.4f}, {y:+.4f}, {z:+.4f}) mm: errors count "
            "from there"
        )


def _left(model: Model, found: Entered, *, each_tower: bool) -> Iterator[str]:
    """Which parts the values hold, and what they leave of each of the others by itself."""
    alone = dict(each_alone(model, each_tower=each_tower))
    held = [name for name, left_mm in alone.items() if left_mm < LEAST_MM]
    if held:
        yield f"wholly in these values: {', '.join(held)}"
    short = {name: mm for name, mm in alone.items() if mm >= LEAST_MM}
    if short:
        shown = ", ".join(f"{name} leaves {mm:.4f} mm" for name, mm in short.items())
        yield (
            f"not wholly: the firmware has no value for all of {', '.join(short)}. By itself "
            f"{shown}, together {found.after_mm:.4f} mm r.m.s. at the tool"
        )


def _three(values: FloatArray, decimals: int = 3) -> str:
    return ", ".join(f"{value:.{decimals}f}" for value in values.tolist())
