"""Ill controllers: behind a port that lies, lags, babbles, garbles, drops and refuses.

The twin stays the honest machine; `Front` listens in its place (a socket, or a pseudo-terminal for
grbl) and applies ills (`ills`) to the bytes of both directions, each from a moment of its own.
What happened to the axes is recorded exactly, apart from what anybody reports: `TrueAxes`.
"""

from __future__ import annotations

import contextlib
import math
import os
import random
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from drivers.motion.controller import Triple
from drivers.motion.twins import Client
from drivers.twins import Disconnected, Transport
from tests.drivers.motion.twins import (
    FailingAxes,
    FailingLinuxCnc,
    GrblTwin,
    MotionTwin,
)

FULL = 1 << 15
"""Bytes that wait for a slow reader; a device that babbles writes no more than a port takes."""


class TrueAxes(FailingAxes):
    """Axes that remember every way they went, and when."""

    def __init__(self, at_mm: Triple) -> None:
        self.ways: list[tuple[float, Triple, Triple, float, bool]] = []
        self.by_itself = False
        super().__init__(at_mm)
        self._remember()

    def go(self, to_mm: Triple, feed_mm_min: float) -> None:
        super().go(to_mm, feed_mm_min)
        self._remember()

    def stop(self) -> None:
        super().stop()
        self._remember()

    def freeze(self) -> None:
        super().freeze()
        self._remember()

    def jog(self, to_mm: Triple, feed_mm_min: float) -> None:
        """Somebody else moves it."""
        self.by_itself = True
        self.go(to_mm, feed_mm_min)
        self.by_itself = False

    def _remember(self) -> None:
        now_s = time.monotonic()
        self.ways.append((now_s, self.from_mm, self.to_mm, self.way_s, self.by_itself))

    def _way(self, at_s: float) -> tuple[float, Triple, Triple, float, bool]:
        return next((way for way in reversed(self.ways) if way[0] <= at_s), self.ways[0])

    def place(self, at_s: float) -> Triple:
        """Where it was at a moment."""
        began_s, start, end, way_s, _ = self._way(at_s)
        fraction = min(1.0, (at_s - began_s) / way_s) if way_s > 0.0 else 1.0
        x, y, z = (a + fraction * (b - a) for a, b in zip(start, end, strict=True))
        return x, y, z

    def moved(self, from_s: float, to_s: float, *, jogs: bool = True) -> float:
        """For how long it moved between two moments, by others or not, s."""
        ends = [way[0] for way in self.ways[1:]] + [math.inf]
        total_s = 0.0
        for (began_s, start, end, way_s, by_itself), next_s in zip(self.ways, ends, strict=True):
            if start != end and (jogs or not by_itself):
                last_s = min(began_s + way_s, next_s, to_s)
                total_s += max(0.0, last_s - max(began_s, from_s))
        return total_s


@dataclass
class Link:
    """One client of a front."""

    number: int
    client: Client = field(default_factory=Client)
    received: bytes = b""
    inward: deque[tuple[float, bytes]] = field(default_factory=deque)
    outward: deque[tuple[float, bytes]] = field(default_factory=deque)
    sent: int = 0


class Ill:
    """One thing that is wrong, from ``begins_s`` for ``lasts_s``; nothing by itself."""

    false_place = False
    """Whether it reports consistently that the machine is where it is not: nobody can tell."""
    deaf = False
    """Whether what is sent may not reach the machine, or not whole."""
    chatty = False
    """Whether it sends what nobody asked for."""

    def __init__(self, generator: random.Random, begins_s: float, lasts_s: float) -> None:
        self.generator = generator
        self.begins_s, self.lasts_s = begins_s, lasts_s
        self.choose()

    def choose(self) -> None:
        """What it is like this time."""

    def __repr__(self) -> str:
        skipped = ("generator", "begins_s", "lasts_s")
        traits = [f"{k}={v!r}" for k, v in vars(self).items() if k not in skipped]
        words = ", ".join(traits)[:120]
        return f"{type(self).__name__}({words}) {self.begins_s:.2f}+{self.lasts_s:.2f}"

    def hears(self, front: Front, link: Link, content: bytes) -> bytes:
        """What the machine hears of what was sent."""
        return content

    def tells(self, front: Front, link: Link, answer: bytes) -> bytes:
        """What is sent of what the machine answers."""
        return answer

    def delay_s(self) -> float:
        """How late this answer is."""
        return 0.0

    def acts(self, front: Front) -> None:
        """Done again and again while it lasts."""


