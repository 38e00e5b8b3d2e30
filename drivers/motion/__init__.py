"""Controllers that move the machine: ``linuxcnc:HOST:PORT`` and ``grbl:PORT``.

May import all of `drivers`; indicators know nothing of it.
"""

from __future__ import annotations

from calib.errors import UsageError
from drivers.motion.controller import Controller, ControllerFault, Limits, MotionFault
from drivers.motion.grbl import Grbl
from drivers.motion.linuxcnc import LinuxCnc

CONTROLLERS: dict[str, type[Controller]] = {kind.name: kind for kind in (LinuxCnc, Grbl)}


def controller_of(words: str, limits: Limits) -> Controller:
    """The controller that ``NAME:ADDRESS`` names, not yet connected.

    Raises UsageError for an unknown one, `ControllerFault` for coordinates that it does not take.
    """
    name, _, address = words.partition(":")
    if name not in CONTROLLERS or not address:
        allowed = " or ".join(f"{kind.name}:{kind.form}" for kind in CONTROLLERS.values())
        raise UsageError("--motion", repr(words), allowed)
    kind = CONTROLLERS[name]
    if kind.coordinates not in (None, limits.coordinates):
        raise ControllerFault(
            MotionFault.STRANGER,
            f"machine behind {name}",
            f'mdi = "{limits.coordinates}" in the machine file',
            f'mdi = "{kind.coordinates}": {name} moves carriages and knows no tool',
        )
    return kind(address, limits)
