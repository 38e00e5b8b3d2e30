"""The history of a folder: offsets over time, files that cannot be used, the index."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from app.evaluating import history
from app.evaluating.history import Entry, MachineHistory, read_history
from app.evaluating.solution import judge, solve_files, solve_sessions
from app.machines.registry import LOOKS
from app.measuring.simulated import simulated_session
from app.report.charts.history import control_charts
from app.report.text.history import history_text
from calib.clusters import on_part
from calib.errors import NotIdentifiable
from calib.printable import HIDDEN, printable
from calib.tripod.pipeline import Model
from protocols.journal import write_whole
from protocols.machine import load_machine
from protocols.procedure import load_procedure
from protocols.record import read_record
from protocols.session import Reading
from tests.app.cli import glidecal, refused, run_here
from tests.conftest import LONG, PATIENCE_S, ROOT, SAMPLES, first_quick, needs_links

BEGAN = datetime(2026, 1, 1, tzinfo=UTC)
NOW = BEGAN + timedelta(days=200)


def measured(
    folder: Path, number: int, offsets_mm: tuple[float, float, float], **changes: object
) -> Path:
    """A session 30 days after the one before, on a machine that stands so."""
    machine = load_machine(None).model_copy(update={"tool_tolerance_mm": 0.5, **changes})
    remainders = (a - b for a, b in zip(offsets_mm, machine.entered_offsets_mm, strict=True))
    truth = Model(machine.geometry(), (*remainders, 0.0, 0.0, 0.0))
    procedure = load_procedure("zero-max-min", machine.geometry())
    session = simulated_session(
        procedure, machine, truth, seed=number, scatter_mm=0.002, resolution_mm=0.001
    )
    when = {"at": BEGAN + timedelta(days=30 * number), "temperature_c": 20.0 + number}
    path = folder / f"s{number}.jsonl"
    write_whole(path, session.opened.model_copy(update=when), [*session.readings])
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Joint x drifts by 20 µm a month, z jumps by 60 µm, offsets are entered before session 3."""
    folder = tmp_path_factory.mktemp("history")
    for number in range(6):
        truth = (0.5 + 0.02 * number, -0.3, 0.2 + (0.06 if number > 1 else 0.0))
        entered = {"entered_offsets_mm": (0.54, -0.3, 0.26)} if number > 2 else {}
        measured(folder, number, truth, **entered)
    damaged = folder / "below"
    damaged.mkdir()
    content = (folder / "s1.jsonl").read_text("utf-8")
    line = content.splitlines()[5]
    (damaged / "altered.jsonl").write_text(
        content.replace(line, line.replace('"cycle":1', '"cycle":2')), "utf-8"
    )
    (damaged / "copy.jsonl").write_text(content, "utf-8")
    torn = measured(damaged, 9, (0.5, -0.3, 0.2), name="another")
    torn.rename(damaged / "torn.jsonl").write_bytes((damaged / "torn.jsonl").read_bytes()[:-9])
    return folder


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache") / "deep" / "history.sqlite"


def orthoglide(folder: Path, index: Path) -> MachineHistory:
    folder_history = read_history(folder, index=index)
    return next(machine for machine in folder_history.machines if machine.machine == "orthoglide")


@LONG
def test_offsets_are_followed_through_what_is_entered(folder: Path, index: Path) -> None:
    machine = orthoglide(folder, index)
    assert [point.path.name for point in machine.points] == [f"s{k}.jsonl" for k in range(6)]
    assert [point.event for point in machine.points] == ["", "", "", "offsets entered", "", ""]
    assert machine.days == (0.0, 30.0, 60.0, 90.0, 120.0, 150.0)
    for number, point in enumerate(machine.points):
        assert point.entry.offsets_mm is not None
        assert point.entry.expanded_mm is not None
        truth = (0.5 + 0.02 * number, -0.3, 0.2 + (0.06 if number > 1 else 0.0))
        for value, true, half in zip(
            point.entry.offsets_mm, truth, point.entry.expanded_mm, strict=True
        ):
            assert abs(value - true) < 2.0 * half
        assert point.entry.temperature_c == 20.0 + number


