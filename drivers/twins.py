"""Simulated indicators: devices with faults on demand, where they listen, a rig that moves them."""

from __future__ import annotations

import contextlib
import math
import os
import selectors
import socket
import sys
import threading
import time
from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Literal, Protocol, Self

from drivers.profile import Profile, Query, Spindle


class Twin(Protocol):
    """A simulated device: bytes in, bytes out."""

    def receive(self, request: bytes) -> bytes:
        """The bytes that the device answers to these."""


class LineTrouble(StrEnum):
    """Faults that any device may show, besides those of its own profile, each explained."""

    explanation: str

    def __new__(cls, name: str, explanation: str) -> Self:
        """The name, with the explanation beside it."""
        trouble = str.__new__(cls, name)
        trouble._value_, trouble.explanation = name, explanation
        return trouble

    SILENCE = "silence", "no answer at all: switched off, or the cable is out"
    SPLIT = "split", "half an answer, without its end"
    NOISE = "noise", "wrong bytes before each answer"
    ECHO = "echo", "each request comes back before its answer"
    DROP_OUTS = "drop-outs", "every third answer is missing"
    SLOW = "slow", "each answer comes 0.4 s late"
    DISCONNECT = "disconnect", "the port is gone at the first request"
    PARITY = "parity", "seven data bits with even parity, to a reader of eight"


SLOW_S = 0.4
NOISE = b"\xff\x80"


class Disconnected(Exception):
    """The device pulled its cable."""


