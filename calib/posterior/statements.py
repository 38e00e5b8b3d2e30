"""How much of a machine is as its file states it, and how likely: cases of the prior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from calib.tripod.effects.drives import ActuatorScale, AxisLean, AxisOffset, AxisSquareness
from calib.tripod.effects.gauges import BowOfTouchedPlate, PlatformTilt

OF_DIRECTIONS = (AxisLean.id, AxisSquareness.id, ActuatorScale.id)
OF_CONTACTS = (BowOfTouchedPlate.id, PlatformTilt.id)
"""A machine whose lines are as stated has a flat plate and a level platform, too."""


@dataclass(frozen=True)
class Statement:
    """What may be off by its tolerance; all else is as the file states it, but for what has a name.

    ``free`` are ids of laws of geometry. Of ``bars`` each may be off, or all alike, or none. Where
    the places of towers may be a guess they are ``guessed``. ``of_firmware``: only that is off
    which firmware of printers fits, or the plate is bowed, too.
    """

    name: str
    prior: float
    free: tuple[str, ...] = ()
    bars: Literal["each", "alike", "none"] = "each"
    guessed: bool = False
    of_firmware: bool = False


NOTHING = Statement("nothing", 0.25, (*OF_DIRECTIONS, AxisOffset.id, *OF_CONTACTS), guessed=True)
DIRECTIONS = Statement("directions", 0.19, (AxisOffset.id, *OF_CONTACTS))
AS_STATED = (
    NOTHING,
    DIRECTIONS,
    Statement("directions, plate, single bars", 0.06, (AxisOffset.id,), "alike", of_firmware=True),
    Statement("directions, plate, bars", 0.09, (AxisOffset.id,), "none", of_firmware=True),
    Statement("directions, bars", 0.03, (AxisOffset.id, *OF_CONTACTS), "none", of_firmware=True),
    Statement("lines", 0.35),
    Statement("lines, bars", 0.03, bars="none"),
)
"""Of a machine with tolerances of its lines.

Switches and where towers stand are what firmware fits, some with one length of all bars: contacts
that these explain to their noise are no reason to doubt all other parts. A plate may be bowed
there, too, which looks like a wrong radius.
"""
