"""Habits of every test: no thread outlives it, sessions go to a folder of their own."""

from __future__ import annotations

import gc
import itertools
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

settings.register_profile("untimed", parent=settings.default, deadline=None)
settings.load_profile("untimed")
"""Machines are noisy: no test has a time to keep."""

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""As the program does, before numpy is imported: small matrices are slower on several cores."""

os.environ.setdefault("TEXTUAL_ANIMATIONS", "none")
"""Nobody watches; and whoever leaves while a line glides is waited for until it has glided."""

os.environ["XDG_DATA_HOME"] = tempfile.mkdtemp(prefix="glidecal-tests-")
os.environ["XDG_CACHE_HOME"] = os.environ["XDG_DATA_HOME"]
"""What the program remembers of a user is none of a test's business."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # a shell has what it starts in the background ignore it, but tests press Ctrl-C there, too
    signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).parent.parent
SAMPLES = ROOT / "sample_sessions"
PATIENCE_S = 30.0

LONG = pytest.mark.long
"""Run by `make test-long` alone: further cases, and what takes half a second or more where quick
tests go the same way."""

needs_links = pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")


def first_quick(cases: Iterable[Any], *, several: bool = False) -> list[Any]:
    """The cases of a parameter, the first for every run, the others for the long one alone.

    ``several``: each is a tuple of the values of several names.
    """
    first, *remainder = cases
    values = remainder if several else [(value,) for value in remainder]
    return [first, *(pytest.param(*arguments, marks=LONG) for arguments in values)]


def pytest_collection_finish() -> None:
    """What was imported stays: looking for garbage in it takes a tenth of the processor's time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


HOMES = itertools.count()


@pytest.fixture(autouse=True)
def _nothing_remembered(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """No test finds what another one made the program remember, such as its indicators.

    The folder is made by who writes to it: to make one for each of thousands of tests, and to
    remove them after the third run, took longer than many tests.
    """
    before = os.environ["XDG_DATA_HOME"]
    os.environ["XDG_DATA_HOME"] = str(tmp_path_factory.getbasetemp() / f"home-{next(HOMES)}")
    yield
    os.environ["XDG_DATA_HOME"] = before


@pytest.fixture(autouse=True)
def _no_leaked_thread() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    deadline = time.monotonic() + PATIENCE_S
    while (survivors := _ours(before)) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not survivors, f"threads left behind: {[t.name for t in survivors]}"


def _ours(before: set[threading.Thread]) -> list[threading.Thread]:
    """New threads, except the idle pool of the event loop."""
    pools = ("asyncio_", "ThreadPoolExecutor")
    return [t for t in threading.enumerate() if t not in before and not t.name.startswith(pools)]


@pytest.fixture
def samples() -> Path:
    return SAMPLES