def test_a_jump_is_flagged_where_it_is_and_a_drift_is_dated(folder: Path, index: Path) -> None:
    machine = orthoglide(folder, index)
    x, y, z = machine.joints
    assert z.chart.changed.tolist() == [False, False, True, False, False, False]
    assert not y.chart.changed.any()
    assert x.drift is not None
    assert x.drift.shown
    assert x.drift.per_day == pytest.approx(0.02 / 30.0, rel=0.2)
    assert y.drift is not None
    assert not y.drift.shown
    assert machine.due is not None
    last = machine.last
    # touched off, 0.24 of a joint offset is left at the tool: tests/calib/test_control_chart.py
    left_days = (0.5 - last.bound_after_mm) / (0.24 * x.drift.per_day)
    assert (machine.due - last.began).days == pytest.approx(left_days, rel=0.02)
    figures = control_charts(machine)
    assert [figure.readings.marks for figure in figures] == [(90.0,)] * 3
    (steady, moved) = (figures[k].readings for k in (1, 2))
    assert [series.name for series in steady.series] == ["session"]
    assert [series.name for series in moved.series] == ["session", "changed, or a rule"]
    assert moved.series[1].x == (60.0,)
    phases = [stroke.points for stroke in moved.strokes]  # centre and limits of each phase
    assert [ends[0][0] for ends in phases] == [0.0] * 3 + [60.0] * 3


def test_what_is_altered_torn_or_doubled_is_named_and_the_rest_shown(
    folder: Path, index: Path
) -> None:
    folder_history = read_history(folder, index=index)
    problems = {path.name: text for path, text in folder_history.problems}
    assert problems.keys() == {"altered.jsonl", "copy.jsonl", "torn.jsonl"}
    assert problems["copy.jsonl"].endswith("s1.jsonl, used once.")
    assert "line 6" in problems["altered.jsonl"]
    assert "not fit its digest" in problems["altered.jsonl"]
    assert problems["torn.jsonl"].startswith("below/torn.jsonl: cut inside line")
    # the torn one is not finished
    assert [len(machine.points) for machine in folder_history.machines] == [6]
    text = " ".join(history_text(folder_history, NOW).split())
    assert "Last calibrated 50 days ago: s5.jsonl. Due in " in text
    assert "joint z changed beyond uncertainty" in text


