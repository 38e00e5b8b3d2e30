"""The site of the documentation, opened from a folder: its search answers, a phone shows it."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import LONG, ROOT
from tests.end_to_end.test_report_in_a_browser import CHROMIUM, PATIENCE_S, Tab, browser

pytestmark = [
    LONG,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium here (Debian package chromium)"),
    pytest.mark.skipif(sys.platform == "win32", reason="looks for chromium as Debian has it"),
]

PHONE = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": False}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocs")
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, timeout=PATIENCE_S)
    return folder


async def results(tab: Tab) -> list[str]:
    """Titles of what the search gives, as soon as there are any."""
    read = "[...document.querySelectorAll('#mkdocs-search-results h3')].map(h => h.innerText)"
    async with asyncio.timeout(PATIENCE_S):
        while not (titles := await tab.value(read)):
            await asyncio.sleep(0.05)
    assert isinstance(titles, list)
    return titles


async def test_the_search_answers_without_a_server(site: Path, tmp_path: Path) -> None:
    """Before: a browser refused its worker, and it gave nothing."""
    async with browser(tmp_path / "profile") as tab:
        await tab.ask("Page.enable")
        await tab.show(f"{(site / 'search.html').as_uri()}?q=backlash")
        assert {"Five minutes", "Split"} <= set(await results(tab))


async def test_no_page_is_wider_than_a_phone(site: Path, tmp_path: Path) -> None:
    """Before: the longest formula of the theory was."""
    async with browser(tmp_path / "profile") as tab:
        await tab.ask("Page.enable")
        await tab.ask("Emulation.setDeviceMetricsOverride", **PHONE)
        for page in sorted(site.glob("*.html")):
            if page.name != "404.html":  # of a server alone
                await tab.show(page.as_uri())
                wider = await tab.value("document.documentElement.scrollWidth > innerWidth")
                assert wider is False, page.name
