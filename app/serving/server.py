"""The web server of ``glidecal serve``: loopback only, replay only, nothing left behind.

textual-serve starts one process of this program for each browser tab. Added to it:

- the port is bound before anything is said, on 127.0.0.1 and nowhere else;
- reports and histories are pages of their own (`ReportPages`);
- requests must name this address and, from a browser, come from its own pages. Otherwise any web
  page that is open in a browser of this computer could start processes and read the sessions;
- pages load styles and fonts from here only, nothing from the internet;
- a tab is started without a shell and without the current folder on its path: a stranger's
  folder beside a session runs nothing. There are so many tabs and no more, none of them larger
  than any screen, and a process ends with its tab, if need be by force;
- tabs are closed when the server ends: aiohttp alone would wait a minute for them;
- what the library logs becomes one line on standard error.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

from aiohttp import web
from textual_serve.app_service import AppService
from textual_serve.download_manager import DownloadManager
from textual_serve.server import Server, to_int

from app.serving.reports import PROGRAM, ReportPages
from calib.errors import UsageError
from protocols.files import reason_of

HOST = "127.0.0.1"


MOST_TABS = 8
"""Each is a process of about 90 MB."""

MOST_CELLS = (500, 200)
"""Columns and rows of the largest screen that a tab draws."""

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
            next_step="Choose another one with --port, or --port 0.",
            reason=reason_of(problem),
        ) from problem


class Pages(Server):
    """Replays and reports of some sessions, or those of folders, on one listening socket."""

    def __init__(self, sessions: Sequence[Path], listening: socket.socket) -> None:
        self._listening = listening
        self._answering: set[asyncio.Task[object]] = set()
        self._tabs = 0
        self._words = replay_command(sessions)
        self._reports = ReportPages(sessions)
        port: int = listening.getsockname()[1]
        super().__init__(
            "glidecal replay",
            host=HOST,
            port=port,
            title="glidecal",
            public_url=f"http://{HOST}:{port}",
        )

    def announcement(self) -> str:
        """The address, and what is not served and why."""
        return (
            f"glidecal: replay and results at {self.public_url} on this computer,\n"
            f"reports and history at {self.public_url}/reports; Ctrl-C ends it.\n"
            "Each browser tab is a process of its own without a login, so nothing can be "
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
            handler_cancellation=True,  # a page that is gone takes its tab with it
            # how long tabs may take to close when the server ends
            shutdown_timeout=3.0,
        )

    async def _make_app(self) -> web.Application:
        app = await super()._make_app()
        app.add_routes(self._reports.routes())
        app.middlewares.append(self._own_pages_only)
        app.on_response_prepare.append(self._own_styles_only)
        return app

    async def _own_styles_only(self, _: web.Request, answer: web.StreamResponse) -> None:
        """The page of the library asks the internet for a font; a workshop need not tell it."""
        policy = f"style-src 'self' 'unsafe-inline' {self.public_url}"
        answer.headers.setdefault("Content-Security-Policy", policy)

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
        task = asyncio.current_task()
        assert task is not None
        self._answering.add(task)  # a tab is one answer that goes on until it is closed
        try:
            return await handler(request)
        finally:
            self._answering.discard(task)

    async def handle_index(self, request: web.Request) -> web.StreamResponse:
        """The page of one tab, or why there is none."""
        self._refuse_too_many()
        return await super().handle_index(request)

    def _refuse_too_many(self) -> None:
        if self._tabs >= MOST_TABS:
            text = f"{MOST_TABS} tabs are open. Close one of them, then load this page again."
            raise web.HTTPServiceUnavailable(text=text)

    async def handle_websocket(self, request: web.Request) -> web.WebSocketResponse:
        """One tab: its process, until either of them goes.

        The library's own handler answers a plain request with a traceback.
        """
        websocket = web.WebSocketResponse(heartbeat=15)
        if not websocket.can_prepare(request).ok:
            upgrade = {"Upgrade": "websocket"}
            raise web.HTTPUpgradeRequired(text=f"Pages are at {self.public_url}.", headers=upgrade)
        self._refuse_too_many()
        self._tabs += 1
        tab = Tab(self._words, websocket, self.download_manager)
        try:
            await websocket.prepare(request)
            width, height = (to_int(request.query.get(side, ""), 0) for side in ("width", "height"))
            await tab.start(width or 80, height or 24)
            await self._process_messages(websocket, tab)
        except Exception:  # what a page sends is the page's: whatever it breaks, its tab ends
            await websocket.close(message=b"not understood")
        finally:
            try:
                await tab.stop()
            finally:
                self._tabs -= 1
        return websocket


class Tab(AppService):
    """The process behind one page."""

    def __init__(
        self, command: Sequence[str], websocket: web.WebSocketResponse, downloads: DownloadManager
    ) -> None:

        async def close() -> None:
            await websocket.close()

        super().__init__(
            "",
            write_bytes=websocket.send_bytes,
            write_str=websocket.send_str,
            close=close,
            download_manager=downloads,
        )
        self._words = command

    async def _open_app_process(self, width: int = 80, height: int = 24) -> Process:
        """Start the app as the library does, without a shell: a file name is never a command."""
        self._process = await asyncio.create_subprocess_exec(
            *self._words,
            stdin=PIPE,
            stdout=PIPE,
            stderr=PIPE,
            env=self._build_environment(*_terminal_size(width, height)),
        )
        self._stdin = self._process.stdin
        return self._process

    async def set_terminal_size(self, width: int, height: int) -> None:
        """Tell the process the new size, within bounds."""
        await super().set_terminal_size(*_terminal_size(width, height))

    async def stop(self) -> None:
        """End the process: politely, then by force."""
        try:
            with contextlib.suppress(TimeoutError):
                # how long the process of a tab may take to end by itself
                async with asyncio.timeout(2.0):
                    await super().stop()
        finally:
            if self._process is not None and self._process.returncode is None:
                self._process.kill()


def _terminal_size(width: int, height: int) -> tuple[int, int]:
    """Columns and rows as a screen may have them."""
    return min(max(1, int(width)), MOST_CELLS[0]), min(max(1, int(height)), MOST_CELLS[1])


def replay_command(sessions: Sequence[Path]) -> list[str]:
    """The words that start one tab."""
    return [*PROGRAM, "replay", "--served", "--", *(str(path.absolute()) for path in sessions)]


class _OneLine(logging.Handler):
    """Log records as single lines, without traceback."""

    def emit(self, record: logging.LogRecord) -> None:
        print(f"glidecal: {record.getMessage()}", file=sys.stderr)