def test_today_is_the_day_in_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before: a session of late evening was of today on the next day, beside its own date."""
    monkeypatch.setattr(f"{__name__}.BEGAN", BEGAN + timedelta(hours=23, minutes=50))
    measured(tmp_path, 0, (0.1, 0.1, 0.1))
    folder_history = read_history(tmp_path, index=tmp_path / "index")
    for hours, when in ((0.1, "today"), (1.0, "1 day ago"), (24.1, "1 day ago")):
        text = " ".join(history_text(folder_history, BEGAN + timedelta(hours=hours)).split())
        assert f"Last calibrated {when}: s0.jsonl" in text
        assert " 2026-01-01 " in text


def test_a_file_with_a_long_name_stays_set_in_below_its_number(tmp_path: Path) -> None:
    measured(tmp_path, 0, (0.1, 0.1, 0.1))
    (session,) = tmp_path.iterdir()
    path = session.rename(tmp_path / f"{'long' * 25}.jsonl")
    text = history_text(read_history(tmp_path, index=tmp_path / "index"), NOW)
    assert f"\n1\n   {path.name}" in text


def test_two_sessions_tell_no_drift_and_none_is_denied(tmp_path: Path) -> None:
    measured(tmp_path, 0, (0.1, 0.1, 0.1))
    measured(tmp_path, 1, (0.1, 0.1, 0.1))
    text = " ".join(history_text(read_history(tmp_path, index=tmp_path / "index"), NOW).split())
    assert "A drift cannot be determined yet: this takes 3 sessions" in text
    assert "No drift" not in text
    assert "imported" not in text  # measured sessions have their day


def test_a_rebuilt_machine_is_an_event(tmp_path: Path) -> None:
    measured(tmp_path, 0, (0.1, 0.1, 0.1))
    measured(tmp_path, 1, (0.1, 0.1, 0.1), leg_length_mm=311.0)
    machine = orthoglide(tmp_path, tmp_path / "index")
    assert machine.points[1].event == "machine file changed: leg_length_mm"


@LONG
def test_a_mechanical_change_begins_a_new_phase(tmp_path: Path) -> None:
    """Joint x drifts by 6 µm a month, too little to be called a change: three sessions before parts
    were moved and three after, each with the mean of its own.
    """
    for number in range(6):
        truth = (0.1 + 0.006 * number, 0.1, 0.1)
        measured(tmp_path, number, truth, adjusted="a" if number < 3 else "b")
    machine = orthoglide(tmp_path, tmp_path / "index")
    assert [point.event for point in machine.points] == [
        *("", "", ""),
        *("machine mechanically changed", "", ""),
    ]
    assert machine.joints[0].chart.centre == pytest.approx([0.106] * 3 + [0.124] * 3, abs=0.006)


def test_machines_of_one_name_are_known_apart_by_their_serial_numbers(tmp_path: Path) -> None:
    for number, serial_number in enumerate(("A1", "B2", "A1")):
        measured(tmp_path, number, (0.5, -0.3, 0.2), serial_number=serial_number, place="hall 3")
    machines = read_history(tmp_path, index=tmp_path / "index").machines
    assert [(machine.machine, len(machine.points)) for machine in machines] == [
        ("orthoglide, no. A1", 2),
        ("orthoglide, no. B2", 1),
    ]
    documents = json.loads(glidecal("history", tmp_path, "--json").out)["machines"]
    assert [
        (document["machine"], document["serial_number"], document["place"])
        for document in documents
    ] == [
        ("orthoglide", "A1", "hall 3"),
        ("orthoglide", "B2", "hall 3"),
    ]


def test_the_index_is_never_the_truth(tmp_path: Path) -> None:
    path = measured(tmp_path, 0, (0.1, 0.1, 0.1))
    index = tmp_path / "index"
    before = history_text(read_history(tmp_path, index=index), NOW)
    for damage in (b"no database, but long enough to be taken for one", index.read_bytes()[:5000]):
        index.write_bytes(damage)
        assert history_text(read_history(tmp_path, index=index), NOW) == before
    with sqlite3.connect(index) as data:  # another program wrote nonsense into it
        data.execute("UPDATE entry SET said = '{}'")
    data.close()
    assert history_text(read_history(tmp_path, index=index), NOW) == before
    assert history_text(read_history(tmp_path, index=tmp_path), NOW) == before  # a folder
    content, times = path.read_bytes(), path.stat()
    path.write_bytes(content.replace(b'"cycle":1', b'"cycle":2', 1))  # as long as before
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    ((_, problem),) = read_history(tmp_path, index=index).problems
    assert "was changed" in problem


@needs_links
def test_the_index_is_not_written_through_a_link(tmp_path: Path) -> None:
    measured(tmp_path, 0, (0.1, 0.1, 0.1))
    index, victim = tmp_path / "index", tmp_path / "victim"
    index.symlink_to(victim)
    before = history_text(read_history(tmp_path, index=index), NOW)
    assert not victim.exists()
    victim.touch()
    assert history_text(read_history(tmp_path, index=index), NOW) == before
    assert victim.read_bytes() == b""
    assert index.is_symlink()


def test_what_is_known_is_not_solved_again(
    folder: Path, index: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read_history(folder, index=index)
    monkeypatch.setattr("app.evaluating.solution.solve_sessions", None)
    assert len(orthoglide(folder, index).points) == 6


PRINTER = "printer.jsonl"
POSTURES = "postures.jsonl"
HEXASLIDE_TABLE = SAMPLES / "hexaslide" / "before.csv"
TOLD: dict[int, dict[str, tuple[float, ...]]] = {
    12: {
        "experiment_2_twelve.jsonl": (
            *(-0.52368, 0.53567, -1.6595, 0.72688, 0.72354, 0.72664),
            *(0.6666, 0.33852),
        ),
        "simulated_zero-max-min.jsonl": (
            *(0.8243, -1.2669, 0.3904, 0.02212, 0.00687, 0.00682),
            *(0.38848, 0.02753),
        ),
        "simulated_plane.jsonl": (
            *(0.83701, -1.26812, 0.38549, 0.01712, 0.01795, 0.01193),
            *(0.40001, 0.07232),
        ),
        PRINTER: (
            *(0.04202, -0.12884, 0.08668, 0.1441, 0.13841, 0.13903),
            *(0.35398, 0.35069),
        ),
        POSTURES: (1.58117, 0.01178),
    }
}
"""By `RESULTS`: offsets x, y, z, their half widths, the tool now and after, mm; of postures the
platform now and its bound.
"""


def told(entry: Entry) -> tuple[float, ...]:
    assert entry.offsets_mm is not None
    assert entry.expanded_mm is not None
    values = entry.offsets_mm + entry.expanded_mm + (entry.bound_before_mm, entry.bound_after_mm)
    return tuple(round(value, 5) for value in values)


def test_other_results_have_another_number(tmp_path: Path) -> None:
    """Fails where samples give other results: raise RESULTS in app/evaluating/history.py, and write
    the new ones here under that number. Else indexes of users would go on telling the old ones.
    """
    expected = TOLD[history.RESULTS]
    for name in expected:
        if (SAMPLES / name).is_file():
            shutil.copy(SAMPLES / name, tmp_path)
    printer = SAMPLES / "printer"
    files = (printer / "printer.cfg", printer / "probe.log")
    assert not run_here("import", *map(str, files), "-o", str(tmp_path / PRINTER))[0]
    hexaslide = ("--machine", "hexaslide", "--protocol", "position")
    assert not run_here("import", *hexaslide, str(HEXASLIDE_TABLE), "-o", str(tmp_path / POSTURES))[
        0
    ]
    past = read_history(tmp_path, index=tmp_path / "index", of_postures=LOOKS)
    results = {
        str(point.path): told(point.entry) for machine in past.machines for point in machine.points
    }
    (point,) = past.of_postures[0].points
    assert point.entry.now_mm is not None
    assert point.entry.bound_mm is not None
    results[str(point.path)] = point.entry.now_mm, point.entry.bound_mm
    assert results.keys() == expected.keys()
    for name, values in expected.items():
        assert results[name] == pytest.approx(values, abs=2e-5), f"{history.RESULTS=}, {results}"


def test_a_program_of_another_version_solves_nothing_again(
    folder: Path, index: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only another number of results does."""
    read_history(folder, index=index)
    content = (folder / "s0.jsonl").read_bytes()
    key = history.key_of(content)
    monkeypatch.setattr("app.version.version", lambda: "99.0")
    assert history.key_of(content) == key
    monkeypatch.setattr(history, "RESULTS", history.RESULTS + 1)
    assert history.key_of(content) != key


