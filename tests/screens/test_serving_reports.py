"""Reports and history of ``glidecal serve``: what is shown, and all that is refused."""

from __future__ import annotations

import asyncio
import html
import os
import re
import shutil
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import aiohttp
import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer
from textual.widgets import OptionList, Static
from yarl import URL

from app.measuring.simulated import simulated_session
from app.screens.home import ReplayChoiceScreen
from app.screens.interface import Glidecal
from app.serving import reports
from app.serving.reports import HEADERS, MOST_MADE, ReportPages
from calib.tripod.pipeline import Model
from protocols.journal import write_whole
from protocols.machine import load_machine
from protocols.procedure import load_procedure
from protocols.record import read_record
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, SAMPLES
from tests.screens.driving import SIZE, history_shown, said, until
from tests.screens.test_serving import PATIENCE_S, Served, all_gone, children, fetch

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and /proc as on Unix")

ONE = SAMPLES / "experiment_2_twelve.jsonl"
NAMES = ["<script>alert(1)<a>&amp;.jsonl", "turned \u202e round.jsonl", "below/{{ 7 * 7 }}.jsonl"]
"""Markup, reading order, a template."""

LINK = re.compile(r'<a href="/(reports|history)/([0-9a-f]{24})">(.*?)</a>')


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three sessions of such names, one that is no name in any language, one altered.

    No history has worked them out before: other tests have the same records.
    """
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (sessions := tmp_path / "sessions").mkdir()
    (sessions / "below").mkdir()
    for name in NAMES:
        shutil.copy(ONE, sessions / name)
    shutil.copy(SAMPLES / "damaged.jsonl", sessions)
    shutil.copy(ONE, sessions / os.fsdecode(b"\xff.jsonl"))
    return sessions


@pytest.fixture
def served(folder: Path) -> Iterator[Served]:
    server = Served(folder)
    yield server
    if server.process.poll() is None:
        server.stop()


def links(page: str) -> dict[str, str]:
    """Addresses by their words."""
    return {html.unescape(words): f"/{kind}/{key}" for kind, key, words in LINK.findall(page)}


def files(folder: Path) -> dict[str, bytes]:
    paths = (path for path in folder.rglob("*") if path.is_file())
    return {os.fsencode(path).hex(): path.read_bytes() for path in paths}


@LONG
def test_a_folder_in_a_browser(served: Served, folder: Path, tmp_path: Path) -> None:
    before = files(folder)
    status, page = fetch(f"{served.address}/reports")
    assert status == 200
    addresses = links(page)
    names = [NAMES[0], "turned \\u202e round.jsonl", NAMES[2], "\\udcff.jsonl", "damaged.jsonl"]
    assert set(addresses) == {*names, "History of this folder"}
    assert "<script" not in page
    # the page of a session is what the verb writes
    status, report = fetch(served.address + addresses[NAMES[0]])
    assert status == 200
    written = tmp_path / "report.html"
    assert glidecal("report", folder / NAMES[0], "-o", written).status == 0
    assert report == written.read_text(encoding="utf-8")
    status, why_not = fetch(served.address + addresses["damaged.jsonl"])
    assert status == 422
    assert "changed" in why_not
    status, history = fetch(served.address + addresses["History of this folder"])
    assert status == 200
    assert "damaged.jsonl" in history
    assert "used once" in " ".join(history.split())
    assert history.count("data:image/svg+xml") == 1, "control charts of one machine"
    assert "Crosses" not in history, "no word of what is not there"
    assert "dotted" not in history
    row = r"</a></td><td>\d+ readings, \w+</td><td>([^<]*)</td><td>([^<]*)</td><td>([^<]*)</td>"
    beside = re.findall(row, page)
    assert len(beside) == 4, "state, machine, day and decision of each"
    assert {decision for _, _, decision in beside} == {"not worked out"}
    beside = re.findall(row, fetch(f"{served.address}/reports")[1])
    assert {decision for _, _, decision in beside} == {""}, "known, but without a tolerance"
    assert "<script" not in history
    assert "\u202e" not in page + history
    # another one is there the next time
    shutil.copy(SAMPLES / "simulated_sweep.jsonl", folder / "new.jsonl")
    assert "new.jsonl" in links(fetch(f"{served.address}/reports")[1])
    (folder / "new.jsonl").unlink()
    assert files(folder) == before
    assert children(served.process.pid) == set()
    assert served.stop() == 0
    assert served.left() == ""


@LONG
async def test_nothing_but_what_was_given_can_be_read(served: Served, tmp_path: Path) -> None:
    shutil.copy(ONE, outside := tmp_path / "outside.jsonl")
    key = ReportPages([outside])
    address = served.address
    async with aiohttp.ClientSession() as session:
        async with in_process(key) as other_client:
            theirs = links(await (await other_client.get("/reports")).text())["outside.jsonl"]
        paths = [
            *(theirs, "/reports/outside.jsonl", "/history/outside.jsonl"),
            *("/reports/..%2f..%2foutside.jsonl", "/reports/%2e%2e/%2e%2e/outside.jsonl"),
            *(f"/reports/{'0' * 24}", f"/history/{'0' * 24}", f"/reports/{'a' * 4000}"),
            *("/reports//etc/passwd", "/reports/%00", "/history/%2fetc", "/history/"),
        ]
        for path in paths:
            target = URL(address + path, encoded=True)
            async with session.get(target, allow_redirects=False) as answer:
                assert answer.status == 404, path
                assert "root:" not in await answer.text()
        for method in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS"):
            async with session.request(method, f"{address}/reports", data=b"x" * 1000) as answer:
                assert answer.status == 405, method
    assert children(served.process.pid) == set()


@LONG
def test_pages_of_others_and_other_names_are_refused(served: Served) -> None:
    """A name that leads here from elsewhere (DNS rebinding), a page of another server, a link."""
    address = f"{served.address}/reports"
    (report,) = (a for w, a in links(fetch(address)[1]).items() if w == "damaged.jsonl")
    for path in (address, served.address + report):
        assert fetch(path, Host="somewhere.example")[0] == 403
        assert fetch(path, Host=f"somewhere.example:{served.port}")[0] == 403
        assert fetch(path, Origin="http://somewhere.example")[0] == 403
        assert fetch(path, Origin="null")[0] == 403
        for site in ("cross-site", "same-site", "nonsense"):
            assert fetch(path, **{"Sec-Fetch-Site": site})[0] == 403
    assert fetch(address, **{"Sec-Fetch-Site": "same-origin"})[0] == 200
    assert children(served.process.pid) == set()


@asynccontextmanager
async def in_process(pages: ReportPages) -> AsyncIterator[TestClient[web.Request, web.Application]]:
    app = web.Application()
    app.add_routes(pages.routes())
    async with TestClient(TestServer(app)) as client:
        yield client


@asynccontextmanager
async def listed(
    folder: Path,
) -> AsyncIterator[tuple[TestClient[web.Request, web.Application], dict[str, str]]]:
    """A browser of these pages, and the addresses of a folder's files by their names."""
    async with in_process(ReportPages([folder])) as client:
        yield client, links(await (await client.get("/reports")).text())


