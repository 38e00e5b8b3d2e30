"""A process beside the program: when that dies without a word, the machine is told to stop.

A dropped connection ends no move of a controller. Nobody but the operator ends what this process
cannot reach.
"""

from __future__ import annotations

import math
import sys

from drivers.motion import controller_of
from drivers.motion.controller import ControllerFault, Limits

NOWHERE = (math.nan, math.nan, math.nan)


def main() -> None:
    """Wait for ``bye`` or the end of the program that started this one."""
    guarded = controller_of(sys.argv[1], Limits(NOWHERE, NOWHERE, 0.0, 0.0))
    if sys.stdin.buffer.read().startswith(b"bye"):
        return
    try:
        guarded.stop()
    except ControllerFault as problem:
        sys.stderr.write(f"glidecal died and could not stop the machine: {problem}\n")
    finally:
        guarded.close()


if __name__ == "__main__":
    main()