def test_it_tells_how_far_it_is(tmp_path: Path) -> None:
    for number in range(3):
        measured(tmp_path, number, (0.1, 0.1, 0.1))
    progress: list[tuple[float, int]] = []
    token = on_part.set(lambda done, parts: progress.append((done, parts)))
    read_history(tmp_path, index=tmp_path / "index")
    read_history(tmp_path, index=tmp_path / "index")
    on_part.reset(token)
    assert progress == [(1, 3), (2, 3), (3, 3)], "nothing the second time"


def test_what_there_is_no_time_for_waits(tmp_path: Path) -> None:
    for number in range(3):
        measured(tmp_path, number, (0.1, 0.1, 0.1))
    index = tmp_path / "index"
    (tmp_path / "s2.jsonl").rename(tmp_path / "later")
    read_history(tmp_path, index=index)
    (tmp_path / "later").rename(tmp_path / "s2.jsonl")
    past = read_history(tmp_path, index=index, within_s=0.0)
    assert (past.sessions, past.waiting) == (3, 1)
    assert [len(machine.points) for machine in past.machines] == [2], "those that are known"
    text = " ".join(history_text(past, NOW).split())
    assert text.startswith("WAIT: 1 of 3 sessions are still to be worked out.")
    assert read_history(tmp_path, index=index, within_s=PATIENCE_S).waiting == 0
    report = json.loads(glidecal("history", tmp_path, "--within", "0", "--json").out)
    assert (report["waiting"], report["machines"]) == (3, [])


