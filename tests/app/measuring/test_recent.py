"""The list of sessions: quick for any number of files of any size, and no file keeps it waiting."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest

from app.measuring.recorded import MOST, SMALL_BYTES, look_at, recent_sessions
from protocols import record
from protocols.journal import Journal, write_whole
from protocols.session import Event, Line, Noted
from tests.protocols.test_journal import opened, reading
from tests.recorded import opened as planned

LARGE = [reading(number) for number in range(1, 801)]


def test_a_large_session_is_known_by_its_ends(tmp_path: Path) -> None:
    path = tmp_path / "closed.jsonl"
    write_whole(path, opened(), [*LARGE])
    assert path.stat().st_size > SMALL_BYTES
    assert look_at(path).state == "800 readings, closed"
    table, cut = tmp_path / "table.jsonl", tmp_path / "cut.jsonl"
    table.write_bytes(path.read_bytes()[:-100])
    assert look_at(table).state == "800 readings, not closed"
    assert not look_at(table).interrupted
    journal = Journal.create(cut, planned())
    journal.append(*LARGE)
    journal.close()
    assert look_at(cut).interrupted


@pytest.mark.parametrize("spoilt", [b"hello", b"\n", b"{}\n"])
def test_a_large_file_that_is_no_session(tmp_path: Path, spoilt: bytes) -> None:
    path = tmp_path / "s.jsonl"
    path.write_bytes(spoilt * (SMALL_BYTES // len(spoilt) + 1))
    assert look_at(path).problem


def test_a_last_event_too_large_to_look_at(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    events: list[Line] = [reading(1), Noted(text="x" * SMALL_BYTES)]
    write_whole(path, opened(), events)
    assert look_at(path).state == "1 reading, closed"
    path.write_bytes(path.read_bytes().rsplit(b"\n", 2)[0] + b"\n")
    assert look_at(path).state == "not closed"


def test_a_thousand_large_sessions_are_listed_by_few_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is read decides how long it takes."""
    path = tmp_path / "0.jsonl"
    write_whole(path, opened(), [*LARGE])
    for number in range(1, 1000):
        (tmp_path / f"{number}.jsonl").hardlink_to(path)
    sizes: list[int] = []
    real = record.parse_line

    def counted(path: Path, number: int, line: bytes) -> Event:
        sizes.append(len(line))
        return real(path, number, line)

    monkeypatch.setattr(record, "parse_line", counted)
    began_s = time.process_time()
    assert len(recent_sessions(tmp_path)) == MOST
    assert time.process_time() - began_s < 5.0
    assert sum(sizes) < MOST * SMALL_BYTES


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX pipes")
def test_pipes_devices_folders_and_sparse_files_are_named_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.jsonl")
    (tmp_path / "folder.jsonl").mkdir()
    (tmp_path / "zero.jsonl").symlink_to("/dev/zero")
    (tmp_path / "nowhere.jsonl").symlink_to(tmp_path / "nowhere")
    (tmp_path / "deep.jsonl").write_text("[" * 100_000 + "\n")
    with (tmp_path / "sparse.jsonl").open("wb") as sparse:
        sparse.truncate(8_000_000_000)
    problems = {session.path.name: session.problem for session in recent_sessions(tmp_path)}
    assert len(problems) == 6
    for name, message in {
        "pipe": "a pipe or a device",
        "folder": "a folder",
        "zero": "a pipe or a device",
        "nowhere": "No such file",
        "deep": "one JSON event",
        "sparse": "up to 64 MB",
    }.items():
        assert message in problems[f"{name}.jsonl"]
