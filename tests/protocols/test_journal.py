"""The record: on the disk before anyone is told, and honest about every kind of damage."""

from __future__ import annotations

import errno
import io
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from calib.errors import RecordError
from protocols import files
from protocols.journal import Journal, write_whole
from protocols.machine import Instrument, Machine
from protocols.procedure import load_procedure
from protocols.record import MOST_BYTES, check_record, read_record
from protocols.session import Continued, Line, Noted, Opened, Reading, Restored, Superseded, fold
from tests.conftest import LONG, SAMPLES, needs_links
from tests.recorded import unsealed


def opened() -> Opened:
    return Opened(program="test", origin="measured", machine=Machine())


def reading(number: int) -> Reading:
    return Reading(
        reading=number,
        leg="x",
        axis="y",
        displacement_mm=0.0,
        value_mm=0.125 * number,
        text=f"01A+0000.{125 * number}",
        mount="xy",
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "s.jsonl"


def finished(path: Path, count: int = 5) -> bytes:
    write_whole(path, opened(), [reading(n) for n in range(1, count + 1)])
    return path.read_bytes()


def test_events_come_back_as_written(path: Path) -> None:
    finished(path)
    record = read_record(path)
    assert record.end == "closed"
    assert [e.value_mm for e in record.events if isinstance(e, Reading)] == [
        0.125 * n for n in range(1, 6)
    ]
    assert [e.line for e in record.events] == list(range(1, 8))
    assert list(path.parent.iterdir()) == [path]


def test_what_comes_after_it_is_let_go_of_is_refused(path: Path) -> None:
    journal = Journal.create(path, opened())
    journal.close()
    with pytest.raises(RecordError, match="found a closed record"):
        journal.append(Noted(text="late"))


def test_cut_anywhere_opens_up_to_the_last_whole_line(path: Path) -> None:
    content = finished(path)
    first = content.index(b"\n") + 1
    for cut in range(first, len(content)):
        record = check_record(path, content[:cut])
        complete = content[:cut].count(b"\n")
        assert len(record.events) == complete
        assert record.end == ("open" if content[cut - 1 : cut] == b"\n" else "torn")


def test_cut_in_the_first_line_is_not_a_session(path: Path) -> None:
    content = finished(path)
    for cut in (0, 1, content.index(b"\n")):
        path.write_bytes(content[:cut])
        with pytest.raises(RecordError, match=r"no whole line|an empty file"):
            read_record(path)


@pytest.mark.parametrize(
    ("saved", "words"),
    [
        (lambda content: content.replace(b"\n", b"\r\n"), "an end as Windows writes it (CR LF)"),
        (lambda content: b"\xef\xbb\xbf" + content, "a byte order mark before it"),
        (lambda content: content.decode().encode("utf-16"), "a byte order mark before it"),
    ],
)
def test_a_record_that_an_editor_saved_again_is_refused_in_these_words(
    path: Path, saved: Callable[[bytes], bytes], words: str
) -> None:
    """Before: "it was changed", or no JSON text."""
    path.write_bytes(saved((SAMPLES / "experiment_2_six.jsonl").read_bytes()))
    message = re.escape(f"line 1: found {words}. Allowed: the bytes that were written")
    with pytest.raises(RecordError, match=message):
        read_record(path)


def test_every_changed_byte_is_noticed_and_its_line_named(path: Path) -> None:
    content = finished(path, 3)
    for at in range(0, len(content) - 1, 7):
        if content[at : at + 1] == b"\n":
            continue
        changed = bytearray(content)
        changed[at] ^= 0x01
        path.write_bytes(changed)
        line = content[:at].count(b"\n") + 1
        with pytest.raises(RecordError, match=rf"line {line}\b|schema"):
            read_record(path)


@pytest.mark.parametrize("how", ["missing", "doubled", "swapped", "reopened"])
def test_lines_missing_doubled_or_moved(path: Path, how: str) -> None:
    lines = finished(path).splitlines(keepends=True)
    changed = {
        "missing": lines[:3] + lines[4:],
        "doubled": [*lines[:3], lines[2], *lines[3:]],
        "swapped": [*lines[:2], lines[3], lines[2], *lines[4:]],
        "reopened": [*lines, lines[-1]],
    }[how]
    path.write_bytes(b"".join(changed))
    broken = {"missing": 4, "doubled": 4, "swapped": 3, "reopened": 8}[how]
    with pytest.raises(RecordError, match=f"line {broken}: found line number|after 'closed'"):
        read_record(path)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b'{"event":"opened","schema":"glidecal.session/99"}\n', "newer glidecal"),
        (b'{"event":"opened","schema":"other/1"}\n', "Not a session"),
        (b'{"a":1}\n', r"an event of schema glidecal\.session/\d+\b"),
        (b"[1,2]\n", "an event of schema"),
        (b"hello\n", "one JSON event. Is it a session?"),
        (b"\xff\xfe\x00\n", "one JSON event"),
    ],
)
def test_what_is_not_a_session_says_so(path: Path, line: bytes, message: str) -> None:
    path.write_bytes(line)
    with pytest.raises(RecordError, match=message):
        read_record(path)


