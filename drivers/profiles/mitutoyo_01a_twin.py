"""The simulated device behind the ``01A`` frames."""

from __future__ import annotations

import math
from collections.abc import Callable


class MitutoyoTwin:
    """Answers ``1`` + CR with the spindle's position, as the interface does."""

    def __init__(self, position_mm: Callable[[], float], resolution_mm: float) -> None:
        self._position_mm = position_mm
        self._decimals = max(1, -math.floor(math.log10(resolution_mm)))
        self._resolution_mm = resolution_mm
        self._received = b""

    def receive(self, request: bytes) -> bytes:
        """One frame for each whole request; an incomplete request is kept."""
        self._received += request
        *whole, self._received = self._received.split(b"\r")
        return b"".join(self._frame() if line == b"1" else b"" for line in whole)

    def _frame(self) -> bytes:
        steps = round(self._position_mm() / self._resolution_mm)
        value = steps * self._resolution_mm
        sign = "-" if steps < 0 else "+"
        return f"01A{sign}{abs(value):08.{self._decimals}f}\r".encode("ascii")
