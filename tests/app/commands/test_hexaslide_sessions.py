"""Sessions of postures on the command line: typed, simulated, killed, verified."""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import re
import select
import shutil
import signal
import sys
import time
import tomllib
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.hexaslide import compare_postures
from app.evaluating.hexaslide_calibration import calibrate_file, verify_sessions
from app.measuring.hexaslide import (
    PostureTaking,
    import_postures,
    measure_simulated,
)
from app.report.pages.hexaslide import source_of_postures
from app.report.pages.report import html_of
from calib.errors import RecordError, UsageError
from calib.hexaslide.checked import frames_apart
from calib.hexaslide.geometry import forward_near
from drivers.profile import Spindle
from drivers.profiles import profile_named
from drivers.twins import IndicatorTwin, TwinPort
from protocols.hexaslide import load_hexaslide
from protocols.hexaslide_session import (
    POSTURE_FORM,
    PROCEDURES,
    PostureSession,
    PosturesOpened,
    SimulatedPostures,
    commands,
    procedure_names,
    read_postures,
    simulated_truth,
)
from protocols.journal import write_whole
from protocols.record import Record
from tests.app.cli import glidecal, refused
from tests.app.commands.posture_sessions import IMPORT, opened, quiet, simulated, table, write
from tests.conftest import LONG, ROOT, first_quick

KILLED_SEED = 6
HEADER = "x_m,y_m,z_m,theta_deg,psi_deg,phi_deg"
RUN = ("run", "--machine", "hexaslide", "--simulated", "--protocol")


@pytest.fixture(scope="module")
def pose(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("pose") / "pose.jsonl", "pose-forward", 5)


@pytest.mark.parametrize("procedure", first_quick(procedure_names()))
def test_a_simulated_session_is_calibrated_to_its_machine(procedure: str, tmp_path: Path) -> None:
    """Independent of what the program says of itself: the platform against the hidden machine."""
    path = simulated(tmp_path / "s.jsonl", procedure, 11)
    session, record = read_postures(path)
    assert record.end == "closed"
    result = calibrate_file(path, None, 0.0)
    assert result.fit.rank == {"position": 46, "constraint-link": 48, "link-indicator": 48}.get(
        procedure, 49
    )
    nominal, truth = session.opened.machine.whole(), simulated_truth(session).whole()
    postures = nominal.random(300, np.random.default_rng(2))
    sliders = nominal.sliders_at(postures)
    stands = [
        np.asarray(forward_near(machine.geometry, sliders, postures))
        for machine in (result.fit.machine, truth)
    ]
    free = result.fit.laid_over
    residual_m = frames_apart(stands[0], stands[1], free).places_rms_m
    before = frames_apart(postures, stands[1], free).places_rms_m
    assert result.platform.bound_m is not None, "whether it holds: test_hexaslide_platform"
    assert max(residual_m, result.platform.bound_m) < 0.2 * before
    assert result.platform.now.places_rms_m == pytest.approx(before, rel=0.25)


def test_calibrate_enter_and_verify_as_a_person_would(tmp_path: Path) -> None:
    before, after, file = (tmp_path / name for name in ("b.jsonl", "a.jsonl", "mine.toml"))
    assert glidecal(*RUN, "position", "--seed", "3", "-o", before).status == 0
    assert glidecal("export", before, "--format", "model", "-o", file).status == 0
    again = ("run", "--machine", file, "--simulated", "--protocol", "position", "--seed", "4")
    assert glidecal(*again, "--behind", before, "-o", after).status == 0
    run = glidecal("verify", before, after, "--tolerance", "0.1", "--json")
    assert run.status == 0, run.err
    report = json.loads(run.out)
    assert (report["schema"], report["decision"]) == ("glidecal.hexaslide-verification/1", "pass")
    assert report["platform_after"]["now_rms_mm"] < 0.01 * report["platform_before"]["now_rms_mm"]
    assert len(report["lost_motions"]) == 3
    same = (*RUN, "position", "--seed", "5", "--behind", before, "-o", tmp_path / "same.jsonl")
    assert glidecal(*same).status == 0
    unchanged = glidecal("verify", before, tmp_path / "same.jsonl", "--tolerance", "0.1")
    assert unchanged.status == 6
    assert "one machine file" in " ".join(unchanged.out.split())
    assert "the same postures" in refused(3, "verify", before, before, "--tolerance", "0.1")
    assert verify_sessions(before, after, None).decision is None
    exchanged = glidecal("verify", after, before, "--tolerance", "0.1")
    assert "b.jsonl is older than a.jsonl: is the order right?" in exchanged.out
    assert report["remarks"] == []
    for wrong in ("0", "-0.1"):
        stated = f"--tolerance={wrong}"
        assert "a positive length" in refused(2, "verify", before, after, stated)
        assert "a positive length" in refused(
            2, "report", before, stated, "-o", tmp_path / "r.html"
        )
    open_run = glidecal("verify", before, after)
    assert open_run.status == 7
    assert "no platform_tolerance_mm in the machine file" in " ".join(open_run.out.split())
    assert "the verification did not pass: not judged" in open_run.err
    assert "UNDECIDED" not in open_run.out
    assert "found klipper" in refused(
        2, "export", after, "--format", "klipper", "-o", tmp_path / "k"
    )
    assert "--subset" in refused(
        2, "export", after, "--format", "json", "--subset", "both", "-o", tmp_path / "x"
    )


