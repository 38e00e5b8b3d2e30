"""Where a simulated device listens: a pseudo-terminal (POSIX) or a loopback TCP port (anywhere)."""

from __future__ import annotations

import os
import selectors
import socket
import threading
from typing import Literal, Protocol, Self

from drivers.profile import Twin

Transport = Literal["pty", "tcp"]


def default_transport() -> Transport:
    """A pseudo-terminal where the system has them."""
    return "pty" if os.name == "posix" else "tcp"


class _Wire(Protocol):
    """One end of a connection as file descriptors or sockets."""

    url: str

    def serve(self, twin: Twin, wake: socket.socket) -> None:
        """Answer until something arrives on ``wake``."""

    def close(self) -> None:
        """Let go of everything."""


class TwinPort:
    """A twin that listens in a thread of its own until it is closed.

    ``url`` is what a real program opens: a device path or ``socket://``.
    """

    def __init__(self, twin: Twin, transport: Transport) -> None:
        self._wire: _Wire = _PseudoTerminal() if transport == "pty" else _LoopbackTcp()
        self.url = self._wire.url
        self._stop, self._wake = socket.socketpair()
        self._thread = threading.Thread(
            target=self._wire.serve, args=(twin, self._wake), name=f"twin {self.url}", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop answering and free the port."""
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
    """A pair of terminal devices; the other end is kept open so that clients may come and go."""

    def __init__(self) -> None:
        import tty  # POSIX only

        self._own_end, self._far_end = os.openpty()
        tty.setraw(self._far_end)
        self.url = os.ttyname(self._far_end)

    def serve(self, twin: Twin, wake: socket.socket) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._own_end, selectors.EVENT_READ)
            selector.register(wake, selectors.EVENT_READ)
            while all(key.fileobj is not wake for key, _ in selector.select()):
                answer = twin.receive(os.read(self._own_end, 1024))
                if answer:
                    os.write(self._own_end, answer)

    def close(self) -> None:
        os.close(self._own_end)
        os.close(self._far_end)


class _LoopbackTcp:
    """A listening socket on the loopback address, one client at a time."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        self._client: socket.socket | None = None

    def serve(self, twin: Twin, wake: socket.socket) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._server, selectors.EVENT_READ)
            selector.register(wake, selectors.EVENT_READ)
            while True:
                for key, _ in selector.select():
                    if key.fileobj is wake:
                        return
                    if key.fileobj is self._server:
                        self._accept(selector)
                    else:
                        self._answer(twin, selector)

    def _accept(self, selector: selectors.BaseSelector) -> None:
        self._drop(selector)
        self._client, _ = self._server.accept()
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        selector.register(self._client, selectors.EVENT_READ)

    def _answer(self, twin: Twin, selector: selectors.BaseSelector) -> None:
        assert self._client is not None
        try:
            request = self._client.recv(1024)
            if request:
                self._client.sendall(twin.receive(request))
        except OSError:
            request = b""
        if not request:
            self._drop(selector)

    def _drop(self, selector: selectors.BaseSelector) -> None:
        if self._client is not None:
            selector.unregister(self._client)
            self._client.close()
            self._client = None

    def close(self) -> None:
        if self._client is not None:
            self._client.close()
        self._server.close()
