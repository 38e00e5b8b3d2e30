"""The machine moves itself through a real LinuxCNC: right readings or none."""

from __future__ import annotations

from pathlib import Path

from tests.controller.self_running import commanded

SHORT = """schema = "glidecal.procedure/1"
name = "short"
title = "Both directions, one leg"
legs = ["x"]
cycles = 1
levels = ["zero", 22.0, 60.0, 22.0, -100.0]
"""


def test_a_session_runs_by_itself(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(SHORT)
    told = commanded(tmp_path, "session", str(tmp_path / "short.toml"), "30000", "0.1")
    assert told["wrong"] == []
    assert told["readings"] == 2 * 6


def test_another_client_a_lost_indicator_and_a_key_stop_it(tmp_path: Path) -> None:
    told = commanded(tmp_path, "disturbed", "3", "3")
    assert told["wrong"] == []
    assert told["met"] == 3


def test_a_killed_program_leaves_it_at_rest(tmp_path: Path) -> None:
    told = commanded(tmp_path, "killed")
    assert 2.0 <= float(str(told["there_mm"])) < 49.0  # of ten seconds
