"""The report in a real browser: words of strangers do nothing there, and the page holds its width.

Through Chromium's own debugging protocol (https://chromedevtools.github.io/devtools-protocol/).
"""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import sys
from base64 import b64decode
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer

from app.evaluating.history import read_history
from app.report.certificate import read_head
from app.report.pages.history import history_page
from app.report.pages.report import html_of
from app.serving.reports import HEADERS
from tests.app.report.certificates import laboratory, report_of
from tests.app.report.test_certificate import check_pages, page_texts
from tests.app.report.test_pages import SIMULATED, hostile_session
from tests.conftest import LONG

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
PATIENCE_S = 300.0
WIDTHS = (700, 1600)

ACTIVE = (
    "<script>window.owned = 1; alert(1)</script>",
    "</td></table><img src='http://127.0.0.1:9/x' onerror='window.owned = 2'>",
    "]]></text></svg><svg onload='window.owned = 3'>",
    '" onmouseover="window.owned = 4" autofocus onfocus="window.owned = 5',
    "<style>@import 'http://127.0.0.1:9/y';</style><link rel=stylesheet href='http://127.0.0.1:9/z'>",
    "<iframe src='http://127.0.0.1:9/frame'></iframe><meta http-equiv=refresh content='0;url=/'>",
    "javascript:alert(1)",
    "{{ 7 * 7 }}{% raw %}",
    "W" * 250,
    "\u202etxt.exe \x1b]0;owned\x07",
)

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium here (Debian package chromium)"),
    pytest.mark.skipif(sys.platform == "win32", reason="looks for chromium as Debian has it"),
]