class IndicatorTwin:
    """A device that answers each whole request, or streams and listens to nothing.

    Its ``fault``, if it has one, is one of `LineTrouble` or the name of a bad reply of the profile.
    """

    def __init__(self, profile: Profile, spindle: Spindle, fault: str | None = None) -> None:
        self._profile = profile
        self._spindle = spindle
        self._fault = fault
        query = Query(channel=spindle.channel)
        self._request = profile.request(query) if profile.request else b""
        self._received = b""
        self._count = 0

    def receive(self, request: bytes) -> bytes:
        """Answers to all whole requests so far; the next line of a stream for no request."""
        answer = self._answers(request)
        return self._faulty(self._fault, request, answer) if self._fault and answer else answer

    def _answers(self, request: bytes) -> bytes:
        if not self._request:
            return b"" if request else self._profile.reply(self._spindle).encode("latin-1")
        expected_request, received = self._request.strip(), self._received + request
        if self._request.endswith((b"\r", b"\n")):
            *parts, self._received = received.split(self._request[-1:])
            requests = [part.strip() for part in parts]
        else:  # nothing ends a request: only the one that is known can be told
            *parts, self._received = received.split(self._request)
            requests = [expected_request] * len(parts)
        return b"".join(self._answer(part, expected_request) for part in requests)

    def _answer(self, request: bytes, expected_request: bytes) -> bytes:
        if request == expected_request:
            return self._profile.reply(self._spindle).encode("latin-1")
        reply = self._profile.otherwise(request.decode("latin-1"), self._spindle)
        return reply.encode("latin-1")

    def _faulty(self, fault: str, request: bytes, answer: bytes) -> bytes:
        """The answer as the fault leaves it."""
        if fault in self._profile.bad_replies:
            return self._profile.bad_replies[fault].reply
        if fault == LineTrouble.DISCONNECT:
            raise Disconnected
        if fault == LineTrouble.SLOW:
            time.sleep(SLOW_S)
        self._count += 1
        shapes: dict[str, bytes] = {
            LineTrouble.SILENCE: b"",
            LineTrouble.SPLIT: answer[: max(1, len(answer) // 2)],
            LineTrouble.NOISE: NOISE + answer,
            LineTrouble.ECHO: request + answer,
            LineTrouble.DROP_OUTS: b"" if self._count % 3 == 0 else answer,
            LineTrouble.PARITY: bytes(byte | (byte.bit_count() % 2) << 7 for byte in answer),
        }
        return shapes.get(fault, answer)


def faults_of(profile: Profile) -> dict[str, str]:
    """The faults that a twin of this profile can show: names, and what each is."""
    bad_replies = {
        name: f"answers {bad.reply.decode('latin-1').strip()}, {bad.kind}"
        for name, bad in profile.bad_replies.items()
    }
    return {**{trouble.value: trouble.explanation for trouble in LineTrouble}, **bad_replies}


Transport = Literal["pty", "tcp"]
CHUNK = 1024


def default_transport() -> Transport:
    """A pseudo-terminal where the system has them."""
    return "pty" if os.name == "posix" else "tcp"


class TwinPort:
    """A twin that listens in a thread of its own until it is closed or pulls its cable.

    ``url`` is what a real program opens: a device path or ``socket://``. A device that streams is
    asked for its next frame every ``stream_s``. ``tcp_port`` 0 takes any free one.
    """

    def __init__(
        self, twin: Twin, transport: Transport, *, stream_s: float = 0.0, tcp_port: int = 0
    ) -> None:
        self._wire: _PseudoTerminal | _LoopbackTcp
        self._wire = _PseudoTerminal() if transport == "pty" else _LoopbackTcp(tcp_port)
        self.url = self._wire.url
        self._twin = twin
        self._stream_s = stream_s or None
        self._stop, self._wake = socket.socketpair()
        self._thread = threading.Thread(target=self._serve, name=f"twin {self.url}", daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        with contextlib.suppress(Disconnected):
            while self._wake not in (ready := self._ready()):
                for source in ready:
                    request = self._wire.receive(source)
                    if request and self._stream_s is None:
                        self._wire.send(self._twin.receive(request))
                if not ready:
                    self._wire.send(self._twin.receive(b""))
            return
        self._wire.close()

    def _ready(self) -> list[object]:
        """Sources with something to read; empty when the next frame of a stream is due."""
        with selectors.DefaultSelector() as selector:
            for source in (*self._wire.sources(), self._wake):
                selector.register(source, selectors.EVENT_READ)
            ready = selector.select(self._stream_s)
            return [key.fileobj for key, _ in ready]

    def close(self) -> None:
        """Stop answering and free the port."""
        with contextlib.suppress(OSError):
            self._stop.send(b"x")
        self._thread.join()
        self._stop.close()
        self._wake.close()
        self._wire.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _PseudoTerminal:
    """A pair of terminal devices; the other end is kept open so that clients may come and go.

    As `_LoopbackTcp`: sources to wait for, bytes of a client, bytes to it.
    """

    url: str
    _near_end: int
    _far_end: int
    _open: bool

    def __init__(self) -> None:
        if sys.platform == "win32":
            raise OSError("Windows has no pseudo-terminals")
        import tty

        self._near_end, self._far_end = os.openpty()
        tty.setraw(self._far_end)  # else it echoes, and makes LF of each CR
        self.url = os.ttyname(self._far_end)
        self._open = True

    def sources(self) -> tuple[int | socket.socket, ...]:
        return (self._near_end,)

    def receive(self, source: object) -> bytes:
        return os.read(self._near_end, CHUNK) if source == self._near_end else b""

    def send(self, answer: bytes) -> None:
        if answer:
            os.write(self._near_end, answer)

    def close(self) -> None:
        if self._open:
            self._open = False
            os.close(self._near_end)
            os.close(self._far_end)


class _LoopbackTcp:
    """A listening socket on the loopback address, one client at a time."""

    def __init__(self, port: int) -> None:
        self._server = socket.create_server(("127.0.0.1", port))
        self.url = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        self._client: socket.socket | None = None

    def sources(self) -> tuple[int | socket.socket, ...]:
        return (self._server,) if self._client is None else (self._server, self._client)

    def receive(self, source: object) -> bytes:
        if source is self._server:
            self._drop()
            self._client, _ = self._server.accept()
            self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return b""
        request = b""
        with contextlib.suppress(OSError):
            request = self._client.recv(CHUNK) if self._client else b""
        if not request:
            self._drop()
        return request

    def send(self, answer: bytes) -> None:
        try:
            if self._client is not None:
                self._client.sendall(answer)
        except OSError:
            self._drop()

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def close(self) -> None:
        self._drop()
        self._server.close()


PUSH_MM, PUSH_S = 1.0, 0.8
"""How far a hand pushes a spindle in, and how long."""


class SimulatedRig:
    """Indicators whose spindles glide to wherever the machine is sent.

    A program opens ``ports``. The rig knows nothing of machines: it is told where each spindle is
    to go. A motion takes ``motion_s`` and follows a smooth curve, so a reading taken too early is a
    moving one. ``fastest_stream`` compresses the time of devices that stream; ``clock`` tells
    seconds.
    """

    def __init__(
        self,
        profiles: Sequence[Profile],
        *,
        resolution_mm: float,
        transport: Transport,
        motion_s: float = 0.0,
        fastest_stream: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock = clock
        self._motion_s = motion_s
        self._lock = threading.Lock()
        self._start_mm = [0.0] * len(profiles)
        self._goal_mm = [0.0] * len(profiles)
        self._departed = -math.inf
        self._pushed = [-math.inf] * len(profiles)
        self._ports = [
            TwinPort(
                IndicatorTwin(profile, Spindle(self._spindle(k), resolution_mm)),
                transport,
                # pace of streaming devices in compressed time
                stream_s=0.01 if fastest_stream and profile.stream_s else profile.stream_s,
            )
            for k, profile in enumerate(profiles)
        ]
        self.ports = tuple(port.url for port in self._ports)

    def go(self, goal_mm: Sequence[float]) -> None:
        """Send every spindle to a new position, in mm."""
        with self._lock:
            now = [self._position(k) for k in range(len(self._goal_mm))]
            self._start_mm, self._goal_mm = now, list(goal_mm)
            self._departed = self._clock()

    def push(self, index: int) -> None:
        """Push one spindle in and let it go, as a hand does; it reads larger meanwhile."""
        with self._lock:
            self._pushed[index] = self._clock()

    def close(self) -> None:
        """Unplug every indicator."""
        for port in self._ports:
            port.close()

    def _spindle(self, index: int) -> Callable[[], float]:
        def position_mm() -> float:
            with self._lock:
                pushed = self._clock() - self._pushed[index] < PUSH_S
                return self._position(index) + PUSH_MM * pushed

        return position_mm

    def _position(self, index: int) -> float:
        elapsed = self._clock() - self._departed
        if elapsed >= self._motion_s:
            return self._goal_mm[index]
        share = (1.0 - math.cos(math.pi * elapsed / self._motion_s)) / 2.0
        start = self._start_mm[index]
        return start + share * (self._goal_mm[index] - start)