class Front:
    """The port at which a twin is reached, with its ills; everything in one thread."""

    def __init__(
        self,
        name: str,
        ills: list[Ill],
        axes: TrueAxes,
        transport: Transport = "tcp",
        make: Callable[[FailingAxes], MotionTwin] | None = None,
    ) -> None:
        self.name, self.ills, self.axes = name, ills, axes
        self.twin: MotionTwin
        if make is not None:
            self.twin = make(axes)
        else:
            self.twin = FailingLinuxCnc(axes) if name == "linuxcnc" else GrblTwin(axes, "tcp")
        self.heard: list[tuple[float, bytes]] = []
        """All that was sent, whether the machine heard it or not."""
        self.changes: list[tuple[float, str]] = []
        """What others changed, and when."""
        self.links: list[Link] = []
        self._ends, self._count = False, 0
        self._began_s = time.monotonic()
        self._ports: dict[int, socket.socket] = {}
        self._server: socket.socket | None = None
        if transport == "pty":
            import tty

            self._near_end, self._far_end = os.openpty()
            tty.setraw(self._far_end)
            os.set_blocking(self._near_end, False)
            self.links.append(Link(0))
            self.endpoint = f"{name}:{os.ttyname(self._far_end)}"
        else:
            self._server = socket.create_server(("127.0.0.1", 0))
            port = self._server.getsockname()[1]
            scheme = "" if name == "linuxcnc" else "socket://"
            self.endpoint = f"{name}:{scheme}127.0.0.1:{port}"
        self._thread = threading.Thread(
            target=self._serve, name=f"front {self.endpoint}", daemon=True
        )
        self._thread.start()

    def active(self) -> list[Ill]:
        """What is wrong now."""
        now_s = time.monotonic() - self._began_s
        return [ill for ill in self.ills if 0.0 <= now_s - ill.begins_s < ill.lasts_s]

    def mend(self) -> None:
        """Nothing is wrong any more."""
        self.ills = []
        self.twin.mend()

    def changed(self, subject: str, change: Callable[[], None]) -> None:
        """Note a change, where it is one."""
        before = self._supervised()
        change()
        if self._supervised() != before or subject == "jog":
            self.changes.append((time.monotonic(), subject))

    def _supervised(self) -> object:
        twin = self.twin
        if isinstance(twin, FailingLinuxCnc):
            states = {k: v for k, v in twin.state.items() if k != "program_codes"}
            return states, twin.offset_mm, twin.control is None
        assert isinstance(twin, GrblTwin)
        return twin.state, twin.offset_mm, twin.override

    def answer(self, link: Link, text: bytes) -> None:
        """Send this when it is due."""
        due_s = time.monotonic()
        for ill in self.active():
            text = ill.tells(self, link, text) if text else text
            due_s += ill.delay_s() if text else 0.0
        if text:
            last_s = link.outward[-1][0] if link.outward else 0.0
            link.outward.append((max(due_s, last_s), text))

    def drop(self, link: Link) -> None:
        """Hang up; a terminal only forgets what was on its way."""
        link.outward.clear()
        link.sent = 0
        if link.number in self._ports:
            self._ports.pop(link.number).close()
            self.links.remove(link)

    def drops(self) -> None:
        """Hang up on everybody, from another thread."""
        for link in list(self.links):
            with contextlib.suppress(OSError):
                self._ports[link.number].shutdown(socket.SHUT_RDWR)

    def _serve(self) -> None:
        while not self._ends:
            chatty = False
            for ill in self.active():
                ill.acts(self)
                chatty |= ill.chatty
            for link in list(self.links):
                self._sends(link)
            self._listens(0.001 if chatty else self._until_due())

    def _until_due(self) -> float:
        due = [link.outward[0][0] for link in self.links if link.outward]
        return max(0.0, min([0.01, *(due_s - time.monotonic() for due_s in due)]))

    def _listens(self, wait_s: float) -> None:
        numbers = [link.number for link in self.links] if self._server else [self._near_end]
        if self._server is not None:
            numbers.append(self._server.fileno())
        readable, _, _ = select.select(numbers, [], [], wait_s)
        for number in readable:
            if self._server is not None and number == self._server.fileno():
                port, _ = self._server.accept()
                port.setblocking(False)
                port.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._ports[port.fileno()] = port
                self.links.append(Link(port.fileno()))
                continue
            link = next(
                link for link in self.links if self._server is None or link.number == number
            )
            try:
                content = os.read(number, 4096)
            except BlockingIOError:
                continue
            except OSError:
                content = b""
            if content:
                self._hears(link, content)
            elif self._server is not None:
                self.drop(link)

    def _hears(self, link: Link, content: bytes) -> None:
        self.heard.append((time.monotonic(), content))
        for ill in self.active():
            content = ill.hears(self, link, content) if content else content
        if not content or (self._server is not None and link not in self.links):
            return
        with contextlib.suppress(Disconnected):
            self.does(link, content)

    def does(self, link: Link, content: bytes) -> None:
        """The machine hears this."""
        twin = self.twin
        if isinstance(twin, GrblTwin):
            if answer := twin.receive(content):
                self.answer(link, answer)
            return
        assert isinstance(twin, FailingLinuxCnc)
        if link.client.echo and link.client.linked:
            self.answer(link, content)
        *lines, link.received = (link.received + content).replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            text = ""
            with contextlib.suppress(ValueError, IndexError, KeyError):  # a garbled line
                text = twin.answer(link.client, line.decode("latin-1").split())
            if text:
                self.answer(link, text.encode("latin-1"))

    def _sends(self, link: Link) -> None:
        while link.outward and link.outward[0][0] <= time.monotonic():
            due_s, text = link.outward[0]
            try:
                count = os.write(link.number if self._server else self._near_end, text)
            except BlockingIOError:
                return
            except OSError:
                self.drop(link)
                return
            link.sent += count
            link.outward.popleft()
            if count < len(text):
                link.outward.appendleft((due_s, text[count:]))
                return

    def close(self) -> None:
        """Stop listening."""
        self._ends = True
        self._thread.join()
        for port in self._ports.values():
            port.close()
        if self._server is not None:
            self._server.close()
        else:
            os.close(self._near_end)
            os.close(self._far_end)
        self.twin.close()