class Tab:
    """A page of the browser: what is asked of it, and all that it told meanwhile."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self.told: list[dict[str, Any]] = []
        self._asked = 0

    async def ask(self, method: str, **parameters: object) -> dict[str, Any]:
        self._asked += 1
        await self.socket.send_json({"id": self._asked, "method": method, "params": parameters})
        while (message := await self._heard()).get("id") != self._asked:
            pass
        assert "error" not in message, message
        return dict(message["result"])

    async def until(self, event: str) -> None:
        while (await self._heard()).get("method") != event:
            pass

    async def _heard(self) -> dict[str, Any]:
        message: dict[str, Any] = await self.socket.receive_json(timeout=PATIENCE_S)
        self.told.append(message)
        if message.get("method") == "Page.javascriptDialogOpening":
            close = {"id": 0, "method": "Page.handleJavaScriptDialog", "params": {"accept": True}}
            await self.socket.send_json(close)
        return message

    async def show(self, url: str) -> None:
        self.told.clear()
        await self.ask("Page.navigate", url=url)
        await self.until("Page.loadEventFired")

    async def value(self, expression: str) -> object:
        result = await self.ask("Runtime.evaluate", expression=expression, returnByValue=True)
        return result["result"].get("value")

    def happened(self, event: str) -> list[dict[str, Any]]:
        return [message["params"] for message in self.told if message.get("method") == event]

    def requests(self) -> list[str]:
        return [event["request"]["url"] for event in self.happened("Network.requestWillBeSent")]


@asynccontextmanager
async def browser(folder: Path) -> AsyncIterator[Tab]:
    """Chromium without a window, of its own profile, listening on loopback."""
    root = ["--no-sandbox"] if os.geteuid() == 0 else []
    options = ["--headless", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
    process = await asyncio.create_subprocess_exec(
        str(CHROMIUM),
        *(*options, *root, "--remote-debugging-port=0", f"--user-data-dir={folder}", "about:blank"),
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.DEVNULL,
    )
    try:
        port = await _port(folder / "DevToolsActivePort")
        async with aiohttp.ClientSession() as client:
            async with client.get(f"http://127.0.0.1:{port}/json/list") as listed:
                pages = json.loads(await listed.text())
            (address,) = (page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")
            async with client.ws_connect(address, max_msg_size=0) as socket:
                yield Tab(socket)
    finally:
        process.terminate()
        await process.wait()


async def _port(port_file: Path) -> int:
    async with asyncio.timeout(PATIENCE_S):
        while not port_file.is_file() or len(lines := port_file.read_text().split()) < 2:
            await asyncio.sleep(0.05)
    return int(lines[0])


@asynccontextmanager
async def served(page: str) -> AsyncIterator[str]:
    """The address of a page that comes with the headers of ``glidecal serve``."""

    async def answer(_: web.Request) -> web.Response:
        return web.Response(text=page, content_type="text/html", headers=HEADERS)

    application = web.Application()
    application.router.add_get("/", answer)
    async with TestServer(application) as server:
        yield str(server.make_url("/"))


@LONG
async def test_a_printed_certificate_is_two_pages_and_an_annex(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pdfium = pytest.importorskip("pypdfium2")
    page = tmp_path / "certificate.html"
    head = read_head(laboratory(tmp_path, monkeypatch))
    page.write_text(html_of(report_of([SIMULATED], head=head)), encoding="utf-8")
    async with browser(tmp_path / "profile") as tab:
        await tab.ask("Page.enable")
        await tab.show(page.as_uri())
        printed = await tab.ask("Page.printToPDF", preferCSSPageSize=True, printBackground=True)
    pages = page_texts(pdfium.PdfDocument(b64decode(printed["data"])))
    check_pages(pages, "Certificate 2026-0042")


DRAWN = "[...document.images].map(one => one.complete && one.naturalWidth > 100)"


def report_page(session: Path) -> tuple[str, str, int]:
    return html_of(report_of([session])), f"Calibration report: {ACTIVE[6]}", 14


def history_of(session: Path) -> tuple[str, str, int]:
    """Of a folder with an unreadable file beside the session; three joints in one picture."""
    folder = session.parent
    (folder / f"{ACTIVE[3].replace('/', '')[:60]}.jsonl").write_text("no session")
    history = read_history(folder, index=folder / "index.sqlite")
    return html_of(history_page(history, datetime.now(UTC))), f"History: {folder.name}", 1


@LONG
@pytest.mark.parametrize("page_of", [report_page, history_of])
async def test_words_of_strangers_do_nothing(
    page_of: Callable[[Path], tuple[str, str, int]], tmp_path: Path
) -> None:
    bare = tmp_path / "bare.html"
    bare.write_text(f"<!DOCTYPE html><body>{'<p>'.join(ACTIVE[:4])}", encoding="utf-8")
    page = tmp_path / "report.html"
    text, title, pictures = page_of(hostile_session(tmp_path, ACTIVE))
    page.write_text(text, encoding="utf-8")
    async with browser(tmp_path / "profile") as tab, served(text) as address:
        for domain in ("Page", "Network", "Runtime", "Log"):
            await tab.ask(f"{domain}.enable")
        await tab.show(bare.as_uri())  # would this browser have told?
        assert tab.happened("Page.javascriptDialogOpening")
        assert await tab.value("window.owned")
        assert any(url.endswith("/x") for url in tab.requests())

        for url in (page.as_uri(), address):
            await tab.show(url)
            assert await tab.value("document.title") == title
            assert await tab.value("typeof window.owned") == "undefined"
            assert not tab.happened("Page.javascriptDialogOpening")
            assert not tab.happened("Runtime.exceptionThrown")
            refused = [event["entry"] for event in tab.happened("Log.entryAdded")]
            assert not [
                entry for entry in refused if not entry.get("url", "").endswith("favicon.ico")
            ]
            addresses = [
                request
                for request in tab.requests()
                if not request.startswith("data:image/svg+xml;base64")
            ]
            assert addresses == [url]
            assert await tab.value(DRAWN) == [True] * pictures
        for width in WIDTHS:
            size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
            await tab.ask("Emulation.setDeviceMetricsOverride", **size)
            assert await tab.value(f"document.documentElement.scrollWidth <= {width}") is True
