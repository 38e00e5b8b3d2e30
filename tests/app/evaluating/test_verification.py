"""Was the right thing entered, and is the tool good enough? On simulated machines."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from app.evaluating.comparison import entered_word
from protocols.journal import write_whole
from protocols.record import read_record
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, SAMPLES, first_quick

D_RHO = (0.8, -0.5, 0.3)
NAMES = ("d_rho_x", "d_rho_y", "d_rho_z")


def session(folder: Path, name: str, times: float, seed: int, **fields: object) -> Path:
    """A machine whose offsets are so many times `D_RHO`."""
    values = dict(zip(NAMES, (times * mm for mm in D_RHO), strict=True))
    document = {"schema": "glidecal.model/1", "parameters_mm": values, **fields}
    model, path = folder / f"{name}.json", folder / f"{name}.jsonl"
    model.write_text(json.dumps(document))
    run = glidecal("simulate", "--model", model, "-o", path, "--seed", str(seed))
    assert run.status == 0, run.err
    return path


def test_chance_is_no_mechanical_change() -> None:
    """95 intervals of 100 hold the truth: of three values one is often outside."""
    words = [entered_word(1.0, left_mm, 0.01) for left_mm in (0.009, 0.016, 0.018, 0.984, 1.99)]
    assert words == ["as expected", "as expected", "something else", "not entered", "wrong sign"]


def test_an_offset_that_is_smaller_than_its_uncertainty_is_not_shown_to_be_entered() -> None:
    assert entered_word(0.005, 0.009, 0.01) == "not shown"
    assert entered_word(-0.1066, -0.1288, 0.243) == "not shown"
    assert entered_word(0.005, -0.007, 0.01) == "as expected"


@pytest.mark.parametrize(
    ("times", "entered", "decision"),
    first_quick(
        [
            (0.0, "as expected", "pass"),
            (1.0, "not entered", "fail"),
            (2.0, "wrong sign", "fail"),
            (0.5, "something else", "fail"),
        ],
        several=True,
    ),
)
def test_what_was_entered_and_whether_it_will_do(
    times: float, entered: str, decision: str, tmp_path: Path
) -> None:
    pair = (session(tmp_path, "a", 1.0, 1), session(tmp_path, "b", times, 2))
    run = glidecal("verify", *pair, "--tolerance", "0.05", "--json")
    assert run.status == {"pass": 0, "fail": 6}[decision]
    assert ("the verification did not pass: FAIL" in run.err) == (decision == "fail")
    report = json.loads(run.out)
    assert report["schema"] == "glidecal.verification/1"
    assert [offset["entered"] for offset in report["offsets"]] == [entered] * 3
    assert report["decision"] == decision
    assert not report["something_missing"]
    text = glidecal("verify", *pair, "--tolerance", "0.05").out
    assert decision.upper() in text
    assert ("Enter the offset" in text) == (entered == "not entered")


def test_the_tolerance_is_the_machines(tmp_path: Path) -> None:
    machine = {"schema": "glidecal.machine/1", "tool_tolerance_mm": 0.05}
    first = session(tmp_path, "a", 1.0, 1, machine=machine)
    second = session(tmp_path, "b", 0.0, 2, machine=machine)
    passed = glidecal("verify", first, second)
    assert "PASS: the tool is off by at most" in passed.out
    assert "± U of both" in passed.out, "solve has that of one session: another number"
    assert "Tolerance: 0.05 mm" in passed.out
    assert (passed.status, passed.err) == (0, "")
    undecided = glidecal("verify", first, second, "--tolerance", "0.0001")
    assert "Tolerance: 0.0001 mm" in undecided.out
    assert undecided.status == 7
    assert "the verification did not pass: UNDECIDED" in undecided.err


def test_the_figure_shown_is_on_the_side_of_the_tolerance_that_was_decided(tmp_path: Path) -> None:
    """A bound of 0.010608 mm is no 0.011 mm beside a PASS at 0.0107 mm."""
    pair = session(tmp_path, "a", 1.0, 1), session(tmp_path, "b", 0.0, 2)
    bound_mm = json.loads(glidecal("verify", *pair, "--json").out)["bound_found_mm"]
    for factor, status in ((1.0001, 0), (0.9999, 7)):
        run = glidecal("verify", *pair, "--tolerance", f"{factor * bound_mm:.12f}")
        assert run.status == status
        match = re.search(r"at most (\S+) mm r.m.s.", run.out)
        assert match
        assert (float(match[1]) <= factor * bound_mm) == (status == 0)
        assert float(match[1]) == pytest.approx(bound_mm, rel=0.05)


@LONG
def test_without_a_tolerance_nothing_is_judged_and_a_hidden_effect_is_pointed_at(
    tmp_path: Path,
) -> None:
    lean = {
        "id": "axis_squareness",
        "where": "xy",
        "parameters": {"lean": {"value": 2.0, "unit": "mrad"}},
    }
    first = session(tmp_path, "a", 1.0, 1, effects=[lean])
    second = session(tmp_path, "b", 0.0, 2, effects=[lean])
    run = glidecal("verify", first, second)
    assert "NOT JUDGED" in run.out
    assert "glidecal diagnose b.jsonl" in run.out
    assert run.status == 7, "a script must not take it for a pass"
    assert "NOT JUDGED" in run.err


def test_bad_pairs(tmp_path: Path) -> None:
    first = session(tmp_path, "a", 1.0, 1)
    assert "the same session" in refused(3, "verify", first, first)
    table, copies = SAMPLES / "tables" / "experiment_2_six.csv", []
    for name in ("once.jsonl", "again.jsonl"):  # before: in tolerance by the readings before
        copies.append(tmp_path / name)
        assert glidecal("import", table, "-o", copies[-1]).status == 0
    assert "again.jsonl: found the same readings twice, see " in refused(3, "verify", *copies)
    second = session(tmp_path, "b", 1.0, 2)
    assert "a positive length" in refused(2, "verify", first, second, "--tolerance", "0")


def of_machine(source: Path, target: Path, **changes: object) -> Path:
    """The same readings of a machine file that states something else."""
    record = read_record(source)
    machine = record.opened.machine.model_copy(update=changes)
    opened = record.opened.model_copy(update={"machine": machine})
    write_whole(target, opened, list(record.events[1:-1]))
    return target


def test_another_machine_of_the_same_kind_verifies_nothing(tmp_path: Path) -> None:
    first, second = session(tmp_path, "a", 1.0, 1), session(tmp_path, "b", 0.0, 2)
    numbered = of_machine(first, tmp_path / "first.jsonl", serial_number="OG-1")
    other = of_machine(second, tmp_path / "second.jsonl", serial_number="OG-2")
    words = refused(5, "verify", numbered, other)
    assert "serial numbers of two machines, OG-1 and OG-2" in words
    assert glidecal("verify", numbered, second, "--tolerance", "0.05").status == 0


def test_a_record_that_does_not_name_what_was_entered_is_pointed_at(tmp_path: Path) -> None:
    first, second = session(tmp_path, "a", 1.0, 1), session(tmp_path, "b", 0.0, 2)
    forgotten = json.loads(glidecal("verify", first, second, "--json").out)["remarks"]
    (remark,) = forgotten
    assert "d_rho_x, d_rho_y, d_rho_z of a.jsonl was entered, but not entered_offsets_mm" in remark
    rounded = tuple(round(mm, 2) for mm in D_RHO)
    path = of_machine(second, tmp_path / "named.jsonl", entered_offsets_mm=rounded)
    assert json.loads(glidecal("verify", first, path, "--json").out)["remarks"] == []