def test_continuing_after_a_cut_loses_nothing_and_doubles_nothing(path: Path) -> None:
    content = finished(path)
    cut = content.index(b'"reading":4')
    path.write_bytes(content[:cut])
    journal = Journal.resume(path, "test again")
    journal.append(reading(4))
    journal.finish(complete=True)
    record = read_record(path)
    assert record.end == "closed"
    assert [r.reading for r in fold(record.events).readings] == [1, 2, 3, 4]
    number = next(k for k, event in enumerate(record.events) if isinstance(event, Continued))
    continued, before = record.events[number], record.events[number - 1]
    assert isinstance(continued, Continued)
    assert continued.paused_s is not None
    passed_s = (continued.at - before.at).total_seconds()
    assert continued.paused_s == pytest.approx(passed_s, abs=0.00051)
    assert continued.paused_s == round(continued.paused_s, 3), "milliseconds"
    torn = path.with_name("s.jsonl.torn").read_bytes()
    assert torn == content[:cut].rsplit(b"\n", 1)[1]


def test_a_closed_session_is_not_continued(path: Path) -> None:
    finished(path)
    with pytest.raises(RecordError, match="closed session"):
        Journal.resume(path, "test")


def test_a_record_is_never_overwritten(path: Path) -> None:
    content = finished(path)
    with pytest.raises(RecordError, match="exists already"):
        Journal.create(path, opened())
    assert path.read_bytes() == content


def test_one_writer_at_a_time(path: Path) -> None:
    journal = Journal.create(path, opened())
    assert list(path.parent.iterdir()) == [path], "no file beside it that somebody could remove"
    with pytest.raises(RecordError, match="in use"):
        Journal.resume(path, "second")
    journal.close()
    Journal.resume(path, "third").close()


@needs_links
@pytest.mark.parametrize("way", ["symbolic", "hard"])
def test_one_writer_at_a_time_by_whatever_name(path: Path, way: str) -> None:
    alias = path.with_name("other.jsonl")
    journal = Journal.create(path, opened())
    if way == "hard":
        alias.hardlink_to(path)
    else:
        alias.symlink_to(path)
    with pytest.raises(RecordError, match="in use" if way == "hard" else "a link to"):
        Journal.resume(alias, "second")
    journal.append(reading(1))
    journal.close()
    assert read_record(alias).end == "open"


