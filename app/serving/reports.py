"""Reports and history in a browser, beside the replays of ``glidecal serve``.

Each page is made by the program's own verb in a process of its own, as a tab is: so many at once,
for so long, so large, ended with its page. What a page shows is text of ours around text of
strangers: it runs no script, loads nothing and stands in no frame. Nothing in an address is a path:
it names a file or folder by a digest of its path, among those that were given to `serve`.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import sys
from asyncio.subprocess import DEVNULL, PIPE
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from aiohttp import web
from jinja2 import Environment, StrictUndefined, Template

from app.measuring.recorded import MOST_LISTED, look_at, sessions_below
from calib.printable import printable

PROGRAM = (sys.executable, "-P", "-m", "app")
"""``-P`` keeps the current folder off Python's path."""

MOST_MADE = 2
"""Pages that are made at the same time; each is a process of about 140 MB."""

MAKING_S = 120.0
"""How long one may take."""

MOST_BYTES = 20_000_000
"""A report of 40 pages has 2 MB."""

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}

BUSY = f"{MOST_MADE} pages are being made. Load this one again when they are there."
SLOW = (
    f"This takes longer than {MAKING_S:.0f} s and was ended. The history remembers what it has "
    "read: load the page again. A report can be written in the terminal: glidecal report."
)
LARGE = f"More than {MOST_BYTES / 1e6:.0f} MB. Write it in the terminal: glidecal report."
UNKNOWN = "There is no such session or folder here, or no longer."

PAGE = """\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
body { font: 10pt/1.4 "DejaVu Sans", Verdana, sans-serif }
body { max-width: 60em; margin: 0 auto; padding: 1em }
pre { white-space: pre-wrap; overflow-wrap: anywhere }
li { overflow-wrap: anywhere }
</style>
</head>
<body>
<h1>{{ title }}</h1>
{%- if text %}
<pre>{{ text }}</pre>
{%- endif %}
{%- for folder in folders %}
<h2>{{ folder.name }}</h2>
{%- if folder.history %}
<p><a href="/history/{{ folder.history }}">History of this folder</a></p>
{%- endif %}
{%- if folder.left_out %}
<p>The newest {{ folder.sessions | length }} sessions; {{ folder.left_out }} are older.</p>
{%- endif %}
<ul>
{%- for key, name, state in folder.sessions %}
<li><a href="/reports/{{ key }}">{{ name }}</a> {{ state }}</li>
{%- endfor %}
</ul>
{%- endfor %}
<p><a href="/reports">Reports and history</a> · <a href="/">Replay and results</a></p>
</body>
</html>
"""


@dataclass(frozen=True)
class Listed:
    """A heading with key, name and state of its sessions; a folder has a key of its history."""

    name: str
    history: str
    sessions: tuple[tuple[str, str, str], ...]
    left_out: int = 0


class ReportPages:
    """The list of sessions, a report for each, a history for each folder; only to be read."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = tuple(path.absolute() for path in paths)
        self._making = 0

    def routes(self) -> list[web.RouteDef]:
        """What can be asked for."""
        return [
            web.get("/reports", self._index),
            web.get("/reports/{key}", self._report),
            web.get("/history/{key}", self._history),
        ]

    async def _index(self, request: web.Request) -> web.Response:
        _refuse_from_elsewhere(request)
        listed = await asyncio.to_thread(self._listed)
        return _page("Reports and history", folders=listed)

    async def _report(self, request: web.Request) -> web.Response:
        _refuse_from_elsewhere(request)
        session = await asyncio.to_thread(self._session, request.match_info["key"])
        return await self._page_of("report", session)

    async def _history(self, request: web.Request) -> web.Response:
        _refuse_from_elsewhere(request)
        folder = _named(request.match_info["key"], self._folders())
        return await self._page_of("history", folder)

    async def _page_of(self, verb: str, path: Path) -> web.Response:
        status, output = await self._made(verb, "-o", "-", "--", str(path))
        if status:
            return _page(f"No {verb}", status=422, text=output)
        return web.Response(text=output, content_type="text/html", charset="utf-8", headers=HEADERS)

    def _folders(self) -> list[Path]:
        return [path for path in self._paths if path.is_dir()]

    def _listed(self) -> list[Listed]:
        alone = [path for path in self._paths if not path.is_dir()]
        lists = [Listed("Sessions", "", _names(alone, None))] if alone else []
        for folder in self._folders():
            sessions = sessions_below(folder)
            names = _names(sessions[:MOST_LISTED], folder)
            remaining = max(0, len(sessions) - MOST_LISTED)
            lists.append(Listed(printable(folder.name), _key(folder), names, remaining))
        return lists

    def _session(self, key: str) -> Path:
        paths = [path for path in self._paths if not path.is_dir()]
        paths += [path for folder in self._folders() for path in sessions_below(folder)]
        return _named(key, paths)

    async def _made(self, *words: str) -> tuple[int, str]:
        """Exit status and text of a verb: what it printed, or what it complained of."""
        if self._making >= MOST_MADE:
            raise web.HTTPServiceUnavailable(text=BUSY)
        self._making += 1
        try:
            process = await asyncio.create_subprocess_exec(
                *PROGRAM,
                *words,
                stdin=DEVNULL,
                stdout=PIPE,
                stderr=PIPE,
                env={**os.environ, "PYTHONUTF8": "1"},
            )
            try:
                async with asyncio.timeout(MAKING_S), asyncio.TaskGroup() as tasks:
                    streams = process.stdout, process.stderr
                    output, complained = (tasks.create_task(_read(stream)) for stream in streams)
                status = await process.wait()
            except TimeoutError:
                raise web.HTTPGatewayTimeout(text=SLOW) from None
            except ExceptionGroup as several:
                raise several.exceptions[0] from None
            finally:  # the page is gone, or it took too long or too much
                if process.returncode is None:
                    process.kill()
                    await process.communicate()
        finally:
            self._making -= 1
        return status, (complained if status else output).result().decode(errors="replace")


async def _read(stream: asyncio.StreamReader | None) -> bytes:
    assert stream is not None
    content = bytearray()
    while part := await stream.read(65536):
        content += part
        if len(content) > MOST_BYTES:
            raise web.HTTPInsufficientStorage(text=LARGE)
    return bytes(content)


def _refuse_from_elsewhere(request: web.Request) -> None:
    """A page of another server may not even link here: each page made is a process."""
    if request.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
        raise web.HTTPForbidden(text="Only pages of this server may ask.")


def _names(paths: Sequence[Path], folder: Path | None) -> tuple[tuple[str, str, str], ...]:
    names = (str(path.relative_to(folder)) if folder else path.name for path in paths)
    return tuple(
        (_key(path), printable(name), printable(look_at(path).state))
        for path, name in zip(paths, names, strict=True)
    )


def _key(path: Path) -> str:
    return hashlib.sha256(os.fsencode(path.absolute())).hexdigest()[:24]


def _named(key: str, among: Iterable[Path]) -> Path:
    for path in among:
        if _key(path) == key:
            return path
    raise web.HTTPNotFound(text=UNKNOWN)


def _page(
    title: str, *, status: int = 200, text: str = "", folders: Sequence[Listed] = ()
) -> web.Response:
    html = _template().render(
        title=printable(title), text=printable(text, keep="\n"), folders=folders
    )
    return web.Response(
        text=html, status=status, content_type="text/html", charset="utf-8", headers=HEADERS
    )


@cache
def _template() -> Template:
    return Environment(autoescape=True, undefined=StrictUndefined).from_string(PAGE)