def test_diagnose_names_the_posture_that_was_taken_wrong(pose: Path, tmp_path: Path) -> None:
    """In words and as a document; a sound session agrees."""
    sound = json.loads(glidecal("diagnose", pose, "--json").out)
    assert (sound["schema"], sound["verdict"]) == ("glidecal.hexaslide-diagnosis/1", "agrees")
    rows = table(tmp_path / "t.csv", pose)
    rows[6][8] = repr(float(rows[6][8]) + 1.0)
    write(tmp_path / "t.csv", rows)
    import_postures(tmp_path / "t.csv", tmp_path / "s.jsonl", opened("pose-forward"))
    run = glidecal("diagnose", tmp_path / "s.jsonl")
    assert run.status == 0, run.err
    text = " ".join(run.out.split())
    assert "posture 5 read or taken wrong" in text
    assert "s.jsonl: explained" in text


def test_a_cut_session_is_said_whatever_is_asked_of_it(pose: Path, tmp_path: Path) -> None:
    """Before: only replay, validate and report told it."""
    cut = tmp_path / "cut.jsonl"
    cut.write_bytes(pose.read_bytes()[:-30])
    lines = len(pose.read_bytes().splitlines())
    words = f"cut.jsonl: cut inside line {lines}; used up to line {lines - 1}."
    out = ("--format", "model", "-o", tmp_path / "m.toml")
    for asked in (("solve", cut), ("diagnose", cut), ("export", cut, *out)):
        run = glidecal(*asked)
        assert run.status == 0, run.err
        assert words in run.err, asked[0]
    message = refused(3, "validate", cut)
    assert f"glidecal run --continue {cut} goes on with it" in message