@LONG
def test_many_sessions_are_worked_out_on_several_processors(tmp_path: Path) -> None:
    for number in range(history.MANY):
        measured(tmp_path, number, (0.1, 0.1, 0.1))
    shutil.copy(SAMPLES / "damaged.jsonl", tmp_path)
    one = history_text(read_history(tmp_path, index=tmp_path / "one"), NOW)
    command = f"""
from pathlib import Path
from app.evaluating.history import read_history
past = read_history(Path({str(tmp_path)!r}), index=Path({str(tmp_path / "two")!r}), processors=2)
print(past.waiting, len(past.machines[0].points))
"""
    process = subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert process.stdout == f"0 {history.MANY}\n"
    assert history_text(read_history(tmp_path, index=tmp_path / "two"), NOW) == one


def test_the_machine_that_is_shown_stays_when_others_come_before_it() -> None:
    def past(name: str) -> MachineHistory:
        entry = Entry(
            began=datetime(2026, 1, 1, tzinfo=UTC),
            machine=load_machine(None),
            offsets_mm=(0.0, 0.0, 0.0),
            expanded_mm=(0.01, 0.01, 0.01),
        )
        return history.history_of_machine(name, "measured", [(Path("a.jsonl"), entry)])

    empty = history.History(Path(), (), ((Path("b.jsonl"), "damaged"),), waiting=3)
    assert empty.of_shown(None).all_machines == ()
    assert not empty.of_shown(None).problems
    first = history.History(Path(), (past("second"),), ())
    shown = first.of_shown(empty.of_shown(None))
    assert [machine.machine for machine in shown.machines] == ["second"]
    both = history.History(Path(), (past("first"), past("second")), ())
    assert [machine.machine for machine in both.of_shown(shown).machines] == ["second"]
    gone = history.History(Path(), (past("first"),), ())
    assert [machine.machine for machine in gone.of_shown(shown).machines] == ["first"]


def test_one_machine_of_several(tmp_path: Path) -> None:
    for number, serial_number in enumerate(("A1", "B2", "A1")):
        (tmp_path / f"{number}").mkdir()
        measured(tmp_path / f"{number}", 0, (0.5, -0.3, 0.2), serial_number=serial_number)
    text = glidecal("history", tmp_path).out
    table = text[: text.index("\n\n")]
    assert ["orthoglide,", "no.", "A1,", "simulated", "2", "2026-01-01"] in [
        line.split() for line in table.splitlines()
    ]
    assert "\n1  0/s0.jsonl" in text, "with their folders"
    assert "\n2  2/s0.jsonl" in text
    for name, count in (("A1", 2), ("orthoglide, no. B2", 1), ("orthoglide", 3)):
        output = glidecal("history", tmp_path, "--machine", name, "--json").out
        machines = json.loads(output)["machines"]
        assert sum(len(machine["sessions"]) for machine in machines) == count
    assert machines[0]["sessions"][0]["session"] == "0/s0.jsonl"
    why_not = refused(2, "history", tmp_path, "--machine", "A")
    assert "no sessions of 'A'" in why_not
    assert "orthoglide, no. A1, orthoglide, no. B2" in " ".join(why_not.split())


@pytest.mark.parametrize(
    "name", first_quick(["simulated_plane", "simulated_zero-max-min", "experiment_1_six"])
)
def test_what_to_enter_needs_no_set_of_parameters(name: str) -> None:
    session = read_record(SAMPLES / f"{name}.jsonl").session
    alone, result = solve_sessions([session]), solve_sessions([session])
    assert alone.joint_offsets_mm == result.joint_offsets_mm
    assert alone.correction.bound_mm == result.correction.bound_mm
    assert [*alone.choice.identified] == ([*result.choice.identified] if "plane" in name else [])


