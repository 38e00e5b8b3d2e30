"""Where a simulated device listens: a pseudo-terminal (POSIX) or a loopback TCP port (anywhere)."""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import threading
from typing import Literal, Self

from drivers.twins import Disconnected, Twin

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
            found = selector.select(self._stream_s)
            return [key.fileobj for key, _ in found]

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

    def __init__(self) -> None:
        import tty  # POSIX only

        self._own_end, self._far_end = os.openpty()
        tty.setraw(self._far_end)
        self.url = os.ttyname(self._far_end)
        self._open = True

    def sources(self) -> tuple[int | socket.socket, ...]:
        return (self._own_end,)

    def receive(self, source: object) -> bytes:
        return os.read(self._own_end, CHUNK) if source == self._own_end else b""

    def send(self, answer: bytes) -> None:
        if answer:
            os.write(self._own_end, answer)

    def close(self) -> None:
        if self._open:
            self._open = False
            os.close(self._own_end)
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
