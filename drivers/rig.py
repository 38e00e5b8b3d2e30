"""A simulated machine that moves, with indicators that answer over real serial connections."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Self

from drivers.profile import Profile, Spindle
from drivers.twin_port import Transport, TwinPort
from drivers.twins import twin_of

FAST_STREAM_S = 0.01
"""Pace of streaming devices in compressed time."""

PUSH_MM, PUSH_S = 1.0, 0.8
"""How far a hand pushes a spindle in, and how long."""


class SimulatedRig:
    """Indicators whose spindles glide to wherever the machine is sent.

    The rig knows nothing of machines: it is told where each spindle is to go. A motion takes
    ``motion_s`` and follows a smooth curve, so a reading taken too early is a moving one.
    ``fastest_stream`` compresses the time of devices that stream.
    """

    def __init__(
        self,
        profiles: Sequence[Profile],
        *,
        resolution_mm: float,
        transport: Transport,
        motion_s: float = 0.0,
        fastest_stream: bool = False,
    ) -> None:
        self._motion_s = motion_s
        self._lock = threading.Lock()
        self._start_mm = [0.0] * len(profiles)
        self._goal_mm = [0.0] * len(profiles)
        self._departed = -math.inf
        self._pushed = [-math.inf] * len(profiles)
        self._ports = [
            TwinPort(
                twin_of(profile, Spindle(self._spindle(k), resolution_mm)),
                transport,
                stream_s=FAST_STREAM_S if fastest_stream and profile.stream_s else profile.stream_s,
            )
            for k, profile in enumerate(profiles)
        ]

    @property
    def ports(self) -> tuple[str, ...]:
        """What a program opens to reach each indicator."""
        return tuple(port.url for port in self._ports)

    def go(self, goal_mm: Sequence[float]) -> None:
        """Send every spindle to a new position, in mm."""
        with self._lock:
            now = [self._position(k) for k in range(len(self._goal_mm))]
            self._start_mm, self._goal_mm = now, list(goal_mm)
            self._departed = time.monotonic()

    def push(self, index: int) -> None:
        """Push one spindle in and let it go, as a hand does; it reads larger meanwhile."""
        with self._lock:
            self._pushed[index] = time.monotonic()

    def close(self) -> None:
        """Unplug every indicator."""
        for port in self._ports:
            port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _spindle(self, index: int) -> Callable[[], float]:
        def position_mm() -> float:
            with self._lock:
                pushed = time.monotonic() - self._pushed[index] < PUSH_S
                return self._position(index) + PUSH_MM * pushed

        return position_mm

    def _position(self, index: int) -> float:
        elapsed = time.monotonic() - self._departed
        if elapsed >= self._motion_s:
            return self._goal_mm[index]
        share = (1.0 - math.cos(math.pi * elapsed / self._motion_s)) / 2.0
        start = self._start_mm[index]
        return start + share * (self._goal_mm[index] - start)
