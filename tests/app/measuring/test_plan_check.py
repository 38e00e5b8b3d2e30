"""What an operator may do before the record begins, without a terminal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from app.measuring.demo import demo_plan, watched_plan
from app.measuring.gauges import PushResult
from app.measuring.opening import PlanCheck
from app.report.text.motion import opened_text
from app.report.text.preparing import check_text, refused_text
from protocols.machine import Instrument

ACTIONS = ("begin", "retry", "port", "exchange")


def fitting(check: PlanCheck, *, opened: bool) -> list[str]:
    return [action for action in ACTIONS if check.fits(action, opened=opened)]


def test_what_does_not_open_is_tried_again_at_the_same_port_or_at_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    missing_port, refused = "/dev/ttyNONE7", "socket://127.0.0.1:1"
    instruments = (
        Instrument(profile="tesa", port=refused, axes="yxz"),
        Instrument(profile="sylvac", port=missing_port, axes="zyx"),
    )
    plan = replace(demo_plan(tmp_path, "zero-max-min", 1), instruments=instruments)
    check = PlanCheck(plan)
    assert fitting(check, opened=False) == []
    assert check.fits("back", opened=False)
    assert check.open() is None
    assert fitting(check, opened=False) == ["retry", "port"]
    assert refused_text(check).startswith(str(check.problem))
    name, adapter, ports_in_use = check.lost
    assert name == f"indicator 2 (sylvac, {missing_port})"
    assert (adapter, ports_in_use) == ("", [refused, missing_port])
    check.read_at("COM5")
    assert [instrument.port for instrument in check.plan.instruments] == [refused, "COM5"]


def test_a_wrong_port_that_was_chosen_can_be_chosen_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is here, or nobody can tell; and all the same the indicator is not there."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    missing_port = [Instrument(profile="tesa", port=f"/dev/ttyNONE{k}") for k in (1, 2)]
    plan = replace(demo_plan(tmp_path, "zero-max-min", 1), instruments=tuple(missing_port))
    check = PlanCheck(plan)
    numbers = []
    for wrong in (str(tmp_path), "socket://127.0.0.1:1", "socket://127.0.0.1:2"):
        assert check.open() is None
        assert "port" in fitting(check, opened=False)
        numbers.append(check.lost[0].split()[1])
        check.read_at(wrong)
    assert numbers == ["1", "2", "1"]


def test_ports_are_exchanged_where_the_other_spindle_moved(tmp_path: Path) -> None:
    plan = demo_plan(tmp_path, "zero-max-min", 1)
    instruments = [
        instrument.model_copy(update={"port": f"COM{k}"})
        for k, instrument in enumerate(plan.instruments, 1)
    ]
    check = PlanCheck(replace(plan, instruments=tuple(instruments)))
    check.find_spindles()
    assert check.spindles is not None
    assert fitting(check, opened=True) == ["begin"]
    check.spindles.finding = PushResult.OTHER
    assert fitting(check, opened=True) == ["begin", "exchange"]


def test_the_demonstration_of_home_opens_and_moves_by_hand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    check = PlanCheck(watched_plan(Path("demo-sessions")))
    assert check.plan.path.parent.is_dir()
    indicators = check.open()
    assert indicators is not None
    try:
        assert opened_text(check.plan, indicators.mover) == check_text(check.plan)
        check.find_spindles()
        assert check.spindles is None, "no hand pushes simulated ones"
    finally:
        indicators.close()
