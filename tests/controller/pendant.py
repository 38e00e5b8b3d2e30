#!/usr/bin/python3
"""Stands in the place of LinuxCNC's screen: homes, moves as told, writes down where things are.

Runs under the system's Python, which has LinuxCNC's modules, and knows nothing of glidecal.
"""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path

import hal
import linuxcnc

command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()
component = hal.component("pendant")
component.ready()
WAIT_S = 20
REACHED_MM = 1e-6
AXES = "XYZABC"
STILL_PERIODS = 20
"""Of the servo thread, not of the clock: a busy machine may starve it, or who tells of it."""


def ask(_nothing: object) -> None:
    command.wait_complete(WAIT_S)


def wait_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + WAIT_S
    while time.monotonic() < end:
        status.poll()
        if condition():
            return
        time.sleep(0.01)
    raise TimeoutError("the controller does not get there")


def home() -> None:
    ask(command.mode(linuxcnc.MODE_MANUAL))
    ask(command.teleop_enable(0))
    command.home(-1)
    wait_for(lambda: all(status.homed[: status.joints]))
    time.sleep(0.1)


def in_mdi() -> bool:
    """Asked until it is so: a controller that just homed may not listen yet."""
    if status.task_mode != linuxcnc.MODE_MDI:
        ask(command.mode(linuxcnc.MODE_MDI))
        status.poll()
    return bool(status.task_mode == linuxcnc.MODE_MDI)


def move(words: str) -> None:
    wait_for(in_mdi)
    ask(command.mdi(words))
    matches = re.findall(rf"([{AXES}])(-?[0-9.]+)", words)
    coordinates = [(AXES.index(axis), float(value)) for axis, value in matches]

    def there() -> bool:
        """Idle and in position it is before it starts, too."""
        idle = status.interp_state == linuxcnc.INTERP_IDLE and status.inpos
        return idle and all(
            abs(status.position[k] - value) < REACHED_MM for k, value in coordinates
        )

    wait_for(there)


def at_rest() -> bool:
    """Nothing moves, and the status, which comes later than the pins, is of now."""
    count = range(status.joints)
    still = min(hal.get_value(f"rigjoint.{k}.still") for k in count)
    differences = [
        status.joint_actual_position[k] - hal.get_value(f"joint.{k}.pos-fb") for k in count
    ]
    return bool(still >= STILL_PERIODS and max(map(abs, differences)) < 1e-9)


def where() -> dict[str, list[float]]:
    wait_for(at_rest)
    return now()


def now() -> dict[str, list[float]]:
    count = range(status.joints)
    return {
        "tool": list(status.actual_position[: status.joints]),
        "joint": [hal.get_value(f"joint.{k}.pos-cmd") for k in count],
        "motor": [hal.get_value(f"joint.{k}.motor-pos-cmd") for k in count],
        "carriage": [hal.get_value(f"rigjoint.{k}.carriage") for k in count],
        "trim": [hal.get_value(f"joint.{k}.backlash-corr") for k in count],
    }


def main() -> None:
    steps = json.loads(Path("told.json").read_text())
    answer: dict[str, list[object]] = {"stops": [], "errors": []}
    try:
        ask(command.state(linuxcnc.STATE_ESTOP_RESET))
        ask(command.state(linuxcnc.STATE_ON))
        wait_for(lambda: status.task_state == linuxcnc.STATE_ON)
        for step in steps:
            home() if step == "home" else move(step)
            answer["stops"].append(where())
    except Exception as problem:  # whatever it is, the test shall read it
        answer["errors"] += [repr(problem), repr(now())]
    while (error := errors.poll()) is not None:
        answer["errors"].append(error[1])
    Path("answer.json").write_text(json.dumps(answer))


main()
sys.exit(0)
