#!/usr/bin/python3
"""Tells where LinuxCNC's joints are, as datagrams; does what is done at the machine by hand.

Runs under the system's Python, which has LinuxCNC's modules, and knows nothing of glidecal. Never
asks the text server anything: two clients that ask it often disturb each other, for it parses with
``strtok`` in threads. Told "on" it switches on and homes what is not homed, as from a screen beside
it; "estop" opens the chain of the emergency stop; "stuck" holds the first carriage.
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
told = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
told.setblocking(False)


def do(wish: bytes) -> None:
    if wish == b"estop":
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
    said = f"{' '.join(map(repr, joints))} {all(homed()):d} {bool(ready):d}"
    told.sendto(said.encode(), ("127.0.0.1", PORT))
    with contextlib.suppress(BlockingIOError):
        do(told.recv(100))
    time.sleep(EVERY_S)
