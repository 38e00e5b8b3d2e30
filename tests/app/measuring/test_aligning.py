"""Rails aligned between rounds: what is recorded, and that nothing from before holds after."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.comparison import compare_files, verify_files
from app.evaluating.solution import solve_files
from app.measuring.aligning import Round, Watch, align_session
from app.measuring.indicators import simulated_indicators
from app.measuring.opening import start_session
from app.measuring.plan import QUICK_INTERVAL_S, Plan, aligning, plan_to_continue
from app.measuring.session import GuidedSession
from app.report.text.alignment import round_text, screw_text
from app.report.text.result import comparison_report
from calib.errors import UsageError
from calib.tripod.alignment import RailMoved
from protocols.machine import Machine, load_machine
from protocols.procedure import load_procedure
from protocols.record import read_record
from protocols.session import Changed, fold
from tests.app.cli import glidecal, refused
from tests.blind.tilted import SHAPES, Hidden, table
from tests.conftest import LONG

MACHINE = Machine(rail_mm=(200.0, 400.0))
FULL = load_procedure("align", MACHINE.geometry())
SHORT = FULL.model_copy(update={"cycles": 2, "plane": None})


def plan(path: Path) -> Plan:
    basis = Plan(path, MACHINE, SHORT, simulated_indicators(["mitutoyo-01a"] * 2), seed=3)
    return replace(aligning(basis, "x"), interval_s=QUICK_INTERVAL_S)


def measure(guided: GuidedSession) -> None:
    """Every step that is left; the record stays open."""
    guided.go()
    while (taken_step := guided.take()) is not None:
        if taken_step.doubt:
            guided.keep(taken_step, "kept")
        guided.go()


@contextmanager
def measured(path: Path) -> Iterator[tuple[GuidedSession, Round]]:
    with start_session(plan(path)) as guided:
        measure(guided)
        yield guided, Round(guided, align_session(guided.session, "x"))


def turn(guided: GuidedSession, work: Round, number: int, by_mm: float) -> None:
    shim = work.aligned.shims[number]
    work.number = number
    step = work.watch_step
    guided.watch(step)
    time.sleep(0.3)
    assert work.watch() is Watch.BEGUN
    assert guided.session.readings == ()  # whatever happens from here on
    assert guided.turn is not None
    guided.turn(RailMoved.by_shim(shim, by_mm), step)
    for _ in range(100):
        if abs((work.live_mm() or 0.0) - by_mm) < 0.05:
            break
        time.sleep(0.05)


@LONG
def test_a_round_of_turning_and_measuring(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    with measured(path) as (guided, work):
        before = max(range(8), key=lambda k: abs(work.aligned.shims[k].move_mm))
        shim = work.aligned.shims[before]
        turn(guided, work, before, shim.move_mm)
        assert work.live_mm() == pytest.approx(shim.move_mm, abs=0.05)  # scatter over the lever
        assert f"> {'xyz'[shim.rail].upper()}" in round_text(work)
        assert "mm to go" in screw_text(work)
        change = work.done(watched=True)
        assert guided.session.readings == ()
        assert guided.session.next_step() == guided.steps[0]
        assert not guided.restore(1, "no")
        measure(guided)
        again = align_session(guided.session, "x")
        assert abs(again.shims[before].move_mm) < 0.15
        guided.finish()
    record = read_record(path)
    session = fold(record.events)
    assert record.end == "closed"
    assert session.complete
    assert [event for event in record.events if isinstance(event, Changed)] == [*session.changes]
    assert [alteration.moved_mm is None for alteration in session.changes] == [True, False]
    assert (change.rail, change.towards, change.support_mm) == (
        "xyz"[shim.rail],
        "xyz"[shim.towards],
        shim.support_mm,
    )
    assert len(session.readings) * 2 == len(session.all_readings)
    assert {r.mount[-2:] for r in session.readings} == {"#2"}
    assert all(why.startswith("the machine was changed") for why in session.superseded.values())
    text = " ".join(glidecal("replay", path, "--headless").out.split())
    assert "superseded: the machine was changed" in text
    assert glidecal("validate", path).status == 0
    assert json.loads(glidecal("align", path, "--json", "--reference", "z").out)["reference"] == "z"


@LONG
def test_nothing_from_before_holds_after(tmp_path: Path) -> None:
    earlier, later = tmp_path / "a.jsonl", tmp_path / "b.jsonl"
    with start_session(plan(earlier)) as guided:
        measure(guided)
        guided.finish()
    with start_session(plan(later)) as guided:
        measure(guided)
        work = Round(guided, align_session(guided.session, "x"))
        work.number = 0
        work.done(watched=False)
        measure(guided)
        guided.finish()
    compared = compare_files(earlier, later)
    assert compared.changed
    assert compared.expected_mm is None
    text = " ".join(comparison_report(compared).split())
    assert "was mechanically changed" in text
    assert "expected" not in text
    assert json.loads(glidecal("compare", earlier, later, "--json").out)["rms_expected_mm"] is None
    for attempt in (
        lambda: verify_files(earlier, later),
        lambda: solve_files([earlier, later]),
    ):
        with pytest.raises(UsageError, match="mechanically changed between them"):
            attempt()
    run = glidecal("diagnose", earlier, later)
    assert run.status == 2
    assert "mechanically changed" in run.err


def test_the_name_in_the_machine_file_tells_it_too(tmp_path: Path) -> None:
    paths = []
    for adjusted in ("before", "after"):
        machine, path = tmp_path / f"{adjusted}.toml", tmp_path / f"{adjusted}.jsonl"
        machine.write_text(f'schema = "glidecal.machine/1"\nadjusted = "{adjusted}"\n')
        assert glidecal("simulate", "--machine", machine, "-o", path).status == 0
        paths.append(path)
    assert "mechanically changed" in glidecal("compare", *paths).out
    assert glidecal("verify", *paths).status == 2


def test_a_simulated_machine_stays_as_it_was_moved(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    with measured(path) as (guided, work):
        work.number = 5
        work.done(watched=False)
        shim = work.aligned.shims[5]
        guided.leave()
    plan = plan_to_continue(path)
    assert plan.reference == "x", "whoever continues it goes on aligning"
    effects = plan.bench.effects
    assert effects[-1] == RailMoved.by_shim(
        replace(shim, move_mm=0.0, expanded_mm=0.0), round(shim.move_mm, 4)
    )


@LONG
def test_the_next_session_starts_from_the_drives_as_they_lie(tmp_path: Path) -> None:
    """What a session tells of rails that are off, and one of that machine: nothing is left."""
    session, file, again = tmp_path / "a.jsonl", tmp_path / "lies.toml", tmp_path / "b.jsonl"
    off = ("--protocol", "align", "--effect", "axis_squareness:xy", "--size", "4.0")
    assert glidecal("simulate", *off, "-o", session).status == 0
    report = json.loads(
        glidecal("align", session, "--machine-file-out", file, "--reference", "y", "--json").out
    )
    machine = load_machine(file)
    x, y, _ = machine.geometry().direction
    assert y == (0.0, 1.0, 0.0)
    assert 1e3 * x[1] == pytest.approx(report["squareness_mrad"][0]["value"], abs=0.001)
    assert x[1] == pytest.approx(4e-3, abs=2e-4)
    assert "linuxcnc-kins" in file.read_text(encoding="utf-8")
    assert "there already" in refused(2, "align", session, "--machine-file-out", file)
    assert "align SESSION" in refused(2, "align", "--simulated", "--machine-file-out", file)
    assert "align SESSION" in refused(2, "align", "--simulated", "--force")
    assert glidecal("simulate", "--machine", file, "--seed", "2", "-o", again).status == 0
    assert json.loads(glidecal("diagnose", again, "--json").out)["verdict"] == "agrees"
    assert glidecal("plan", again).status == 0


def test_bad_input(tmp_path: Path) -> None:
    machine = tmp_path / "m.toml"
    machine.write_text('schema = "glidecal.machine/1"\nrail_mm = [300.0, 200.0]\n')
    run = glidecal("align", "--machine", machine, "--simulated")
    assert run.status == 3
    assert "rail_mm: the nearer end first" in run.err
    assert glidecal("align").status == 2
    run = glidecal("align", "--machine", "linear-delta", "--simulated")
    assert run.status == 2
    assert "are not along their drives at one Zero" in run.err  # not a crash on the screen
    run = glidecal("align", "--protocol", "plane", "--simulated")
    assert run.status == 5
    assert "do not show squareness xy" in run.err  # before any of it is measured
    run = glidecal("align", "--simulated")
    assert run.status == 2
    assert "--headless" not in run.err  # it has no such option
    (tmp_path / "s.jsonl").touch()  # a file that is not there is named first
    for unused in (
        *(("--simulated",), ("--seed", "1"), ("--protocol", "align")),
        *((name, "orthoglide") for name in ("--output", "--machine", "--protocol")),
        ("--continue", str(tmp_path / "s.jsonl")),
    ):
        assert "beside a session" in refused(2, "align", tmp_path / "s.jsonl", *unused)
    for unused in (("--seed", "1"), ("--protocol", "align"), ("--output", "a.jsonl")):
        message = refused(2, "align", "--continue", tmp_path / "s.jsonl", *unused)
        assert f"{unused[0]}: found beside --continue" in message
    assert "a session that was measured" in glidecal("align", "--simulated", "--json").err
    delta = tmp_path / "d.jsonl"
    assert glidecal("simulate", "--machine", "linear-delta", "-o", delta).status == 0
    run = glidecal("align", delta)
    assert run.status == 2
    assert "are not along their drives at one Zero" in run.err


def test_a_star_is_brought_to_its_machine_file(tmp_path: Path) -> None:
    """Drives 40 mrad from square by design; that of y leans 2 mrad more towards that of x.

    The table is of a simulation of its own. As designed nothing is to be moved; else the ends
    of one rail or the other, whose moves differ by 2 mrad of their distance.
    """
    shape = SHAPES["star"]
    (tmp_path / "star.toml").write_text(shape.file, encoding="utf-8")
    for size, needed in ((0.0, set()), (2e-3, {("y", "x")})):
        hidden = Hidden(np.zeros(3), np.zeros(3), "axis_squareness", (0, 1), size)
        csv = tmp_path / f"{size}.csv"
        csv.write_text(table(shape, hidden, np.random.default_rng(5), 0.002), encoding="utf-8")
        session = csv.with_suffix(".jsonl")
        glidecal("import", csv, "--machine", tmp_path / "star.toml", "-o", session)
        moves = json.loads(glidecal("align", session, "--json").out)["moves"]
        assert {(m["rail"], m["towards"]) for m in moves if m["needed"]} == needed
        if needed:
            first, second = (m for m in moves if m["needed"])
            way = second["support_mm"] - first["support_mm"]
            assert second["move_mm"] - first["move_mm"] == pytest.approx(-2e-3 * way, abs=0.02)
            assert "from the drives of the machine file" in glidecal("align", session).out
