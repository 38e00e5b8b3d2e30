"""Controllers that move the machine: ``linuxcnc:HOST:PORT`` and ``grbl:PORT``.

May import all of `drivers`; indicators know nothing of it.
"""

from __future__ import annotations

from calib.errors import UsageError
from drivers.motion.controller import Controller, Limits
from drivers.motion.grbl import Grbl
from drivers.motion.linuxcnc import LinuxCnc

CONTROLLERS: dict[str, type[Controller]] = {one.name: one for one in (LinuxCnc, Grbl)}


def controller_of(told: str, limits: Limits) -> Controller:
    """The controller that ``NAME:ADDRESS`` names, not yet connected. Raises UsageError."""
    name, _, address = told.partition(":")
    if name not in CONTROLLERS or not address:
        allowed = " or ".join(f"{one.name}:{one.form}" for one in CONTROLLERS.values())
        raise UsageError("--motion", repr(told), allowed)
    return CONTROLLERS[name](address, limits)
