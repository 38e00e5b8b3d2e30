#!/usr/bin/python3
"""Tells where LinuxCNC's joints are, as datagrams; it never asks the text server anything.

Runs under the system's Python, which has LinuxCNC's modules, and knows nothing of glidecal. Two
clients that ask the text server often disturb each other: it parses with ``strtok`` in threads.
"""

from __future__ import annotations

import socket
import time

import hal

EVERY_S, PORT = 0.004, 5999

component = hal.component("teller")
component.ready()
told = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
while True:
    joints = [hal.get_value(f"joint.{k}.pos-fb") for k in range(3)]
    told.sendto(" ".join(map(repr, joints)).encode(), ("127.0.0.1", PORT))
    time.sleep(EVERY_S)