def test_what_solve_refuses_has_no_line(tmp_path: Path) -> None:
    record = read_record(SAMPLES / "simulated_zero-max-min.jsonl")
    readings = [event for event in record.events if isinstance(event, Reading)][:1]
    write_whole(path := tmp_path / "one.jsonl", record.opened, [*readings])
    past = read_history(tmp_path, index=tmp_path / "index")
    ((_, problem),) = past.problems
    with pytest.raises(NotIdentifiable) as refusal:
        solve_files([path])
    assert problem == f"one.jsonl: {refusal.value}"
    assert past.all_machines == ()


def test_the_decision_is_that_of_solve(tmp_path: Path) -> None:
    path = measured(tmp_path, 0, (3.0, -4.0, 2.0))
    (machine,) = read_history(tmp_path, index=tmp_path / "index").machines
    assert machine.last.decision == judge(solve_files([path]), 0.5).before == "fail"


@LONG
def test_the_command(folder: Path, tmp_path: Path) -> None:
    report = json.loads(glidecal("history", folder, "--json").out)
    assert report["schema"] == "glidecal.history/1"
    (machine,) = (entry for entry in report["machines"] if entry["machine"] == "orthoglide")
    assert machine["joints"][2]["changed"][2] is True
    assert len(report["problems"]) == 3
    assert "no session file" in refused(3, "history", tmp_path)
    assert "No such file or directory" in refused(3, "history", tmp_path / "nowhere")


def test_effects_are_diagnosed_where_asked_for(tmp_path: Path) -> None:
    measured(tmp_path, 0, (0.1, 0.1, 0.1))
    index = tmp_path / "index"
    assert orthoglide(tmp_path, index).last.effects is None
    folder_history = read_history(tmp_path, effects=True, index=index)
    assert folder_history.machines[0].last.effects == ()


@LONG
@given(words=st.text(max_size=30))
@example(words="\ue000 {page.next} \ue000")  # what lines have for a key while they are broken
@settings(max_examples=100)
def test_hostile_names_are_inert(words: str) -> None:
    entry = Entry(
        began=BEGAN,
        machine=load_machine(None).model_copy(update={"name": f"=1+1[b]\x1b]0;{words}"}),
        offsets_mm=(0.0, 0.0, 0.0),
        expanded_mm=(0.1, 0.1, 0.1),
        effects=("[red]x[/red]",),
    )
    machine_history = history.history_of_machine(
        entry.machine.name, "measured", [(Path(f"[blink]{words}\u202e.jsonl"), entry)]
    )
    text = history_text(history.History(Path(), (machine_history,), ()), NOW)
    output = printable(text, keep="\n")  # as it leaves the program, and every screen
    assert not HIDDEN.search(output.replace("\n", ""))
    assert "[red]x[/red]" in output


def test_a_table_that_is_imported_again_is_used_once(tmp_path: Path) -> None:
    """Before: seven imports of one table were seven sessions, and their mean was very sure."""
    table = SAMPLES / "tables" / "experiment_2_six.csv"
    postures = ("--machine", "hexaslide", "--protocol", "position")
    for number, day in enumerate(("2026-01-01", "2026-02-01")):
        for name, source in (("t", (table,)), ("p", (*postures, HEXASLIDE_TABLE))):
            path = str(tmp_path / f"{name}{number}.jsonl")
            assert not run_here("import", *map(str, source), "--measured-on", day, "-o", path)[0]
    for _ in range(2):  # the second time as the index remembers it
        past = read_history(tmp_path, index=tmp_path / "index", of_postures=LOOKS)
        assert [len(machine.points) for machine in past.all_machines] == [1, 1]
        problems = {path.name: text for path, text in past.problems}
        assert problems.keys() == {"t1.jsonl", "p1.jsonl"}
        assert problems["t1.jsonl"].endswith("the same readings as t0.jsonl, used once.")
