"""Reports and history in a browser, beside the replays of ``glidecal serve``.

Each page is made by the program's own verb in a process of its own, as a tab is: so many at once,
for so long, so large, ended with its page. What a page shows is text of ours around text of
strangers: it runs no script, loads nothing and stands in no frame. Nothing in an address is a path:
it names a file or folder by a digest of its path, among those that were given to `serve`.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import math
import os
import sys
from asyncio.subprocess import DEVNULL, PIPE
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

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

WORKING_OUT_S = 20.0
"""So long a history works out sessions before it shows those that it has."""

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
    f"This takes longer than {MAKING_S:.0f} s and was ended. A report can be written in the "
    "terminal: glidecal report."
)
DECISION = "Decision: on the machine as it was found, by the tolerance in its file."
NOT_KNOWN = "not worked out"
LARGE = f"More than {MOST_BYTES / 1e6:.0f} MB. Write it in the terminal: glidecal report."
UNKNOWN = "There is no such session or folder here, or no longer."


Row = tuple[str, str, tuple[str, ...]]
"""Address and words of a link, and what stands beside it."""

SESSION_COLUMNS = ("session", "readings", "machine", "measured", "decision")
MACHINE_COLUMNS = ("machine", "sessions", "last")


@dataclass(frozen=True)
class Listing:
    """A heading with a table; a folder has a key of its history."""

    name: str
    history: str
    rows: tuple[Row, ...]
    left_out: int = 0
    columns: tuple[str, ...] = SESSION_COLUMNS
    below: str = ""


class ReportPages:
    """The list of sessions, a report for each, a history for each folder; only to be read."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = tuple(path.absolute() for path in paths)
        self._making = 0
        self._waiting: dict[str, int] = {}

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
        key = request.match_info["key"]
        folder, within = _named(key, self._folders()), f"--within={WORKING_OUT_S:g}"
        if machine := request.query.get("machine"):
            if printable(machine) != machine:
                raise web.HTTPNotFound(text=UNKNOWN)
            return await self._page_of("history", folder, within, f"--machine={machine}")
        status, output = await self._made("history", "--json", within, "--", str(folder))
        if status:
            return _page("No history", status=422, text=output)
        document = json.loads(output)
        machines = _machines(key, document)
        waiting = document["waiting"]
        if len(machines) < 2 and not waiting:
            return await self._page_of("history", folder, within)
        # where nothing can be remembered it would begin anew for ever
        again = 0 < waiting < self._waiting.get(key, math.inf)
        self._waiting[key] = waiting
        notice = [f"{waiting:,} of {document['files']:,} sessions are still being worked out."]
        problems = [problem["problem"] for problem in document["problems"]]
        return _page(
            f"History: {folder.name}",
            text="\n\n".join([*(notice if waiting else []), *problems]),
            folders=[Listing("Machines", "", machines, columns=MACHINE_COLUMNS)],
            again=again,
        )

    async def _page_of(self, verb: str, path: Path, *options: str) -> web.Response:
        status, output = await self._made(verb, "-o", "-", *options, "--", str(path))
        if status:
            return _page(f"No {verb}", status=422, text=output)
        return web.Response(text=output, content_type="text/html", charset="utf-8", headers=HEADERS)

    def _folders(self) -> list[Path]:
        return [path for path in self._paths if path.is_dir()]

    def _listed(self) -> list[Listing]:
        alone = [path for path in self._paths if not path.is_dir()]
        lists = [Listing("Sessions", "", _rows(alone, None))] if alone else []
        for folder in self._folders():
            sessions = sessions_below(folder)
            rows = _rows(sessions[:MOST_LISTED], folder)
            remaining = max(0, len(sessions) - MOST_LISTED)
            lists.append(
                Listing(printable(folder.name), _key(folder), rows, remaining, below=DECISION)
            )
        return lists

    def _session(self, key: str) -> Path:
        paths = [path for path in self._paths if not path.is_dir()]
        paths += [path for folder in self._folders() for path in sessions_below(folder)]
        return _named(key, paths)

    async def _made(self, *arguments: str) -> tuple[int, str]:
        """Exit status and text of a verb: what it printed, or what it complained of."""
        if self._making >= MOST_MADE:
            raise web.HTTPServiceUnavailable(text=BUSY)
        self._making += 1
        try:
            process = await asyncio.create_subprocess_exec(
                *PROGRAM,
                *arguments,
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


def _rows(paths: Sequence[Path], folder: Path | None) -> tuple[Row, ...]:
    """Rows of sessions; a decision where a history worked it out."""
    from app.evaluating.history import known_decisions  # heavy: not for the pages of replays
    from app.report.text.history import ORIGIN_WORDS

    decisions, rows = known_decisions(paths), []
    for path in paths:
        name, view = str(path.relative_to(folder)) if folder else path.name, look_at(path)
        decision = decisions[path] or "" if path in decisions else NOT_KNOWN
        machine = f"{view.machine}{ORIGIN_WORDS[view.origin]}"
        cells = (view.state, machine, view.day, "" if view.problem else decision)
        rows.append((f"/reports/{_key(path)}", printable(name), tuple(map(printable, cells))))
    return tuple(rows)


def _machines(key: str, document: dict[str, Any]) -> tuple[Row, ...]:
    """Rows of a history, by name, serial number and origin."""
    from app.report.text.history import ORIGIN_WORDS  # heavy: not for the pages of replays

    rows = []
    for machine in (*document["machines"], *document["posture_machines"]):
        title, days = machine["title"], [session["began"] for session in machine["sessions"]]
        address = f"/history/{key}?{urlencode({'machine': title})}"
        name = printable(f"{title}{ORIGIN_WORDS[machine['origin']]}")
        rows.append((address, name, (f"{len(days)}", max(days)[:10])))
    return tuple(rows)


def _key(path: Path) -> str:
    return hashlib.sha256(os.fsencode(path.absolute())).hexdigest()[:24]


def _named(key: str, among: Iterable[Path]) -> Path:
    for path in among:
        if _key(path) == key:
            return path
    raise web.HTTPNotFound(text=UNKNOWN)


def _page(
    title: str,
    *,
    status: int = 200,
    text: str = "",
    folders: Sequence[Listing] = (),
    again: bool = False,
) -> web.Response:
    """A page with links in ``folders``; a browser loads it ``again`` where more is to come."""
    text = printable(text, keep="\n")
    html = _template().render(title=printable(title), text=text, folders=folders, again=again)
    return web.Response(
        text=html, status=status, content_type="text/html", charset="utf-8", headers=HEADERS
    )


@cache
def _template() -> Template:
    page = resources.files("app.serving").joinpath("page.html").read_text(encoding="utf-8")
    return Environment(autoescape=True, undefined=StrictUndefined).from_string(page)
