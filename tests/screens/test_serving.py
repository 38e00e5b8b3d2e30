"""``glidecal serve`` as a process: loopback only, its own pages only, nothing left behind."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Awaitable, Callable, Iterator, Sequence
from pathlib import Path

import aiohttp
import pytest

from app.serving.server import MOST_TABS, replay_command
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, SAMPLES, first_quick

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and /proc as on Unix")

SAMPLE = SAMPLES / "simulated_zero-max-min.jsonl"
PATIENCE_S = 300.0
COLOUR = re.compile(rb"\x1b\[[\d;]*m")


class Served:
    """A running server; its address is what it says itself."""

    def __init__(
        self,
        *sessions: Path,
        program: Sequence[str | Path] = (sys.executable, "-m", "app"),
        cwd: Path | None = None,
    ) -> None:
        self.process = subprocess.Popen(
            [*program, "serve", "--port", "0", *sessions],
            cwd=cwd,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self._left = ""
        try:
            self.said = " ".join(self._line() for _ in range(4))
            self.address = self.said.split(" at ")[1].split()[0]
            self.port = int(self.address.rsplit(":", 1)[1])
        except BaseException:  # also where the test runs out of time
            self.stop(signal.SIGKILL)
            raise

    def _line(self) -> str:
        assert self.process.stderr is not None
        return self.process.stderr.readline().decode().strip()

    def stop(self, how: signal.Signals = signal.SIGTERM) -> int:
        self.process.send_signal(how)
        status = self.process.wait(PATIENCE_S)
        for stream in (self.process.stdout, self.process.stderr):
            assert stream is not None
            with stream:
                self._left += stream.read().decode()
        return status

    def left(self) -> str:
        """What it said after its first lines, once it is stopped."""
        return self._left


@pytest.fixture
def served() -> Iterator[Served]:
    server = Served(SAMPLE)
    yield server
    if server.process.poll() is None:
        server.stop(signal.SIGKILL)


def fetch(address: str, **headers: str) -> tuple[int, str]:
    request = urllib.request.Request(address, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as problem:
        with problem:
            return problem.code, problem.read().decode()


def listening_addresses(port: int) -> set[str]:
    """Local addresses of listening sockets on a port, from the tables of the kernel."""
    addresses = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        path = Path(table)
        for line in path.read_text().splitlines()[1:] if path.exists() else ():
            local, state = line.split()[1], line.split()[3]
            address, _, number = local.partition(":")
            if state == "0A" and int(number, 16) == port:
                addresses.add(address)
    return addresses


def children(process: int) -> set[int]:
    """Every process below this one."""
    below: dict[int, set[int]] = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            after_name = status.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        below.setdefault(int(after_name[1]), set()).add(int(status.parent.name))
    processes: set[int] = set()
    waiting = [process]
    while waiting:
        fresh = below.get(waiting.pop(), set()) - processes
        processes |= fresh
        waiting += fresh
    return processes


def alive(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def all_gone(processes: set[int]) -> bool:
    deadline = time.monotonic() + PATIENCE_S
    while any(alive(p) for p in processes) and time.monotonic() < deadline:
        time.sleep(0.05)
    return not any(alive(p) for p in processes)


@LONG
def test_page_on_loopback_only(served: Served) -> None:
    status, page = fetch(served.address)
    assert status == 200
    assert f'data-session-websocket-url="ws://127.0.0.1:{served.port}/ws"' in page
    assert "glidecal" in page
    assert listening_addresses(served.port) == {"0100007F"}
    assert "without a login" in served.said
    with urllib.request.urlopen(served.address, timeout=PATIENCE_S) as answer:
        policy = answer.headers["Content-Security-Policy"]
    assert policy == f"style-src 'self' 'unsafe-inline' {served.address}"
    assert "Measuring stays in the terminal" in served.said
    assert served.stop() == 0


def test_other_names_and_other_pages_are_refused(served: Served) -> None:
    assert fetch(served.address, Host=f"localhost:{served.port}")[0] == 200
    assert fetch(served.address, Host="somewhere.example")[0] == 403
    assert fetch(served.address, Origin=served.address)[0] == 200
    assert fetch(served.address + "/ws", Origin="http://somewhere.example")[0] == 403
    assert children(served.process.pid) == set()


async def in_a_tab(
    served: Served, look: Callable[[aiohttp.ClientWebSocketResponse], Awaitable[None]]
) -> None:
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"{served.address}/ws?width=80&height=24") as tab,
    ):
        await look(tab)


async def shown(tab: aiohttp.ClientWebSocketResponse, words: str) -> None:
    """Read what is drawn until these words are on the screen, in whatever colours."""
    drawn = b""
    async with asyncio.timeout(PATIENCE_S):
        async for message in tab:
            if message.type == aiohttp.WSMsgType.BINARY:
                drawn += message.data
            if words.encode() in COLOUR.sub(b"", drawn):
                return
    pytest.fail(f"{words!r} was not drawn")


async def test_a_tab_replays_and_its_process_ends_with_it(served: Served) -> None:
    async def look(tab: aiohttp.ClientWebSocketResponse) -> None:
        await shown(tab, "PAUSED")
        assert children(served.process.pid)
        await tab.send_json(["stdin", "\x1b[C\x1b[C"])
        await shown(tab, "Taken, step 2")

    await in_a_tab(served, look)
    assert await asyncio.to_thread(all_gone, children(served.process.pid))
    assert served.process.poll() is None


@LONG
@pytest.mark.parametrize("how", first_quick([signal.SIGINT, signal.SIGTERM, signal.SIGKILL]))
async def test_the_end_of_the_server_ends_every_tab(served: Served, how: signal.Signals) -> None:
    processes: set[int] = set()

    async def look(tab: aiohttp.ClientWebSocketResponse) -> None:
        await shown(tab, "PAUSED")
        processes.update(children(served.process.pid))
        begun = time.monotonic()
        status = await asyncio.to_thread(served.stop, how)
        assert status == (-signal.SIGKILL if how == signal.SIGKILL else 0)
        assert time.monotonic() - begun < 20.0

    await in_a_tab(served, look)
    assert processes
    assert await asyncio.to_thread(all_gone, processes)
    assert listening_addresses(served.port) == set()


def test_bad_files_and_taken_ports_are_refused(tmp_path: Path) -> None:
    assert "changed" in refused(3, "serve", SAMPLES / "damaged.jsonl")
    assert "No such file" in refused(3, "serve", SAMPLE, tmp_path / "none.jsonl")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        message = refused(2, "serve", SAMPLE, "--port", str(port))
    assert f"port {port} on 127.0.0.1" in message
    assert "--port" in message


def test_no_host_can_be_chosen() -> None:
    assert glidecal("serve", SAMPLE, "--host", "0.0.0.0").status == 2


def test_without_the_extra_the_way_to_it_is_said(tmp_path: Path) -> None:
    (tmp_path / "textual_serve.py").write_text("raise ModuleNotFoundError(name='textual_serve')\n")
    done = subprocess.run(
        [sys.executable, "-m", "app", "serve", str(SAMPLE)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert done.returncode == 2
    assert f'{sys.executable} -m pip install "textual-serve>=' in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


def test_a_file_name_is_never_a_command_or_an_option(tmp_path: Path) -> None:
    evil = tmp_path / "a; touch b $(c) 'd' & e.jsonl"
    words = replay_command([evil, Path("--json")])
    assert words[1:6] == ["-P", "-m", "app", "replay", "--served"]
    assert words[6:] == ["--", str(evil), str(Path("--json").absolute())]


@LONG
async def test_a_strangers_folder_runs_nothing(tmp_path: Path) -> None:
    """The program as installed, begun in a folder with Python files of the names it imports."""
    names = ("app", "calib", "drivers", "protocols", "textual", "aiohttp", "numpy")
    files = [tmp_path / name / "__init__.py" for name in names] + [tmp_path / "app" / "__main__.py"]
    for file in (*files, tmp_path / "typer.py", tmp_path / "sitecustomize.py"):
        file.parent.mkdir(exist_ok=True)
        file.write_text(f"open({str(tmp_path / 'ran')!r}, 'a').write(__file__)\n")
    session = tmp_path / "$(touch ran) & touch ran.jsonl"
    shutil.copy(SAMPLE, session)
    served = Served(session, program=[Path(sys.executable).with_name("glidecal")], cwd=tmp_path)
    try:
        await in_a_tab(served, lambda tab: shown(tab, "PAUSED"))
    finally:
        served.stop()
    assert not (tmp_path / "ran").exists()


@LONG
def test_a_plain_request_for_the_socket_is_told_to_upgrade(served: Served) -> None:
    status, words = fetch(served.address + "/ws")
    assert status == 426
    assert served.address in words
    assert served.stop() == 0
    assert served.left() == ""


@LONG
async def test_so_many_tabs_and_no_more(served: Served) -> None:
    async with aiohttp.ClientSession() as session, contextlib.AsyncExitStack() as tabs:

        async def opened() -> aiohttp.ClientWebSocketResponse:
            return await session.ws_connect(f"{served.address}/ws")

        for _ in range(MOST_TABS):
            await tabs.enter_async_context(await opened())
        with pytest.raises(aiohttp.WSServerHandshakeError, match="503"):
            await opened()
        status, words = await asyncio.to_thread(fetch, served.address)
        assert status == 503
        assert f"{MOST_TABS} tabs are open" in words
        assert len(children(served.process.pid)) == MOST_TABS
    assert await asyncio.to_thread(all_gone, children(served.process.pid))
    assert (await asyncio.to_thread(fetch, served.address))[0] == 200


@LONG
async def test_no_tab_is_larger_than_any_screen(served: Served) -> None:
    """Twice too large: as it begins, and by a message."""
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"{served.address}/ws?width=20000&height=20000") as tab,
    ):
        await shown(tab, "PAUSED")
        (process,) = children(served.process.pid)
        started = Path(f"/proc/{process}/environ").read_text().split("\0")
        assert {"COLUMNS=500", "ROWS=200"} <= set(started)
        await tab.send_json(["resize", {"width": 10**9, "height": -5}])
        await tab.send_json(["resize", {"width": 80, "height": 24}])
        await tab.send_json(["stdin", "\x1b[C\x1b[C"])
        await shown(tab, "Taken, step 2")
        memory = Path(f"/proc/{process}/status").read_text().partition("VmHWM:")[2].split()[0]
        assert int(memory) < 400_000  # kB
    assert await asyncio.to_thread(all_gone, {process})


@LONG
@pytest.mark.parametrize(
    "message",
    first_quick(
        [
            "",
            "[]",
            "3",
            "[" * 100_000,
            '["resize", {"width": Infinity, "height": 1}]',
            '["stdin", 7]',
        ]
    ),
)
async def test_what_no_page_sends_ends_its_tab_only(served: Served, message: str) -> None:
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"{served.address}/ws") as tab,
    ):
        await tab.send_str(message)
        async with asyncio.timeout(PATIENCE_S):
            async for _ in tab:
                pass
    assert await asyncio.to_thread(all_gone, children(served.process.pid))
    assert served.stop() == 0
    assert served.left() == ""


@LONG
async def test_a_process_that_does_not_listen_ends_with_its_tab(served: Served) -> None:
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"{served.address}/ws") as tab,
    ):
        await shown(tab, "PAUSED")
        (process,) = children(served.process.pid)
        os.kill(process, signal.SIGSTOP)
    assert await asyncio.to_thread(all_gone, {process})