@LONG
def test_each_of_two_sessions_is_read_once_and_a_cut_one_is_said(
    pose: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By `verify` and `compare`; the report of a verification tells it of the later one, too."""
    later = simulated(tmp_path / "later.jsonl", "pose-forward", 6)
    cut = tmp_path / "cut.jsonl"
    cut.write_bytes(later.read_bytes()[:-30])
    reads: list[str] = []

    def counted(path: Path) -> tuple[PostureSession, Record]:
        reads.append(path.name)
        return read_postures(path)

    monkeypatch.setattr("protocols.hexaslide_session.read_postures", counted)
    for result in (verify_sessions(pose, cut, 0.1), compare_postures(pose, cut)):
        assert [words.partition(":")[0] for words in result.warnings] == ["cut.jsonl"]
        assert "cut inside line" in result.warnings[0]
    assert reads == 2 * ["pose.jsonl", "cut.jsonl"]
    limits = " ".join(html_of(source_of_postures(pose, cut, 0.1).page()).split())
    assert result.warnings[0] in limits


def test_a_reading_that_is_kept_never_ends_the_session(tmp_path: Path) -> None:
    """Before: it ended where no machine has both postures, with status 5."""
    taking = PostureTaking.begin(tmp_path / "s.jsonl", opened("position"))
    operator = SimulatedPostures(load_hexaslide(), taking.commands, 8)
    first = operator.typed(1, 0)
    taking.take(first)
    taking.skip("out of sight")
    taking.take(first)  # a quarter of a metre from posture 3
    assert taking.doubt is not None
    taking.keep()
    assert taking.session.next_posture == 4
    taking.close()
    again = PostureTaking.resume(tmp_path / "s.jsonl")
    assert again.doubt is None
    again.take(operator.typed(4, 0))
    assert again.session.next_posture == 5
    again.close()


def test_a_reading_that_is_taken_again_is_forgotten(tmp_path: Path) -> None:
    """Before: the right one departed from the wrong one that it replaces."""
    taking = PostureTaking.begin(tmp_path / "s.jsonl", opened("position"))
    operator = SimulatedPostures(load_hexaslide(), taking.commands, 8)
    taking.take(operator.typed(1, 0))
    x, y, z = operator.typed(2, 0).split()
    taking.take(f"{x} {float(y) + 0.2} {z}")
    assert taking.doubt is None, "within the tolerances"
    taking.take_again()
    taking.take(f"{x} {y} {z}")
    assert taking.doubt is None
    for number in range(3, 12):
        taking.take(operator.typed(number, 0))
        assert taking.doubt is None
    taking.close()


def test_what_departs_is_questioned_and_explained(tmp_path: Path) -> None:
    """Two sliders exchanged, the platform left in the posture before, a slip of the finger."""
    taking = PostureTaking.begin(tmp_path / "s.jsonl", opened("position"))
    operator = SimulatedPostures(load_hexaslide(), taking.commands, 8)
    for number in range(1, 16):
        taking.take(operator.typed(number, 0))
        assert taking.doubt is None
    taking.take(operator.typed(3, 1))
    assert taking.doubt is not None
    assert "the platform in posture 3" in taking.doubt.explanations
    taking.take_again()
    x, y, z = operator.typed(16, 0).split()
    taking.take(f"{y} {x} {z}")
    assert taking.doubt is not None
    assert "x and y exchanged" in taking.doubt.explanations
    taking.take_again("exchanged")
    taking.take(f"{float(x) + 5.0} {y} {z}")
    assert taking.doubt is not None, "five millimetres"
    taking.close()
    again = PostureTaking.resume(tmp_path / "s.jsonl")
    assert again.doubt is not None, "nobody had answered"
    again.keep()
    assert again.session.next_posture == 17
    again.close()
    third = PostureTaking.resume(tmp_path / "s.jsonl")
    assert third.doubt is None
    for wrong in ("1 2", "1 2 x", "1,5 2 3", "nan 1 2", "1 2 3 4"):
        with pytest.raises(UsageError, match="3 numbers: x, y, z, in mm"):
            third.take(wrong)
    third.skip("out of sight")
    third.close()
    session, record = read_postures(tmp_path / "s.jsonl")
    assert record.end == "open"
    assert session.skipped == {17: "out of sight"}
    assert sorted(session.superseded) == [16, 17]


@LONG
def test_good_sessions_are_not_questioned(tmp_path: Path) -> None:
    for seed in range(8):
        name = procedure_names()[seed % len(procedure_names())]
        session, _ = read_postures(simulated(tmp_path / f"{seed}.jsonl", name, 40 + seed))
        assert session.superseded == {}


@LONG
@pytest.mark.skipif(sys.platform == "win32", reason="kills as Unix does")
def test_forty_kills_lose_nothing(tmp_path: Path) -> None:
    """What was told is on the disk, and what is there is what an undisturbed session has."""
    path, chance = tmp_path / "k.jsonl", random.Random(4)
    taking = PostureTaking.begin(tmp_path / "whole.jsonl", killed())
    measure_simulated(taking, KILLED_SEED, quiet)
    reports: set[str] = set()
    processes = multiprocessing.get_context("forkserver")
    processes.set_forkserver_preload([__name__])  # to load scipy forty times takes minutes
    for life in range(40):
        ours, theirs = processes.Pipe()
        process = processes.Process(target=_measured, args=(path, theirs))
        process.start()
        reports.add(ours.recv())
        if life % 5 == 0:  # 48 postures are enough for forty lives
            ours.send("go on")
        time.sleep(chance.uniform(0.0, 0.03))  # anywhere in the next reading
        process.kill()
        process.join()
    last = PostureTaking.resume(path)
    measure_simulated(last, KILLED_SEED, quiet)
    session, record = read_postures(path)
    assert record.end == "closed"
    texts = {
        f"reading {reading.reading}: posture {reading.posture}: {reading.text}"
        for reading in session.readings
    }
    assert len(reports) == 40
    assert reports - texts == set()
    assert [reading.text for reading in session.readings] == [
        reading.text for reading in taking.session.readings
    ]


def killed() -> PosturesOpened:
    """The fewest that show all a constraint link shows; in most of forty lives one is measured."""
    whole = opened("constraint-link", KILLED_SEED)
    postures = commands(whole.machine, whole.procedure).procedure.in_metres()[:48]
    return whole.model_copy(update={"procedure": whole.procedure.with_postures(postures)})


def _measured(path: Path, tells: Connection) -> None:
    """A session is begun or gone on with, as ``run`` does; each reading waits to be heard."""
    begun = path.exists() and path.stat().st_size > 0
    taking = PostureTaking.resume(path) if begun else PostureTaking.begin(path, killed())

    def say(words: str) -> None:
        tells.send(words)
        tells.recv()

    measure_simulated(taking, KILLED_SEED, say)


@LONG
@pytest.mark.skipif(sys.platform == "win32", reason="a terminal of Unix")
def test_postures_are_typed_in_a_terminal(tmp_path: Path) -> None:
    """A wrong line is told, a doubtful value questioned, a pause can be gone on with."""
    postures = tmp_path / "p.csv"
    postures.write_text(f"{HEADER}\n0,-0.8,-1.15,0,0,0\n0.1,-0.9,-1.1,5,5,5\n", encoding="utf-8")
    path = tmp_path / "typed.jsonl"
    begin = ("run", "--machine", "hexaslide", "--protocol", "position", "-o", str(path))
    output, status = _in_terminal(
        (*begin, "--posture-file", str(postures)),
        ["0.2 -799.7", "0.2 -799.7 -1149.9", "100.0 -900.3 -1400", "foo", "skip", "again", "pause"],
    )
    assert status == 130
    assert "found 2 numbers" in output
    assert "found 'foo'. Allowed: again (it is not used" in output
    assert "found 'skip'. Allowed: again" in output
    assert max(map(len, output.partition("Paused.")[0].splitlines())) <= 80
    assert "Posture 1 of 2" in output
    assert "slider" in output
    assert "Reading 2 departs: z is off by -300" in output.replace("\r", "")
    output, status = _in_terminal(("run", "--continue", str(path)), ["100.0 -900.3 -1099.6"])
    assert status == 0
    session, record = read_postures(path)
    assert record.end == "closed"
    assert [reading.values for reading in session.readings] == [
        (0.2, -799.7, -1149.9), (100.0, -900.3, -1099.6),
    ]  # fmt: skip


@LONG
@pytest.mark.skipif(sys.platform == "win32", reason="a terminal of Unix")
def test_an_indicator_in_the_link_is_read(tmp_path: Path) -> None:
    """Enter reads it; its text is kept beside the value."""
    postures, path = tmp_path / "p.csv", tmp_path / "read.jsonl"
    postures.write_text(f"{HEADER}\n0,-0.8,-1.15,0,0,0\n", encoding="utf-8")
    twin = IndicatorTwin(profile_named("mitutoyo-01a"), Spindle(lambda: 0.123, 0.001))
    with TwinPort(twin, "tcp") as port:
        begin = ("run", "--machine", "hexaslide", "--protocol", "link-indicator", "-o", str(path))
        options = ("--indicator", f"mitutoyo-01a:{port.url}", "--posture-file", str(postures))
        output, status = _in_terminal((*begin, *options), [""])
    assert status == 0, output
    (reading,) = read_postures(path)[0].readings
    assert reading.values == (0.123,)
    assert "0.123" in reading.text
    assert "an empty line reads the indicator" in output


@LONG
def test_the_five_minutes_of_the_documentation(tmp_path: Path) -> None:
    """Each line of the page, on the sample, and the figures that it states."""
    page = (ROOT / "docs/hexaslide.md").read_text("utf-8").partition("## What a procedure sees")[0]
    words = " ".join(page.split())
    shutil.copy(ROOT / "protocols/machines/hexaslide-h60.toml", tmp_path / "machine.toml")
    texts = []
    for line in re.findall(r"^    glidecal (.*)$", page, re.MULTILINE):
        run = glidecal(*line.split(), cwd=tmp_path)
        assert run.status == 0, run.err
        texts.append(" ".join(run.out.split()))
        for name in ("before.csv", "after.csv"):
            shutil.copy(ROOT / "sample_sessions/hexaslide" / name, tmp_path)
    result = next(text for text in texts if "combinations" in text)
    match = re.search(r"off by ([\d.]+) mm r.m.s. now .* by at most ([\d.]+) mm", result)
    assert match is not None
    stated = f"off by {float(match[1]):.2f} mm r.m.s. now, by at most {float(match[2]):.3f} mm"
    assert stated in words
    verdict = next(text for text in texts if text.startswith("PASS"))
    verified = re.search(r"is off by ([\d.]+) mm .* take ([\d.]+) mm", verdict)
    assert verified is not None
    off, bound = (f"{float(figure):.3f} mm" for figure in verified.groups())
    assert f"is off by {off} r.m.s., give or take {bound}" in words
    assert "before.jsonl: agrees" in texts[-1]


def _in_terminal(verb: tuple[str, ...], lines: list[str]) -> tuple[str, int]:
    """What is shown while these lines are typed, each after a prompt, and the exit status."""
    import pty

    child, terminal = pty.fork()
    if child == 0:
        os.environ["PYTHONPATH"] = str(ROOT)
        os.execv(sys.executable, [sys.executable, "-m", "glidecal", *verb])
    output, position, typed = "", 0, iter(lines)
    deadline = time.monotonic() + 90.0
    while time.monotonic() < deadline:
        ready, _, _ = select.select([terminal], [], [], 1.0)
        if not ready:
            continue
        try:
            output += os.read(terminal, 4096).decode()
        except OSError:  # the program has ended
            break
        if " > " in output[position:]:
            position = len(output)
            if (line := next(typed, None)) is not None:
                os.write(terminal, f"{line}\n".encode())
    else:
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return output, os.waitstatus_to_exitcode(status)


def test_wrong_requests_are_told(pose: Path, tmp_path: Path) -> None:
    out = tmp_path / "s.jsonl"
    begin = ("run", "--machine", "hexaslide", "-o", out)
    assert "--protocol: found none" in refused(2, *begin, "--simulated")
    assert "constraint-link" in refused(2, *begin, "--simulated", "--protocol", "sideways")
    assert "a terminal" in refused(2, *begin, "--protocol", "position")
    assert "--motion" in refused(2, *RUN, "position", "--motion", "grbl:x", "-o", out)
    assert "measures length" in refused(
        2, *begin, "--protocol", "position", "--indicator", "mitutoyo-01a:x"
    )
    assert "--behind" in refused(2, *begin, "--protocol", "position", "--behind", pose)
    assert "a simulated one" in refused(2, *RUN, "position", "--behind", _imported(pose, tmp_path))
    assert "closed session" in refused(3, "run", "--continue", pose)
    assert "--adopt" in refused(2, "diagnose", pose, "--adopt", tmp_path / "m.json")
    assert "--resolution" in refused(2, *IMPORT, "position", pose, "-o", out, "--resolution", "0.1")
    assert "--posture-file" in refused(2, "import", "x.csv", "-o", out, "--posture-file", pose)
    far = tmp_path / "far.csv"
    far.write_text(f"{HEADER}\n0,-0.8,-2,0,0,0\n", encoding="utf-8")
    assert "posture 1, z_m: found -2" in refused(
        3, *RUN, "position", "--posture-file", far, "-o", out
    )
    assert not out.exists()
    few = tmp_path / "few.csv"
    few.write_text(f"{HEADER}\n0,-0.8,-1.1,0,0,0\n", encoding="utf-8")
    assert glidecal(*RUN, "position", "--posture-file", few, "-o", out).status == 0
    assert "found 1. Allowed: 16 or more" in refused(5, "solve", out)
    run = glidecal("run", "--machine", "hexaslide", "--protocol", "position", "--dry-run")
    assert (run.status, "24 postures" in run.out) == (0, True)
    words = " ".join(run.out.split())
    assert "degrees. Attach a tracker's target" in words
    assert "set in the base frame. Come to the first posture" in words
    assert _digits(run.out)[:13] == [
        *("1", "300.000", "-701.418", "-1170.052", "-15.000", "15.000", "30.000"),
        *("450.3451", "302.7620", "678.5024", "603.2283", "383.8239", "384.8398"),
    ]


def test_lengths_in_another_unit_are_asked_for(tmp_path: Path) -> None:
    out, shipped = tmp_path / "out.jsonl", PROCEDURES / "position.toml"
    metres = tmp_path / "metres.toml"
    rows = [
        [
            float(number) / factor
            for number, factor in zip(row, (1e3, 1e3, 1e3, 1, 1, 1), strict=True)
        ]
        for row in tomllib.loads(shipped.read_text(encoding="utf-8"))["postures"]
    ]
    head = shipped.read_text(encoding="utf-8").partition("postures = [")[0]
    metres.write_text(f"{head}postures = {rows}\n", encoding="utf-8")
    message = refused(3, *RUN, str(metres), "-o", out)
    assert "lengths 1000 times as large: are they in the unit of the file?" in message
    assert "A procedure file has millimetres" in message
    millimetres = tmp_path / "millimetres.csv"
    millimetres.write_text(f"{HEADER}\n0,-800,-1000,0,0,0\n", encoding="utf-8")
    message = refused(3, *RUN, "position", "--posture-file", millimetres, "-o", out)
    assert "a thousandth as large" in message
    assert not out.exists()


def _digits(text: str) -> list[str]:
    """What stands below the line of a table, in a terminal of 80 columns."""
    assert "…" not in text.partition("─")[2]
    assert max(map(len, text.splitlines())) < 80
    return text.rpartition("─")[2].split()


def test_a_replay_shows_all_digits(pose: Path) -> None:
    first = read_postures(pose)[0].all_readings[0]
    cells = _digits(glidecal("replay", pose, "--headless").out)
    assert cells[:14] == ["1", "1", *(f"{v:.4f}" for v in (*first.sliders_mm, *first.values))]


def _imported(pose: Path, folder: Path) -> Path:
    table(folder / "i.csv", pose)
    import_postures(folder / "i.csv", folder / "i.jsonl", opened("pose-forward"))
    return folder / "i.jsonl"


def test_what_takes_no_postures_says_who_does(pose: Path, samples: Path) -> None:
    assert "session of another kind of machine: validate" in refused(3, "align", pose)
    legs = samples / "experiment_1_six.jsonl"
    for verb in ("compare", "verify"):  # the verb itself is not what to try next
        assert "take it, compare and verify two of one kind" in refused(3, verb, pose, legs)


def test_a_changed_record_is_found(pose: Path, tmp_path: Path) -> None:
    lines = pose.read_text("utf-8").split("\n")
    cut = tmp_path / "cut.jsonl"
    cut.write_text("\n".join(lines[:6]) + "\n" + lines[6][:50], encoding="utf-8")
    session, record = read_postures(cut)
    assert (record.end, len(session.readings)) == ("torn", 5)
    assert "glidecal run --continue" in refused(3, "validate", cut)
    changed = tmp_path / "changed.jsonl"
    changed.write_text("\n".join([*lines[:3], lines[3].replace("1", "2", 1), *lines[4:]]), "utf-8")
    with pytest.raises(RecordError, match="line 4"):
        read_postures(changed)


def test_a_record_of_schema_1_is_read(pose: Path, tmp_path: Path) -> None:
    """In it every chain has a rail, and nothing else differs."""
    session, record = read_postures(pose)
    assert session.opened.schema_id == "glidecal.hexaslide-session/4"
    opened = session.opened.model_copy(update={"schema_id": "glidecal.hexaslide-session/1"})
    write_whole(old := tmp_path / "old.jsonl", opened, list(record.events[1:-1]), POSTURE_FORM)
    assert b'"schema":"glidecal.hexaslide-session/1"' in old.read_bytes()
    assert glidecal("validate", old).status == 0
    first, second = (calibrate_file(path, None, 0.0).fit.parameters for path in (pose, old))
    assert first == pytest.approx(second, abs=0.0)
    newer = old.read_bytes().replace(b"hexaslide-session/1", b"hexaslide-session/5", 1)
    (path := tmp_path / "newer.jsonl").write_bytes(newer)
    assert "newer glidecal (record schema 5; this one reads up to 4)" in refused(3, "solve", path)