def test_without_locks_nothing_is_recorded(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    with monkeypatch.context() as patched:
        patched.setattr(files, "lock", refuse)
        with pytest.raises(RecordError, match="cannot be locked: No locks available"):
            Journal.create(path, opened())
        assert path.read_bytes() == b""
    Journal.create(path, opened()).close()


def test_locks_that_lie_are_found_out_before_a_second_append(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a network share without locks: both believe that they are alone."""
    monkeypatch.setattr(files, "lock", lambda _: None)
    first = Journal.create(path, opened())
    first.append(reading(1))
    second = Journal.resume(path, "second")
    for _ in range(2):
        with pytest.raises(RecordError, match=r"lines of another program.*still in it"):
            first.append(reading(2))
    with pytest.raises(RecordError, match="lines of another program"):
        first.close()
    first.close()
    second.append(reading(2))
    second.finish(complete=True)
    assert [r.reading for r in fold(read_record(path).events).readings] == [1, 2]


def test_two_who_write_at_the_same_moment_lose_nothing(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both looked before either wrote: one line lies over the other, and the record is broken."""
    monkeypatch.setattr(files, "lock", lambda _: None)
    first = Journal.create(path, opened())
    first.append(reading(1))
    before = path.read_bytes()
    second = Journal.resume(path, "second" * 100)
    after = path.read_bytes()

    def later(file: io.FileIO, lines: bytes) -> None:
        path.write_bytes(after)
        write_all(file, lines)

    write_all = files.write_all
    with monkeypatch.context() as patched:
        path.write_bytes(before)  # as the first finds it; the second writes a moment later
        patched.setattr(files, "write_all", later)
        first.append(reading(2))
    for journal, place in ((first, "s-kept.jsonl"), (second, "s-kept-2.jsonl")):
        with pytest.raises(RecordError, match=re.escape(place)):
            journal.append(reading(3))
        readings = list(fold(journal.events).readings)
        assert list(fold(read_record(path.with_name(place)).events).readings) == readings
        with pytest.raises(RecordError):
            journal.close()


def test_a_record_changed_by_another_program_is_kept_beside_it(path: Path) -> None:
    journal = Journal.create(path, opened())
    journal.append(reading(1), reading(2))
    path.write_bytes(path.read_bytes().replace(b"0.125", b"0.126"))
    for _ in range(2):
        with pytest.raises(RecordError, match=r"changed by another program.*s-kept\.jsonl"):
            journal.append(reading(3))
    with pytest.raises(RecordError, match=r"s-kept\.jsonl"):
        journal.close()
    again = Journal.resume(path.with_name("s-kept.jsonl"), "again")
    assert [r.value_mm for r in fold(again.events).readings] == [0.125, 0.25]
    again.close()


def test_what_took_the_place_of_a_record_is_left_alone(path: Path) -> None:
    journal = Journal.create(path, opened())
    journal.append(reading(1))
    path.rename(path.with_name("moved.jsonl"))
    path.write_text("something else")
    with pytest.raises(RecordError, match=r"removed or replaced.*s-kept\.jsonl"):
        journal.close()
    assert path.read_text() == "something else"
    assert len(read_record(path.with_name("s-kept.jsonl")).events) == 2


@needs_links
def test_no_file_is_written_through_a_link(path: Path, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("untouched")
    path.symlink_to(tmp_path / "nowhere")
    with pytest.raises(RecordError, match="exists already"):
        Journal.create(path, opened())
    path.unlink()
    content = finished(path)
    path.write_bytes(content[: content.index(b'"reading":4')])
    path.with_name("s.jsonl.torn").symlink_to(victim)
    path.with_name("s.jsonl-2.torn").symlink_to(tmp_path / "nowhere")
    Journal.resume(path, "test").close()
    assert victim.read_text() == "untouched"
    assert not (tmp_path / "nowhere").exists()
    assert path.with_name("s.jsonl-3.torn").read_bytes().startswith(b'{"line":5')


def test_an_empty_file_of_a_killed_program_is_begun_again(path: Path) -> None:
    path.touch()
    for reader in (read_record, lambda path: Journal.resume(path, "test")):
        with pytest.raises(RecordError, match=r"Nothing was measured\. Begin again"):
            reader(path)
    Journal.create(path, opened()).close()
    assert read_record(path).end == "open"
    with pytest.raises(RecordError, match="exists already"):
        Journal.create(path, opened())


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX pipes")
def test_only_regular_files_of_a_sensible_size_are_read(path: Path, tmp_path: Path) -> None:
    os.mkfifo(path)
    for thing, message in ((path, "a pipe or a device"), (tmp_path, "a folder")):
        with pytest.raises(RecordError, match=message):
            read_record(thing)
        with pytest.raises(RecordError, match=message):
            Journal.resume(thing, "test")
    with pytest.raises(RecordError, match="a pipe or a device"):
        read_record(Path("/dev/zero"))
    path.unlink()
    with path.open("wb") as sparse:
        sparse.truncate(8_000_000_000)
    for reader in (read_record, lambda path: Journal.resume(path, "test")):
        with pytest.raises(RecordError, match=r"8,000\.0 MB\. Allowed: up to 64 MB"):
            reader(path)


@LONG
def test_a_record_does_not_grow_beyond_what_can_be_read(path: Path) -> None:
    journal = Journal.create(path, opened())
    with pytest.raises(RecordError, match="up to 64 MB"):
        journal.append(Noted(text="x" * MOST_BYTES))
    journal.append(reading(1))
    journal.finish(complete=True)
    assert read_record(path).end == "closed"


@pytest.mark.parametrize("brackets", ["[", '{"a":'])
def test_a_hundred_thousand_levels_are_no_event(path: Path, brackets: str) -> None:
    path.write_text(brackets * 100_000 + "\n")
    with pytest.raises(RecordError, match="line 1"):
        read_record(path)


def test_the_last_line_of_an_open_record_vouches_for_itself(path: Path) -> None:
    journal = Journal.create(path, opened())
    journal.append(reading(1), reading(2))
    journal.close()
    path.write_bytes(path.read_bytes().replace(b'"value_mm":0.25', b'"value_mm":0.26'))
    for reader in (read_record, lambda path: Journal.resume(path, "test")):
        with pytest.raises(RecordError, match="line 3: found a content that does not fit"):
            reader(path)


def test_records_without_seals_are_read(path: Path) -> None:
    """As older programs wrote them; there the next line alone vouches for a line."""
    content = unsealed(SAMPLES / "simulated_zero-max-min.jsonl")
    assert content.count(b'"seal"') == 1
    assert check_record(path, content).end == "closed"
    lines = content.splitlines(keepends=True)[:3]
    path.write_bytes(b"".join(lines))
    journal = Journal.resume(path, "test")
    journal.close()
    path.write_bytes(path.read_bytes().replace(b'"value_mm":0.412', b'"value_mm":0.413'))
    with pytest.raises(RecordError, match="line 3: found a content"):
        read_record(path)


def test_windows_locks_one_byte_behind_every_record(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places: set[int] = set()

    class Msvcrt:
        LK_NBLCK = 2

        @staticmethod
        def locking(descriptor: int, mode: int, count: int) -> None:
            place = os.lseek(descriptor, 0, os.SEEK_CUR)
            assert (mode, count) == (2, 1)
            if place in places:
                raise PermissionError(errno.EACCES, "Permission denied")
            places.add(place)

    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setitem(sys.modules, "msvcrt", Msvcrt)
    journal = Journal.create(path, opened())
    with pytest.raises(RecordError, match="in use"):
        Journal.resume(path, "second")
    journal.finish(complete=True)
    assert MOST_BYTES < min(places) < 2**31


def test_an_interruption_behind_a_write_takes_the_lines_back(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C before anyone was told."""
    journal = Journal.create(path, opened())
    journal.append(reading(1))
    acknowledged = path.read_bytes()

    def interrupted(file: io.FileIO, content: bytes) -> None:
        file.write(content)
        raise KeyboardInterrupt

    monkeypatch.setattr(files, "write_all", interrupted)
    with pytest.raises(KeyboardInterrupt):
        journal.append(reading(2))
    journal.close()
    assert path.read_bytes() == acknowledged


def test_without_a_folder_nothing_is_said_of_readings(path: Path) -> None:
    with pytest.raises(RecordError, match="Make that folder first") as refusal:
        Journal.create(path.parent / "none" / "s.jsonl", opened())
    assert "reading" not in str(refusal.value)


def test_full_disk_loses_nothing_acknowledged(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system call fails after half of the bytes are written."""
    journal = Journal.create(path, opened())
    journal.append(reading(1))
    acknowledged = path.read_bytes()

    def refuse(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", refuse)
        with pytest.raises(RecordError, match="No space left"):
            journal.append(reading(2))
    assert path.read_bytes() == acknowledged
    journal.append(reading(2))
    journal.finish(complete=False)
    assert [r.reading for r in fold(read_record(path).events).readings] == [1, 2]


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX resource limits")
def test_real_file_size_limit(path: Path) -> None:
    """The kernel itself refuses to let the file grow, in the middle of a line."""
    script = f"""
import resource, signal, sys
from pathlib import Path
from calib.errors import RecordError
from protocols.journal import Journal
from protocols.record import read_record
from tests.protocols.test_journal import opened, reading
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
path = Path({str(path)!r})
journal = Journal.create(path, opened())
taken = 0
try:
    for number in range(1, 50):
        journal.append(reading(number))
        taken = number
except RecordError as problem:
    print(problem)
record = read_record(path)
assert record.end == "open", record.end
assert sum(e.event == "reading" for e in record.events) == taken > 1
journal.close()
"""
    process = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=600, check=False
    )
    assert process.returncode == 0, process.stderr
    assert "File too large" in process.stdout


def test_no_write_permission(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="writing"):
        Journal.create(tmp_path / "missing folder" / "s.jsonl", opened())


def test_several_events_are_written_all_or_none(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal.create(path, opened())
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(errno.EIO, "I/O")))
    with pytest.raises(RecordError):
        journal.append(Noted(text="a"), reading(1))
    monkeypatch.undo()
    assert len(journal.events) == 1
    journal.close()
    assert len(read_record(path).events) == 1


def test_a_failed_take_back_does_not_spoil_what_comes_after(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither the write nor the cut succeeds; the next write cuts first."""

    class Stubborn(io.FileIO):
        cuts = True

        def truncate(self, size: int | None = None) -> int:
            if not self.cuts:
                raise OSError(errno.EIO, "Input/output error")
            return super().truncate(size)

    monkeypatch.setattr(files, "open_to_write", Stubborn)
    journal = Journal.create(path, opened())
    with monkeypatch.context() as patched:
        patched.setattr(Stubborn, "cuts", False)
        patched.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(errno.EIO, "I/O")))
        with pytest.raises(RecordError):
            journal.append(*[reading(n) for n in range(1, 6)])
    journal.append(Noted(text="short"))
    journal.close()
    assert [event.event for event in read_record(path).events] == ["opened", "noted"]


@pytest.mark.parametrize(
    ("events", "message"),
    [
        ([reading(2)], "found reading 2. Allowed: reading 1"),
        ([reading(1), Superseded(readings=(2,), reason="x")], "before it was taken"),
        ([reading(1), reading(2).model_copy(update={"axis": "z"})], "in a second place"),
        (
            [reading(1), Restored(readings=(1,), reason="x")],
            "line 3: found reading 1 restored. Allowed: readings that were superseded",
        ),
        ([Restored(readings=(1,), reason="x")], "line 2: found reading 1 restored"),
        (
            [
                reading(1),
                Superseded(readings=(1,), reason="x"),
                *[Restored(readings=(1,), reason="y")] * 2,
            ],
            "line 5: found reading 1 restored",
        ),
    ],
)
def test_records_are_checked_for_meaning(path: Path, events: list[Line], message: str) -> None:
    write_whole(path, opened(), events)
    with pytest.raises(RecordError, match=message):
        read_record(path)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"axis": "z"}, ""),
        ({"leg": "z"}, "leg z, axis y in step 2. Allowed: leg x, axis y or z, as in the procedure"),
        ({"leg": "y", "axis": "z"}, "leg y, axis z in step 2"),
        ({"step": None, "leg": "z"}, ""),
    ],
)
def test_a_reading_has_the_leg_of_its_step(
    path: Path, changed: dict[str, object], message: str
) -> None:
    procedure = load_procedure("zero-max-min", Machine().geometry())
    instruments = (Instrument(profile="a"), Instrument(profile="a"))
    planned = opened().model_copy(update={"procedure": procedure, "instruments": instruments})
    assert planned.steps()[1].leg == "x"
    write_whole(path, planned, [reading(1).model_copy(update={"step": 2, **changed})])
    if message:
        with pytest.raises(RecordError, match=message):
            read_record(path)
    else:
        assert len(fold(read_record(path).events).readings) == 1


def test_text_that_is_not_unicode_leaves_no_file(path: Path) -> None:
    with pytest.raises(RecordError, match="not Unicode"):
        Journal.create(path, opened().model_copy(update={"operator": "\udcff"}))
    assert not list(path.parent.iterdir())
    note = Noted(text="x").model_copy(update={"text": "\udcff"})
    with pytest.raises(RecordError, match="not Unicode"):
        write_whole(path, opened(), [reading(1), note])
    assert not list(path.parent.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="an open file cannot be deleted there")
def test_a_deleted_file_comes_back_whole(path: Path) -> None:
    journal = Journal.create(path, opened())
    journal.append(reading(1))
    path.unlink()
    journal.append(reading(2))
    journal.finish(complete=True)
    record = read_record(path)
    assert record.end == "closed"
    assert [r.reading for r in fold(record.events).readings] == [1, 2]


def test_superseded_and_restored_readings_fold_to_what_counts(path: Path) -> None:
    events: list[Line] = [reading(1), reading(2), Superseded(readings=(1, 2), reason="wild")]
    events += [Restored(readings=(1,), reason="was right"), reading(3)]
    write_whole(path, opened(), [*events, Superseded(readings=(3,), reason="late")])
    session = fold(read_record(path).events)
    assert [r.reading for r in session.readings] == [1]
    assert session.superseded == {2: "wild", 3: "late"}
    assert [r.reading for r in session.all_readings] == [1, 2, 3]


def test_every_interruption_keeps_its_own_torn_bytes(path: Path) -> None:
    complete = b"".join(finished(path).splitlines(keepends=True)[:3])
    for torn in (b'{"event":"rea', b'{"event":"not'):
        path.write_bytes(complete + torn)
        Journal.resume(path, "test").close()
        complete = path.read_bytes()
    remnants = sorted(path.parent.glob("*.torn"), key=lambda file: len(file.name))
    assert [file.name for file in remnants] == ["s.jsonl.torn", "s.jsonl-2.torn"]
    assert [file.read_bytes() for file in remnants] == [b'{"event":"rea', b'{"event":"not']
    continued = [e for e in read_record(path).events if e.event == "continued"]
    assert [e.torn_bytes for e in continued] == [13, 13]
