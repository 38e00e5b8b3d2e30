"""Controllers that move the machine: ``linuxcnc:HOST:PORT`` and ``grbl:PORT``.

May import all of `drivers`; indicators know nothing of it.
"""

from __future__ import annotations

from calib.errors import UsageError
from drivers.motion.controller import Controller, ControllerFault, Limits, MotionFault
from drivers.motion.grbl import Grbl
from drivers.motion.linuxcnc import LinuxCnc

CONTROLLERS: dict[str, type[Controller]] = {kind.name: kind for kind in (LinuxCnc, Grbl)}


def check_controller(endpoint: str) -> None:
    """Raises UsageError where the endpoint is not ``NAME:ADDRESS`` of a known controller."""
    name, _, address = endpoint.partition(":")
    if name not in CONTROLLERS or not address:
        forms = " or ".join(f"{kind.name}:{kind.form}" for kind in CONTROLLERS.values())
        raise UsageError("--motion", repr(endpoint), forms)


def controller_of(endpoint: str, limits: Limits) -> Controller:
    """The controller that ``NAME:ADDRESS`` names, not yet connected.

    Raises as `check_controller`, `ControllerFault` for coordinates that it does not take.
    """
    check_controller(endpoint)
    name, _, address = endpoint.partition(":")
    kind = CONTROLLERS[name]
    if kind.coordinates not in (None, limits.coordinates):
        raise ControllerFault(
            MotionFault.STRANGER,
            f"machine behind {name}",
            f'mdi = "{limits.coordinates}" in the machine file',
            f'mdi = "{kind.coordinates}": {name} moves carriages and has no tool coordinates',
        )
    return kind(address, limits)
