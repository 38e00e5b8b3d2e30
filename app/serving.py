"""The web server of ``glidecal serve``: loopback only, replay only, nothing left behind.

textual-serve starts one process of this program for each browser tab. Five things are added:

- the port is bound before anything is said, on 127.0.0.1 and nowhere else;
- requests must name this address and, from a browser, come from its own pages. Otherwise any web
  page that is open in a browser of this computer could start processes and read the sessions;
- pages load styles and fonts from here only, nothing from the internet;
- tabs are closed when the server ends: aiohttp alone would wait a minute for them;
- what the library logs becomes one line on standard error.
"""

from __future__ import annotations

import asyncio
import logging
import shlex
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

from aiohttp import web
from textual_serve.server import Server

from protocols.errors import UsageError

HOST = "127.0.0.1"
CLOSING_S = 3.0
"""How long tabs may take to close when the server ends."""

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def listen(port: int) -> socket.socket:
    """A socket that listens on the loopback address; port 0 takes a free one.

    Raises UsageError where the port cannot be had.
    """
    try:
        return socket.create_server((HOST, port))
    except OSError as problem:
        raise UsageError(
            f"port {port} on {HOST}",
            problem.strerror or str(problem),
            "a free port that this user may open",
            "Choose another one with --port, or --port 0.",
        ) from problem


class Pages(Server):
    """Replays of some sessions on one listening socket."""

    def __init__(self, sessions: Sequence[Path], listening: socket.socket) -> None:
        self._listening = listening
        self._answering: set[asyncio.Task[object]] = set()
        port: int = listening.getsockname()[1]
        super().__init__(
            replay_command(sessions),
            host=HOST,
            port=port,
            title="glidecal",
            public_url=f"http://{HOST}:{port}",
        )

    def announcement(self) -> str:
        """The address, and what is not served and why."""
        return (
            f"glidecal: replay and results at {self.public_url} on this computer; "
            "Ctrl-C ends it.\n"
            "Each browser tab is a process of its own and nobody logs in, so nothing can be "
            "measured,\nexported or verified from there: an indicator has one owner. Measuring "
            "stays in the terminal."
        )

    def serve(self, debug: bool = False) -> None:
        """Serve until Ctrl-C or a signal to end; ``debug`` is the library's, for its developers."""
        self.debug = debug
        logging.getLogger("textual-serve").addHandler(_OneLine())
        web.run_app(
            self._make_app(),
            sock=self._listening,
            print=None,
            access_log=None,
            shutdown_timeout=CLOSING_S,
        )

    async def _make_app(self) -> web.Application:
        app = await super()._make_app()
        app.middlewares.append(self._own_pages_only)
        app.on_response_prepare.append(self._own_styles_only)
        return app

    async def _own_styles_only(self, _: web.Request, answer: web.StreamResponse) -> None:
        """The page of the library asks the internet for a font; a workshop need not tell it."""
        answer.headers["Content-Security-Policy"] = (
            f"style-src 'self' 'unsafe-inline' {self.public_url}"
        )

    async def on_startup(self, _: web.Application) -> None:
        """Everything was said before."""

    async def on_shutdown(self, _: web.Application) -> None:
        """Give up every tab; its process ends with it."""
        for task in list(self._answering):
            task.cancel()

    @web.middleware
    async def _own_pages_only(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse requests under another name, or from pages of another server."""
        names = (f"{HOST}:{self.port}", f"localhost:{self.port}")
        origin = request.headers.get("Origin")
        if request.host not in names:
            raise web.HTTPForbidden(text=f"This server is {self.public_url}.")
        if origin is not None and origin not in [f"http://{name}" for name in names]:
            raise web.HTTPForbidden(text="Only pages of this server may ask.")
        return await self._answer(request, handler)

    async def _answer(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Answer, known to `on_shutdown`: a tab is one answer that goes on until it is closed."""
        task = asyncio.current_task()
        assert task is not None
        self._answering.add(task)
        try:
            return await handler(request)
        finally:
            self._answering.discard(task)


def replay_command(sessions: Sequence[Path]) -> str:
    """The command line of one tab, quoted for the shell: a file name is never a command."""
    words = [sys.executable, "-m", "app", "replay", "--served", "--"]
    words += [str(path.absolute()) for path in sessions]
    return subprocess.list2cmdline(words) if sys.platform == "win32" else shlex.join(words)


class _OneLine(logging.Handler):
    """Log records as single lines, without traceback."""

    def emit(self, record: logging.LogRecord) -> None:
        print(f"glidecal: {record.getMessage()}", file=sys.stderr)
