"""A fault of the disk at every call that a session makes: nothing acknowledged is lost."""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, TypeVar
from unittest import mock

import pytest

from calib.errors import RecordError
from protocols import files
from protocols.journal import Journal
from protocols.record import read_record
from protocols.session import Line, Noted, Reading
from tests.conftest import first_quick
from tests.protocols.test_journal import opened, reading

SHORT = 0
FAULTS = (errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EINTR, SHORT)
T = TypeVar("T")
TRIES = 3
"""So often the operator presses Space before giving up."""


class Disk:
    """Counts the calls on the files of one folder and lets one of them fail, or several."""

    def __init__(self, folder: Path, fails_at: int = -1, fault: int = 0, lasts: int = 1) -> None:
        self.folder = folder
        self.calls: list[str] = []
        self._failing = range(fails_at, fails_at + lasts)
        self._fault = fault
        self._descriptors: set[int] = set()

    def call(self, name: str, path: Path | None = None) -> bool:
        """One call; whether it is to fall short. Raises the fault."""
        if path is not None and path.parent != self.folder:
            return False
        self.calls.append(name)
        if len(self.calls) - 1 not in self._failing:
            return False
        if self._fault != SHORT:
            raise OSError(self._fault, os.strerror(self._fault))
        return True

    def open(self, path: Path, mode: Literal["x+b", "r+b"]) -> object:
        self.call(f"open {mode}", path)
        file = REAL_OPEN(path, mode)
        return FaultyFile(file, self) if path.parent == self.folder else file

    @contextmanager
    def beneath(self) -> Iterator[None]:
        """Put it under the journal."""

        def fsync(descriptor: int) -> None:
            if descriptor in self._descriptors:
                self.call("fsync")

        def leads_to(path: Path, file: io.FileIO) -> bool:
            self.call("stat", path)
            return REAL_LEADS_TO(path, file)

        def sync_folder(folder: Path) -> None:
            self.call("fsync of the folder", folder / "any")

        with (
            mock.patch.object(files, "open_to_write", self.open),
            mock.patch.object(files, "leads_to", leads_to),
            mock.patch.object(files, "sync_folder", sync_folder),
            mock.patch.object(os, "fsync", fsync),
        ):
            yield

    def watch(self, descriptor: int) -> None:
        self._descriptors.add(descriptor)

    def forget(self, descriptor: int) -> None:
        self._descriptors.discard(descriptor)


REAL_OPEN, REAL_LEADS_TO = files.open_to_write, files.leads_to


class FaultyFile:
    """A file on that disk."""

    def __init__(self, file: io.FileIO, disk: Disk) -> None:
        self._file = file
        self._disk = disk
        disk.watch(file.fileno())

    def write(self, content: bytes) -> int:
        short = self._disk.call("write")
        return self._file.write(content[: len(content) // 2] if short else content)

    def truncate(self, size: int) -> int:
        self._disk.call("truncate")
        return self._file.truncate(size)

    def readall(self) -> bytes:
        self._disk.call("read")
        return self._file.readall()

    def close(self) -> None:
        if not self._file.closed:
            self._disk.forget(self._file.fileno())
            self._file.close()
            self._disk.call("close")

    def __getattr__(self, name: str) -> object:
        return getattr(self._file, name)


class Operator:
    """Measures, presses again where the disk refuses, and remembers what was acknowledged."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.told: list[int] = []
        self.words: list[str] = []

    def measure(self, *, remove: bool) -> None:
        """A session with a break; somebody removes the file in between, or nobody."""
        journal = self._patiently(lambda: Journal.create(self.path, opened()))
        if journal is None:
            return
        self._take(journal, reading(1))
        self._take(journal, Noted(text="two at once"), reading(2), reading(3))
        if remove:
            self.path.unlink()
        self._take(journal, reading(len(self.told) + 1))
        self._patiently(journal.close)
        if not self.path.exists():
            return
        with self.path.open("ab") as torn:
            torn.write(b'{"line":9,"prev')
        again = self._patiently(lambda: Journal.resume(self.path, "test again"))
        if again is not None:
            count = sum(isinstance(event, Reading) for event in again.events)
            self._take(again, reading(count + 1))
            self._patiently(lambda: again.finish(complete=True))
            self._patiently(again.close)

    def _take(self, journal: Journal, *events: Line) -> None:
        def append() -> bool:
            journal.append(*events)
            return True

        if self._patiently(append):
            self.told += [event.reading for event in events if isinstance(event, Reading)]

    def _patiently(self, act: Callable[[], T]) -> T | None:
        for _ in range(TRIES):
            try:
                return act()
            except RecordError as problem:
                self.words.append(str(problem))
        return None


def kept(folder: Path) -> list[list[int]]:
    """The readings of every record that is there."""
    return [
        [event.reading for event in read_record(path).events if isinstance(event, Reading)]
        for path in folder.rglob("*.jsonl")
        if b"\n" in path.read_bytes()
    ]


def run(folder: Path, remove: bool, **fault: int) -> tuple[Disk, Operator]:
    disk_folder = folder / "disk"
    disk_folder.mkdir(parents=True)
    disk, operator = Disk(disk_folder, **fault), Operator(disk_folder / "s.jsonl")
    with disk.beneath():
        operator.measure(remove=remove)
    return disk, operator


@pytest.mark.parametrize("remove", first_quick([False, True]), ids=["kept", "removed"])
@pytest.mark.parametrize(
    "lasts", first_quick([1, 2, 10_000]), ids=["once", "twice", "from then on"]
)
def test_a_fault_at_every_call_of_a_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, remove: bool, lasts: int
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("USERPROFILE", str(tmp_path / "home"))
    (tmp_path / "home").mkdir()
    complete, operator = run(tmp_path / "none", remove)
    assert operator.told == [1, 2, 3, 4, 5]
    assert not operator.words
    assert {"write", "truncate", "fsync", "stat", "read", "close"} <= set(complete.calls)
    for number, name in enumerate(complete.calls):
        for fault in FAULTS:
            folder = tmp_path / f"{number}-{fault}"
            _, operator = run(folder, remove, fails_at=number, fault=fault, lasts=lasts)
            records = kept(folder)
            if "kept" in "".join(operator.words):
                records += kept(tmp_path / "home")
            is_lost = operator.told and not any(
                record[: len(operator.told)] == operator.told for record in records
            )
            assert not is_lost, (name, fault, operator.told, records, operator.words)
            for path in (tmp_path / "home").iterdir():
                path.unlink()
