#!/usr/bin/python3
"""Tells where LinuxCNC's joints are, as datagrams; does what is done at the machine by hand.

Runs under the system's Python, which has LinuxCNC's modules, and knows nothing of glidecal. Never
asks the text server anything: two clients that ask it often disturb each other, for it parses with
``strtok`` in threads. Told "on" it switches on and homes what is not homed, as from a screen beside
it; "estop" opens the chain of the emergency stop; "stuck" holds the first carriage. What a screen
or a panel beside the program does: "mdi LINE", "manual", "auto", "unhome", "override SHARE",
"jog SPEED", "hold 1" or "hold 0" at the pin of a feed hold.
"""

from __future__ import annotations

import contextlib
import socket
import time

import hal
import linuxcnc

EVERY_S, PORT = 0.004, 5999

component = hal.component("teller")
component.newpin("chain", hal.HAL_BIT, hal.HAL_OUT)
component["chain"] = True
component.ready()
reporter = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
reporter.setblocking(False)


def beside(what: str, how: str) -> None:
    """As a screen beside the program does it."""
    command = linuxcnc.command()
    if what == "mdi":
        command.mode(linuxcnc.MODE_MDI)
        command.wait_complete(1.0)
        command.mdi(how)
    elif what == "override":
        command.feedrate(float(how))
    elif what == "hold":
        hal.set_p("motion.feed-hold", how)
    else:
        command.mode(linuxcnc.MODE_AUTO if what == "auto" else linuxcnc.MODE_MANUAL)
        command.wait_complete(1.0)
        if what == "unhome":
            command.teleop_enable(0)
            command.wait_complete(1.0)
            command.unhome(1)
        elif what == "jog":
            command.teleop_enable(1)
            command.wait_complete(1.0)
            command.jog(linuxcnc.JOG_INCREMENT, 0, 0, float(how), 3.0)


def do(wish: bytes) -> None:
    what, _, how = wish.decode().partition(" ")
    if what in ("mdi", "manual", "auto", "unhome", "override", "jog", "hold"):
        beside(what, how)
    elif wish == b"estop":
        component["chain"] = False
    elif wish == b"stuck":
        hal.set_p("rigjoint.0.stuck", "1")
    else:
        component["chain"] = True
        hal.set_p("rigjoint.0.stuck", "0")
        command = linuxcnc.command()
        command.state(linuxcnc.STATE_ESTOP_RESET)
        command.wait_complete(5.0)
        command.state(linuxcnc.STATE_ON)
        command.wait_complete(5.0)
        if not all(homed()):
            command.mode(linuxcnc.MODE_MANUAL)
            command.wait_complete(5.0)
            command.teleop_enable(0)
            command.wait_complete(5.0)
            command.home(-1)


def homed() -> list[bool]:
    return [bool(hal.get_value(f"joint.{k}.homed")) for k in range(3)]


while True:
    joints = [hal.get_value(f"joint.{k}.pos-fb") for k in range(3)]
    ready = all(homed()) and hal.get_value("motion.motion-enabled")
    report = f"{' '.join(map(repr, joints))} {all(homed()):d} {bool(ready):d}"
    reporter.sendto(report.encode(), ("127.0.0.1", PORT))
    with contextlib.suppress(BlockingIOError):
        do(reporter.recv(100))
    time.sleep(EVERY_S)
