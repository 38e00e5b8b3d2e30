"""Across the thread line: that something was heard, from the threads of the indicators."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress


class News:
    """Wakes one task of the event loop, as rarely as its pictures allow."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._heard = asyncio.Event()
        self._first_at = 0.0

    def tell(self) -> None:
        """Something was heard and can be looked at; called in any thread."""
        if not self._heard.is_set():
            with suppress(RuntimeError):  # the loop has ended: nobody looks any more
                self._loop.call_soon_threadsafe(self._wake, time.monotonic())

    def _wake(self, at: float) -> None:
        if not self._heard.is_set():
            self._first_at = at
            self._heard.set()

    async def gathered(self, within_s: float) -> None:
        """Wait for news and until the first of them are so old; then what follows is news again."""
        await self._heard.wait()
        await asyncio.sleep(self._first_at + within_s - time.monotonic())
        self._heard.clear()