NO_MACHINE = '{"machines": [], "posture_machines": [], "problems": [], "files": 1, "waiting": 0}'


def program(monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    """In place of the program; a history has no machine."""
    code = f"import sys\nif '--json' in sys.argv: print('{NO_MACHINE}'); sys.exit()\n{code}"
    monkeypatch.setattr(reports, "PROGRAM", (sys.executable, "-c", code))


async def test_pages_tell_the_browser_to_run_and_load_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program(monkeypatch, "print('<p>made', end='')")
    async with listed(folder) as (client, addresses):
        for path in ("/reports", *addresses.values()):
            answer = await client.get(path)
            assert answer.status == 200
            assert HEADERS.items() <= dict(answer.headers).items()
            assert answer.content_type == "text/html"
            assert answer.charset == "utf-8"
        assert "default-src 'none'" in HEADERS["Content-Security-Policy"]
        # text that is ours stays, text that is not is no markup
        assert await (await client.get(addresses[NAMES[0]])).text() == "<p>made"
        history = await (await client.get(addresses["History of this folder"])).text()
        assert history == "<p>made"


SLEEPS = "import time; time.sleep(600)"


async def test_what_takes_too_long_or_too_much_is_ended(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = children(os.getpid())
    async with listed(folder) as (client, addresses):
        program(monkeypatch, SLEEPS)
        monkeypatch.setattr(reports, "MAKING_S", 0.5)
        assert (await client.get(addresses["damaged.jsonl"])).status == 504
        monkeypatch.setattr(reports, "MAKING_S", PATIENCE_S)
        program(monkeypatch, "while True: print('x' * 100_000)")
        monkeypatch.setattr(reports, "MOST_BYTES", 1_000_000)
        assert (await client.get(addresses["damaged.jsonl"])).status == 507
        program(monkeypatch, "import sys\nwhile True: print('x' * 100_000, file=sys.stderr)")
        assert (await client.get(addresses["damaged.jsonl"])).status == 507
        program(monkeypatch, "import os; os._exit(3)")
        assert (await client.get(addresses["damaged.jsonl"])).status == 422
        assert await asyncio.to_thread(all_gone, children(os.getpid()) - before)


async def test_so_many_at_once_and_each_ends_with_its_page(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = children(os.getpid())
    async with listed(folder) as (client, addresses):
        program(monkeypatch, SLEEPS)
        making = [
            asyncio.create_task(client.get(addresses["damaged.jsonl"])) for _ in range(MOST_MADE)
        ]
        async with asyncio.timeout(PATIENCE_S):
            while len(working := children(os.getpid()) - before) < MOST_MADE:
                await asyncio.sleep(0.02)
        assert (await client.get(addresses["damaged.jsonl"])).status == 503
        assert (await client.get("/reports")).status == 200
        for task in making:
            task.cancel()
        await asyncio.gather(*making, return_exceptions=True)
        assert await asyncio.to_thread(all_gone, working)
        program(monkeypatch, "print('made')")
        assert (await client.get(addresses["damaged.jsonl"])).status == 200


async def test_a_tab_of_a_folder_shows_its_sessions_and_history(folder: Path) -> None:
    interface = Glidecal(ReplayChoiceScreen([folder]), read_only=True)
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        choices = interface.screen.query_one(OptionList)
        words = [str(option.prompt) for option in choices.options]
        assert words[0] == "History of sessions"
        assert len(words) == 1 + 5
        await pilot.press("enter")
        await history_shown(pilot, interface)
        # on a busy machine sessions wait: then files that cannot be read stand beside the machines
        parts = interface.screen.query(Static).results
        await until(
            pilot, "all files", lambda: any("damaged.jsonl" in str(p.content) for p in parts())
        )
        await pilot.press("escape")
        await until(pilot, "list", lambda: isinstance(interface.screen, ReplayChoiceScreen))
        shutil.rmtree(folder)
        await pilot.press("enter")
        await until(pilot, "words", lambda: "no such folder" in said(interface))
        await pilot.press("f10")


def test_a_folder_without_sessions_is_refused(tmp_path: Path) -> None:
    assert "no session file" in refused(3, "serve", tmp_path)


def simulated(path: Path, **changes: object) -> None:
    machine = load_machine(None).model_copy(update=changes)
    truth = Model(machine.geometry(), (0.5, -0.3, 0.2, 0.0, 0.0, 0.0))
    procedure = load_procedure("zero-max-min", machine.geometry())
    session = simulated_session(
        procedure, machine, truth, seed=1, scatter_mm=0.002, resolution_mm=0.001
    )
    write_whole(path, session.opened, [*session.readings])


@LONG
async def test_demonstrations_are_apart(tmp_path: Path) -> None:
    """Beside a measured session of the same machine."""
    simulated(tmp_path / "demo.jsonl")
    record = read_record(tmp_path / "demo.jsonl")
    measured = record.opened.model_copy(update={"origin": "measured"})
    write_whole(tmp_path / "real.jsonl", measured, [*record.events[1:-1]])
    title = measured.machine.title
    async with in_process(ReportPages([tmp_path])) as client:
        page = await (await client.get("/reports")).text()
        assert page.count(f"<td>{title}</td>") == 1
        assert page.count(f"<td>{title}, simulated</td>") == 1
        history = links(page)["History of this folder"]
        page = await (await client.get(history)).text()
        assert re.findall(r'<a href="/history/[^"]*">(.*?)</a></td><td>(\d)<', page) == [
            (title, "1"),
            (f"{title}, simulated", "1"),
        ]


@LONG
async def test_each_machine_has_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not worked out yet is counted; the page loads itself until nothing is missing."""
    monkeypatch.setattr(reports, "WORKING_OUT_S", 0.0)
    for number, name in enumerate(("mill <1>", "mill & lathe")):
        simulated(tmp_path / f"{number}.jsonl", name=name, tool_tolerance_mm=0.5)
    async with in_process(ReportPages([tmp_path])) as client:
        address = links(await (await client.get("/reports")).text())["History of this folder"]
        page = await (await client.get(address)).text()
        assert "2 of 2 sessions are still being worked out" in page
        assert 'http-equiv="refresh"' in page
        assert 'http-equiv="refresh"' not in await (await client.get(address)).text(), (
            "nothing came of it: not for ever"
        )
        monkeypatch.setattr(reports, "WORKING_OUT_S", PATIENCE_S)
        page = await (await client.get(address)).text()
        assert "worked out" not in page
        machines = dict(re.findall(r'<a href="(/history/[^"]*machine=[^"]*)">(.*?)</a>', page))
        names = ["mill &amp; lathe, simulated", "mill &lt;1&gt;, simulated"]
        assert [*machines.values()] == names
        for target, words in machines.items():
            answer = await client.get(URL(html.unescape(target), encoded=True))
            assert answer.status == 200
            page = await answer.text()
            assert f"<h2>{words}</h2>" in page
            assert page.count("<h2>") == 1
            assert page.count("data:image/svg+xml") == 1
            assert "dotted: the tolerance" in page
        unknown = await client.get(f"{address}?machine=nothing")
        assert unknown.status == 422
        for words in ("%00", "a%1b", "%e2%80%ae"):
            target = URL(f"{address}?machine={words}", encoded=True)
            assert (await client.get(target)).status == 404
        listed_page = await (await client.get("/reports")).text()
        assert listed_page.count("<td>pass</td>") == 2
