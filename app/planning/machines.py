"""The machines by name: one function each, from a request to what can be planned for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from app.planning.request import Request
from calib.design.planning import PlannedMachine
from protocols.errors import UsageError
from protocols.machine_files import machine_names

if TYPE_CHECKING:
    from calib.tripod.planning import TripodPlanning
    from protocols.procedure import Procedure


def planned_machine(name: str, request: Request) -> PlannedMachine:
    """The machine of that name, or of a file. Raises UsageError for a name that is not known."""
    if name == "hexaslide":
        from app.planning.hexaslide import hexaslide_planning

        return hexaslide_planning(request)
    return of_three_drives(name, request)[0]


def of_three_drives(name: str, request: Request) -> tuple[TripodPlanning, Procedure]:
    """Such a machine with its procedure. Raises UsageError for a name that is not known."""
    from app.planning.tripod import tripod_planning

    names = (*machine_names(), "hexaslide")
    if name not in names and not Path(name).suffix and not Path(name).exists():
        listed = ", ".join(sorted(names))
        raise UsageError("machine", repr(name), f"{listed}, or the path of a machine file")
    own = (request.known, request.postures, request.posture_file)
    if request.measured or any(one is not None for one in own):
        raise UsageError(
            "--measured, --known, --postures and --posture-file",
            f"the machine {name}",
            "the machine hexaslide",
        )
    return tripod_planning(name, request)
